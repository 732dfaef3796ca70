#!/usr/bin/env bash
# Cargo for maturin where tests were built before: builds the whole workspace with its tests, so that every crate has the features
# that it was compiled with then, and only the native module is left. Usage: CARGO=python/cargo.sh maturin build ...
set -euo pipefail
[ "${1:-}" = rustc ] || exec cargo "$@"
shift
kept=()
for argument in "$@"; do
    # What follows is for the compiler, and for one crate alone.
    [ "$argument" = -- ] && break
    kept+=("$argument")
done
exec cargo build --workspace --tests "${kept[@]}"
