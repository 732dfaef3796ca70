#!/usr/bin/env bash
# Python, both ways. The worlds as Gymnasium environments, one at a time and 64 with one call, beside Gymnasium's own. Then
# environments in Python: a bare loop, the worker alone, and a whole run (act and learn, lag 1), steps per second.
#
#     bench/python.sh [SECONDS per run, default 30]
#
# PYTHON names the interpreter that has gymnasium[box2d] and the package (python/build.sh). Nothing else should run on the machine; the
# run takes two cores.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$(command -v "${PYTHON:-python3}")
seconds=${1:-30}
leadtime=${LEADTIME:-}
if [ -z "$leadtime" ]; then
    cargo build --release --quiet --locked
    leadtime=${CARGO_TARGET_DIR:-target}/release/leadtime
fi
runs=$(mktemp -d)
trap 'rm -rf "$runs"' EXIT
export OMP_NUM_THREADS=1

"$python" bench/python_worlds.py

for id in CartPole-v1 LunarLander-v3; do
    alone=$("$python" bench/python_worker.py "$id" 16)
    echo "$alone"
    timeout --signal=INT "$seconds" "$leadtime" up --actors 1 -c python --runs "$runs" --name "${id,,}" \
        --set world.env.id="$id" --set "world.worker=\"$python $PWD/python/leadtime/worker.py\"" --set world.batch=64 \
        --set learner.n_envs=32 --set learner.total_steps=1000000000 >/dev/null 2>&1 || true
    "$python" - "$runs/${id,,}/metrics.jsonl" "$alone" <<'PY'
import json, statistics, sys
rates = [json.loads(line).get("system/steps_per_second") for line in open(sys.argv[1])]
rates = [rate for rate in rates if rate]
run, alone = statistics.median(rates[len(rates) // 2:]), json.loads(sys.argv[2])
print(json.dumps({"run": alone["environment"], "steps/s": round(run), "of the bare loop": round(run / alone["bare steps/s"], 2)}))
PY
done
