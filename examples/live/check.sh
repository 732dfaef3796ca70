#!/usr/bin/env bash
# Lets the Python client be spoken to for 100 steps. Usage: examples/live/check.sh PROGRAM PYTHON
set -euo pipefail
program=$(realpath "$1") python=$(realpath -s "$2")
cd "$(dirname "$0")/../.."
place=$(mktemp -d)
# 100 steps of 20 ms hold several sentences only where a word takes a step.
"$program" serve deploy/policies/piloting.safetensors --listen tcp/127.0.0.1:0 --voice text 2>"$place/log" &
notifier=$!
trap 'kill $notifier; wait $notifier || true; rm -rf "$place"' EXIT
for _ in $(seq 100); do
    grep -q "is at work at" "$place/log" && break
    sleep 0.1
done
endpoint=$(sed -n 's/.* is at work at \(tcp[^ ]*\).*/\1/p' "$place/log")
"$python" examples/live/client.py "$endpoint" 0.02 | tee "$place/said"
grep -q "^session [0-9a-f]*: 8 numbers, topics ascend, " "$place/said"
n=$(grep -c "understood after" "$place/said")
[ "$n" -ge 3 ] || { echo "$n sentences in 100 steps"; exit 1; }
if grep -E "stale|lost|closed" "$place/said"; then exit 1; fi
