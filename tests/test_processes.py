"""What a process imports and keeps: a host unchanged, streams, the cache of compiled code."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from biaxbayes.laws import LAWS
from biaxbayes.laws.materials import derivatives
from biaxbayes.model.posterior import Posterior
from biaxbayes.specimens.specimen import Protocol, Specimen

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


HELP = """
import contextlib, sys
from biaxbayes.cli import main
with contextlib.suppress(SystemExit):
    main(["--help"])
print("== modules:", *sys.modules)
"""


def test_the_help_imports_no_numbers():
    done = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True, check=True)
    modules = done.stdout.rsplit("== modules:", 1)[1].split()
    assert "biaxbayes.cli" in modules and not {"numpy", "numba", "pandas"} & set(modules)


def test_code_that_may_not_be_compiled_is_refused_in_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "biaxbayes", "check", str(DATA)],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "NUMBA_DISABLE_JIT is set" in done.stderr


DENSITY = """
import numpy as np
from biaxbayes import read_specimen
from biaxbayes.model.posterior import Posterior

posterior = Posterior(read_specimen(r"{specimen}"), noise="independent", mounting="noisy")
rng = np.random.default_rng(1)
u = rng.normal(0.0, 0.3, (200, posterior.dimension))
print(posterior.log_prob(u).tobytes().hex())
"""


def test_compiled_functions_of_two_laws_have_two_names():
    """With one name, compiled by two processes, one would run in the environment of the other."""
    up = np.linspace(0.0, 1.0, 6)
    record = Protocol("1", 1.0 + 0.2 * up, 1.0 + 0.1 * up, 10.0 * up, 8.0 * up)
    specimen = Specimen("virtual", (record,), "piola", load_noise=0.5)
    types = [
        numba.typeof(
            Posterior(specimen, law=law, mounting="ignored", noise="independent").assembly.problem
        )
        for law in LAWS
    ]
    assert len({str(kind) for kind in types}) == len(LAWS)
    registered = derivatives.registry
    assert len({kind.__name__ for kind in registered}) == len(registered)


@pytest.mark.long
def test_a_process_that_compiles_finds_what_later_ones_find(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    code = DENSITY.format(specimen=DATA)
    command = [sys.executable, "-c", code]
    how = {"env": environment, "capture_output": True, "text": True, "check": True}
    first, second = (subprocess.run(command, **how).stdout for _ in range(2))
    assert first == second
    assert len(set(bytes.fromhex(first.strip()))) > 100  # not all of them -inf


SMALL = """
import numba
before = numba.config.CACHE_DIR
from biaxbayes.compilation import CACHE, compiled

@compiled()
def doubled(x):
    return 2.0 * x

print(doubled(21.0), numba.config.CACHE_DIR == before, sum(doubled.stats.cache_hits.values()))
"""


def small_program(folder: Path, cache: Path | str) -> tuple[list[str], str]:
    """Words that a program prints that compiles a function, and its standard error."""
    program = folder / "program.py"
    if not program.exists():  # numba 0.60 goes by its date
        program.write_text(SMALL)
    done = subprocess.run(
        [sys.executable, str(program)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split(), done.stderr


def test_compiled_code_is_cached_and_the_setting_of_numba_stays_the_users(tmp_path):
    assert small_program(tmp_path, tmp_path / "cache") == (["42.0", "True", "0"], "")
    assert small_program(tmp_path, tmp_path / "cache") == (["42.0", "True", "1"], "")


DAMAGED = """
from biaxbayes.compilation import compiled
from biaxbayes.options import for_users

@compiled()
def doubled(x):
    return 2.0 * x

@for_users
def verb():
    return doubled(21.0)

try:
    print(verb())
except Exception as error:
    print(type(error).__name__, error)
"""


@pytest.mark.long
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_damaged_compiled_code_is_said_in_one_line_and_made_again(tmp_path, kind):
    program, cache = tmp_path / "program.py", tmp_path / "cache"
    program.write_text(DAMAGED)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    how = {"env": environment, "capture_output": True, "text": True, "check": True}
    command = [sys.executable, str(program)]
    assert subprocess.run(command, **how).stdout == "42.0\n"
    for damage in (lambda raw: b"", lambda raw: raw[: len(raw) // 2], lambda raw: raw[:60] * 20):
        (file,) = cache.rglob(f"*.{kind}")
        file.write_bytes(damage(file.read_bytes()))
        said = subprocess.run(command, **how).stdout
        assert said.startswith("RunError") and str(cache) in said and said.count("\n") == 1
        assert subprocess.run(command, **how).stdout == "42.0\n"


def test_a_cache_that_cannot_be_written_is_left_aside_with_one_line(tmp_path):
    (tmp_path / "file").write_text("no folder")
    words, output = small_program(tmp_path, tmp_path / "file")
    assert words == ["42.0", "True", "0"]
    assert output.count("\n") == 1 and "compiled code cannot be cached in" in output
