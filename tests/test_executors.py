"""Executors: equal results, one BLAS thread, and workers that die."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import executor_tasks as tasks
from biaxbayes.errors import InputError
from biaxbayes.executors import cluster
from biaxbayes.executors.beside import Beside, Partner, Standby, each, when_asked
from biaxbayes.executors.executor import InThisProcess, Workers, executor_for


def test_every_task_is_done_once_and_in_several_processes():
    numbers = list(range(8))
    for executor in (InThisProcess(), Workers(2)):
        found = {o.index: o.value for o in executor.run(tasks.square, numbers)}
        assert found == {n: n * n for n in numbers}
    seen = [o.value for o in Workers(2).run(tasks.where, numbers)]
    assert len({process for process, _ in seen}) == 2
    assert {threads for _, threads in seen} == {1}


FRESH = """
from biaxbayes.executors.executor import Workers
from executor_tasks import has
if __name__ == "__main__":
    print([o.value for o in Workers(1, modules=("tabnanny",)).run(has, ["tabnanny", "pipes"])])
"""


copied = pytest.mark.skipif(
    "forkserver" not in multiprocessing.get_all_start_methods(),
    reason="workers are no copies of a process on this system",
)


def told_by(code, folder):
    """Words that a program prints; what workers import is settled by the first of a process."""
    path = folder / "program.py"
    path.write_text(code)
    paths = os.pathsep.join([str(Path(tasks.__file__).parent), *sys.path])
    told = subprocess.run(
        [sys.executable, str(path)],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    return told.stdout.split()


@copied
def test_workers_begin_with_the_modules_that_they_are_made_for(tmp_path):
    assert told_by(FRESH, tmp_path) == ["[True,", "False]"]


def test_a_task_whose_worker_died_is_done_by_another(tmp_path):
    outcomes = list(Workers(2).run(tasks.die_once, [str(tmp_path)]))
    assert [(o.value, o.lost) for o in outcomes] == [("survived", "")]


def test_a_task_that_kills_every_worker_is_given_up_and_no_other():
    words = ["a", "dies", "b", "c"]
    outcomes = {o.index: o for o in Workers(2).run(tasks.die_always, words)}
    assert len(outcomes) == 4
    assert "died 3 times" in outcomes[1].lost
    assert [outcomes[i].value for i in (0, 2, 3)] == ["a", "b", "c"]
    assert not any(outcomes[i].lost for i in (0, 2, 3))


def test_a_worker_that_dies_when_it_has_finished_costs_no_task(tmp_path):
    """Its result may be on the way, on the dead worker, or not known of."""
    work = [(str(tmp_path), number) for number in range(5)]
    outcomes = {o.index: (o.value, o.lost) for o in Workers(2).run(tasks.say_and_die_soon, work)}
    assert outcomes == {number: (number, "") for number in range(5)}
    assert len(list(tmp_path.iterdir())) == 5


def test_workers_are_let_go_where_dask_stumbles_over_one(monkeypatch):
    """As over one that died while it was started in the place of another."""
    from distributed.nanny import WorkerProcess

    kill, lost = WorkerProcess.kill, []

    async def stumbles_once(self, **how):
        if lost:
            return await kill(self, **how)
        lost.append(self.pid)
        raise AssertionError("can only join a started process")

    monkeypatch.setattr(WorkerProcess, "kill", stumbles_once)
    before = time.monotonic()
    assert [o.value for o in Workers(2).run(tasks.square, [3])] == [9]
    assert lost and gone(lost[0])
    assert time.monotonic() - before < cluster.WORKER_SECONDS


@pytest.mark.parametrize("executor", [InThisProcess(), Workers(2)], ids=["here", "workers"])
def test_tasks_that_are_added_while_outcomes_are_taken_are_done_as_well(executor):
    numbers, found = [1, 2], {}
    with executor:
        for outcome in executor.run(tasks.square, numbers):
            found[outcome.index] = outcome.value
            if numbers[outcome.index] in (1, 2, 10):
                numbers.append(10 * numbers[outcome.index])
    assert sorted(numbers) == [1, 2, 10, 20, 100]
    assert found == {index: n * n for index, n in enumerate(numbers)}


@copied
def test_what_workers_are_copies_of_begins_before_the_first_task(tmp_path):
    assert told_by(EARLY, tmp_path) == ["None", "False", "True", "True"]


EARLY = """
import sys
from multiprocessing import forkserver
from biaxbayes.executors.executor import Workers
from executor_tasks import has
if __name__ == "__main__":
    workers = Workers(1, modules=("tabnanny",))
    print(forkserver._forkserver._forkserver_pid)
    workers.get_ready()
    began = forkserver._forkserver._forkserver_pid
    print("distributed" in sys.modules)
    print(*(o.value for o in workers.run(has, ["tabnanny"])))
    print(forkserver._forkserver._forkserver_pid == began)
