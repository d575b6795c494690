"""The verbs export and predict, on a run whose draws and verdicts are exchanged."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

import commands
from biaxbayes.laws.published import MATERIALS
from biaxbayes.verbs.sample import sample
from card_readers import biaxial_stress, read_abaqus, read_febio
from commands import exit_code, refused
from quick_posteriors import exact_specimen, runs_without_figures

MEDIA = MATERIALS["weisbecker-media"].material


def with_result(run, verdict="identified"):
    reported = tuple(replace(r, verdict=verdict) for r in run.result.reported)
    vars(run)["result"] = replace(run.result, reported=reported)


def with_draws(run, **columns):
    vars(run)["draws"] = run.draws.assign(**columns)


@pytest.fixture
def run(small_copy, monkeypatch):
    """Converged, both mounting stretches identified."""
    small_copy.provenance["convergence"]["state"] = "converged"
    with_result(small_copy)
    monkeypatch.setattr(
        "biaxbayes.runs.run.open_run", lambda path: small_copy if path == small_copy.path else None
    )
    return small_copy


def test_export_many_draws_elsewhere_and_again(run, tmp_path, capsys):
    out = tmp_path / "cards"
    arguments = ("export", run.path, "--to", "febio", "--draws", 12, "--out", out)
    assert exit_code(*arguments) == 0
    files = sorted(out.glob("*.feb"))
    assert len(files) == 12
    assert all(read_febio(file.read_text()).bulk > 0.0 for file in files)
    assert "--overwrite" in refused(capsys, *arguments)
    before = [file.read_bytes() for file in files]
    assert exit_code(*arguments, "--overwrite") == 0
    assert [file.read_bytes() for file in files] == before


@pytest.mark.parametrize("switch", [False, True])
def test_export_warns_of_compressed_fibres_without_the_switch(run, capsys, switch):
    with_draws(run, alpha=90.0, kappa=0.0, mounting_stretch_y=0.9)
    run.provenance["settings"]["fibre_switch"] = switch
    assert exit_code("export", run.path, "--to", "abaqus", "--draws", 3) == 0
    message = "fibre strain is negative in tested states of 3 of 3"
    assert (message in capsys.readouterr().err) is not switch


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"kappa": 0.5}, "kappa"),
        ({"k1": np.nan}, "k1"),
        ({"noise_sd": -1.0}, "noise_sd"),
        ({"mounting_stretch_x": 0.0}, "mounting_stretch_x"),
    ],
)
def test_draws_of_a_damaged_run_are_refused(run, change, name, capsys):
    with_draws(run, **change)
    for verb in (["export", run.path, "--to", "febio"], ["predict", run.path]):
        assert f"its draws of {name} are" in refused(capsys, *verb)
    del run.draws["C1"]
    assert exit_code("predict", run.path) == 2


def test_unusable_runs_are_refused_unless_wanted(run, capsys):
    run.provenance["convergence"]["state"] = "unusable"
    for verb in (["export", run.path, "--to", "abaqus"], ["predict", run.path]):
        assert exit_code(*verb) == 3
        assert "--anyway" in capsys.readouterr().err
        assert exit_code(*verb, "--anyway") == 0
        assert "not converged" in capsys.readouterr().err
    run.provenance["convergence"]["state"] = "tentative"
    assert exit_code("predict", run.path) == 0
    assert "tentative" in capsys.readouterr().err


def test_bands_at_a_total_stretch_are_those_of_the_draws_whatever_the_verdicts(run, capsys):
    """And a note says what they rest on; nothing is said at stretches from the mounted state."""
    arguments = ("predict", run.path, "--relative-to", "unloaded", "--stretch", 1.1)
    tables = []
    for verdict in ("identified", "not identified"):
        with_result(run, verdict)
        assert exit_code(*arguments) == 0
        said = capsys.readouterr().out
        assert f"mounting_stretch_x ({run.result['mounting_stretch_x'].interval})" in said
        tables.append(pd.read_csv(run.path / "prediction.csv"))
    pd.testing.assert_frame_equal(*tables)
    assert exit_code("predict", run.path, "--stretch", 1.1) == 0
    assert "unloaded" not in capsys.readouterr().out


def test_predict_follows_the_tested_range_by_default(run):
    """From the mounted state."""
    assert exit_code("predict", run.path, "--stress", "piola") == 0
    table = pd.read_csv(run.path / "prediction.csv")
    x, y = run.specimen.protocols[0].stretch[-1]  # of the equibiaxial protocol
    assert table["stretch_x"].iloc[-1] == pytest.approx(x)
    assert ((table["extrapolation"] == "no") == (table["stretch_y"] <= y)).all()


def test_predict_inflates_a_tube_both_ways(run):
    tube = ("--inflate", "--radius", 10, "--wall", 1.2, "--axial-stretch", 1.1)
    assert exit_code("predict", run.path, *tube, "--points", 5) == 0
    table = pd.read_csv(run.path / "inflation.csv")
    assert table["pressure_kPa"].tolist() == [0.0, 4.0, 8.0, 12.0, 16.0]
    assert table["outer_diameter_mm_median"].is_monotonic_increasing
    options = ("--circumferential-stretch", "1:1.2", "--points", 3, "--around", "y")
    assert exit_code("predict", run.path, *tube, *options) == 0
    table = pd.read_csv(run.path / "inflation.csv")
    assert table["circumferential_stretch"].tolist() == [1.0, 1.1, 1.2]
    assert {"pressure_kPa_predictive_high", "axial_force_mN_median"} <= set(table.columns)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--inflate", "--radius", "1", "--wall", "2"], "thicker than the mid radius"),
        (["--inflate", "--radius", "9", "--wall", "1", "--stretch", "1.2"], "--stretch does not"),
        (["--radius", "9"], "--radius does not go without --inflate"),
        (["--inflate", "--pressure", "16"], "is not of the form 0:16"),
        (["--inflate", "--circumferential-stretch", "1.2"], "is not of the form 1:1.2"),
        (["--axial-stretch", "1.1"], "--axial-stretch does not go"),
        (["--stretches", "a.csv", "--ratio", "1:2"], "whole path"),
        (["--stretches", "a.csv"], "no such file"),
        (["--stretch", "nan"], "not strains or per cent"),
        (["--stretch", "1"], "not a possible largest stretch"),
        (["--style", "missing.mplstyle"], "the style cannot be read"),
    ],
)
def test_predict_refuses_by_name(run, options, message, capsys):
    code, _, error = commands.run(capsys, "predict", run.path, *options)
    assert code == 2 and message in error


@pytest.mark.long
def test_a_sampled_run_goes_all_the_way(tmp_path):
    """From a record to a card and a prediction that hold the truth they were made from."""
    specimen = exact_specimen(MEDIA, increments=40, noise_N=0.002)
    with runs_without_figures():
        sampled = sample(specimen, out=tmp_path / "run", noise="independent", ess=200, workers=1)
    assert sampled.state == "converged"
    assert exit_code("export", sampled.path, "--to", "abaqus", "--at", "map") == 0
    (file,) = (sampled.path / "cards-abaqus-kPa-mm").glob("*.inp")
    card = read_abaqus(file.read_text())
    path = np.linspace(1.05, 1.18, 6)
    truth = np.array(MEDIA.cauchy(path, path))
    got = np.array(biaxial_stress(card.isochoric_energy, path, path))
    assert np.abs(got / truth - 1.0).max() < 0.03
    assert exit_code("predict", sampled.path, "--stretch", 1.16, "--probability", 0.99) == 0
    table = pd.read_csv(sampled.path / "prediction.csv").iloc[20:]
    states = (table[["stretch_x", "stretch_y"]].to_numpy() * (1.01, 1.02)).T
    for axis, true in zip("xy", MEDIA.cauchy(*states), strict=True):
        # rows of a curve share their error: a band of 99 % that holds one holds them all
        assert (true > table[f"cauchy_{axis}_kPa_credible_low"]).all()
        assert (true < table[f"cauchy_{axis}_kPa_credible_high"]).all()


def test_export_writes_the_median_draw_by_default(run, capsys):
    assert exit_code("export", run.path, "--to", "abaqus", "--units", "MPa-mm") == 0
    said = capsys.readouterr().out
    folder = run.path / "cards-abaqus-MPa-mm"
    manifest = pd.read_csv(folder / "manifest.csv")
    assert len(manifest) == 1
    assert f"off the readings by {100 * manifest['distance_to_readings'][0]:.2g} %" in said
    result = read_abaqus((folder / manifest["file"][0]).read_text())
    draw = run.draws.iloc[manifest["draw"][0]]
    assert result.solids[0].values["c"] == pytest.approx(2.0 * draw["C1"] / 1000.0)


def test_a_run_that_ignored_the_mounting_says_so_in_its_cards(run):
    for axis in "xy":
        del run.draws[f"mounting_stretch_{axis}"]
    assert exit_code("export", run.path, "--to", "abaqus") == 0
    (card,) = (run.path / "cards-abaqus-kPa-mm").glob("*.inp")
    assert "ignored the mounting stretch" in card.read_text()


def test_predict_takes_a_path_from_a_file(run, tmp_path):
    file, out = tmp_path / "path.csv", tmp_path / "out"
    file.write_text("stretch_x,stretch_y\n1,1\n0.98,1.05\n0.97,1.1\n")  # where nothing was read
    options = ("--stretches", file, "--out", out, "--format", "png", "--width-mm", 180)
    assert exit_code("predict", run.path, *options) == 0
    table = pd.read_csv(out / "prediction.csv")
    assert table["stretch_y"].tolist() == [1.0, 1.05, 1.1]
    # both directions are side by side
    height, width, _ = imread(out / "prediction.png").shape
    assert width > 1.9 * height
