"""A run that was stopped, killed, damaged or starved continues to the same bytes."""

import hashlib
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import time
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import Interrupted, RunError
from biaxbayes.progress_bar import graceful_stop, with_progress
from biaxbayes.runs import checkpoint
from biaxbayes.runs.checkpoint import NAME, PREVIOUS
from biaxbayes.runs.folder import PROVENANCE
from biaxbayes.sampling.sampler import Plan
from biaxbayes.stored_data import DamagedArchive, unpack_record
from biaxbayes.text_files import WRITTEN
from biaxbayes.verbs import sample as sampling
from commands import exit_code, refused
from quick_posteriors import without_figures

pytestmark = pytest.mark.usefixtures("usual_signals")
ROOT = Path(__file__).parents[1]
LOCK = ".lock"
SPECIMEN = ROOT / "data" / "donor2-adventitia.csv"
OPTIONS = ("--ess", "6000", "--seed", "3", "--quiet")


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Few walkers and short blocks, so that a short run has several checkpoints.

    Figures and report are the same whatever happened before: they are left out here.
    """
    with without_figures(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "Plan", partial(Plan, walkers=32, first_block=16))
        patch.setattr("biaxbayes.reports.run_page.report_page", lambda run: "")
        yield


def sample(out, *more, specimen=SPECIMEN, options=OPTIONS):
    return exit_code("sample", specimen, "--out", out, *options, *more)


def resume_refused(capsys, out, *more, specimen=SPECIMEN):
    return refused(capsys, "sample", specimen, "--out", out, *OPTIONS, "--resume", *more)


def content(path):
    """The bytes of a file; HDF5 before 2 stamps groups with the time, so only their data then."""
    if path.suffix != ".nc" or h5py.version.hdf5_version_tuple >= (2, 0, 0):
        return path.read_bytes()
    parts = []

    def add(name, item):
        values = repr(np.asarray(item).tolist()) if isinstance(item, h5py.Dataset) else ""
        parts.append(f"{name}: {values}")

    with h5py.File(path) as file:
        file.visititems(add)
    return "\n".join(parts).encode()


def compared(folder):
    """Every byte of a run, but for the provenance, which says how long it took."""
    assert {p.name for p in folder.iterdir() if p.name.startswith(".")} <= {LOCK, WRITTEN}
    return {
        str(p.relative_to(folder)): hashlib.sha256(content(p)).hexdigest()
        for p in folder.rglob("*")
        if p.is_file() and p.name not in (PROVENANCE, NAME, PREVIOUS, LOCK, WRITTEN)
    }


def files(folder):
    """All files with their content; that of the lock has none, and may stay."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file() and p.name != LOCK}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run left alone, with a copy of its folder after every checkpoint."""
    place = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        real = checkpoint.save

        def save(folder, state, identity):
            real(folder, state, identity)
            copy = place / f"after-{len(list(place.glob('after-*')))}"
            shutil.copytree(folder, copy, ignore=shutil.ignore_patterns(".lock"))

        patch.setattr(checkpoint, "save", save)
        assert sample(place / "run", "--workers", 1) == 0
    assert len(list(place.glob("after-*"))) >= 4
    return place


@pytest.fixture(scope="module")
def expected(whole):
    return compared(whole / "run")


@pytest.fixture
def halfway(whole, tmp_path):
    """A folder with two checkpoints of the run, as after a kill."""
    return Path(shutil.copytree(whole / "after-2", tmp_path / "halfway"))


# --- the same bytes ----------------------------------------------------------------------------


@pytest.mark.long
def test_from_any_checkpoint_and_with_other_workers(whole, expected, tmp_path):
    assert {"posterior.nc", "summary.csv", "specimen.csv", "fit.json"} <= set(expected)
    for number in range(len(list(whole.glob("after-*")))):
        folder = shutil.copytree(whole / f"after-{number}", tmp_path / str(number))
        assert sample(folder, "--resume", "--workers", 2) == 0
        assert compared(folder) == expected


@pytest.mark.long
def test_in_a_new_folder_resuming_is_starting(expected, tmp_path):
    """So does a run killed during warm-up: it left a lock and half a file at most."""
    folder = tmp_path / "new" / "run"
    folder.mkdir(parents=True)
    (folder / ".lock").write_text('{"host": "" , "pid": 2147483646}')
    (folder / ".checkpoint-following.npz.4711.tmp").write_bytes(b"half")
    assert sample(folder, "--resume") == 0
    assert compared(folder) == expected


