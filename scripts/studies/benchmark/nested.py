"""Nautilus, a nested sampler, from a narrowed prior."""

from __future__ import annotations

import time
import warnings

import numpy as np
from scipy.stats import t as student

from studies.benchmark.natural_density import NAMES, NaturalDensity, summaries
from studies.benchmark.outcome import Outcome
from studies.benchmark.straight import Straight

ESS = 10_000
NU, WIDER = 4, 1.5
"""Degrees of freedom of the narrowed prior, and its width over that of the flow's Gaussian."""
ENLARGED = 1.5
"""Growth of nautilus's ellipsoids along each axis: at its default of 1.1 they cut tails off."""


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
