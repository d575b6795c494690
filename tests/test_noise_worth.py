"""Which residuals count as those of a model that misses smoothly."""

import numpy as np

from biaxbayes.fitting.effective_readings import effective_readings, misses_smoothly


def test_independent_errors_keep_their_worth():
    rng = np.random.default_rng(4)
    sets = [list(rng.standard_normal((6, 60, 2))) for _ in range(100)]
    assert sum(map(misses_smoothly, sets)) == 0
    worth = [effective_readings(r).total / effective_readings(r).count.sum() for r in sets]
    assert np.median(worth) > 0.8


def test_what_a_fit_leaves_of_a_smooth_misfit_is_noticed():
    """A quartic misfit less its best parabola: one error, but the remainder wiggles."""
    s = np.linspace(-1.0, 1.0, 60)
    rng = np.random.default_rng(5)
    residuals = []
    for _ in range(4):
        misfit = np.column_stack([np.polyval(rng.standard_normal(5), s) for _ in "xy"])
        fitted = np.array([np.polyval(np.polyfit(s, m, 2), s) for m in misfit.T]).T
        residuals.append(misfit - fitted + 0.01 * rng.standard_normal(misfit.shape))
    assert misses_smoothly(residuals)
    assert effective_readings(residuals).total < 0.3 * effective_readings(residuals).count.sum()


def test_an_error_that_grows_is_judged_in_its_own_unit():
    """Load-cell errors that grow a hundredfold are independent in units of their sd."""
    rng = np.random.default_rng(6)
    sd = np.column_stack([np.geomspace(0.01, 1.0, 60)] * 2)
    residuals = [sd * rng.standard_normal(sd.shape) for _ in range(3)]
    found = effective_readings(residuals, [sd] * 3)
    assert found.total > 0.5 * found.count.sum()
