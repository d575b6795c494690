"""What a caller's settings, closed streams and files that cannot be written may not do."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
from biaxbayes.cards import export as cards
from biaxbayes.errors import InputError
from biaxbayes.text_files import atomic_write_all

DATA = Path(__file__).parents[1] / "data" / "donor2-media.csv"


@pytest.fixture
def run(small_run, copied):
    """A copy of a run of few draws."""
    return biaxbayes.open_run(copied(small_run.path))


@pytest.mark.long
def test_numpy_that_raises_in_the_caller_raises_nowhere_here(tmp_path):
    with np.errstate(all="raise"):
        run = biaxbayes.sample(DATA, out=tmp_path / "run", ess=50, max_steps=128)
        biaxbayes.predict(run, stretch=1.1, anyway=True)
        biaxbayes.report(run)
        assert np.geterr()["under"] == "raise"


@pytest.mark.parametrize(
    "words", [("simulate", "--material", "list"), ("check", DATA), ("--help",)], ids=lambda w: w[0]
)
def test_a_closed_pipe_ends_as_other_programs_do(words):
    command = [sys.executable, "-m", "biaxbayes", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    said = process.stderr.read()
    process.stderr.close()
    assert process.wait() == 141 and not said


def test_files_that_belong_together_are_written_together(tmp_path):
    names = [tmp_path / "a", tmp_path / "b"]
    atomic_write_all(dict.fromkeys(names, b"old"))
    names[1].unlink()
    names[1].mkdir()
    with pytest.raises(InputError, match="is a folder"):
        atomic_write_all(dict.fromkeys(names, b"new"))
    assert names[0].read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 2


def test_an_export_that_fails_leaves_the_earlier_one(run, tmp_path, monkeypatch):
    out = tmp_path / "cards"
    biaxbayes.export(run, "abaqus", draws=3, out=out, anyway=True)
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    write, suffix = cards.PROGRAMS["abaqus"]
    left = iter([write, write])

    def fails(card, version):
        make = next(left, None)
        if make is None:
            raise MemoryError
        return make(card, version)

    monkeypatch.setitem(cards.PROGRAMS, "abaqus", (fails, suffix))
    with pytest.raises(MemoryError):
        biaxbayes.export(run, "abaqus", draws=3, seed=5, out=out, overwrite=True, anyway=True)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
    monkeypatch.setitem(cards.PROGRAMS, "abaqus", (write, suffix))
    again = biaxbayes.export(run, "abaqus", draws=2, seed=5, out=out, overwrite=True, anyway=True)
    assert {p.name for p in out.iterdir()} == {cards.MANIFEST, *again["file"]}


def test_a_prediction_whose_figure_fails_leaves_the_old_pair(run, monkeypatch):
    first = biaxbayes.predict(run, stretch=1.1, out=run.path, anyway=True)
    before = {n: (run.path / n).read_bytes() for n in ("prediction.csv", "prediction.pdf")}

    def failing(*_, **__):
        raise MemoryError

    monkeypatch.setattr("biaxbayes.figures.style.figure_bytes", failing)
    with pytest.raises(MemoryError):
        biaxbayes.predict(run, stretch=1.15, out=run.path, anyway=True)
    assert {n: (run.path / n).read_bytes() for n in before} == before
    assert len(first)
