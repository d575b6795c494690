"""A study on worker processes and on a Dask cluster that loses a worker: equal results."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

import quick_posteriors
from biaxbayes.cluster import Cluster
from biaxbayes.laws.goh import GOH
from biaxbayes.parallel import InThisProcess, Processes
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.studies.study_file import read_study
from biaxbayes.verbs.batch import run_study

pytestmark = pytest.mark.slow
SPECIMENS = 4
DASK = Path(sys.executable).parent / "dask"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("specimens")
    text = "ess = 200\n"
    for number in range(SPECIMENS):
        layer = ("media", "intima")[number % 2]
        material = GOH(C1_kPa=14.0 + 10.0 * number, k1_kPa=60.0, k2=8.0, alpha_deg=40.0, kappa=0.1)
        data = quick_posteriors.specimen(material, increments=20, seed=number)
        write_specimen(replace(data, name=f"s{number}"), folder / f"s{number}.csv")
        text += f'[[specimen]]\nfile = "s{number}.csv"\ndonor = "D{number // 2}"\n'
        text += f'layer = "{layer}"\n'
    (folder / "study.toml").write_text(text)
    return read_study(folder / "study.toml")


def contents(folder):
    """What a study wrote, byte for byte."""
    result = sorted(folder.glob("study*.csv")) + sorted(folder.glob("runs/*/summary.csv"))
    return {str(p.relative_to(folder)): p.read_bytes() for p in result}


@pytest.fixture(scope="module")
def alone(study, tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone") / "study"
    run_study(study, folder, InThisProcess())
    result = contents(folder)
    assert len(result) == 4 + SPECIMENS
    return result


@pytest.fixture
def cluster(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    environment = os.environ | {"OMP_NUM_THREADS": "1"}

    def start(*words):
        path = tmp_path / f"{words[0]}-{time.monotonic_ns()}.log"
        command = [str(DASK), *words, "--no-dashboard"]
        with path.open("w") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, env=environment)

    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", str(port))
    workers = [start("worker", address, "--nthreads", "1", "--no-nanny") for _ in range(2)]
    yield address, workers
    for process in (*workers, scheduler):
        process.kill()  # a worker may take long to end when it has to
        process.wait(30)


def test_processes_find_what_one_process_finds(study, alone, tmp_path):
    run_study(study, tmp_path / "study", Processes(2))
    assert contents(tmp_path / "study") == alone


def test_a_cluster_that_loses_a_worker_finds_the_same(study, alone, cluster, tmp_path):
    address, workers = cluster
    folder = tmp_path / "study"

    def kill():
        # both workers have a specimen of which something is saved, or one has finished
        while len(list(folder.glob("runs/*/checkpoint.npz"))) < 2:
            time.sleep(0.05)
        os.kill(workers[0].pid, signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    result = run_study(study, folder, Cluster(address))
    killer.join(1.0)
    assert workers[0].wait(10) == -signal.SIGKILL
    assert sum(result.states.values()) == SPECIMENS and not result.failures
    assert contents(folder) == alone
