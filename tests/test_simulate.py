"""``biaxbayes simulate`` as a user calls it."""

import json

import numpy as np
import pytest

import biaxbayes
from biaxbayes.laws.published import MATERIALS
from biaxbayes.specimens.specimen_file import read_specimen
from commands import exit_code, refused, run
from virtual_tubes import ARTERY, MATERIAL, readings


def simulate(*arguments):
    """Exit code of the command."""
    return exit_code("simulate", *arguments)


def test_five_numbers_several_protocols_and_the_seed(tmp_path):
    options = [
        *("--goh", 14, 140, 11.9, 38.4, 0.21),
        *("--prestretch", 1.02, 1.01, "--total-stretch", 1.2, "--ratio", "1:1"),
        *("--ratio", "1:0.5", "--increments", 20, "--edge", "20x15", "--thickness", 0.9),
        *("--noise-N", 0.001, "--misfit", 0.02, "--geometry", "mounted"),
        *("--loads", "cauchy"),
    ]
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        path = tmp_path / f"{name}.csv"
        assert simulate(*options, "--seed", seed, "--name", "s", "--out", path) == 0
    a, b, c = (read_specimen(tmp_path / f"{name}.csv") for name in "abc")
    assert a == b
    assert a != c
    assert [p.name for p in a.protocols] == ["1:1", "1:0.5"]
    assert a.loads == "cauchy"
    assert a.edge_y_mm == pytest.approx(15.0 * 1.01)
    assert a.protocols[0].stretch_x[-1] * 1.02 == pytest.approx(1.2)
    assert a.protocols[0].stretch_y[-1] * 1.01 == pytest.approx(1.2)


FUNG = ("--law", "fung", "--values", "c0_kPa=10,c_kPa=5,b_x=8,b_y=5,b_xy=2")
TEST = ("--prestretch", 1.02, 1.01, "--measured-stretch", 1.15)
TUBE = (
    *("--goh", *MATERIAL.values(), "--test", "tube"),
    *("--header", "unloaded_outer_diameter_mm=8", "--total-stretch", 1.28),
)


def test_a_specimen_of_another_law(tmp_path):
    out = tmp_path / "x.csv"
    assert simulate(*FUNG, *TEST, "--thickness", 2, "--out", out) == 0
    made = read_specimen(out).protocols[0]
    # W = c0 (I1 - 3) + c/2 (exp(Q) - 1), P = dW/dl at l = l_measured l_mounted, by complex step
    total = np.array([made.stretch_x * 1.02, made.stretch_y * 1.01])

    def energy(lx, ly):
        ex, ey = (lx**2 - 1) / 2, (ly**2 - 1) / 2
        q = 8 * ex**2 + 5 * ey**2 + 2 * 2 * ex * ey
        return 10 * (lx**2 + ly**2 + 1 / (lx * ly) ** 2 - 3) + 2.5 * (np.exp(q) - 1)

    for k, load in enumerate((made.load_x, made.load_y)):
        step = np.zeros((2, 1), dtype=complex)
        step[k] = 1e-30j
        piola = energy(*(total + step)).imag / 1e-30
        np.testing.assert_allclose(load, piola * 20 * 2 * 1e-3, rtol=1e-10)
    written = json.loads((tmp_path / "x.truth.json").read_text())["x"]["material"]
    assert written == {"law": "fung", "c0_kPa": 10, "c_kPa": 5, "b_x": 8, "b_y": 5, "b_xy": 2}
    material = biaxbayes.law("fung", c0_kPa=10, c_kPa=5, b_x=8, b_y=5, b_xy=2)
    same, truth = biaxbayes.simulate(
        material=material, prestretch=(1.02, 1.01), measured_stretch=1.15, thickness=2
    )
    np.testing.assert_array_equal(same.protocols[0].load_x, made.load_x)
    assert "law=fung" in repr(truth)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give one of --material NAME and --goh"),
        (["--material", "smoljkic-m55", "--total-stretch", 1.2], "give --prestretch X Y"),
        (["--material", "donor1", "--total-stretch", 1.2, "--measured-stretch", 1.1], "give one"),
        (["--material", "donor1", "--measured-stretch", 1], "ends where it starts"),
        (["--material", "donor1", "--measured-stretch", 1.9], "cannot be used"),
        (["--material", "donor1", "--ratio", "1:1", "--ratio", "1:1"], "each ratio once"),
        (["--material", "donor1", "--ratio", "1/2"], "is not of the form 1:0.5"),
        (["--material", "donor1", "--noise-N", -1], "--noise-N must be at least 0"),
        (["--goh", 1, 2, 3, 4, 0.5, "--prestretch", 1, 1], "kappa must lie between"),
        (["--law", "fung"], "give --values c0_kPa=...,c_kPa=...,b_x=...,b_y=...,b_xy=..."),
        (["--values", "c0_kPa=1"], "--values needs --law"),
        ([*FUNG[:2], "--values", "c0_kPa=1,b=2"], "b is not a parameter of the law fung"),
        ([*FUNG, "--material", "donor1"], "or --law with --values"),
        ([*FUNG, *TEST, "--hooks"], "leave --hooks out"),
        ([*FUNG, *TEST, "--header", "unloaded_outer_diameter_mm=8"], "--header"),
        ([*TUBE, "--prestretch", 1.02, 1.02], "--prestretch"),
        ([*TUBE, "--hooks"], "--hooks"),
        ([*TUBE, "--axial-stretch", 5], "--axial-stretch"),
        (TUBE[:-2], "--total-stretch"),
        ([*TUBE, "--axial-stretch", 0.5, "--thickness", 4.9], "pressure"),
    ],
)
def test_what_cannot_be_simulated_is_one_line_and_exit_2(tmp_path, capsys, arguments, message):
    code, _, error = run(capsys, "simulate", *arguments, "--out", tmp_path / "x.csv")
    assert code == 2 and message in error and not any(tmp_path.iterdir())