@pytest.mark.long
def test_a_finished_run_continues_when_more_is_asked_for(expected, tmp_path):
    assert sample(tmp_path / "run", options=("--ess", "100", "--seed", "3", "--quiet")) == 0
    fewer = compared(tmp_path / "run")
    assert fewer["posterior.nc"] != expected["posterior.nc"]
    assert sample(tmp_path / "run", "--resume") == 0
    assert compared(tmp_path / "run") == expected


# --- stopped by the user -----------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_finishes_the_block_saves_and_says_how_to_continue(
    expected, tmp_path, capsys, monkeypatch, number, code
):
    real, saved = checkpoint.save, []

    def save(folder, state, identity):
        real(folder, state, identity)
        saved.append(state.steps)
        if len(saved) == 2:
            signal.raise_signal(number)

    monkeypatch.setattr(checkpoint, "save", save)
    before = signal.getsignal(number)
    assert sample(tmp_path / "run") == code
    assert signal.getsignal(number) is before
    message = capsys.readouterr().err
    assert f"interrupted after {saved[1]} steps, all saved in {tmp_path / 'run'}" in message
    assert "--resume continues" in message
    assert len(saved) == 2
    assert not (tmp_path / "run" / PROVENANCE).exists()
    if number == signal.SIGINT:
        monkeypatch.undo()
        assert sample(tmp_path / "run", "--resume") == 0
        assert set(compared(tmp_path / "run")) >= {"posterior.nc"}


@pytest.mark.long
def test_a_second_signal_stops_at_once_without_damage(expected, halfway, capsys, monkeypatch):
    """Also in the middle of a block, with the ensembles in two processes."""
    from biaxbayes.sampling.ensembles import Ensembles

    real, started, senders = Ensembles.run, [], []
    second = ["sh", "-c", f"sleep 0.5; kill -INT {os.getpid()}"]

    def run(self, steps):
        started.append(time.monotonic())
        signal.raise_signal(signal.SIGINT)  # seen at once; two that wait are one for the system
        senders.append(subprocess.Popen(second))  # beside a thread nothing would be forked
        return real(self, 50_000)

    monkeypatch.setattr(Ensembles, "run", run)
    before = files(halfway)
    assert sample(halfway, "--resume", "--workers", 2) == 130
    assert time.monotonic() - started[0] < 5.0
    assert [sender.wait() for sender in senders] == [0]
    assert files(halfway) == before
    monkeypatch.undo()
    assert sample(halfway, "--resume") == 0
    assert compared(halfway) == expected


def test_a_signal_that_compiled_code_hides_is_still_a_signal():
    hidden = SystemError("_numba_unpickle returned a result with an exception set")
    hidden.__cause__ = KeyboardInterrupt(signal.SIGTERM)

    @with_progress
    def verb():
        raise SystemError("CPUDispatcher returned a result with an exception set") from hidden

    with pytest.raises(KeyboardInterrupt) as stopped, graceful_stop():
        verb()
    assert stopped.value.args == (signal.SIGTERM,)
    with pytest.raises(KeyboardInterrupt):
        verb()
    with pytest.raises(SystemError, match="bad argument"), graceful_stop():
        raise SystemError("bad argument to internal function")


def test_signals_are_handled_afterwards_as_before():
    before = signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        own = signal.getsignal(signal.SIGTERM)
        with graceful_stop() as stop:
            signal.raise_signal(signal.SIGTERM)
            assert stop() == signal.SIGTERM
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_signal_that_nohup_ignores_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with graceful_stop() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert stop() == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


# --- another problem ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (("--seed", "4"), ["seed (3 there, 4 now)"]),
        (("--fix", "kappa=0.1"), ["kappa (default there, 0.1 now)"]),
        (("--noise", "independent", "--fibre-switch"), ["option noise", "option fibre_switch"]),
    ],
)
def test_other_options_are_refused_by_name(halfway, capsys, more, named):
    before = files(halfway)
    message = resume_refused(capsys, halfway, *more)
    for words in (*named, "start again without --resume", str(halfway / NAME)):
        assert words in message
    assert files(halfway) == before


def test_another_file_or_version_is_refused(halfway, capsys, monkeypatch):
    media = SPECIMEN.with_name("donor2-media.csv")
    assert "differs in specimen (" in resume_refused(capsys, halfway, specimen=media)
    monkeypatch.setattr(biaxbayes, "__version__", "99.0")
    assert "version (" in resume_refused(capsys, halfway)


@pytest.mark.long
def test_starting_again_needs_no_permission_and_keeps_the_checkpoint_until_its_first(
    halfway, expected, monkeypatch
):
    before = (halfway / NAME).read_bytes()
    monkeypatch.setattr(
        sampling, "draw_posterior", lambda *a, **k: (_ for _ in ()).throw(MemoryError)
    )
    assert sample(halfway, "--seed", "3") == 2
    assert (halfway / NAME).read_bytes() == before
    monkeypatch.undo()
    assert sample(halfway) == 0
    assert compared(halfway) == expected


