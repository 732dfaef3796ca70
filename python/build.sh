#!/usr/bin/env bash
# Builds the package into python/dist: the native worlds, the Python half, and the program. Usage: python/build.sh [PROFILE]
# (release, the default, or dev, which is built sooner, with the features that tests have). PROGRAM names a program that is
# built already, MATURIN maturin where it is not on the path.
set -euo pipefail
cd "$(dirname "$0")/.."
profile=${1:-release}
maturin=${MATURIN:-maturin}
if ! command -v "$maturin" >/dev/null; then
    echo "error: $maturin is not here: pip install maturin" >&2
    exit 2
fi
if [ -z "${PROGRAM:-}" ]; then
    cargo build --locked --profile "$profile" -p leadtime
    folder=$profile
    [ "$profile" = dev ] && folder=debug
    PROGRAM=${CARGO_TARGET_DIR:-target}/$folder/leadtime
fi
mkdir -p python/leadtime.data/scripts
strip -o python/leadtime.data/scripts/leadtime "$PROGRAM"
if [ "$profile" = dev ]; then
    # Who tests the package has the tests' crates; cargo alone would compile a hundred of them again, with fewer features.
    CARGO=$PWD/python/cargo.sh
    export CARGO
fi
# One package is in the folder: this one.
rm -f python/dist/*.whl
"$maturin" build --locked --profile "$profile" --manifest-path python/Cargo.toml --out python/dist
