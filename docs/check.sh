#!/usr/bin/env bash
# Runs every command that README and docs show. Usage: docs/check.sh [--write] [PROGRAM]
#
# PROGRAM is the built `leadtime` (default: target/release/leadtime, built first). Long trainings are shortened to one
# update, studies to their plan. --write trains the three worlds instead, as README does, and keeps what comes out in
# docs/results/smoke_*.json, with which tests/docs.rs compares README's tables.
set -euo pipefail
cd "$(dirname "$0")/.."

write=()
if [ "${1:-}" = --write ]; then write=(--write); shift; fi
program=${1:-}
if [ -z "$program" ]; then
    cargo build --release --locked -p leadtime
    program=target/release/leadtime
fi
if ! command -v python3 >/dev/null; then
    echo "skipped: no Python here"
    exit
fi
python=python3
if ! python3 -c 'import numpy' 2>/dev/null; then
    # Without it, everything else is checked.
    python3 -m venv .venv/docs && .venv/docs/bin/pip install -q numpy && python=.venv/docs/bin/python
fi
exec "$python" docs/check.py "${write[@]}" "$(realpath "$program")"
