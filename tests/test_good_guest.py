"""A good guest in the process of somebody else: nothing of the host is changed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

DATA = Path(__file__).parent.parent / "data"
HOST = """
import gc, multiprocessing, os, random, signal, sys, threading, time
from pathlib import Path
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
        "garbage collector": (gc.isenabled(), gc.get_threshold(), gc.get_freeze_count() > 0),
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
