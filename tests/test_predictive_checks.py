"""The model checked against its own data, in words, wherever a run is written about."""

import re

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.predictive_checks import path_warnings, predictive_checks
from biaxbayes.reports.methods import closing_message, latex_table
from biaxbayes.reports.run_page import report_page
from quick_posteriors import bent, runs_without_figures, specimen

TRUTH = GOH(9.0, 20.0, 4.0, 42.0, 0.15)


def true_draws(noise_sd: float, n: int = 50) -> pd.DataFrame:
    values = dict(zip(("C1", "k1", "k2", "alpha", "kappa"), TRUTH.values, strict=True))
    values |= {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02, "noise_sd": noise_sd}
    return pd.DataFrame([values] * n)


def checks(data, draws, noise="independent"):
    return predictive_checks(Posterior(data, noise=noise), draws)


def test_misfit_of_the_truth_is_the_noise():
    data = specimen(TRUTH, noise_N=0.002, increments=400)
    table = checks(data, true_draws(0.002))
    assert len(table) == 6
    # Standard error of an rms of 400 readings: 3.5 %.
    assert table["rms"].to_numpy() == pytest.approx(0.002, rel=0.15)
    assert set(table["agreement"]) == {"noise"} and path_warnings(table) == []
    assert (table["runs_z"].abs() < 3.5).all()
    assert (table["autocorrelation"].abs() < 0.2).all()
    share = float(table["inside"].mean())
    assert 0.87 < share < 0.93


def test_a_smooth_misfit_is_named():
    data = specimen(TRUTH, noise_N=0.0002, increments=400)
    wrong = true_draws(0.0002).assign(C1=12.0)
    table = checks(data, wrong)
    assert (table["runs_z"] < -10.0).all() and (table["autocorrelation"] > 0.9).all()


def test_the_band_of_the_tissue_holds_what_the_law_misses():
    """The residuals are the law's, the band that of the tissue: law and misfit."""
    data = specimen(TRUTH, noise_N=0.002, increments=60)
    data = bent(data, data.protocols[1].name, 0.15)
    posterior = Posterior(data)
    values = true_draws(0.002).drop(columns="noise_sd").to_dict("list")
    for axis, reading in zip("xy", data.mounting_readings(shared=True)[0][0], strict=True):
        values[f"mounting_force_{axis}"] = np.full(50, reading)
    table = predictive_checks(posterior, pd.DataFrame(values))
    alone = checks(data, true_draws(0.002))
    np.testing.assert_allclose(table["rms"], alone["rms"])
    assert (table["inside"] >= 0.85).all() and alone["inside"].min() < 0.3


def test_the_missed_protocol_is_named_with_its_number():
    clean = specimen(TRUTH, increments=60)
    name = clean.protocols[1].name
    data = bent(clean, name, 0.15)
    table = checks(data, true_draws(0.002))
    message = path_warnings(table)
    assert len(message) == 1
    assert message[0].startswith(f"GOH misses protocol {name} by ")
    assert path_warnings(table, "may-newman")[0].startswith(f"May-Newman misses protocol {name} ")
    row = table[(table.protocol == name) & (table.direction == "y")].iloc[0]
    peak = float(clean.protocols[1].load_y.max())
    assert row["largest"] == pytest.approx(0.15 * peak, abs=0.008)


WRITERS = (closing_message, report_page, latex_table)


@pytest.fixture(scope="module")
def data():
    return specimen(TRUTH, increments=15)


@pytest.fixture(scope="module")
def missed(data, tmp_path_factory):
    name = data.protocols[1].name
    folder = tmp_path_factory.mktemp("missed") / "run"
    with runs_without_figures():
        return name, biaxbayes.sample(
            bent(data, name, 0.2), out=folder, noise="independent", ess=100, workers=1
        )


@pytest.mark.parametrize("write", WRITERS)
def test_the_missed_path_is_named(write, missed):
    name, run = missed
    text = " ".join(write(run).split())
    plain = re.sub(r"<[^>]+>|\\(?=[^a-z])", "", text).replace("&#39;", "'")
    message = re.findall(r"GOH misses protocol (\S+) by [\d.]+ m?N root mean square", plain)
    assert name in message
    assert "do not use these parameters for that path" in plain


@pytest.mark.long
def test_a_described_specimen_is_not_warned_of(data, tmp_path):
    with runs_without_figures():
        run = biaxbayes.sample(data, out=tmp_path / "run", ess=60, workers=1)
    for write in WRITERS:
        assert "GOH misses the " not in write(run)
