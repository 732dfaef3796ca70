#!/usr/bin/env bash
# Every benchmark beside its peer, one after the other, each on one core (the whole systems on two).
#
#     bench/side_by_side.sh [SECONDS per whole system, default 30]     about ten minutes after the build
#
# PYTHON names the interpreter that has the peers (gymnasium[box2d], envpool, torch, sample-factory); a peer whose packages are missing says so.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
seconds=${1:-30}
export OMP_NUM_THREADS=1 MKL_NUM_THREADS=1
cargo build --release --quiet --locked
leadtime=${CARGO_TARGET_DIR:-target}/release/leadtime
runs=$(mktemp -d)
trap 'rm -rf "$runs"' EXIT

ours() { taskset -c 0 cargo bench --quiet --locked --workspace --bench "$1" -- --noplot --warm-up-time 1 --measurement-time 3 |
    grep -E '^[a-z].*/|thrpt:' | grep -v change; }
peer() { taskset -c 0 "$python" "bench/peers/$1" || true; }
# Steps per second over a run's second half, from its own metrics: the time of starting does not count.
whole() {
    local name=$1
    shift
    timeout --signal=INT "$seconds" "$leadtime" up --actors 1 --runs "$runs" --name "$name" "$@" >/dev/null 2>&1 || true
    "$python" - "$runs/$name/metrics.jsonl" <<'PY'
import json, statistics, sys
rates = [json.loads(line).get("system/steps_per_second") for line in open(sys.argv[1])]
rates = [rate for rate in rates if rate]
print(json.dumps({"ours": sys.argv[1].split("/")[-2], "steps_per_second": round(statistics.median(rates[len(rates) // 2:]))}))
PY
}

echo "== lander, frames/s"
ours lander
peer lander_gymnasium.py
peer lander_envpool.py
echo "== notifier, steps/s"
ours notifier
echo "== inference, observations/s; update, samples/s"
ours inference
ours acting
ours update
peer ppo_torch.py
echo "== whole systems, steps/s on two cores"
small=(--set learner.n_envs=4 --set learner.n_steps=128 --set learner.n_minibatches=4 --set learner.n_epochs=4 --set learner.mode=lag --set learner.total_steps=100000000)
whole pilot -c pilot "${small[@]}"
"$python" bench/peers/whole_cleanrl_style.py "$seconds" || true
whole notifier-small -c lander "${small[@]}"
whole notifier -c lander --set learner.total_steps=100000000
"$python" bench/peers/whole_sample_factory.py "$seconds" || true
