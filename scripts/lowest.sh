#!/usr/bin/env bash
# Run the fast tests with the lowest versions that pyproject.toml declares, in an environment of
# their own. It takes a Python for which these versions were built: 3.11 or 3.12.
set -euo pipefail
cd "$(dirname "$0")/.."

source scripts/environment.sh .venv-test '.[dev]'
lowest="$PWD/.venv-lowest"
[ -x "$lowest/bin/uv" ] || { python -m venv "$lowest" && "$lowest/bin/pip" install --quiet uv; }
"$lowest/bin/uv" pip install --quiet --python "$lowest/bin/python" --resolution lowest-direct \
    --editable '.[test]'
export OMP_NUM_THREADS=1 MPLBACKEND=Agg
"$lowest/bin/python" -m pytest -n "${BIAXBAYES_TEST_WORKERS:-2}" --dist loadfile \
    --no-loadscope-reorder "$@"
