#!/usr/bin/env bash
# Builds the package into python/dist: the native worlds, the Python half, and the program. Usage: python/build.sh [PROFILE]
# (release, the default, or dev, which is built sooner). MATURIN names maturin where it is not on the path.
set -euo pipefail
cd "$(dirname "$0")/.."
profile=${1:-release}
folder=$profile
[ "$profile" = dev ] && folder=debug
cargo build --locked --profile "$profile" -p leadtime
scripts=python/leadtime.data/scripts
mkdir -p "$scripts"
strip -o "$scripts/leadtime" "${CARGO_TARGET_DIR:-target}/$folder/leadtime"
"${MATURIN:-maturin}" build --locked --profile "$profile" --manifest-path python/Cargo.toml --out python/dist
