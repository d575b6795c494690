"""Executors: equal results, one BLAS thread, and workers that die."""

from __future__ import annotations

import time

import pytest

import executor_tasks as tasks
from biaxbayes.errors import InputError
from biaxbayes.executors.executor import InThisProcess, executor_for
from biaxbayes.executors.local_processes import LocalProcesses


def test_every_task_is_done_once_and_in_several_processes():
    numbers = list(range(8))
    for executor in (InThisProcess(), LocalProcesses(2)):
        found = {o.index: o.value for o in executor.run(tasks.square, numbers)}
        assert found == {n: n * n for n in numbers}
    seen = [o.value for o in LocalProcesses(2).run(tasks.where, numbers)]
    assert len({process for process, _ in seen}) == 2
    assert {threads for _, threads in seen} == {1}


def test_a_task_whose_worker_died_is_done_by_another(tmp_path):
    outcomes = list(LocalProcesses(2).run(tasks.die_once, [str(tmp_path)]))
    assert [(o.value, o.lost) for o in outcomes] == [("survived", "")]


def test_a_task_that_kills_every_worker_is_given_up_and_no_other():
    words = ["a", "dies", "b", "c"]
    outcomes = {o.index: o for o in LocalProcesses(2).run(tasks.die_always, words)}
    assert len(outcomes) == 4
    assert "died 3 times" in outcomes[1].lost
    assert [outcomes[i].value for i in (0, 2, 3)] == ["a", "b", "c"]
    assert not any(outcomes[i].lost for i in (0, 2, 3))


def test_an_exception_comes_through_with_where_it_happened():
    with pytest.raises(ValueError, match="two") as raised:
        list(LocalProcesses(1).run(tasks.fail, [1, 2]))
    assert "executor_tasks.py" in "".join(raised.value.__notes__)


def test_a_stop_hands_out_nothing_further_and_waits_for_what_is_under_way(tmp_path):
    asked = []

    def stop():
        if not asked and list(tmp_path.glob("begun-*")):
            asked.append(time.monotonic())
            (tmp_path / "stop").touch()
        return bool(asked)

    outcomes = list(LocalProcesses(1).run(tasks.until_told, [str(tmp_path)] * 5, stop=stop))
    assert [o.value for o in outcomes] == ["ended"]


def test_leaving_early_ends_the_workers(tmp_path):
    running = LocalProcesses(2).run(tasks.where, list(range(50)))
    next(running)
    clock = time.monotonic()
    running.close()
    assert time.monotonic() - clock < 5.0


def test_what_was_asked_for():
    assert isinstance(executor_for(1), InThisProcess)
    assert isinstance(executor_for(1, isolated=True), LocalProcesses)
    assert executor_for(3).workers == 3
    with pytest.raises(InputError, match="at least 1"):
        executor_for(0)
    with pytest.raises(InputError, match="both"):
        executor_for(2, "tcp://127.0.0.1:8786")


def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch):
    pytest.importorskip("distributed")
    from distributed import default_client

    from biaxbayes.executors import dask_cluster

    monkeypatch.setattr(dask_cluster, "CONNECT_SECONDS", 1.0)
    for address in ("tcp://127.0.0.1:9", "nowhere", ""):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            list(dask_cluster.DaskCluster(address).run(tasks.square, [1]))
    # Nothing is left behind that other libraries would take for a cluster to ask.
    with pytest.raises(ValueError, match="No client"):
        default_client()
