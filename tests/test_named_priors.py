"""Priors of fibre angle and dispersion from imaging."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erfi

from biaxbayes.errors import InputError
from biaxbayes.model.priors import Prior, named_priors, read_priors


def kappa_of_concentration(b: float) -> float:
    """Dispersion of a rotationally symmetric von Mises distribution (Gasser et al. 2006)."""
    norm = 4.0 * np.sqrt(b / (2.0 * np.pi)) / erfi(np.sqrt(2.0 * b))
    value, _ = quad(lambda t: norm * np.exp(b * (np.cos(2 * t) + 1)) * np.sin(t) ** 3, 0, np.pi)
    return 0.25 * float(value)


def test_a_dispersion_follows_from_the_stated_concentration():
    grid = np.linspace(0.01, 14.0, 400)
    kappa = [kappa_of_concentration(b) for b in grid]
    draws = np.random.default_rng(1).normal(size=20_000)
    stated = {name: entry for name, entry in named_priors().items() if "b" in entry}
    assert len(stated) == 5
    for name, entry in stated.items():
        mean, sd = entry["b"]
        b = mean + sd * draws
        of_b = np.interp(b[b > 0.01], grid, kappa)
        prior = read_priors(Path(name))["kappa"]
        assert isinstance(prior, Prior)
        # to the last stated digit, and twice the Monte Carlo error of a mean of 20,000
        assert prior.location == pytest.approx(of_b.mean(), abs=0.0015)
        assert prior.scale == pytest.approx(of_b.std(), abs=0.0015)


def test_every_named_prior_states_its_source_and_has_mass_where_the_parameter_can_be():
    for name, entry in named_priors().items():
        assert all(entry[key] for key in ("tissue", "source", "stated", "assumed"))
        for prior in read_priors(Path(name)).values():
            assert isinstance(prior, Prior)
            assert np.isfinite(prior.ppf(np.array([0.05, 0.5, 0.95]))).all()


def test_an_unknown_name_lists_the_names():
    with pytest.raises(InputError) as caught:
        read_priors(Path("human-carotids"))
    assert "human-carotid" in str(caught.value) and "mouse-skin-young-dorsal" in str(caught.value)
