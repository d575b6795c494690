"""One writer a run folder: live owners are respected, dead ones are not."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import resource
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from biaxbayes.errors import InputError, RunError
from biaxbayes.file_lock import try_lock
from biaxbayes.runs import lock
from biaxbayes.runs.folder import (
    PROVENANCE,
    READY,
    clear_leftovers,
    finish_moving,
    manifest,
    staged,
)
from biaxbayes.runs.lock import NAME, folder_lock
from biaxbayes.text_files import atomic_write_bytes

HOLDER = """
import sys, time
from pathlib import Path
from biaxbayes.runs.lock import folder_lock
with folder_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@contextlib.contextmanager
def held_elsewhere(folder):
    """Another process that holds the lock of a folder."""
    other = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "held\n"
    try:
        yield other
    finally:
        other.kill()
        other.wait()
        other.stdout.close()


@contextlib.contextmanager
def nobody():
    """Run as a user to whom permissions apply."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def owner(folder, **changes):
    """Leave what this process writes into a lock, with changes, as if it had been killed."""
    with folder_lock(folder):
        mine = json.loads((folder / NAME).read_text())
    (folder / NAME).write_text(json.dumps(mine | changes))


def test_a_live_owner_is_named_and_a_killed_one_is_not_waited_for(tmp_path):
    with held_elsewhere(tmp_path) as other:
        with pytest.raises(RunError) as refusal, folder_lock(tmp_path):
            pass
        who = f"process {other.pid} on {socket.gethostname()} is writing there"
        assert who in str(refusal.value)
        assert "another `out`" in str(refusal.value)
        other.send_signal(signal.SIGKILL)
        other.wait()
        assert (tmp_path / NAME).exists()
        with folder_lock(tmp_path):
            assert json.loads((tmp_path / NAME).read_text())["pid"] == os.getpid()
    assert not (tmp_path / NAME).exists()


def test_not_twice_in_one_process(tmp_path):
    with folder_lock(tmp_path):
        with pytest.raises(RunError, match="is writing there"), folder_lock(tmp_path):
            pass
        assert (tmp_path / NAME).exists()
    with folder_lock(tmp_path):
        pass


@pytest.mark.parametrize(
    "left",
    [
        "",
        "{",
        "[]",
        "null",
        '{"host": 3}',
        "9" * 5000,
        "[" * 4000,
        json.dumps({"host": socket.gethostname(), "pid": float("inf")}),
        json.dumps({"host": socket.gethostname(), "pid": "x"}),
    ],
)
def test_what_a_dying_process_left_is_stale(tmp_path, left):
    (tmp_path / NAME).write_text(left)
    with folder_lock(tmp_path):
        pass


@pytest.mark.parametrize("pid", [os.getpid(), 1, 2**31 - 2], ids=["own", "first", "nobody"])
def test_a_process_id_given_to_another_does_not_hold_the_lock(tmp_path, pid):
    owner(tmp_path, pid=pid)
    with folder_lock(tmp_path):
        pass


def test_an_owner_on_another_host_is_believed(tmp_path):
    owner(tmp_path, host="cluster-node-7\n\x1b[31m")
    with pytest.raises(RunError, match="on cluster-node-7") as refusal, folder_lock(tmp_path):
        pass
    assert "delete .lock in that folder" in str(refusal.value)
    assert str(refusal.value).isprintable()
    assert (tmp_path / NAME).exists()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP])
@pytest.mark.parametrize(
    ("changes", "live"),
    [
        ({}, True),
        ({"pid": 1, "began": ""}, True),
        ({"began": "1"}, False),  # the id of this process, given to another that began elsewhen
        ({"pid": 2**31 - 2}, False),
        ({"pid": -1}, False),
        ({"pid": 0}, False),
    ],
)
def test_without_file_locks_the_process_and_its_beginning_decide(
    tmp_path, monkeypatch, changes, live, number
):
    owner(tmp_path, **changes)

    def without_locks(handle, flags):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", without_locks)
    if live:
        with pytest.raises(RunError, match="is writing there"), folder_lock(tmp_path):
            pass
    else:
        with folder_lock(tmp_path):
            pass


def test_of_many_at_once_one_gets_a_stale_lock(tmp_path):
    owner(tmp_path, pid=2**31 - 2)
    program = (
        "import sys, time\nfrom pathlib import Path\n"
        "from biaxbayes.errors import RunError\nfrom biaxbayes.runs.lock import folder_lock\n"
        "sys.stdin.readline()\n"
        "try:\n"
        "    with folder_lock(Path(sys.argv[1])):\n"
        "        print('got', flush=True)\n"
        "        sys.stdin.readline()\n"
        "except RunError:\n    print('refused', flush=True)\n"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    many = [subprocess.Popen([sys.executable, "-c", program, tmp_path], **pipes) for _ in range(4)]
    for process in many:
        process.stdin.write("\n")
        process.stdin.flush()
    message = [process.stdout.readline().strip() for process in many]
    for process in many:
        process.communicate("\n")
    assert sorted(message) == ["got"] + ["refused"] * 3


def test_a_lock_removed_by_its_owner_while_another_takes_it_is_taken_again(tmp_path, monkeypatch):
    removed = []

    def slow(handle):
        if not removed:
            removed.append((tmp_path / NAME).unlink())
        return try_lock(handle)

    monkeypatch.setattr(lock, "try_lock", slow)
    with folder_lock(tmp_path):
        assert json.loads((tmp_path / NAME).read_text())["pid"] == os.getpid()


def test_a_link_in_place_of_the_lock_is_not_followed(tmp_path):
    victim = tmp_path / "thesis.txt"
    victim.write_text("years of work")
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / NAME).symlink_to(victim)
    with pytest.raises(RunError, match="cannot be written"), folder_lock(folder):
        pass
    assert victim.read_text() == "years of work"


def test_a_folder_that_may_not_be_written(tmp_path):
    tmp_path.chmod(0o555)
    refused = pytest.raises(RunError, match=r"cannot be written .*; choose another `out`")
    with nobody(), refused, folder_lock(tmp_path):
        pass


# --- files that appear together ----------------------------------------------------------------


@pytest.fixture
def old_run(tmp_path):
    """A run folder of two products, and a file of the user's."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "posterior.nc").write_text("old draws")
    (folder / "corner.pdf").write_text("old figure")
    (folder / PROVENANCE).write_text(json.dumps({"biaxbayes": "0", "files": manifest(folder)}))
    (folder / "notes.txt").write_text("mine")
    return folder


