"""One writer a run folder: live owners are respected, dead ones are not."""

import contextlib
import errno
import json
import os
import shutil
import subprocess
import sys

import pytest

from biaxbayes.errors import InputError, RunError
from biaxbayes.file_lock import folder_lock
from biaxbayes.runs.folder import PROVENANCE, READY, finish_moving, manifest, staged
from biaxbayes.text_files import WRITTEN, atomic_write_text

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
    return {p.name: p.read_text() for p in folder.glob("[!.]*") if p.is_file()}


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


def whole_run(folder, seed, files):
    """A run of some files, and one of the user's; what a verb wrote is listed."""
    for name in files:
        atomic_write_text(folder / name, f"{name} of {seed}")
    record = {"biaxbayes": "1", "seed": seed, "files": manifest(folder)}
    atomic_write_text(folder / PROVENANCE, json.dumps(record))


def every_file(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_text()
        for p in folder.rglob("[!.]*")
        if p.is_file() and READY not in p.parts
    }


def test_a_crash_at_any_call_of_the_system_is_made_up_for(tmp_path, monkeypatch):
    calls = ("replace", "rename", "unlink", "rmdir", "mkdir")
    real = {name: getattr(os, name) for name in calls}

    def replaced(folder, last):
        """Replace a run by another; the process ends before a call. The number of calls."""
        (folder / "evidence").mkdir(parents=True)
        (folder / "cards").mkdir()
        whole_run(folder, 1, ("posterior.nc", "corner.pdf", "evidence/laws.csv"))
        (folder / WRITTEN).touch()
        for name in ("prediction.csv", "cards/a.inp"):
            atomic_write_text(folder / name, "of 1")
        (folder / "notes.txt").write_text("mine")
        count = 0

        def counted(name):
            def call(*arguments, **options):
                nonlocal count
                count += 1
                if count > last:
                    raise KeyboardInterrupt
                return real[name](*arguments, **options)

            return call

        with contextlib.suppress(KeyboardInterrupt), staged(folder) as aside:
            (aside / "evidence").mkdir()
            whole_run(aside, 2, ("posterior.nc", "report.html", "evidence/fits.csv"))
            for name in calls:
                monkeypatch.setattr(os, name, counted(name))
        monkeypatch.undo()
        return count

    count = replaced(tmp_path / "whole", 10_000)
    new, before = every_file(tmp_path / "whole"), None
    assert set(new) == {
        *("posterior.nc", "report.html", "evidence/fits.csv", "notes.txt", PROVENANCE)
    }
    assert count > 12
    for last in range(count):
        folder = tmp_path / str(last)
        replaced(folder, last)
        before = before or every_file(folder)
        # as the next process does, which is killed once more
        committed = (folder / READY).is_dir() or every_file(folder) == new
        assert committed or every_file(folder) == before
        with contextlib.suppress(KeyboardInterrupt), monkeypatch.context() as patch:
            patch.setattr(
                shutil, "rmtree", lambda *a, **k: (_ for _ in ()).throw(KeyboardInterrupt)
            )
            finish_moving(folder)
        finish_moving(folder)
        assert every_file(folder) == (new if committed else before)
        assert not (folder / READY).exists()


def test_a_list_of_files_leads_nowhere_outside(tmp_path, old_run):
    outside = tmp_path / "victim.txt"
    outside.write_text("keep")
    digest = manifest(tmp_path)["victim.txt"]
    names = ["../victim.txt", str(outside), "a/../../victim.txt", "link/victim.txt", ".hidden", ""]
    (old_run / ".hidden").write_text("keep")
    (old_run / "link").symlink_to(tmp_path)
    (old_run / "listed.txt").write_text("keep")
    record = {"biaxbayes": "0", "seed": 1, "files": dict.fromkeys(names, digest)}
    (old_run / PROVENANCE).write_text(json.dumps(record))
    (old_run / WRITTEN).write_text("".join(f"{digest}  {n}\n" for n in (*names, "listed.txt")))
    with staged(old_run) as aside:
        write_new(aside)
    assert outside.read_text() == "keep"
    assert (old_run / ".hidden").exists() and not (old_run / "listed.txt").exists()
