"""Memory that is free goes back to the system, and a picture is in memory once."""

import os
import platform
import subprocess
import sys

import pytest

from biaxbayes.jobs.batch import tasks

ON_LINUX = pytest.mark.skipif(
    sys.platform != "linux", reason="elsewhere /proc does not say what a process holds"
)
GNU = pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="only the GNU C library can be asked to"
)

RESIDENT = """
import os
def resident_MB():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6
"""


def _printed(script):
    own = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")}  # Dask leaves some
    command = [sys.executable, "-c", RESIDENT + script]
    run = subprocess.run(command, capture_output=True, text=True, check=True, env=own)
    return [float(word) for word in run.stdout.split()]


FREED = """
import numpy as np
from biaxbayes.executors import memory

np.ones(3_000_000)  # the limit of the C library grows to 24 MB as this is freed
{first}
pairs = [[np.ones(1_000_000), np.ones(100_000)] for _ in range(5)]  # 8 MB, and 0.8 MB above
full = resident_MB()
for pair in pairs:
    del pair[0]
print(full - resident_MB())
"""


@ON_LINUX
@GNU
def test_large_arrays_go_back_once_they_are_freed():
    (kept,) = _printed(FREED.format(first=""))
    (freed,) = _printed(FREED.format(first="memory.return_arrays()"))
    assert kept < 8.0 and freed > 39.0


@ON_LINUX
def test_a_picture_is_not_copied():
    surface, took = _printed(
        """
from biaxbayes.figures.style import blank_figure, figure_bytes, print_style

def peak_MB():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM"))

with print_style():
    figure_bytes(blank_figure(1.0, 1.0), "png")
    figure = blank_figure(20.0, 20.0)
    before = resident_MB()
    figure_bytes(figure, "png")
print(4 * (20 * 300) ** 2 / 1e6, peak_MB() - before)
"""
    )
    assert 0.9 * surface < took < 1.3 * surface


def test_workers_keep_no_large_arrays(monkeypatch):
    asked = []
    monkeypatch.setattr(tasks, "return_arrays", lambda: asked.append(True))
    monkeypatch.setattr(tasks, "compare_layers", lambda task: task.donor)
    task = tasks.LayerTask("D1", (), (), ())
    assert tasks.work_on(task) == "D1" and not asked  # in the user's own process nothing is set
    monkeypatch.setattr(tasks.multiprocessing, "parent_process", lambda: True)
    assert tasks.work_on(task) == "D1" and asked
