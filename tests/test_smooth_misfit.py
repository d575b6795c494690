"""The smooth misfit of a law: how large it is, and how far it moves a least squares."""

import numpy as np

from biaxbayes.fitting.constrained import fit_setup, minimum, starting_points
from biaxbayes.fitting.law_fit import fit_law
from biaxbayes.laws import law_named
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.virtual_test import smooth_misfit as drawn_misfit
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.specimens.specimen import Protocol, Specimen

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
    sizes = [fit_law(specimen(0.03, 0.002 * peak, seed), "goh").misfit for seed in range(6)]
    assert 0.018 < np.median(sizes) < 0.045
    none = [fit_law(specimen(0.0, 0.002 * peak, seed), "goh").misfit for seed in range(6)]
    assert np.median(none) < 0.004


def test_the_errors_are_the_scatter_of_fits_to_other_misfits():
    """Mounting stretches over specimens with other misfits and noise, over their stated sd."""
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
    assert fit.misfit < 1e-6 and np.all(fit.sd < 1e-5)


def test_the_problem_of_a_law_is_public_to_its_errors():
    made = specimen(0.02, 0.001, 1)
    setup = fit_setup(made, "noisy", "shared", None, law_named("goh"), weighted=True, compiled=True)
    problem, found = minimum(setup, starting_points(setup, 2, 0, None))
    assert found.converged
    assert len(setup.by_protocol(problem.residual(found.unknowns))) == 3
