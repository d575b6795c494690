"""Shares of a proposal's components, set for the sampler rather than for the fit.

An independence sampler moves the slower, the larger the mean importance weight is where it
stands: with w = density / proposal, both normalised, its autocorrelation time is about
2 E[w] - 1, the mean taken over the density (Liu, Statistics and Computing 6 (1996) 113). E[w] is
a convex function of the shares of a mixture's components. Components that were added to cover
tails (:mod:`.covering`) take more than they need; what they need is found here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from biaxbayes.inference.mixture import StudentMixture
from biaxbayes.inference.patchwork import Patchwork

__all__ = ["rebalance"]

POINTS = 8000
ROUNDS = 20
KEPT = 0.5
"""Part of the proposal that stays as it is: the points may not have been where it reaches."""


def rebalance(
    proposal: Patchwork, points: np.ndarray, log_prob: np.ndarray, rng: np.random.Generator
) -> Patchwork:
    """Set the shares of all components so that E[w] is least.

    Parameters
    ----------
    proposal : Patchwork
    points : ndarray, shape (n, d)
        Draws of the density.
    log_prob : ndarray, shape (n,)
    rng : numpy.random.Generator
    """
    if len(points) > POINTS:
        few = rng.choice(len(points), POINTS, replace=False)
        points, log_prob = points[few], log_prob[few]
    share, log_density = _components(proposal, points)
    # q_k / pi, up to a constant that the shares do not depend on
    ratio = log_density - log_prob
    ratio = np.exp(ratio - np.median(ratio.max(axis=0)))
    kept, free = KEPT * (share @ ratio), share
    for _ in range(ROUNDS):
        # E[w] = E[1 / sum_k a_k q_k / pi];  a_k <- a_k sqrt(E[w^2 q_k / pi]), summing to one
        w = 1.0 / (kept + (1.0 - KEPT) * (free @ ratio))
        free = free * np.sqrt(ratio @ (w * w))
        free /= free.sum()
    return _with_shares(proposal, KEPT * share + (1.0 - KEPT) * free)


def _components(proposal: Patchwork, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (k,) and log densities (k, n) of the components of all parts."""
    shares, columns = [], []
    for weight, part in zip(proposal.weights, proposal.parts, strict=True):
        r, log_jacobian = part.trend.straighten(points)
        mixture = part.mixture
        shares.append(weight * mixture.weights)
        for mean, factor in zip(mixture.means, mixture.factors, strict=True):
            alone = StudentMixture.single(mean, factor)
            columns.append(alone.log_density(r, part.mirrors) + log_jacobian)
    return np.concatenate(shares), np.array(columns)


def _with_shares(proposal: Patchwork, share: np.ndarray) -> Patchwork:
    counts = [len(part.mixture.weights) for part in proposal.parts]
    by_part = np.split(share, np.cumsum(counts)[:-1])
    parts = []
    for part, own in zip(proposal.parts, by_part, strict=True):
        old = part.mixture
        mixture = StudentMixture.from_factors(own / own.sum(), old.means, old.factors)
        parts.append(replace(part, mixture=mixture))
    return Patchwork(np.array([own.sum() for own in by_part]), tuple(parts))