"""


def test_an_exception_comes_through_with_where_it_happened():
    with pytest.raises(ValueError, match="two") as raised:
        list(Workers(1).run(tasks.fail, [1, 2]))
    assert "executor_tasks.py" in "".join(raised.value.__notes__)


def test_a_stop_hands_out_nothing_further_and_waits_for_what_is_under_way(tmp_path):
    asked = []

    def stop():
        if not asked and list(tmp_path.glob("begun-*")):
            asked.append(time.monotonic())
            (tmp_path / "stop").touch()
        return bool(asked)

    outcomes = list(Workers(1).run(tasks.until_told, [str(tmp_path)] * 5, stop=stop))
    assert [o.value for o in outcomes] == ["ended"]


def test_leaving_early_ends_the_workers(tmp_path):
    running = Workers(2).run(tasks.where, list(range(50)))
    next(running)
    clock = time.monotonic()
    running.close()
    assert time.monotonic() - clock < 5.0


SCRIPT = """
import logging, os, signal, sys, time
from pathlib import Path

import executor_tasks as tasks
from biaxbayes.progress_bar import graceful_stop
from biaxbayes.executors.executor import Workers

if __name__ == "__main__":
    with graceful_stop() as stop, Workers(2) as workers:
        def stopped():
            asked = stop()
            if asked and sys.argv[2] == "finish":
                (Path(sys.argv[1]) / "stop").touch()
            if asked:
                print("asked", flush=True)
            return asked
        for o in workers.run(tasks.until_told, [sys.argv[1]] * 9, stop=stopped):
            print(o.value, flush=True)
"""


@pytest.mark.usefixtures("usual_signals")
@pytest.mark.parametrize("how", ["finish", "at once", "killed"])
def test_signals_reach_the_workers_through_us_and_leave_none_behind(tmp_path, how):
    """The terminal sends them to the whole group."""
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    run = subprocess.Popen(
        [sys.executable, "-W", "error", str(path), str(tmp_path), how],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": paths},
    )
    until(lambda: len(list(tmp_path.glob("begun-*"))) == 2)
    pids = [int(p.name.removeprefix("begun-")) for p in tmp_path.glob("begun-*")]
    clock = time.monotonic()
    if how == "killed":
        run.kill()
    else:
        os.killpg(run.pid, signal.SIGINT)
        assert run.stdout.readline() == "asked\n"
        if how == "at once":
            os.killpg(run.pid, signal.SIGINT)
    out, err = run.communicate(timeout=60)
    if how == "finish":
        assert out.count("ended") == 2
        assert err == "stopping after this block; once more to stop at once\n"
        assert run.returncode == 0
    else:
        assert time.monotonic() - clock < 8.0
        assert "ended" not in out and "distributed" not in err.replace("distributed/", "")
    until(lambda: not any(map(alive, pids)))


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


def test_what_was_asked_for():
    assert isinstance(executor_for(1), InThisProcess)
    assert executor_for(1, isolated=True).count == 1
    assert executor_for(3).count == 3
    with pytest.raises(InputError, match="at least 1"):
        executor_for(0)
    with pytest.raises(InputError, match="both"):
        executor_for(2, "tcp://127.0.0.1:8786")


def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch):
    from distributed import default_client

    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 1.0)
    for address in ("tcp://127.0.0.1:9", "nowhere", ""):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            list(Workers(scheduler=address).run(tasks.square, [1]))
    # Nothing is left behind that other libraries would take for a cluster to ask.
    with pytest.raises(ValueError, match="No client"):
        default_client()


# --- one piece of work beside this process -------------------------------------------------


def test_work_beside_is_done_in_another_process_and_gives_the_same():
    here, there = Beside(os.getpid, 1), Beside(os.getpid, 2)
    assert here.result() == os.getpid()
    if sys.platform == "linux" and threading.active_count() == 1:
        assert there.result() != os.getpid()
    values = np.arange(200_000.0)  # more than a pipe holds
    np.testing.assert_array_equal(Beside(lambda: values * 2.0, 2).result(), values * 2.0)


def test_work_that_fails_beside_fails_here():
    def fail():
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        Beside(fail, 2).result()


def test_work_whose_process_dies_is_done_here():
    home = os.getpid()

    def die_elsewhere():
        if os.getpid() != home:
            os.kill(os.getpid(), signal.SIGKILL)
        return 7

    assert Beside(die_elsewhere, 2).result() == 7


STOPPED = """
import os
from biaxbayes.executors.beside import Beside
from biaxbayes.progress_bar import STOPS

