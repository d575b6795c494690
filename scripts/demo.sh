#!/usr/bin/env bash
# Create an environment, install biaxbayes, and run the main job on a shipped specimen.
set -euo pipefail
cd "$(dirname "$0")/.."

source scripts/environment.sh .venv .

echo "sampling data/donor2-media.csv (the first run compiles for some seconds) ..."
biaxbayes sample data/donor2-media.csv --out demo/donor2-media-posterior --overwrite
echo
echo "look at demo/donor2-media-posterior/report.html, corner.pdf and stress-bands.pdf"
