"""What correlated residuals are worth, beside the scatter of means over many repetitions."""

import numpy as np
import pytest

from biaxbayes.laws.goh import GOH
from biaxbayes.model.effective_readings import (
    effective_readings,
    misses_smoothly,
    systematic_readings,
)
from biaxbayes.model.preparation import prepare
from model_cases import bent
from quick_posteriors import specimen


def curves(rng: np.random.Generator, share: float, n: int = 60, count: int = 6):
    """Residuals of unit variance, a share of it common to all readings of a curve."""
    common = rng.standard_normal((count, 1, 2))
    own = rng.standard_normal((count, n, 2))
    return list(np.sqrt(share) * common + np.sqrt(1.0 - share) * own)


@pytest.mark.parametrize("share", [0.4, 0.7, 0.95])
def test_a_common_error_is_worth_what_the_scatter_of_means_says(share):
    rng = np.random.default_rng(3)
    sets = [curves(rng, share) for _ in range(200)]
    means = np.array([[c.mean(axis=0) for c in residuals] for residuals in sets])
    # var(mean) = v / n_eff, with v = 1 by construction
    true = 1.0 / means.var()
    found = [systematic_readings(r).effective.mean() for r in sets]
    assert np.median(found) == pytest.approx(true, rel=0.35)


def test_independent_errors_keep_their_worth():
    rng = np.random.default_rng(4)
    sets = [curves(rng, 0.0) for _ in range(100)]
    assert sum(map(misses_smoothly, sets)) == 0
    for residuals in sets[:10]:
        assert systematic_readings(residuals).total == effective_readings(residuals).total


def test_a_fit_hides_how_smooth_a_misfit_is():
    """A quartic misfit less its best parabola: one error, but the remainder wiggles."""
    s = np.linspace(-1.0, 1.0, 60)
    rng = np.random.default_rng(5)
    residuals = []
    for _ in range(4):
        misfit = np.column_stack([np.polyval(rng.standard_normal(5), s) for _ in "xy"])
        fitted = np.array([np.polyval(np.polyfit(s, m, 2), s) for m in misfit.T]).T
        residuals.append(misfit - fitted + 0.01 * rng.standard_normal(misfit.shape))
    assert misses_smoothly(residuals)
    by_autocorrelation = effective_readings(residuals).effective.mean()
    assert by_autocorrelation > 3.0
    assert 1.0 <= systematic_readings(residuals).effective.mean() < 0.6 * by_autocorrelation


def test_a_grown_error_is_judged_in_its_own_unit():
    """Load-cell errors that grow a hundredfold are independent in units of their sd."""
    rng = np.random.default_rng(6)
    sd = np.column_stack([np.geomspace(0.01, 1.0, 60)] * 2)
    residuals = [sd * rng.standard_normal(sd.shape) for _ in range(3)]
    found = systematic_readings(residuals, [sd] * 3)
    assert found.total > 0.5 * found.count.sum()


def test_the_posterior_of_a_missed_specimen_is_weighed_by_its_curves():
    data = specimen(GOH(9.0, 20.0, 4.0, 42.0, 0.15), increments=30)
    fitted = prepare(data, noise="systematic")
    assert fitted.beta > 0.5
    missed = bent(bent(data, data.protocols[0].name, 0.2), data.protocols[1].name, -0.2)
    by_runs, by_lags = (
        prepare(missed, noise=n).readings.total for n in ("systematic", "effective")
    )
    assert 6.0 <= by_runs < 0.7 * by_lags
    growing = prepare(missed, noise="systematic", noise_growth=True)
    assert growing.readings.total < 0.7 * by_lags
