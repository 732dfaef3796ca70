#!/usr/bin/env bash
# Runs every command that README and docs show. Usage: docs/check.sh [--full [--write]] [PROGRAM]
#
# PROGRAM is the built `leadtime` (default: target/release/leadtime, built first). Long trainings are shortened to one
# update, studies to their plan; --full also trains the three worlds and compares README's tables with what comes out.
# --full --write does nothing but that, and keeps what came out in docs/results/smoke_*.json, where tests/docs.rs finds it.
set -euo pipefail
cd "$(dirname "$0")/.."

full=()
if [ "${1:-}" = --full ]; then
    full=(--full)
    shift
    if [ "${1:-}" = --write ]; then full+=(--write); shift; fi
fi
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
exec "$python" docs/check.py "${full[@]}" "$(realpath "$program")"
