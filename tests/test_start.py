"""What a command imports before it does anything: what it does not need costs every start."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

MEDIA = Path(__file__).resolve().parents[1] / "data" / "donor2-media.csv"
HEAVY = {"sklearn", "arviz", "arviz_stats", "corner", "distributed", "scipy.stats", "xarray"}


def imported(code: str) -> set[str]:
    """Modules of a process that ran some code."""
    listed = f"{code}\nimport sys\nprint('== modules:', *sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", listed], capture_output=True, text=True, check=True
    )
    return set(done.stdout.rsplit("== modules:", 1)[1].split())


def called(*arguments: str) -> str:
    """Code of a command that does not end the process."""
    return (
        "import contextlib\nfrom biaxbayes.cli import main\n"
        f"with contextlib.suppress(SystemExit): main({list(arguments)!r})"
    )


def test_the_help_imports_no_numbers():
    assert not imported(called("--help")) & {"numpy", "numba", "pandas"}


def test_a_look_at_a_file_imports_nothing_of_runs():
    found = imported(called("check", str(MEDIA)))
    assert "numpy" in found
    assert not found & (HEAVY | {"pandas", "h5py", "emcee", "matplotlib", "biaxbayes.runs.run"})


@pytest.mark.parametrize(("stated", "expected"), [({}, "1 {1}"), ({"OMP_NUM_THREADS": "4"}, "4")])
def test_a_command_takes_one_thread_for_its_matrices_unless_told_otherwise(stated, expected):
    code = called("check", str(MEDIA)) + (
        "\nimport os, numpy, threadpoolctl\nfound = threadpoolctl.threadpool_info()\n"
        "print('threads', os.environ['OMP_NUM_THREADS'], {f['num_threads'] for f in found})"
    )
    rest = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=rest | stated
    )
    assert done.stdout.rsplit("threads ", 1)[1].startswith(expected)


@pytest.mark.parametrize("stream", [1, 2])
def test_a_closed_stream_is_no_error(stream):
    command = f'exec "{sys.executable}" -m biaxbayes check "{MEDIA}" {stream}>&-'
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=True)
    assert done.stderr == ""


def test_code_that_may_not_be_compiled_is_refused_in_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "biaxbayes", "check", str(MEDIA)],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "NUMBA_DISABLE_JIT is set" in done.stderr


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "biaxbayes", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("biaxbayes")
