"""Messages for what new users do: one line that names the mistake and the way out."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.machines.generic import parse_columns
from biaxbayes.options import SamplingPlan
from biaxbayes.specimens.check import check_specimen
from biaxbayes.specimens.specimen_file import (
    parse_specimen,
    read_specimen,
    specimen_text,
    write_specimen,
)
from biaxbayes.verbs.sample import SampleJob
from commands import refused, run

MADE = biaxbayes.simulate(material="donor2-media", noise_N=0.0006, increments=40)[0]


def made_file(folder, change=lambda line: line, rows=lambda rows: rows) -> Path:
    """A specimen file with lines of its header, or its rows, changed."""
    path = folder / "made.csv"
    write_specimen(MADE, path)
    lines = path.read_text().splitlines()
    first = 1 + next(i for i, line in enumerate(lines) if line.startswith("stretch_x"))
    path.write_text("\n".join([*map(change, lines[:first]), *rows(lines[first:])]) + "\n")
    return path


def test_shuffled_rows(capsys, tmp_path):
    shuffle = np.random.default_rng(1).permutation
    path = made_file(tmp_path, rows=shuffle)
    (result,) = (f for f in check_specimen(read_specimen(path)) if f.severity == "error")
    assert "out of order" in result.message
    path = made_file(
        tmp_path,
        lambda line: line + ",protocol" * line.startswith("stretch_x"),
        lambda rows: shuffle([f"{row},{'ab'[i < 20]}" for i, row in enumerate(rows)]),
    )
    assert "are mixed" in refused(capsys, "check", path)


@pytest.mark.parametrize("keys", [("edge_x_mm", "edge_y_mm"), ("thickness_mm",)])
def test_metres_instead_of_millimetres(capsys, tmp_path, keys):
    def in_metres(line: str) -> str:
        key, _, value = line.removeprefix("# ").partition(": ")
        return f"# {key}: {float(value) / 1000:g}" if key in keys else line

    assert "are in metres" in refused(capsys, "check", made_file(tmp_path, in_metres))


def test_a_strain_where_a_stretch_is_needed(capsys, small_run):
    code, _, err = run(capsys, "predict", small_run.path, "--stretch", 0.2, "--anyway")
    assert code == 2 and "for a strain of 0.2 write 1.2" in err


def test_a_protocol_that_the_run_does_not_have(capsys, small_run, tmp_path):
    own = [p.name for p in small_run.specimen.protocols]
    arguments = ("predict", small_run.path, "--anyway", "--out", tmp_path / "out", "--protocol")
    code, _, err = run(capsys, *arguments, "nope")
    assert code == 2 and f"unknown protocol 'nope'; the run has {', '.join(own)}" in err
    assert not (tmp_path / "out").exists()
    assert run(capsys, *arguments, own[0])[0] == 0


@pytest.mark.parametrize(("typed", "meant"), [("sampel", "sample"), ("Simulate", "simulate")])
def test_did_you_mean(capsys, typed, meant):
    assert f"did you mean {meant}?" in refused(capsys, typed, "x.csv")
    assert "commands are sample" in refused(capsys, "quux")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("force_x_mN", "did you mean force_x_N (values in N: 1 mN = 0.001 N)?"),
        ("thickness_m", "did you mean thickness_mm (values in mm: 1 m = 1000 mm)?"),
        ("force_x", "did you mean force_x_N?"),
    ],
)
def test_a_name_with_another_unit_says_how_to_scale(capsys, tmp_path, typed, meant):
    known = meant.split()[3].rstrip("?")
    file = made_file(tmp_path, lambda line: line.replace(known, typed))
    assert meant in refused(capsys, "check", file)


TARED = biaxbayes.simulate(material="donor2-media", noise_N=0.0006)[0].zeroed()


@pytest.mark.parametrize(
    "force", [(15.8, 12.6), (15800.0, 12600.0), (1.6e-11, 1.3e-11)], ids=["mN", "uN", "GN"]
)
def test_a_wrong_unit_is_refused_before_a_folder_is_made(capsys, tmp_path, force):
    path, folder = tmp_path / "tared.csv", tmp_path / "run"
    write_specimen(TARED, path)
    err = refused(capsys, "sample", path, "--mounting-force", *force, "--out", folder)
    assert "tared.csv" in err and "--mounting-force" in err and "in N" in err and "row" not in err
    assert not folder.exists()


def prepared(specimen, force, folder: Path) -> SampleJob:
    return SampleJob.prepare(
        specimen,
        out=folder,
        options={"mounting": "noisy"},
        amount=SamplingPlan(seed=1, ess=100.0, max_steps=200, workers=1),
        mounting_force=force,
    )


SIZES = st.floats() | st.floats(-1e6, 1e6) | st.floats(-0.05, 0.05)


@given(st.tuples(SIZES, SIZES), st.sampled_from([1e-3, 1.0, 20.0]))
@settings(max_examples=60, deadline=None)
def test_whatever_force_is_given_the_sampled_specimen_can_be_read_again(force, scale):
    """Or it is refused, naming the option, before anything is sampled."""
    specimen = biaxbayes.simulate(
        material="donor2-media", noise_N=0.0006, thickness=scale, increments=12
    )[0].zeroed()
    try:
        result = prepared(specimen, force, Path("unused")).specimen
    except InputError as error:
        assert "`mounting_force`" in str(error) or "stress" in str(error) or "load" in str(error)
        return
    lines = specimen_text(result).split("\n")
    assert parse_specimen(lines, Path("specimen.csv")).protocols == result.protocols


def test_a_target_of_convert_with_another_unit():
    with pytest.raises(InputError, match="write force_x_N=Fx:mN;"):
        parse_columns(["force_x_mN=Fx"])
