"""Messages for what new users do: one line that names the mistake and the way out."""

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.machines.generic import parse_columns
from biaxbayes.specimens.check import check_specimen
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from commands import refused, run

MADE = biaxbayes.simulate(material="donor2-media", noise_N=0.0006, increments=40)[0]


def lines_of(tmp_path) -> tuple[list[str], list[str]]:
    path = tmp_path / "made.csv"
    write_specimen(MADE, path)
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("stretch_x"))
    return lines[: first + 1], lines[first + 1 :]


def test_shuffled_rows(capsys, tmp_path):
    head, rows = lines_of(tmp_path)
    rng = np.random.default_rng(1)
    path = tmp_path / "shuffled.csv"
    path.write_text("\n".join([*head, *rng.permutation(rows)]) + "\n")
    (result,) = (f for f in check_specimen(read_specimen(path)) if f.severity == "error")
    assert "out of order" in result.message
    named = [f"{row},{'a' if i < 20 else 'b'}" for i, row in enumerate(rows)]
    shuffled = [*head[:-1], f"{head[-1]},protocol", *rng.permutation(named)]
    path.write_text("\n".join(shuffled) + "\n")
    text = refused(capsys, "check", path)
    assert "are mixed" in text and "one row" not in text


@pytest.mark.parametrize("keys", [("edge_x_mm", "edge_y_mm"), ("thickness_mm",)])
def test_metres_instead_of_millimetres(capsys, tmp_path, keys):
    head, rows = lines_of(tmp_path)
    for i, line in enumerate(head):
        key, _, value = line.removeprefix("# ").partition(": ")
        if key in keys:
            head[i] = f"# {key}: {float(value) / 1000:g}"
    path = tmp_path / "metres.csv"
    path.write_text("\n".join([*head, *rows]) + "\n")
    assert "are in metres, multiply them by 1000" in refused(capsys, "check", path)


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


def test_an_angle_in_radians(capsys, tmp_path):
    path = tmp_path / "made.csv"
    write_specimen(MADE, path)
    arguments = ("fit", path, "--method", "zeroed", "--fix")
    assert "write alpha=34.38" in run(capsys, *arguments, "alpha=0.6")[2]
    for sound in ("alpha=41", "alpha=0", "kappa=0.1"):
        assert "radians" not in run(capsys, *arguments, sound)[2]


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
    head, rows = lines_of(tmp_path)
    known = meant.split()[3].rstrip("?")
    path = tmp_path / "other.csv"
    path.write_text("\n".join([*(line.replace(known, typed) for line in head), *rows]) + "\n")
    assert meant in refused(capsys, "check", path)


def test_a_target_of_convert_with_another_unit():
    with pytest.raises(InputError, match="write force_x_N=Fx:mN;"):
        parse_columns(["force_x_mN=Fx"])
