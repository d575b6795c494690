#!/usr/bin/env bash
# Build the documentation into site/; a broken link or reference is an error.
set -euo pipefail
cd "$(dirname "$0")/.."

source scripts/environment.sh .venv-docs '.[docs]'

python scripts/docs_verbs.py --check
NO_MKDOCS_2_WARNING=1 mkdocs build --strict --quiet
echo "open site/index.html"
