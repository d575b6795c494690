#!/usr/bin/env bash
# Create an environment, install biaxbayes, and sample two shipped specimens: a square alone, and a
# square with two strips of the same tissue.
set -euo pipefail
cd "$(dirname "$0")/.."

source scripts/environment.sh .venv .

echo "sampling data/donor2-media.csv, a square alone (the first run compiles for some seconds) ..."
biaxbayes sample data/donor2-media.csv --out demo/donor2-media-posterior --overwrite
echo
echo "sampling data/pieces, a square with two strips cut beside it ..."
biaxbayes sample data/pieces/square.csv data/pieces/strip-x.csv data/pieces/strip-y.csv --out demo/square-and-strips-posterior --overwrite
echo
echo "look at report.html, corner.pdf and stress-bands.pdf in both folders of demo"
echo "the same in the browser: pip install '.[app]', then biaxbayes app demo"
