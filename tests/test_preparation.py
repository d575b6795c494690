"""A posterior as a value: what it is given, and the likelihood of averaged rows."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
from biaxbayes.fitting.fit import fit
from biaxbayes.laws.goh import GOH
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare, start_parameters
from biaxbayes.model.priors import Prior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.averaging import average_rows
from biaxbayes.specimens.specimen import Protocol, Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

DATA = Path(__file__).parents[1] / "data"


def media():
    return biaxbayes.read_specimen(DATA / "donor2-media.csv")


@cache
def prepared():
    return prepare(media())


def test_a_misfit_is_relative_to_the_loads_of_the_fit_unless_another_is_given():
    posterior = prepared()
    assert posterior.misfit_fit is posterior.fit
    other = biaxbayes.fit(media(), method="linden")
    given = posterior.replaced(misfit_fit=other)
    assert given.misfit_fit is other and given.fit is posterior.fit
    values = posterior.natural(posterior.coordinates(start_parameters(posterior)))
    assert given.log_density(values) != posterior.log_density(values)
    # and it stays what it is
    assert given.replaced(max_rows=50).misfit_fit is other


@pytest.mark.long
def test_drawing_leaves_the_posterior_as_it_is():
    posterior = Posterior(media(), noise="independent")
    points = posterior.coordinates(start_parameters(posterior)) + np.linspace(0, 0.1, 5)[:, None]
    before, attributes = posterior.log_prob(points), dict(vars(posterior))
    plan = Plan(ess=1e9, max_steps=64, first_block=64, population=1024, ensembles=2, walkers=32)
    first, again = (draw_posterior(posterior, plan) for _ in range(2))
    np.testing.assert_array_equal(first.chain, again.chain)
    assert first.evaluations == again.evaluations
    assert vars(posterior).keys() == attributes.keys()
    assert all(v is attributes[k] for k, v in vars(posterior).items())
    np.testing.assert_array_equal(posterior.log_prob(points), before)


MATERIAL = GOH(9.0, 20.0, 4.0, 42.0, 0.15)


def long_specimen(increments: int = 400, misfit: float = 0.0, seed: int = 4) -> Specimen:
    made, _ = virtual_specimen(
        MATERIAL, name="long", mounting_stretch=(1.01, 1.02), total_stretch=1.2,
        ratios=((1.0, 1.0), (1.0, 0.5)), increments=increments,
        machine=Machine(noise_N=0.004, misfit=misfit), seed=seed,
    )  # fmt: skip
    return made


def test_rows_are_means_and_rest_is_kept():
    stretch = np.concatenate([[1.0, 1.0], np.linspace(1.0, 1.2, 9)[1:]])
    load = np.concatenate([[0.3, 0.5], np.arange(8.0)])
    p = Protocol("a", stretch, stretch, load, 2 * load, rest_rows=2)
    # 8 rows, three of them to be left: groups of 2, 3 and 3, none of them much smaller
    out = average_rows(Specimen("s", (p,), "piola"), 3)
    q = out.specimen.protocols[0]
    assert q.load_x.tolist() == [0.3, 0.5, 0.5, 3.0, 6.0]
    assert q.stretch_x[2:] == pytest.approx(
        [stretch[2:4].mean(), stretch[4:7].mean(), stretch[7:].mean()]
    )
    assert q.rest_rows == 2
    assert out.weight == (pytest.approx(8 / 3),)
    assert np.abs(out.scatter[0]).max() < 1e-20  # a straight line has no scatter


@pytest.mark.parametrize("size", [2, 3, 5])
def test_scatter_is_that_of_the_noise(size):
    rng = np.random.default_rng(1)
    n = 6000
    stretch = np.linspace(1.0, 1.2, n + 1)
    load = 50.0 * (stretch - 1.0) ** 2 + 0.2 * rng.standard_normal(n + 1)
    data = Specimen("s", (Protocol("a", stretch, stretch, load, load),), "piola")
    out = average_rows(data, n // size)
    # mean square of k readings about their own mean: sd^2 (k - 1) / k
    assert out.scatter[0].mean() == pytest.approx(0.04 * (size - 1) / size, rel=0.05)


def test_independent_errors_of_averaged_rows_are_those_of_all_rows():
    """Over changes of the parameters that move the posterior by many units."""
    data = long_specimen(misfit=0.02)
    full = Posterior(data, noise="independent", max_rows="none")
    max_rows = Posterior(data, noise="independent", max_rows=100)
    assert max_rows.rows.pieces[0].protocols[0].rows == 101
    z = np.random.default_rng(2).standard_normal((6, 40))
    draws = {"C1": 9.0 * np.exp(0.05 * z[0]), "k1": 20.0 * np.exp(0.1 * z[1])}
    draws |= {"k2": 4.0 * np.exp(0.1 * z[2]), "alpha": 42.0 + z[3], "kappa": 0.15 + 0.01 * z[4]}
    for axis, force in zip("xy", data.mounting_readings(shared=True)[0][0], strict=True):
        draws[f"mounting_force_{axis}"] = np.full(40, force)
    draws["noise_sd"] = 0.01 * np.exp(0.3 * z[5])
    of_all, of_means = full.log_density(draws), max_rows.log_density(draws)
    assert np.ptp(of_all) > 1000.0
    change = (of_means - of_all) - (of_means - of_all).mean()
    assert np.abs(change).max() < 0.002 * np.ptp(of_all)


@pytest.mark.parametrize(
    ("increments", "options", "max_rows"),
    [
        (400, {}, 100),
        (400, {"noise": "independent"}, 0),
        (150, {}, 0),
        (400, {"max_rows": "none"}, 0),
    ],
)
def test_automatic_only_where_it_is_long_and_the_law_misses_smoothly(increments, options, max_rows):
    assert Posterior(long_specimen(increments), **options).settings.max_rows == max_rows


@pytest.mark.parametrize("load_noise", [0.004, None])
def test_averaging_a_long_record_changes_no_reading_of_a_misfit(load_noise):
    """The same readings with the same noise, whether averaged once or twice."""
    data = replace(long_specimen(), load_noise=load_noise)
    full, max_rows = (
        Posterior(data, max_rows=rows, misfit_fit=FIT(data)) for rows in ("none", 100)
    )
    assert len(full.misfit.noise_sd) == len(max_rows.misfit.noise_sd)
    # groups of three and of four averages of four rows each, instead of 12 and 13 rows
    np.testing.assert_allclose(max_rows.misfit.noise_sd, full.misfit.noise_sd, rtol=0.15)
    np.testing.assert_allclose(max_rows.readings.weight, full.readings.weight, rtol=0.3)
    values = start_parameters(full)
    near = [values | {"k1": values["k1"] * f} for f in (0.99, 1.0, 1.01)]
    a, b = (np.array([p.log_density(v) for v in near]) for p in (full, max_rows))
    np.testing.assert_allclose(a - a[1], b - b[1], rtol=0.05, atol=0.05)


FIT = cache(fit)


def test_a_prior_with_one_bound_on_the_wrong_side_of_the_fit_still_gives_a_start():
    """The fit is mounted at 1.01 and 1.02; the prior ends below, and has no lower end."""
    prior = Prior("normal", 1.0, 0.01, high=1.005)
    posterior = Posterior(long_specimen(), mounting="free", priors={"mounting_stretch": prior})
    assert posterior.fit.mounting_stretch.min() > 1.005
    start = start_parameters(posterior)
    assert start["mounting_stretch_x"] == pytest.approx(1.005 - 0.01 * 1.005)
    assert np.isfinite(posterior.log_density(start))
