"""The error models against SciPy's normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from biaxbayes.error_model import (
    CONSTANT,
    ERROR_MODELS,
    GROWING,
    curve_log_likelihood,
    log_likelihood,
    misfit,
    simulate,
    standard_cdf,
    standard_quantile,
)
from biaxbayes.options import Settings
from biaxbayes.parameters import ERRORS, NOISE_SD

LOAD = np.array([0.0, 0.1, 0.4, 1.0])
MEASURED = np.array([0.03, 0.08, 0.45, 0.9])
SD, GROWTH = 0.05, 0.1


@pytest.mark.parametrize("growth", [False, True])
def test_sd_likelihood_and_simulation_are_those_of_normal_errors(growth):
    values = {"noise_sd": SD} | ({"noise_growth": GROWTH} if growth else {})
    model = GROWING if growth else CONSTANT
    errors = model.at(values)
    sd = np.sqrt(SD**2 + (GROWTH * LOAD) ** 2) if growth else np.full(4, SD)
    np.testing.assert_allclose(model.sd(values, LOAD) * np.ones(4), sd, rtol=1e-14)
    expected = norm.logpdf(MEASURED, LOAD, sd)
    np.testing.assert_allclose(log_likelihood(LOAD, sd, MEASURED), expected, rtol=1e-12)
    # the mean of readings that scatter: what each of them would add, on average
    apart = 0.02
    both = [norm.logpdf(MEASURED + d, LOAD, sd) for d in (apart, -apart)]
    found = log_likelihood(LOAD, sd, MEASURED, apart**2)
    np.testing.assert_allclose(found, np.mean(both, axis=0), rtol=1e-12)
    # and the sums that the kernel makes of it
    square = (MEASURED - LOAD) ** 2
    total = sum(misfit(errors, f, s) for f, s in zip(LOAD, square, strict=True))
    curve = curve_log_likelihood(errors, total, len(LOAD))
    assert curve == pytest.approx(expected.sum(), rel=1e-12)
    readings = simulate(np.tile(LOAD, (20_000, 1)), sd, np.random.default_rng(3))
    error = readings - LOAD
    assert np.all(np.abs(error.mean(axis=0)) < 5.0 * sd / np.sqrt(20_000))
    np.testing.assert_allclose(error.std(axis=0), sd, rtol=5.0 / np.sqrt(2 * 20_000))


def test_bands_and_checks_use_the_same_distribution():
    z = np.linspace(-3.0, 3.0, 7)
    np.testing.assert_allclose(standard_cdf(z), norm.cdf(z), rtol=1e-12)
    np.testing.assert_allclose(standard_quantile(norm.cdf(z)), z, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("model", ERROR_MODELS, ids=str)
def test_settings_choose_each_model_and_its_parameters_are_registered(model):
    settings = Settings(**({model.option: True} if model.option else {}))
    assert settings.error_model is model
    assert [p.name for p in model.parameters] == list(model.values._fields)
    assert model.parameters[0] is NOISE_SD and set(model.parameters) <= set(ERRORS)
