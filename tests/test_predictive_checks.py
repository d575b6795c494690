"""The model checked against its own data, in words; and a protocol left out."""

import time

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, norm

from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH
from biaxbayes.prediction.predictive_checks import checks_in_words, path_warnings, predictive_checks
from biaxbayes.sampling.sampler import Plan
from goh_functions import GOH_LAW
from model_cases import bent
from quick_posteriors import THREE_RATIOS, specimen
from studies.leave_out import leave_out, leave_out_each, with_own_mounting

TRUTH = GOH(9.0, 20.0, 4.0, 42.0, 0.15)


def true_draws(noise_sd: float, n: int = 50) -> pd.DataFrame:
    values = {
        "C1": TRUTH.C1_kPa,
        "k1": TRUTH.k1_kPa,
        "k2": TRUTH.k2,
        "alpha": TRUTH.alpha_deg,
        "kappa": TRUTH.kappa,
        "mounting_stretch_x": 1.01,
        "mounting_stretch_y": 1.02,
        "noise_sd": noise_sd,
    }
    return pd.DataFrame({k: np.full(n, v) for k, v in values.items()})


def test_truth_misses_by_noise_alone():
    data = specimen(TRUTH, increments=60)
    checks = predictive_checks(data, true_draws(0.002))
    assert set(checks["verdict"]) == {"noise"}
    assert path_warnings(checks, "N") == []
    assert checks_in_words(checks, "N") == [
        "The model misses no reading by more than the load cell's noise."
    ]


def test_the_missed_protocol_is_named_with_its_number():
    clean = specimen(TRUTH, increments=60)
    name = clean.protocols[1].name
    data = bent(clean, name, 0.15)
    checks = predictive_checks(data, true_draws(0.002))
    said = path_warnings(checks, "N")
    assert len(said) == 1
    assert said[0].startswith(f"GOH misses the {name} protocol by ")
    assert path_warnings(checks, "N", "may-newman")[0].startswith(f"May-Newman misses the {name} ")
    assert "do not use these parameters for that path" in said[0]
    row = checks[(checks.protocol == name) & (checks.direction == "y")].iloc[0]
    peak = float(clean.protocols[1].load_y.max())
    assert row["largest"] == pytest.approx(0.15 * peak, abs=0.008)
    assert any("too narrow" in text for text in checks_in_words(checks, "N"))


def test_fast_enough_for_a_closing_message():
    data = specimen(TRUTH, increments=300)
    draws = true_draws(0.002, n=4000)
    predictive_checks(data, draws)
    clock = time.process_time()
    predictive_checks(data, draws)
    assert time.process_time() - clock < 0.5


def test_own_mounting_balances_the_reading():
    data = specimen(TRUTH, increments=20)
    name = data.protocols[2].name
    draws = with_own_mounting(true_draws(0.002, 400), data, name, np.random.default_rng(1), GOH_LAW)
    lm = draws[[f"mounting_stretch_x[{name}]", f"mounting_stretch_y[{name}]"]].to_numpy()
    force = np.column_stack(TRUTH.piola(*lm.T)) * data.area
    reading, sd = data.mounting_readings(shared=False)
    assert force.mean(axis=0) == pytest.approx(reading[2], abs=5 * float(sd.max()) / 20)
    assert force.std(axis=0) == pytest.approx(sd[2], rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize("mounting", ["shared", "per-protocol"])
def test_a_goh_protocol_is_predicted(mounting):
    noise_N, probability = 0.005, 0.99
    data = specimen(TRUTH, increments=40, noise_N=noise_N)
    table = leave_out(
        data,
        data.protocols[1].name,
        plan=Plan(ess=100, workers=1, ensembles=2, population=2048, walkers=32),
        probability=probability,
        mounting_stretch=mounting,
        noise="independent",
    )
    assert list(table["direction"]) == ["x", "y"]
    outside = ((1.0 - table["inside"]) * table["readings"]).round()
    # as many as the band's content lets miss it, but for one protocol in a thousand
    assert (outside <= binom.isf(1e-3, table["readings"], 1.0 - probability)).all()
    # As wide as the noise, which 160 readings state to 6 %, and one mounting reading explain.
    alone = 2.0 * norm.isf(0.5 * (1.0 - probability)) * noise_N
    assert (table["width"] > 0.8 * alone).all()
    assert (table["width"] < (1.2 if mounting == "shared" else 2.0) * alone).all()


def test_nothing_to_leave_out():
    data = specimen(TRUTH, ratios=THREE_RATIOS[:1])
    with pytest.raises(InputError, match="none to leave out"):
        leave_out_each(data)
    with pytest.raises(InputError, match="no protocol"):
        leave_out(data, "other")
