"""Executors: equal results, one BLAS thread, and workers that die."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import executor_tasks as tasks
import shared
from biaxbayes import cluster as dask_cluster
from biaxbayes.cluster import Cluster
from biaxbayes.errors import InputError, RunError
from biaxbayes.parallel import Processes, executor_for
from biaxbayes.tasks import Executor


def test_every_task_is_done_once_and_in_several_processes():
    numbers = list(range(8))
    for executor in (Executor(), Processes(2)):
        result = {o.index: o.value for o in executor.run(tasks.square, numbers)}
        assert result == {n: n * n for n in numbers}
    with Processes(2) as executor:
        seen = [[o.value for o in executor.run(tasks.where, numbers)] for _ in range(2)]
    processes = [{process for process, _ in once} for once in seen]
    assert len(processes[0]) == 2 and processes[0] == processes[1]  # they stay
    assert {threads for once in seen for _, threads in once} == {1}


def test_a_task_whose_worker_died_is_done_by_another(tmp_path):
    outcomes = list(Processes(2).run(tasks.die_once, [str(tmp_path)]))
    assert [(o.value, o.failure) for o in outcomes] == [("survived", "")]


def test_a_task_that_kills_every_worker_is_given_up_and_no_other():
    words = ["a", "dies", "b", "c"]
    outcomes = {o.index: o for o in Processes(2).run(tasks.die_always, words)}
    assert len(outcomes) == 4
    assert "died 3 times" in outcomes[1].failure
    assert [outcomes[i].value for i in (0, 2, 3)] == ["a", "b", "c"]
    assert not any(outcomes[i].failure for i in (0, 2, 3))


def test_an_exception_comes_through_with_where_it_happened():
    with pytest.raises(ValueError, match="two") as raised:
        list(Processes(1).run(tasks.fail, [1, 2]))
    assert "executor_tasks.py" in str(raised.value.__cause__)


def test_a_stop_hands_out_nothing_further_and_waits_for_what_is_under_way(tmp_path):
    arguments = []

    def stop():
        if not arguments and list(tmp_path.glob("started-*")):
            arguments.append(True)
            (tmp_path / "stop").touch()
        return bool(arguments)

    outcomes = list(Processes(1).run(tasks.until_stopped, [str(tmp_path)] * 5, stop=stop))
    assert [o.value for o in outcomes] == ["ended"]


SCRIPT = """
import os, sys
from pathlib import Path

import executor_tasks as tasks
from biaxbayes.parallel import Processes
from biaxbayes.progress_bar import graceful_stop

if __name__ == "__main__":
    with graceful_stop() as stop, Processes(2) as workers:
        def stopped():
            stopping = stop()
            if stopping and sys.argv[2] == "finish":
                (Path(sys.argv[1]) / "stop").touch()
            if stopping:
                print("stopping", flush=True)
            return stopping
        for o in workers.run(tasks.until_stopped, [sys.argv[1]] * 9, stop=stopped):
            print(o.value, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
@pytest.mark.usefixtures("usual_signals")
@pytest.mark.parametrize("how", ["finish", "at once", "killed"])
def test_signals_reach_the_workers_through_us_and_leave_none_behind(tmp_path, how):
    """The terminal sends them to the whole group."""
    run = started(tmp_path, SCRIPT, how)
    until(lambda: len(started_in(tmp_path)) == 2)
    if how == "killed":
        run.kill()
    else:
        os.killpg(run.pid, signal.SIGINT)
        assert run.stdout.readline() == "stopping\n"
        if how == "at once":
            os.killpg(run.pid, signal.SIGINT)
    with run:  # communicate() would miss what readline() has read ahead
        out, err = run.stdout.read(), run.stderr.read()
    if how == "finish":
        assert out.count("ended") == 2
        assert err == "stopping after this block; press Ctrl-C again to stop at once\n"
        assert run.returncode == 0
    else:
        assert "ended" not in out
    until(lambda: not any(map(alive, started_in(tmp_path))))


def started(folder, code, *words):
    path = folder / "script.py"
    path.write_text(code)
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-W", "error", str(path), str(folder), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": paths},
    )


def started_in(folder):
    """Processes in which a task has started."""
    return [int(p.name.removeprefix("started-")) for p in folder.glob("started-*")]


def until(true):
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


UNGUARDED = """
import executor_tasks as tasks
from biaxbayes.errors import RunError
from biaxbayes.parallel import Processes
try:
    list(Processes(2).run(tasks.square, [1, 2, 3]))
except RunError as error:
    print(error)
"""


def test_a_script_without_a_guard_is_refused_with_what_is_missing(tmp_path):
    out, _ = started(tmp_path, UNGUARDED).communicate(timeout=120)
    assert 'if __name__ == "__main__":' in out


def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch):
    from distributed import default_client

    monkeypatch.setattr(dask_cluster, "CONNECT_SECONDS", 1.0)
    for address in ("tcp://127.0.0.1:9", "nowhere", "foo://a:1"):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            list(Cluster(address).run(tasks.square, [1]))
    # Nothing is left behind that other libraries would take for a cluster to ask.
    with pytest.raises(ValueError, match="No client"):
        default_client()
    monkeypatch.setattr(dask_cluster.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"distributed.*biaxbayes\[cluster\]"):
        executor_for(scheduler="tcp://127.0.0.1:8786")


def test_a_cluster_does_every_task_once_and_raises_errors_here(scheduler, tmp_path):
    numbers = list(range(6))
    with Cluster(scheduler) as cluster:
        assert {o.index: o.value for o in cluster.run(tasks.square, numbers)} == {
            n: n * n for n in numbers
        }
        threads = {o.value[1] for o in cluster.run(tasks.where, numbers)}
        assert threads == {1}
        (lost,) = cluster.run(tasks.die_once, [str(tmp_path)])
        assert (lost.value, lost.failure) == ("survived", "")
        with pytest.raises(ValueError, match="two") as raised:
            list(cluster.run(tasks.fail, [1, 2]))
        assert "executor_tasks.py" in "".join(raised.value.__notes__)


def test_workers_with_other_versions_are_refused(scheduler, monkeypatch):
    other = dask_cluster.package_versions() | {"numpy": "1.0", "scipy": "1.1"}
    monkeypatch.setattr(dask_cluster, "package_versions", lambda: other)
    with pytest.raises(InputError, match=r"numpy .*, scipy .*, here is numpy 1.0, scipy 1.1"):
        list(Cluster(scheduler).run(tasks.square, [1]))


@pytest.mark.long
def test_a_scheduler_that_goes_is_one_line():
    local = shared.local_cluster(1)
    running = Cluster(local.scheduler_address).run(tasks.square, list(range(10**6)))
    next(running)
    local.close()
    with pytest.raises(RunError, match="lost the connection to the scheduler"):
        list(running)
