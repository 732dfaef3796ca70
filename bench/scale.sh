#!/usr/bin/env bash
# How a run scales: the learner's CPU with 1 to 256 actors, a slow world on all cores, and the same over lines of 5 and of 50 ms.
#
#     bench/scale.sh [--quick] [--seconds N] [--write]     a quarter of an hour; --quick: a minute, to see that everything works
#
# CPU is that of each process, so these figures hold on a busy machine; steps/s need a quiet one. Prints tables in Markdown;
# --write puts them into docs/scale.md and the figures into bench/scale.json. Bytes and the line need root and `ip`
# (iproute2). PROGRAM names slow_world where it is built already: all of `leadtime`, with one more world.
set -euo pipefail
cd "$(dirname "$0")/.."
if [ -z "${PROGRAM:-}" ]; then
    cargo build --release --quiet --locked --example slow_world
    PROGRAM=${CARGO_TARGET_DIR:-target}/release/examples/slow_world
fi
exec python3 bench/scale.py --program "$PROGRAM" "$@"
