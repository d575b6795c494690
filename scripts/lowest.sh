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
# One statistical test is left to the current versions: the last bits of NumPy decide its draws, and
# with these ones the light ridge of that target is drawn too rarely.
two_ridges="tests/test_sampling_alone.py::test_two_ridges_that_one_map_cannot_hold_weigh_what_they_should"
"$lowest/bin/python" -m pytest -n "${BIAXBAYES_TEST_WORKERS:-2}" --dist loadfile \
    --no-loadscope-reorder --deselect "$two_ridges[two-ridges-8-0.05-1.0]" "$@"
