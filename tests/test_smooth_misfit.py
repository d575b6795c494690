"""Which residuals show a smooth misfit of a law."""

import numpy as np

from biaxbayes.fitting.residuals import has_smooth_misfit


def test_independent_errors_show_none():
    rng = np.random.default_rng(4)
    sets = [list(rng.standard_normal((6, 60, 2))) for _ in range(100)]
    assert sum(map(has_smooth_misfit, sets)) == 0


def test_what_a_fit_leaves_of_a_smooth_misfit_is_noticed():
    """A quartic misfit less its best parabola: one error, but the remainder wiggles."""
    s = np.linspace(-1.0, 1.0, 60)
    rng = np.random.default_rng(5)
    residuals = []
    for _ in range(4):
        misfit = np.column_stack([np.polyval(rng.standard_normal(5), s) for _ in "xy"])
        fitted = np.array([np.polyval(np.polyfit(s, m, 2), s) for m in misfit.T]).T
        residuals.append(misfit - fitted + 0.01 * rng.standard_normal(misfit.shape))
    assert has_smooth_misfit(residuals)
