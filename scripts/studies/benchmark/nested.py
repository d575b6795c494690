"""Nautilus, a nested sampler, from a narrowed prior in the sampling coordinates."""

from __future__ import annotations

import time
import warnings

import numpy as np
from scipy.stats import t as student

from biaxbayes.model.posterior import Posterior
from studies.benchmark.outcome import Outcome

ESS = 10_000
NU, WIDER = 3, 2.0
"""Degrees of freedom of the narrowed prior, and its width over that of the draws."""
ENLARGED = 1.5
"""Growth of nautilus's ellipsoids along each axis: at its default of 1.1 they cut tails off."""


def in_a_narrowed_prior(
    posterior: Posterior, points: np.ndarray, *, live: int, limit: float, seed: int = 1
) -> Outcome:
    """Nautilus between a Student t around draws (n, d) and the posterior.

    Any normalised reference gives the same evidence and the same posterior, when the likelihood is
    the density over the reference (posterior repartitioning: Chen, Hobson, Das and Gelderblom,
    Statistics and Computing 29 (2019) 835). This one has heavy tails and twice the width of the
    draws along their principal axes.
    """
    import nautilus

    centre, factor = points.mean(axis=0), WIDER * np.linalg.cholesky(np.cov(points.T))
    d, evaluations = points.shape[1], 0
    log_volume = float(np.log(np.diag(factor)).sum())

    def coordinates(cube: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z = student.ppf(np.atleast_2d(cube), NU)
        return centre + z @ factor.T, student.logpdf(z, NU).sum(axis=1) - log_volume

    def log_likelihood(cube: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        u, reference = coordinates(cube)
        evaluations += len(u)
        value = posterior.log_prob(u) - reference
        return np.where(np.isfinite(value), value, -1e300)

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
    weight = np.exp(log_weight - log_weight.max())
    # Kish's size is what nautilus takes its own error from
    ess = float(weight.sum() ** 2 / (weight**2).sum())
    draws = posterior.natural(coordinates(cube)[0])
    return Outcome(
        ess,
        evaluations,
        seconds,
        0.0,
        float("nan"),
        draws | {"weight": weight},
        "" if finished else "not finished",
        (float(sampler.log_z), 1.0 / float(np.sqrt(ess))),
    )
