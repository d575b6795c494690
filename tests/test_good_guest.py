"""A good guest in the process of somebody else: nothing of the host is changed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DATA = Path(__file__).parent.parent / "data"
HOST = """
import gc, multiprocessing, os, random, signal, sys, threading, time, warnings
from pathlib import Path
import matplotlib
import numba
import numpy as np
from threadpoolctl import threadpool_info

def children():
    "Processes of ours, but for the tracker that multiprocessing keeps to clean up after spawning."
    own = str(os.getpid())
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if (path / "stat").read_text().rpartition(")")[2].split()[1] == own:
                found.append((path / "cmdline").read_bytes().decode())
        except OSError:
            continue
    return [line for line in found if "resource_tracker" not in line]

def snapshot():
    return {
        "environment": dict(os.environ),
        "start method": multiprocessing.get_start_method(allow_none=True),
        "signal handlers": {s: signal.getsignal(s) for s in signal.valid_signals()},
        "blocked signals": signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        "numpy errors": np.geterr(),
        "random": random.getstate(),
        "numpy random": repr(np.random.get_state()),
        "threads": sorted(t.name for t in threading.enumerate()),
        "children": children() + multiprocessing.active_children(),
        "folder": os.getcwd(),
        "BLAS threads": [i["num_threads"] for i in threadpool_info()],
        "garbage collector": (
            gc.isenabled(), gc.get_threshold(), gc.get_freeze_count() > 0, list(gc.callbacks)
        ),
        "matplotlib": matplotlib.rcParams.copy(),
        # Libraries that are imported add filters for warnings of their own.
        "warnings": [f for f in warnings.filters if f[1] is None and f[2].__module__ == "builtins"],
        "numba": {k: v for k, v in vars(numba.config).items() if k.isupper()},
    }

if __name__ == "__main__":
    import scipy.linalg
    random.seed(1); np.random.seed(1); gc.freeze()
    signal.signal(signal.SIGUSR1, lambda *_: None)
    before = snapshot()

    def unchanged(what):
        now = snapshot()
        different = {k: (v, now[k]) for k, v in before.items() if now[k] != v}
        print(what, "unchanged" if not different else different, flush=True)

    import biaxbayes
    unchanged("import")
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    run = biaxbayes.sample(data, out=out / "run", ess=50, max_steps=128, workers=2)
    unchanged("sample")
    biaxbayes.plot(run, "corner", out=out / "corner")
    unchanged("plot")
    biaxbayes.report(run, "html", out=out / "report.html")
    unchanged("report")
    other = out / "other.csv"
    other.write_bytes(data.read_bytes())
    biaxbayes.batch([data, other], out=out / "study", workers=2, ess=50, max_steps=128)
    unchanged("batch")
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="children are looked up in /proc")
def test_nothing_of_the_host_is_changed(tmp_path):
    script = tmp_path / "host.py"
    script.write_text(HOST)
    command = [sys.executable, script, DATA / "donor2-media.csv", tmp_path]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "MPL"))}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    verbs = ("import", "sample", "plot", "report", "batch")
    assert done.stdout.splitlines() == [f"{verb} unchanged" for verb in verbs]


TWO_THREADS = """
import sys, threading, warnings
from pathlib import Path
import matplotlib
import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_info
import biaxbayes

def settings():
    threads = [library["num_threads"] for library in threadpool_info()]
    return matplotlib.rcParams.copy(), list(warnings.filters), threads, np.geterr()

def sampled(folder):
    return biaxbayes.sample(data, out=folder, ess=50, max_steps=128, progress=False)

def drawn(run, folder):
    biaxbayes.plot(run, "corner", out=folder / "corner.svg")
    return (folder / "corner.svg").read_bytes()

def at_once(function, *arguments):
    answers = {}
    def call(k):
        answers[k] = function(*(a[k] for a in arguments))
    threads = [threading.Thread(target=call, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [answers[k] for k in range(2)]

data, out, trials = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
run = sampled(out / "single")
figure = drawn(run, out)
before = settings()
for trial in range(trials):
    folders = [out / f"{trial}-{k}" for k in range(2)]
    runs = at_once(sampled, folders)
    figures = at_once(drawn, runs, folders)
    print(
        all(np.array_equal(run.draws, other.draws) for other in runs),
        all(other == figure for other in figures),
        settings() == before,
        flush=True,
    )
"""


@pytest.mark.long
def test_two_threads_that_sample_and_plot_give_the_results_of_one(tmp_path):
    script = tmp_path / "threads.py"
    script.write_text(TWO_THREADS)
    command = [sys.executable, script, DATA / "donor2-media.csv", tmp_path, "2"]
    environment = os.environ | {"MPLBACKEND": "module://no_backend_of_this_name"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["True True True"] * 2


@pytest.mark.long
@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline", "no-backend"])
def test_the_backend_of_a_notebook_is_not_loaded(tmp_path, backend):
    """Jupyter passes its MPLBACKEND on to the programs that a cell starts."""
    environment = os.environ | {"MPLBACKEND": backend}
    program = [sys.executable, "-m", "biaxbayes"]
    plan = ["--ess", "50", "--max-steps", "128"]
    data = DATA / "donor2-media.csv"
    for command in (
        ["sample", data, "--out", tmp_path / "run"],
        ["batch", data, "--out", tmp_path / "study", "--workers", "1"],
    ):
        done = subprocess.run(
            [*program, *command, *plan],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )
        assert done.returncode in (0, 3), done.stderr  # so few draws do not converge
        assert backend not in done.stderr and "internal error" not in done.stdout + done.stderr
    assert (tmp_path / "run" / "corner.pdf").stat().st_size > 0
    assert list((tmp_path / "study").rglob("corner.pdf"))
