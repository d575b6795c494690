#!/usr/bin/env bash
# Create an environment, install biaxbayes with what its tests need, and run them.
# Further arguments go to pytest: -m long runs whole runs and studies of three seconds and more, which
# continuous integration runs as well, -m slow those of many minutes.
set -euo pipefail
cd "$(dirname "$0")/.."

source scripts/environment.sh .venv-test '.[dev]'

ruff format --check src tests scripts benchmark
ruff check src tests scripts benchmark
mypy
export OMP_NUM_THREADS=1 MPLBACKEND=Agg
pytest -n "${BIAXBAYES_TEST_WORKERS:-2}" --dist loadfile --no-loadscope-reorder "$@"
