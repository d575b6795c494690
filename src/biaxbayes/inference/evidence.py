"""The marginal likelihood, by bridge sampling between the draws and the frozen proposal.

With p the unnormalised posterior, Z its integral and q the normalised proposal,

    Z = E_q[h p] / E_post[h q],     h = 1 / (s1 p / Z + s2 q),

for n1 effective posterior and n2 proposal draws, s_i = n_i / (n1 + n2); h is the choice of least
error (Meng and Wong, Statistica Sinica 6 (1996) 831), found by iteration. The relative error is
that of Fruehwirth-Schnatter, Econometrics Journal 7 (2004) 143.

A tempered likelihood is no density of the data and has no evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import logsumexp

from biaxbayes.inference.convergence import autocorrelation_time
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Draws

__all__ = ["Evidence", "bridge", "evidence", "evidence_record"]

LARGEST = 40_000
"""Draws of either kind that are used; more would cost time and add no digit that matters."""
ITERATIONS, SETTLED = 200, 1e-10


@dataclass(frozen=True)
class Evidence:
    """Log marginal likelihood of the data.

    Attributes
    ----------
    log_evidence : float
        Natural log, for data in the unit of the file. Priors count as stated: what has no stable
        mounted state has density zero, and the rest is not renormalised.
    error : float
        Standard deviation of the estimate.
    mounting_reading : float or None
        Log density of the mounting reading where the model is one without prestretch
        (``ignored``): a force of zero, read with the load cell's noise. Add it before comparing
        with a model that infers the mounting stretch, whose data include that reading. None where
        it is in ``log_evidence`` already, or cannot be stated.
    """

    log_evidence: float
    error: float
    mounting_reading: float | None = None


def bridge(posterior_log_ratio: np.ndarray, proposal_log_ratio: np.ndarray) -> tuple[float, float]:
    """Log integral of p by bridge sampling.

    Parameters
    ----------
    posterior_log_ratio : ndarray, shape (ensembles, steps, walkers)
        ln p - ln q at the posterior draws.
    proposal_log_ratio : ndarray, shape (n,)
        ln p - ln q at independent draws of q; -inf where p is zero.

    Returns
    -------
    log_integral, error : float
    """
    first, second = posterior_log_ratio.ravel(), proposal_log_ratio
    n1 = first.size / autocorrelation_time(np.tanh(posterior_log_ratio - np.median(first)))
    n2 = float(second.size)
    log_s1, log_s2 = np.log(n1 / (n1 + n2)), np.log(n2 / (n1 + n2))
    value = float(logsumexp(second) - np.log(n2))  # importance sampling to start from
    for _ in range(ITERATIONS):
        # ln of p / (s1 p / Z + s2 q) under q, and of q / (s1 p / Z + s2 q) under the posterior
        above = second - np.logaddexp(log_s1 + second - value, log_s2)
        below = -np.logaddexp(log_s1 + first - value, log_s2)
        before = value
        value = float(_log_mean(above) - _log_mean(below))
        if abs(value - before) < SETTLED:
            break
    relative1 = np.exp(below - _log_mean(below)).reshape(posterior_log_ratio.shape)
    relative2 = np.exp(above - _log_mean(above))
    tau = autocorrelation_time(relative1) if np.ptp(relative1) > 0.0 else 1.0
    variance = relative2.var() / n2 + relative1.var() * max(tau, 1.0) / first.size
    return value, float(np.sqrt(variance))


def _log_mean(logs: np.ndarray) -> float:
    return float(logsumexp(logs) - np.log(logs.size))


def evidence(posterior: Posterior, draws: Draws, *, seed: int = 0) -> Evidence:
    """Log marginal likelihood of a posterior from its draws.

    Parameters
    ----------
    posterior : Posterior
        The one that was drawn from; independent noise and all rows.
    draws : Draws
    seed : int
        For the draws of the proposal.

    Raises
    ------
    ValueError
        If the likelihood is tempered or its rows are averaged.
    """
    problem = _without(posterior)
    if problem:
        raise ValueError(problem)
    ensembles, steps, walkers, d = draws.chain.shape
    stride = max(1, -(-ensembles * steps * walkers // LARGEST))
    chain = draws.chain[:, ::stride]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77,)))
    fresh = draws.proposal.sample(rng, min(chain[..., 0].size, LARGEST))
    value, error = bridge(
        _log_ratio(posterior, draws, chain.reshape(-1, d)).reshape(chain.shape[:3]),
        _log_ratio(posterior, draws, fresh),
    )
    return Evidence(value, error, _mounting_reading(posterior))


def evidence_record(posterior: Posterior, draws: Draws, seed: int) -> dict[str, Any]:
    """The evidence as JSON values, or the reason why there is none."""
    problem = _without(posterior)
    if not problem and draws.convergence.state != "reliable":
        problem = "the draws are not reliable"
    if problem:
        return {"log_evidence": None, "reason": problem}
    found = evidence(posterior, draws, seed=seed)
    return {
        "log_evidence": found.log_evidence,
        "error": found.error,
        "log_density_of_mounting_reading": found.mounting_reading,
    }


def _without(posterior: Posterior) -> str:
    """Why a posterior has no evidence; empty where it has one."""
    if posterior.settings.noise != "independent" or posterior.beta != 1.0:
        return "a tempered likelihood has no evidence (--noise independent has one)"
    if posterior.settings.thin:
        return "averaged rows have no evidence (--thin none has one)"
    return ""


def _log_ratio(posterior: Posterior, draws: Draws, points: np.ndarray) -> np.ndarray:
    """Ln p - ln q; -inf where p is zero, also where q is."""
    log_prob = posterior.log_prob(points)
    inside = np.isfinite(log_prob)
    out = np.full(len(points), -np.inf)
    out[inside] = log_prob[inside] - draws.proposal.log_density(points[inside])
    return out


def _mounting_reading(posterior: Posterior) -> float | None:
    offset = any(name.startswith("load_offset") for name in posterior.free)
    if posterior.settings.mounting != "ignored" or offset:
        return None
    reading, sd = posterior.specimen.mounting_readings(
        shared=posterior.settings.mounting_stretch == "shared"
    )
    if not (sd > 0.0).all():
        return None
    # lm = 1 carries no force: ln N(f0 | 0, s0)
    return float((-0.5 * (reading / sd) ** 2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi)).sum())
