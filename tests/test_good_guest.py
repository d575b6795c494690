"""A good guest in the process of somebody else: nothing of the host is changed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DATA = Path(__file__).parents[1] / "data" / "donor2-media.csv"
HOST = """
import multiprocessing, os, random, signal, sys, threading, warnings
from pathlib import Path
import matplotlib
import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_info

def snapshot():
    return {
        "environment": dict(os.environ),
        "start method": multiprocessing.get_start_method(allow_none=True),
        "signal handlers": {s: signal.getsignal(s) for s in signal.valid_signals()},
        "numpy errors": np.geterr(),
        "random": random.getstate(),
        "numpy random": repr(np.random.get_state()),
        "threads": sorted(t.name for t in threading.enumerate()),
        "children": multiprocessing.active_children(),
        "folder": os.getcwd(),
        "BLAS threads": [i["num_threads"] for i in threadpool_info()],
        "matplotlib": matplotlib.rcParams.copy(),
        # Libraries that are imported add filters for warnings of their own.
        "warnings": [f for f in warnings.filters if f[1] is None and f[2].__module__ == "builtins"],
    }

if __name__ == "__main__":
    random.seed(1); np.random.seed(1)
    before = snapshot()

    def compare(verb):
        now = snapshot()
        different = {k: (v, now[k]) for k, v in before.items() if now[k] != v}
        print(verb, different or "unchanged", flush=True)

    import biaxbayes
    compare("import")
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    run = biaxbayes.sample(data, out=out / "run", ess=50, max_steps=128, workers=2)
    compare("sample")
    biaxbayes.plot(run, "corner", out=out / "corner")
    compare("plot")
    biaxbayes.batch([data], out=out / "study", workers=2, ess=50, max_steps=128)
    compare("batch")
"""
TWO_THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import biaxbayes

def results(folder):
    run = biaxbayes.sample(data, out=folder, ess=50, max_steps=128, progress=False)
    biaxbayes.plot(run, "corner", out=folder / "corner.svg")
    return run.draws, (folder / "corner.svg").read_bytes()

data, out = Path(sys.argv[1]), Path(sys.argv[2])
draws, figure = results(out / "single")
with ThreadPoolExecutor(2) as threads:
    for other, drawn in threads.map(results, [out / "a", out / "b"]):
        print(draws.equals(other), drawn == figure)
"""


def output(folder: Path, code: str, environment: dict[str, str]) -> list[str]:
    """Lines that a program prints which is given a specimen and a folder."""
    script = folder / "host.py"
    script.write_text(code)
    command = [sys.executable, script, DATA, folder]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.long
def test_nothing_of_the_host_is_changed(tmp_path):
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "MPL"))}
    verbs = ("import", "sample", "plot", "batch")
    assert output(tmp_path, HOST, environment) == [f"{verb} unchanged" for verb in verbs]


@pytest.mark.long
def test_two_threads_give_the_results_of_one_and_load_no_backend(tmp_path):
    """Jupyter passes its MPLBACKEND on to the programs that a cell starts."""
    environment = os.environ | {"MPLBACKEND": "module://no_backend_of_this_name"}
    assert output(tmp_path, TWO_THREADS, environment) == ["True True"] * 2