home = os.getpid()

def stopped_elsewhere():
    if os.getpid() != home:
        for number in STOPS:
            os.kill(os.getpid(), number)
    return os.getpid()

with Beside(stopped_elsewhere, 2) as work:
    assert work.result() != home or not work.begun
    assert work.begun or not os.path.exists("/proc/self")
"""


def test_work_beside_leaves_the_signals_of_the_terminal_to_who_began_it():
    subprocess.run([sys.executable, "-c", STOPPED], check=True, timeout=60)


def test_work_is_not_forked_from_among_threads():
    done = threading.Event()
    other = threading.Thread(target=done.wait)
    other.start()
    try:
        assert Beside(os.getpid, 2).result() == os.getpid()
    finally:
        done.set()
        other.join()


@pytest.mark.parametrize("workers", [1, 2])
def test_tasks_on_standby_are_worked_on_in_one_process_and_come_back_in_order(workers):
    ready: list[int] = []

    def squared(values):
        return values**2, len(ready), os.getpid()

    with Standby(lambda: ready.append(1), squared, workers) as standby:
        for k in range(3):
            standby.begin(np.full(200_000, float(k)))  # more than a pipe holds
        found = standby.results()
    assert [float(values[0]) for values, _, _ in found] == [0.0, 1.0, 4.0]
    elsewhere = standby.begun
    assert elsewhere or workers == 1 or sys.platform != "linux" or threading.active_count() > 1
    # only where there is a process is it made ready, before the first task
    assert {n for _, n, _ in found} == {int(elsewhere)} and len(ready) == 0
    assert (os.getpid() in {pid for _, _, pid in found}) is not elsewhere


@pytest.mark.parametrize("begun", [0, 1])
def test_a_standby_that_dies_leaves_its_tasks_to_this_process(begun):
    home = os.getpid()

    def die_elsewhere(task):
        if os.getpid() != home:
            os.kill(os.getpid(), signal.SIGKILL)
        return task + 1

    with Standby(lambda: None, die_elsewhere, 2) as standby:
        for k in range(begun + 1):
            standby.begin(k)
        assert standby.results() == list(range(1, begun + 2))


def test_a_standby_gets_a_task_as_it_was_handed_over():
    with Standby(lambda: None, len, 2) as standby:
        names = ["a"]
        standby.begin(names)
        names.append("b")
        assert standby.results() == [1 if standby.begun else 2]
        if standby.begun:
            with pytest.raises((AttributeError, TypeError, pickle.PicklingError)):
                standby.begin(lambda: None)  # type: ignore[arg-type]


def test_without_semaphores_a_standby_works_in_this_process(monkeypatch):
    def none(*_):
        raise OSError("no semaphores")

    monkeypatch.setattr(multiprocessing.get_context("fork"), "Queue", none)
    with Standby(lambda: None, abs, 2) as standby:
        standby.begin(-3)
        assert standby.results() == [3] and not standby.begun


def test_a_standby_without_tasks_ends():
    with Standby(lambda: None, abs, 2) as standby:
        assert standby.results() == []
    with Standby(lambda: time.sleep(600), abs, 2) as standby:
        standby.begin(-1)
    assert not standby.begun or not standby._process.is_alive()


class Counter:
    """What a process has of its own: how often it was asked, and where."""

    def __init__(self) -> None:
        self.asked = 0

    def ask(self, more: int) -> tuple[int, int]:
        self.asked += more
        return self.asked, os.getpid()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_partner_does_one_piece_of_work_after_the_other(workers):
    counter = Counter()
    with Partner(workers, of=counter) as partner:
        values = np.full(200_000, 2.0)  # more than a pipe holds
        squares = partner.begin(np.square, values)
        late = partner.begin(os.getpid)
        elsewhere = partner.begun
        assert not partner.is_free
        assert late() == os.getpid()  # it has other work
        assert squares().tolist() == [4.0] * 200_000
        assert partner.is_free is elsewhere
        found = [partner.begin("ask", k)() for k in (1, 2)]
    assert elsewhere or workers == 1 or sys.platform != "linux" or threading.active_count() > 1
    assert [asked for asked, _ in found] == [1, 3]
    assert ({pid for _, pid in found} == {os.getpid()}) is not elsewhere
    assert counter.asked == (0 if elsewhere else 3)
    assert partner.begin(abs, -1)() == 1  # after its end


def divided(x):
    return 1 // x


def died(home):
    if os.getpid() != home:
        os.kill(os.getpid(), signal.SIGKILL)
    return "here"


def test_what_fails_in_a_partner_fails_here_and_what_kills_it_is_done_here():
    with Partner(2) as partner:
        failing = partner.begin(divided, 0)
        with pytest.raises(ZeroDivisionError):
            failing()
        assert not partner.begun and partner.begin(divided, 1)() == 1
    with Partner(2) as partner:
        assert partner.begin(died, os.getpid())() == "here"
        assert not partner.begun and partner.begin(abs, -3)() == 3
    with Partner(2) as partner:
        if partner.begun:
            os.kill(partner._process.pid, signal.SIGKILL)
            partner._process.join()
        assert [partner.begin(abs, k)() for k in (-1, -2)] == [1, 2]


def modules_there(name):
    return name in sys.modules, os.getpid()


def test_a_partner_has_imported_its_modules_before_it_works(tmp_path, monkeypatch):
    (tmp_path / "slow_to_import.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    with Partner(2, modules=["slow_to_import"]) as partner:
        elsewhere = partner.begun
        there, pid = partner.begin(modules_there, "slow_to_import")()
    assert there is elsewhere and (pid != os.getpid()) is elsewhere
    assert "slow_to_import" not in sys.modules


def test_a_partner_that_is_in_the_middle_of_work_ends():
    with Partner(2) as partner:
        begun, process = partner.begun, partner._process
        partner.begin(time.sleep, 600 if begun else 0)
    assert not begun or not process.is_alive()


def test_work_that_waits_is_done_when_its_result_is_asked_for():
    done: list[int] = []
    later = when_asked(done.append, 1)
    assert done == []
    later()
    assert done == [1] and each(abs, [-1, -2]) == [1, 2]


@contextlib.contextmanager
def begun(code: str) -> Iterator[tuple[subprocess.Popen, int]]:
    """A process of its own, with no other threads, and the first number that it prints."""
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            yield started, int(started.stdout.readline())
        finally:
            started.kill()


def gone(pid: int) -> bool:
    """Whether a process ends within ten seconds."""
    for _ in range(200):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            return True
        if state == "Z":
            return True
        time.sleep(0.05)
    return False


SLEEP_BESIDE = """
import time
from biaxbayes.executors.beside import Beside
with Beside(lambda: time.sleep(600), 2) as beside:
    print(beside._process.pid, flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="work is done beside on Linux alone")
def test_work_that_nobody_waits_for_ends():
    with begun(SLEEP_BESIDE + "time.sleep(600)\n") as (process, pid):
        assert gone(pid) and process.poll() is None


@pytest.mark.skipif(sys.platform != "linux", reason="work is done beside on Linux alone")
def test_work_ends_with_a_process_that_is_killed():
    """Else it would hold the lock of a run folder that a resumed run waits for."""
    with begun(SLEEP_BESIDE + "    time.sleep(600)\n") as (process, pid):
        process.kill()
        process.wait()
        assert gone(pid)