# --- damage ------------------------------------------------------------------------------------


def body_of(path):
    return path.read_bytes()[32:]


def sealed(body):
    """Bytes with the right checksum: whoever made them knew how."""
    return hashlib.sha256(body).digest() + body


@pytest.mark.long
def test_a_damaged_checkpoint_is_reported_and_the_one_before_used(halfway, expected, capsys):
    raw = (halfway / NAME).read_bytes()
    (halfway / NAME).write_bytes(raw[: len(raw) // 2])
    assert sample(halfway, "--resume") == 0
    message = capsys.readouterr().err
    assert f"{NAME} is damaged" in message and f"continuing from {PREVIOUS}" in message
    assert message.count("\n") == 1
    assert compared(halfway) == expected


def test_with_none_readable_nothing_is_guessed(halfway, capsys):
    for name in (NAME, PREVIOUS):
        (halfway / name).write_bytes(b"not a checkpoint")
    message = resume_refused(capsys, halfway)
    assert f"{NAME} is damaged" in message and f"{PREVIOUS} is damaged" in message


def test_cut_short_anywhere_or_with_any_bit_flipped(whole):
    raw = (whole / "after-0" / NAME).read_bytes()
    for size in range(0, len(raw), 600):
        with pytest.raises(DamagedArchive):
            unpack_record(raw[:size])
    rng = np.random.default_rng(1)
    for position in range(0, len(raw), 599):
        flipped = bytearray(raw)
        flipped[position] ^= 1 << rng.integers(8)
        with pytest.raises(DamagedArchive):
            unpack_record(bytes(flipped))


def archive_of(arrays) -> bytes:
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def test_nothing_is_unpickled(whole, tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.write_text, (tmp_path / "owned", "yes"))

    trap = np.empty(1, dtype=object)
    trap[0] = Trap()
    with pytest.raises(DamagedArchive):
        unpack_record(sealed(archive_of({"chain": trap})))
    assert not (tmp_path / "owned").exists()


def test_another_format_is_named(whole, halfway):
    with np.load(io.BytesIO(body_of(halfway / NAME))) as archive:
        parts = {k: archive[k] for k in archive.files}
    stored = json.loads(parts["text"].tobytes())
    text = json.dumps(stored | {"format": 99}).encode()
    parts["text"] = np.frombuffer(text, dtype=np.uint8)
    (halfway / NAME).write_bytes(sealed(archive_of(parts)))
    with pytest.raises(RunError, match=r"checkpoint format 99, this version reads \d+; finish"):
        checkpoint.load(halfway, stored["identity"])


# --- no room -----------------------------------------------------------------------------------


def test_a_checkpoint_that_does_not_fit_leaves_the_two_before(halfway, capsys):
    before = files(halfway)
    limited(sample, halfway, "--resume", size=200_000, code=2)
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "File too large" in message and "--resume continues" in message
    assert files(halfway) == before


@pytest.mark.long
def test_products_that_do_not_fit_leave_the_finished_run_before(whole, expected, tmp_path, capsys):
    folder = shutil.copytree(whole / "run", tmp_path / "run")
    before = files(folder)
    for size in (2_000, 1_000_000):
        limited(sample, folder, "--resume", size=size, code=2)
        message = capsys.readouterr().err
        assert message.count("\n") == 1
        assert "cannot be written" in message and "untouched" in message
        assert files(folder) == before
    biaxbayes.open_run(folder).tree.close()
    assert sample(folder, "--resume") == 0
    assert compared(folder) == expected


def limited(call, *arguments, size, code):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        assert call(*arguments) == code
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_folder_that_is_being_written_is_left_alone(halfway, capsys):
    from biaxbayes.file_lock import folder_lock

    before = files(halfway)
    with folder_lock(halfway):
        assert "another process is writing there" in resume_refused(capsys, halfway)
    assert files(halfway) == before


@pytest.mark.parametrize("verb", ["calibrate", "compare_laws"])
def test_a_study_that_a_hang_up_stops_ends_with_129_and_leaves_nothing_half_written(verb, tmp_path):
    options = {"source": "prior", "replications": 2} if verb == "calibrate" else {}
    (tmp_path / ".ranks.csv.123.tmp").write_text("half")
    with pytest.raises(Interrupted, match="after 0 of") as raised:
        getattr(biaxbayes, verb)(SPECIMEN, out=tmp_path, stop=lambda: signal.SIGHUP, **options)
    assert raised.value.exit_code == 129
    assert not list(tmp_path.glob("*.tmp")) and not list(tmp_path.glob(".*.tmp"))
