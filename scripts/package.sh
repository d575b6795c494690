#!/usr/bin/env bash
# Build the wheel and the sdist, install each in an environment of its own, and run the main job.
# The extras are resolved against the package index; add --extras to install them as well.
set -euo pipefail
cd "$(dirname "$0")/.."

source scripts/environment.sh .venv .
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python -m pip install --quiet --disable-pip-version-check build
python -m build --outdir "$folder/dist" .
specimen="$PWD/data/donor2-media.csv"
cd "$folder"

for file in dist/*.whl dist/*.tar.gz; do
    python -m venv "$folder/clean"
    clean="$folder/clean/bin"
    "$clean/python" -m pip install --quiet --disable-pip-version-check "$file"
    "$clean/biaxbayes" --version
    "$clean/biaxbayes" sample "$specimen" --out run --ess 200 --quiet
    test -s run/report.html -a -s run/corner.pdf
    for extra in fe xlsx bench cluster docs; do
        if [ "${1:-}" = "--extras" ]; then how=(); else how=(--dry-run); fi
        "$clean/python" -m pip install --quiet --disable-pip-version-check "${how[@]}" "$file[$extra]"
        echo "$file[$extra] resolves"
    done
    rm -rf run "$folder/clean"
    echo "$file installs and samples"
done
