"""The integral of a density, by bridge sampling between its draws and a normalised proposal.

With p the unnormalised density, Z its integral and q the normalised proposal,

    Z = E_q[h p] / E_p[h q],     h = 1 / (s1 p / Z + s2 q),

for n1 effective draws of p and n2 of q, s_i = n_i / (n1 + n2); h is the choice of least
error (Meng and Wong, Statistica Sinica 6 (1996) 831), found by iteration. The relative error is
that of Fruehwirth-Schnatter, Econometrics Journal 7 (2004) 143.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from biaxbayes.sampling.convergence import autocorrelation_time
from biaxbayes.sampling.proposal import MixtureProposal
from biaxbayes.sampling.target import LogDensity

MAX_BRIDGE_DRAWS = 40_000
"""Draws of either kind that are used; more would cost time and add no digit that matters."""
MAX_BRIDGE_ITERATIONS, LOG_INTEGRAL_TOLERANCE = 200, 1e-10


def log_integral(
    log_prob: LogDensity, chain: np.ndarray, proposal: MixtureProposal, *, seed: int = 0
) -> tuple[float, float]:
    """Log integral of a density, and its error; the chain is (ensembles, steps, walkers, d)."""
    ensembles, steps, walkers, d = chain.shape
    stride = max(1, -(-ensembles * steps * walkers // MAX_BRIDGE_DRAWS))
    chain = chain[:, ::stride]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77,)))
    fresh = proposal.sample(rng, min(chain[..., 0].size, MAX_BRIDGE_DRAWS))
    return bridge(
        _log_ratio(log_prob, proposal, chain.reshape(-1, d)).reshape(chain.shape[:3]),
        _log_ratio(log_prob, proposal, fresh),
    )


def _log_ratio(log_prob: LogDensity, proposal: MixtureProposal, points: np.ndarray) -> np.ndarray:
    """Ln p - ln q; -inf where p is zero, also where q is."""
    values = log_prob(points)
    inside = np.isfinite(values)
    out = np.full(len(points), -np.inf)
    out[inside] = values[inside] - proposal.log_density(points[inside])
    return out


def bridge(draws_log_ratio: np.ndarray, proposal_log_ratio: np.ndarray) -> tuple[float, float]:
    """Log integral of p and its error from ln p - ln q at draws of p, and at draws (n,) of q."""
    first, second = draws_log_ratio.ravel(), proposal_log_ratio
    n1 = first.size / autocorrelation_time(np.tanh(draws_log_ratio - np.median(first)))
    n2 = float(second.size)
    log_s1, log_s2 = np.log(n1 / (n1 + n2)), np.log(n2 / (n1 + n2))
    value = float(logsumexp(second) - np.log(n2))  # importance sampling to start from
    for _ in range(MAX_BRIDGE_ITERATIONS):
        # ln of p / (s1 p / Z + s2 q) under q, and of q / (s1 p / Z + s2 q) under p
        above = second - np.logaddexp(log_s1 + second - value, log_s2)
        below = -np.logaddexp(log_s1 + first - value, log_s2)
        before = value
        value = float(_log_mean(above) - _log_mean(below))
        if abs(value - before) < LOG_INTEGRAL_TOLERANCE:
            break
    relative1 = np.exp(below - _log_mean(below)).reshape(draws_log_ratio.shape)
    relative2 = np.exp(above - _log_mean(above))
    tau = autocorrelation_time(relative1) if np.ptp(relative1) > 0.0 else 1.0
    variance = relative2.var() / n2 + relative1.var() * max(tau, 1.0) / first.size
    return value, float(np.sqrt(variance))


def _log_mean(logs: np.ndarray) -> float:
    return float(logsumexp(logs) - np.log(logs.size))