def test_existing_files_are_kept(tmp_path, capsys):
    out = tmp_path / "x.csv"
    assert simulate("--material", "donor1", "--out", out) == 0
    before = out.read_bytes()
    assert "exists already" in refused(capsys, "simulate", "--material", "donor2", "--out", out)
    assert out.read_bytes() == before
    assert simulate("--material", "donor2", "--out", out, "--overwrite") == 0
    assert out.read_bytes() != before
    assert simulate("--material", "donor2", "--out", tmp_path / "no" / "x.csv") == 2
    assert simulate("--material", "donor2", "--out", tmp_path) == 2
    assert simulate("--material", "donor2") == 2


def test_the_names_are_listed(capsys):
    assert simulate("--material", "list") == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in MATERIALS)


def test_without_prestretch_a_file_looks_tared(tmp_path, capsys):
    arguments = ("--material", "weisbecker-media", "--prestretch", 1, 1, "--total-stretch", 1.1)
    assert simulate(*arguments, "--out", tmp_path / "x.csv") == 0
    assert "tared" in capsys.readouterr().err


def test_a_tube_is_inflated_from_no_pressure(tmp_path, capsys):
    out = tmp_path / "tube.csv"
    sizes = ("--thickness", 0.9, "--header", "opening_angle_fung_deg=70")
    axial = ("--axial-stretch", 1.1, "--axial-stretch", 1.2)
    assert simulate(*TUBE, *sizes, *axial, "--out", out) == 0
    assert "mounting" not in capsys.readouterr().out
    tube = read_specimen(out)
    assert tube.experiment == ARTERY
    assert [p.stretch_y[0] for p in tube.protocols] == [1.1, 1.2]
    for p in tube.protocols:
        assert p.load_x[0] == pytest.approx(0.0, abs=1e-3) and p.stretch_x[-1] == 1.28
        np.testing.assert_allclose(tube.load(p), readings(ARTERY, p.stretch, MATERIAL), rtol=1e-9)
    noisy = tmp_path / "noisy.csv"
    errors = ("--noise-kPa", 0.03, "--noise-N", 0.003, "--misfit", 0.02)
    assert simulate(*TUBE, *sizes, *axial, *errors, "--out", noisy) == 0
    apart = read_specimen(noisy).protocols[1].load_x / tube.protocols[1].load_x - 1.0
    assert 0.005 < np.std(apart[10:]) < 0.06
    assert read_specimen(noisy).noise_sds == pytest.approx([0.03, 0.003])
