#!/usr/bin/env bash
# The drill: half an hour in which a run is hit by everything that goes wrong, once in each deterministic mode. Says what
# it did, and fails if the weights differ from those of an undisturbed run, if the books do not balance, if memory or a
# file is left behind, or if somebody was let in who may not. Usage: bench/drill.sh [MINUTES of blows per mode, default 10]
# PROGRAM names a program that is built already.
set -euo pipefail
cd "$(dirname "$0")/.."
[ -n "${PROGRAM:-}" ] || cargo build --release --locked -q
place=$(mktemp -d)
trap 'code=$?; if [ $code = 0 ]; then rm -rf "$place"; else echo "what it left: $place" >&2; fi' EXIT
for mode in sync lag; do
    python3 bench/drill.py --program "${PROGRAM:-target/release/leadtime}" --place "$place/$mode" --mode "$mode" --minutes "${1:-10}"
done
