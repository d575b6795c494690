"""The error models against SciPy's normal distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from biaxbayes.model.error_model import curve_log_likelihood, error_model, misfit

LOAD = np.array([0.0, 0.1, 0.4, 1.0])
MEASURED = np.array([0.03, 0.08, 0.45, 0.9])
SD, GROWTH = 0.05, 0.1


@pytest.mark.parametrize("growth", [False, True])
@pytest.mark.parametrize("noise", ["independent", "effective", "systematic"])
def test_sd_likelihood_and_simulation_are_those_of_normal_errors(noise, growth):
    errors = error_model(noise, growth=growth)
    values = {"noise_sd": SD, "noise_growth": GROWTH}
    sd = np.sqrt(SD**2 + (GROWTH * LOAD) ** 2) if growth else np.full(4, SD)
    np.testing.assert_allclose(errors.sd(values, LOAD) * np.ones(4), sd, rtol=1e-14)
    expected = norm.logpdf(MEASURED, LOAD, sd)
    np.testing.assert_allclose(errors.log_likelihood(values, LOAD, MEASURED), expected, rtol=1e-12)
    # the mean of readings that scatter: what each of them would add, on average
    apart = 0.02
    both = [norm.logpdf(MEASURED + d, LOAD, sd) for d in (apart, -apart)]
    found = errors.log_likelihood(values, LOAD, MEASURED, apart**2)
    np.testing.assert_allclose(found, np.mean(both, axis=0), rtol=1e-12)
    # and the sums that the kernel makes of it
    square = (MEASURED - LOAD) ** 2
    total = sum(misfit(errors.spread, SD, GROWTH, f, s) for f, s in zip(LOAD, square, strict=True))
    curve = curve_log_likelihood(errors.spread, SD, total, len(LOAD))
    assert curve == pytest.approx(expected.sum(), rel=1e-12)
    readings = errors.simulate(values, np.tile(LOAD, (20_000, 1)), np.random.default_rng(3))
    error = readings - LOAD
    assert np.all(np.abs(error.mean(axis=0)) < 5.0 * sd / np.sqrt(20_000))
    np.testing.assert_allclose(error.std(axis=0), sd, rtol=5.0 / np.sqrt(2 * 20_000))
    assert errors.grows is growth
