"""One writer a run folder: live owners are respected, dead ones are not."""

import contextlib
import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from biaxbayes.errors import InputError, RunError
from biaxbayes.file_lock import folder_lock
from biaxbayes.runs.folder import PROVENANCE, READY, finish_moving, manifest, staged

OWNER = """
import sys, time
from pathlib import Path
from biaxbayes.file_lock import folder_lock
with folder_lock(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


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


def test_a_live_owner_is_respected_and_a_killed_one_is_not_waited_for(tmp_path):
    command = [sys.executable, "-c", OWNER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "locked\n"
        with pytest.raises(RunError) as refusal, folder_lock(tmp_path):
            pass
        assert "another process is writing there" in str(refusal.value)
        assert "another `out`" in str(refusal.value)
        other.kill()
    twice = pytest.raises(RunError, match="is writing there")
    with folder_lock(tmp_path), twice, folder_lock(tmp_path):
        pass  # nor twice in one process
    with folder_lock(tmp_path):
        pass


def test_a_folder_that_may_not_be_written(tmp_path):
    tmp_path.chmod(0o555)
    refused = pytest.raises(RunError, match=r"cannot be written .*; choose another `out`")
    with nobody(), refused, folder_lock(tmp_path):
        pass


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
    return {p.name: p.read_text() for p in folder.iterdir() if p.is_file()}


def write_new(aside):
    (aside / "posterior.nc").write_text("new draws")
    (aside / PROVENANCE).write_text(json.dumps({"biaxbayes": "1", "files": manifest(aside)}))


def test_new_files_replace_all_of_the_old_and_none_of_the_users(old_run):
    with staged(old_run) as aside:
        write_new(aside)
        assert content(old_run)["posterior.nc"] == "old draws"
    assert set(content(old_run)) == {"posterior.nc", PROVENANCE, "notes.txt"}
    assert content(old_run)["posterior.nc"] == "new draws"


def test_a_product_that_the_user_changed_stays(old_run):
    (old_run / "corner.pdf").write_text("mended by hand")
    with staged(old_run) as aside:
        write_new(aside)
    assert content(old_run)["corner.pdf"] == "mended by hand"


@pytest.mark.parametrize(
    "trouble",
    [OSError(errno.ENOSPC, "No space left on device"), InputError("No space left on device")]
    + [KeyboardInterrupt(), MemoryError()],
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
