"""Nested samplers: dynesty from the prior for speed, nautilus from a narrowed one for accuracy."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import t as student

from studies.benchmark.natural_density import NAMES, NaturalDensity, summaries
from studies.benchmark.outcome import Outcome
from studies.benchmark.straight import Straight

__all__ = ["from_the_prior", "in_a_narrowed_prior"]

ESS = 10_000
NU, WIDER = 4, 1.5
"""Degrees of freedom of the narrowed prior, and its width over that of the flow's Gaussian."""
ENLARGED = 1.5
"""Growth of nautilus's ellipsoids along each axis: at its default of 1.1 they cut tails off."""


def from_the_prior(density: NaturalDensity, *, live: int, slices: int, seed: int = 1) -> Outcome:
    """Dynesty with slice steps, from the prior to the posterior; draws are weighted."""
    import dynesty

    transform, log_prior = _prior_cube(density)

    def log_likelihood(x: np.ndarray) -> float:
        value = float((density(x[None]) - log_prior(x[None]))[0])
        return value if np.isfinite(value) else -1e300

    clock = time.perf_counter()
    before = density.evaluations
    sampler = dynesty.NestedSampler(
        log_likelihood,
        lambda cube: transform(cube[None])[0],
        len(NAMES),
        nlive=live,
        sample="rslice",
        slices=slices,
        rstate=np.random.default_rng(seed),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sampler.run_nested(dlogz=0.1, print_progress=False)
    seconds = time.perf_counter() - clock
    found = sampler.results
    weight = found.importance_weights()
    return Outcome(
        _kish(weight),
        density.evaluations - before,
        seconds,
        0.0,
        float("nan"),
        summaries(found.samples) | {"weight": weight},
        "",
        (float(found.logz[-1]), float(found.logzerr[-1])),
    )


def in_a_narrowed_prior(
    density: NaturalDensity, straight: Straight, *, live: int, limit: float, seed: int = 1
) -> Outcome:
    """Nautilus between a Student t around the posterior and the posterior.

    Any normalised reference gives the same evidence and the same posterior, when the likelihood is
    the density over the reference (posterior repartitioning: Chen, Hobson, Das and Gelderblom,
    Statistics and Computing 29 (2019) 835). This one has independent Student t coordinates before
    the fitted flow, wider than the posterior and with heavy tails; from it a nested sampler is
    quick and accurate enough to judge evidence to hundredths. The density is the compiled one.
    """
    import nautilus

    d = len(NAMES)
    before = density.evaluations

    def log_likelihood(cube: np.ndarray) -> np.ndarray:
        z = student.ppf(np.atleast_2d(cube), NU)
        x, log_jacobian = straight.natural_points(WIDER * z)
        regular = np.isfinite(x).all(axis=1) & np.isfinite(log_jacobian)
        out = np.full(len(z), -1e300)
        reference = student.logpdf(z[regular], NU).sum(axis=1) - d * np.log(WIDER)
        value = density(x[regular]) + log_jacobian[regular] - reference
        out[regular] = np.where(np.isfinite(value), value, -1e300)
        return out

    clock = time.perf_counter()
    sampler = nautilus.Sampler(
        lambda cube: cube,
        log_likelihood,
        n_dim=d,
        n_live=live,
        n_networks=1,
        enlarge_per_dim=ENLARGED,
        vectorized=True,
        pass_dict=False,
        seed=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        finished = sampler.run(n_eff=ESS, discard_exploration=True, timeout=limit, verbose=False)
    seconds = time.perf_counter() - clock
    cube, log_weight, _ = sampler.posterior()
    x, _ = straight.natural_points(WIDER * student.ppf(cube, NU))
    weight = np.exp(log_weight - log_weight.max())
    ess = _kish(weight)
    return Outcome(
        ess,
        density.evaluations - before,
        seconds,
        0.0,
        float("nan"),
        summaries(x) | {"weight": weight},
        "" if finished else "not finished",
        # Kish's size is what nautilus takes its own error from.
        (float(sampler.log_z), 1.0 / float(np.sqrt(ess))),
    )


def _kish(weight: np.ndarray) -> float:
    """Effective size of weighted draws, (sum w)^2 / sum w^2."""
    return float(weight.sum() ** 2 / (weight**2).sum())


def _prior_cube(density: NaturalDensity) -> tuple[Callable, Callable]:
    """From the unit cube to the prior, and the prior's log density."""
    priors = density.priors
    logs = [NAMES.index(n) for n in ("C1", "k1", "k2", "noise_sd")]
    centre = np.log([priors[NAMES[i]].location for i in logs])
    scale = np.array([priors[NAMES[i]].scale for i in logs])
    stretch = priors["mounting_stretch_x"]
    below = float(ndtr((0.0 - stretch.location) / stretch.scale))

    def transform(cube: np.ndarray) -> np.ndarray:
        x = np.empty_like(cube)
        x[:, logs] = np.exp(centre + scale * ndtri(cube[:, logs]))
        x[:, 3] = 0.5 * np.pi * cube[:, 3]
        x[:, 4] = cube[:, 4] / 3.0
        for i in (5, 6):
            u = below + (1.0 - below) * cube[:, i]
            x[:, i] = stretch.location + stretch.scale * ndtri(u)
        return x

    half_log_2pi = 0.5 * np.log(2.0 * np.pi)

    def log_prior(x: np.ndarray) -> np.ndarray:
        z = (np.log(x[:, logs]) - centre) / scale
        out = -(0.5 * z * z + np.log(scale) + half_log_2pi).sum(axis=1)
        out -= np.log(x[:, logs]).sum(axis=1)
        out += np.log(2.0 / np.pi) + np.log(3.0)
        for i in (5, 6):
            z = (x[:, i] - stretch.location) / stretch.scale
            out -= 0.5 * z * z + np.log(stretch.scale) + half_log_2pi + np.log1p(-below)
        return out

    return transform, log_prior
