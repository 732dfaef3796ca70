#!/usr/bin/env bash
# What encryption, a status page and a live page cost: the same run in turns over plain TCP; over TLS; over TLS while its
# status is scraped and its live page is read, without the playthrough (`curves`); and the same with it (`watched`).
#
#     bench/secure.sh [SECONDS per run, default 30] [ROUNDS, default 5]     on two cores, nothing else running
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-30}
rounds=${2:-5}
cargo build --release --quiet --locked
leadtime=$PWD/${CARGO_TARGET_DIR:-target}/release/leadtime
place=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$place"' EXIT
cd "$place"
"$leadtime" certs init pki >/dev/null
"$leadtime" certs issue pki learner:l1@127.0.0.1 actor:a1 observer:o1 >/dev/null 2>&1

# One run of these seconds; prints steps per second over its second half.
run() {
    local kind=$1 name=$2 port=$3 learner=() actor=() watch=() scheme=tcp is_watched=
    if [ "$kind" != tcp ]; then
        scheme=tls
        learner=(--tls pki/l1 --acl pki/acl.json5)
        actor=(--tls pki/a1)
    fi
    case $kind in
        curves) is_watched=yes watch=(--play off) ;;
        watched) is_watched=yes ;;
    esac
    if [ "$is_watched" ]; then learner+=(--status "127.0.0.1:$((port + 1))"); fi
    "$leadtime" learner -c lander --name "$name" --runs runs --set learner.total_steps=100000000 --seed 1 \
        --listen "$scheme/127.0.0.1:$port" "${learner[@]}" >"$name.log" 2>&1 &
    local learner_id=$!
    "$leadtime" actor --connect "$scheme/127.0.0.1:$port" --id a1 "${actor[@]}" >"$name-actor.log" 2>&1 &
    local others=($!)
    if [ "$is_watched" ]; then
        "$leadtime" watch --connect "$scheme/127.0.0.1:$port" --tls pki/o1 --http "127.0.0.1:$((port + 2))" "${watch[@]}" >"$name-watch.log" 2>&1 &
        others+=($!)
        while sleep 1; do curl -s "http://127.0.0.1:$((port + 1))/metrics"; done >/dev/null &
        others+=($!)
        { sleep 3; curl -sN "http://127.0.0.1:$((port + 2))/events"; } >/dev/null &
        others+=($!)
    fi
    sleep "$seconds"
    kill -INT "$learner_id" 2>/dev/null || true
    wait "$learner_id" 2>/dev/null || true
    kill "${others[@]}" 2>/dev/null || true
    wait "${others[@]}" 2>/dev/null || true
    python3 - "runs/$name/metrics.jsonl" <<'PY'
import json, statistics, sys
rates = [json.loads(line).get("system/steps_per_second") for line in open(sys.argv[1])]
rates = [rate for rate in rates if rate]
print(round(statistics.median(rates[len(rates) // 2:])))
PY
}

port=47400
for round in $(seq "$rounds"); do
    for kind in tcp tls curves watched; do
        port=$((port + 3))
        echo "$kind $(run $kind "$kind-$round" $port)" | tee -a figures
    done
done
python3 - <<'PY'
import statistics
figures = {}
for line in open("figures"):
    kind, steps = line.split()
    figures.setdefault(kind, []).append(int(steps))
plain = statistics.median(figures["tcp"])
for kind, steps in figures.items():
    middle = statistics.median(steps)
    print(f"{kind:8} {middle:8.0f} steps/s, {100 * middle / plain:5.1f} % of plain TCP, {min(steps)} to {max(steps)}")
PY
