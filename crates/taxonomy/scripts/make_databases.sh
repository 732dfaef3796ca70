#!/usr/bin/env bash
# Makes the shipped databases anew from their plans and annotations: call log, database and report under crates/taxonomy/data.
# Build the program first (`cargo build --release -p leadtime --features minilm`) and fetch the embedder
# (`fetch_model.sh`). Starts from the beginning: what an older plan or prompt asked for has no place in a log.
set -euo pipefail
usage="usage: make_databases.sh LEADTIME EMBEDDER_DIRECTORY"
leadtime=$(realpath "${1:?$usage}")
embedder=$(realpath "${2:?$usage}")
cd "$(dirname "$0")/../data"
fresh=$(mktemp -d)
trap 'rm -r "$fresh"' EXIT
for domain in lander highway steakhouse; do
    "$leadtime" taxonomy build "$domain/plan.toml" --backend authored --annotations "$domain/annotations.txt" \
        --embedder "$embedder" -o "$fresh/$domain"
    cp "$fresh/$domain"/{calls.jsonl,taxonomy.toml,coverage.md} "$domain/"
done