def content(folder):
    return {p.name: p.read_text() for p in folder.iterdir()}


def write_new(aside):
    (aside / "posterior.nc").write_text("new draws")
    (aside / PROVENANCE).write_text(json.dumps({"biaxbayes": "1", "files": manifest(aside)}))


def test_new_files_replace_all_of_the_old_and_none_of_the_users(old_run):
    with staged(old_run) as aside:
        write_new(aside)
        assert content_of_files(old_run)["posterior.nc"] == "old draws"
    assert set(content(old_run)) == {"posterior.nc", PROVENANCE, "notes.txt"}
    assert content(old_run)["posterior.nc"] == "new draws"


def content_of_files(folder):
    return {p.name: p.read_text() for p in folder.iterdir() if p.is_file()}


def test_a_product_that_the_user_changed_stays(old_run):
    (old_run / "corner.pdf").write_text("mended by hand")
    with staged(old_run) as aside:
        write_new(aside)
    assert content(old_run)["corner.pdf"] == "mended by hand"


@pytest.mark.parametrize(
    "trouble",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        InputError("cannot be written (No space left on device)", file="x"),
        KeyboardInterrupt(),
        MemoryError(),
    ],
)
def test_trouble_leaves_the_old_files(old_run, trouble):
    before = content(old_run)
    expected = RunError if isinstance(trouble, OSError | InputError) else type(trouble)
    with pytest.raises(expected) as output, staged(old_run) as aside:
        write_new(aside)
        raise trouble
    assert content(old_run) == before
    if expected is RunError:
        assert "No space left on device" in str(output.value)
        assert "untouched" in str(output.value)
        assert ".writing" not in str(output.value)


@pytest.mark.parametrize("moved", [0, 1])
def test_a_crash_between_two_renames_is_made_up_for(old_run, monkeypatch, moved):
    real, count = Path.replace, []

    def dies(self, target):
        if self.parent.name == READY:
            if len(count) == moved:
                raise KeyboardInterrupt
            count.append(self)
        return real(self, target)

    monkeypatch.setattr(Path, "replace", dies)
    with pytest.raises(KeyboardInterrupt), staged(old_run) as aside:
        write_new(aside)
    monkeypatch.undo()
    finish_moving(old_run)
    assert content(old_run)["posterior.nc"] == "new draws"
    assert json.loads(content(old_run)[PROVENANCE])["biaxbayes"] == "1"
    assert set(content(old_run)) == {"posterior.nc", PROVENANCE, "notes.txt"}


def test_what_waits_to_be_moved_must_be_the_programs_own(tmp_path, old_run):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious.csv").write_text("1")
    (old_run / READY).symlink_to(elsewhere)
    before = content_of_files(old_run)
    finish_moving(old_run)
    assert (elsewhere / "precious.csv").exists()
    assert content_of_files(old_run) == before


def test_a_list_of_files_leads_nowhere_outside(tmp_path, old_run):
    outside = tmp_path / "victim.txt"
    outside.write_text("keep")
    digest = manifest(tmp_path)["victim.txt"]
    names = ["../victim.txt", str(outside), "a/../../victim.txt", ".hidden", ""]
    (old_run / ".hidden").write_text("keep")
    (old_run / PROVENANCE).write_text(json.dumps({"files": dict.fromkeys(names, digest)}))
    with staged(old_run) as aside:
        write_new(aside)
    assert outside.read_text() == "keep"
    assert (old_run / ".hidden").exists()


def test_leftovers_of_killed_processes_go_and_other_files_stay(old_run):
    (old_run / ".writing-abc").mkdir()
    (old_run / ".writing-abc" / "half.pdf").write_text("%PD")
    (old_run / ".checkpoint-following.npz.4711.tmp").write_text("half")
    (old_run / ".mine.tmp").write_text("keep")
    clear_leftovers(old_run)
    assert not list(old_run.glob(".writing*")) and not list(old_run.glob(".check*"))
    assert (old_run / ".mine.tmp").exists()


def test_a_file_that_does_not_fit_leaves_the_one_before(tmp_path):
    path = tmp_path / "checkpoint.npz"
    atomic_write_bytes(path, b"before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(InputError, match="cannot be written \\(File too large\\)"):
            atomic_write_bytes(path, bytes(100_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"before"
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.npz"]


def test_a_link_planted_under_the_temporary_name_is_not_followed(tmp_path):
    victim = tmp_path / "victim.txt"
    victim.write_text("keep")
    (tmp_path / f".out.csv.{os.getpid()}.tmp").symlink_to(victim)
    atomic_write_bytes(tmp_path / "out.csv", b"new")
    assert victim.read_text() == "keep"
    assert (tmp_path / "out.csv").read_bytes() == b"new"
    assert not (tmp_path / "out.csv").is_symlink()
