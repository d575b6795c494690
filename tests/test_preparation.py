"""A posterior as a value: what it is given, and that looking at it changes nothing."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare, start_parameters, with_sampling_constants
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Plan

DATA = Path(__file__).parents[1] / "data"


def media():
    return biaxbayes.read_specimen(DATA / "donor2-media.csv")


@cache
def prepared():
    return prepare(media())


def test_a_weight_that_needs_a_fit_is_not_made_up():
    with pytest.raises(InputError, match=r"beta .* biaxbayes\.prepare") as caught:
        Posterior(media(), noise="effective")
    assert "\n" not in str(caught.value)
    assert Posterior(media(), noise="effective", beta=0.25).beta == 0.25


def test_preparing_fits_weighs_and_lays_out():
    posterior = biaxbayes.prepare(media())
    assert posterior.readings.beta == posterior.beta < 1.0
    lm = posterior.fit.mounting_stretch[0]
    tops = [max(getattr(p, f"stretch_{a}").max() for p in media().protocols) for a in "xy"]
    np.testing.assert_allclose(
        posterior.sampling_constants.reference_stretch, tops * np.clip(lm, 1.0, 1.5)
    )
    stated = prepare(media(), beta=0.3)
    assert stated.beta == 0.3 and stated.readings is None
    assert stated.replaced(thin=0).fit is stated.fit


@pytest.mark.long
def test_drawing_leaves_the_posterior_as_it_is():
    posterior = Posterior(media(), noise="independent")
    points = posterior.coordinates(start_parameters(posterior)) + np.linspace(0, 0.1, 5)[:, None]
    before, held = posterior.log_prob(points), dict(vars(posterior))
    plan = Plan(ess=1e9, max_steps=64, first_block=64, population=1024, ensembles=2, walkers=32)
    first, again = (draw_posterior(posterior, plan) for _ in range(2))
    np.testing.assert_array_equal(first.chain, again.chain)
    assert first.rejected == again.rejected
    assert {k: v is held[k] for k, v in vars(posterior).items()} == dict.fromkeys(held, True)
    np.testing.assert_array_equal(posterior.log_prob(points), before)


def test_another_chart_is_another_posterior_of_the_same_density():
    posterior = prepared()
    softer = with_sampling_constants(posterior, 3.0 * posterior.sampling_constants.softening)
    assert (
        softer is not posterior
        and softer.sampling_constants.softening == 3.0 * posterior.sampling_constants.softening
    )
    assert (
        softer.sampling_constants.reference_stretch
        == posterior.sampling_constants.reference_stretch
    )
    parameters = posterior.natural(posterior.coordinates(start_parameters(posterior)))
    there = softer.coordinates(parameters)
    assert not np.allclose(there, posterior.coordinates(parameters))
    natural = softer.natural(there)
    for name, value in parameters.items():
        np.testing.assert_allclose(natural[name], value, rtol=1e-9)


def test_a_sampler_counts_for_itself():
    """Two targets of one posterior, evaluated in turn."""
    posterior = prepared()
    inside = posterior.coordinates(start_parameters(posterior))
    outside = inside.copy()
    outside[:, list(posterior.free).index("kappa")] = 2.0
    one, other = posterior.target(), posterior.target()
    one.log_prob(np.vstack([inside, outside, outside]))
    assert one.rejections(one.counts) == {
        "evaluated": 3, "out_of_range": 2, "no_mounting_root": 0, "overflow": 0
    }  # fmt: skip
    assert not other.counts.any()
    np.testing.assert_array_equal(other.bounds, posterior.bounds)
