"""The smooth misfit of a law: which residuals show one, and how far it moves a fit."""

import numpy as np

from biaxbayes.fitting.effective_readings import effective_readings, has_smooth_misfit
from biaxbayes.fitting.law_fits import fit_law
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.virtual_test import simulate_smooth_misfit as drawn_misfit
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.specimens.specimen import Protocol, Specimen


def test_independent_errors_keep_their_worth():
    rng = np.random.default_rng(4)
    sets = [list(rng.standard_normal((6, 60, 2))) for _ in range(100)]
    assert sum(map(has_smooth_misfit, sets)) == 0
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
    assert has_smooth_misfit(residuals)
    assert effective_readings(residuals).total < 0.3 * effective_readings(residuals).count.sum()


def test_an_error_that_grows_is_judged_in_its_own_unit():
    """Load-cell errors that grow a hundredfold are independent in units of their sd."""
    rng = np.random.default_rng(6)
    sd = np.column_stack([np.geomspace(0.01, 1.0, 60)] * 2)
    residuals = [sd * rng.standard_normal(sd.shape) for _ in range(3)]
    result = effective_readings(residuals, [sd] * 3)
    assert result.total > 0.5 * result.count.sum()


# --- the misfit of a law, and how far it moves a least-squares fit ---

MATERIAL = GOH(8.0, 12.0, 4.0, 40.0, 0.12)
MOUNTING = (1.03, 1.02)


def specimen(misfit: float, noise: float, seed: int) -> Specimen:
    rng = np.random.default_rng(seed)
    protocols = []
    for ratio in ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0)):
        test = virtual_test(
            MATERIAL, mounting_stretch=MOUNTING, ratio=ratio, total_stretch=1.2, increments=30
        )
        load = np.array([test.force_x_N, test.force_y_N])
        s = np.linspace(0.0, 1.0, load.shape[1])
        load = load * (1.0 + np.array([drawn_misfit(s, misfit, rng) for _ in "xy"]))
        load = load + noise * rng.standard_normal(load.shape)
        protocols.append(Protocol(str(ratio), test.measured_x, test.measured_y, *load))
    return Specimen(
        "virtual",
        tuple(protocols),
        "force",
        edge_x_mm=10.0,
        edge_y_mm=10.0,
        thickness_mm=1.0,
        load_noise=noise,
    )


def test_the_size_of_the_misfit_is_that_of_the_truth():
    peak = specimen(0.0, 1e-9, 0).peak_load
    sizes = [fit_law(specimen(0.03, 0.002 * peak, seed), "goh").discrepancy_sd for seed in range(6)]
    assert 0.018 < np.median(sizes) < 0.045
    none = [fit_law(specimen(0.0, 0.002 * peak, seed), "goh").discrepancy_sd for seed in range(6)]
    assert np.median(none) < 0.004


def test_the_errors_are_the_scatter_of_fits_to_other_misfits():
    """Mounting stretches over specimens with other misfits and noise, over their reported sd."""
    peak = specimen(0.0, 1e-9, 0).peak_load
    off = []
    for seed in range(16):
        fit = fit_law(specimen(0.02, 0.002 * peak, seed), "goh")
        off += list((fit.mounting_stretch[0] - MOUNTING) / fit.sd[0])
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_posteriors_are_widened_where_the_law_misses_and_hardly_elsewhere():
    peak = specimen(0.0, 1e-9, 0).peak_load
    missed = [fit_law(specimen(0.03, 0.001 * peak, seed), "goh") for seed in range(4)]
    clean = [fit_law(specimen(0.0, 0.005 * peak, seed), "goh") for seed in range(4)]
    widest = [np.median(list(f.widening.values())) for f in missed]
    least = [np.median(list(f.widening.values())) for f in clean]
    assert np.median(widest) > 1.3 > np.median(least) >= 1.0
    assert all(np.all(f.mounting_widening >= 1.0) for f in (*missed, *clean))
    # rows that all count make the posterior narrower still
    counted = fit_law(specimen(0.03, 0.001 * peak, 0), "goh", weighted=False)
    assert min(counted.widening.values()) > 1.5 * max(1.0, min(missed[0].widening.values()))


def test_a_record_without_noise_has_no_misfit():
    fit = fit_law(specimen(0.0, 0.0, 0), "goh")
    assert fit.discrepancy_sd < 1e-6 and np.all(fit.sd < 1e-5)
