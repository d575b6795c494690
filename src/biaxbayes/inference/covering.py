"""Components where a proposal falls short of the density.

An independence sampler holds a walker for as long as its importance weight, density over
proposal, exceeds the typical one. After Raftery and Bao (Incremental mixture importance sampling,
Biometrics 66 (2010) 1162), components are added one after the other around the point of the
largest weight, shaped like its neighbourhood, until no weight stands out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from biaxbayes.inference.mixture import StudentMixture
from biaxbayes.inference.proposal import Proposal

__all__ = ["cover"]

MAX_COMPONENTS = 12
TALL = np.log(6.0)
"""A weight this many e-folds above the mean one stands out."""
NEIGHBOURS = 0.04
SHARE = 0.03
"""Neighbourhood of a new component, as a share of the points; and its mixture weight."""


def cover(
    proposal: Proposal, points: np.ndarray, log_prob: np.ndarray, log_mean_weight: float
) -> Proposal:
    """Add components to a proposal where points of the density stand out.

    Parameters
    ----------
    proposal : Proposal
    points : ndarray, shape (n, d)
        Points of positive density: history of walkers, draws of the proposal.
    log_prob : ndarray, shape (n,)
    log_mean_weight : float
        Log of the mean importance weight (an estimate of the evidence).

    Returns
    -------
    Proposal
    """
    r, log_jacobian = proposal.trend.straighten(points)
    log_density = proposal.log_density(points)
    scale = np.linalg.inv(np.linalg.cholesky(np.cov(r.T) + 1e-9 * np.eye(r.shape[1])))
    white = r @ scale.T
    n, d = r.shape
    near = max(int(NEIGHBOURS * n), 6 * d)
    if n < 2 * near:
        return proposal
    for _ in range(MAX_COMPONENTS):
        log_weight = log_prob - log_density
        top = int(np.argmax(log_weight))
        if log_weight[top] - log_mean_weight < TALL:
            break
        distance = ((white - white[top]) ** 2).sum(axis=1)
        chosen = np.argpartition(distance, near)[:near]
        # Neighbours that are themselves short of proposal shape the component.
        excess = np.exp(np.clip(log_weight[chosen] - log_weight[top], -20.0, 0.0)) + 1.0 / near
        share = excess / excess.sum()
        offset = r[chosen] - r[top]
        covariance = (offset * share[:, None]).T @ offset
        covariance += 1e-3 * np.diag(np.diag(covariance)) + 1e-12 * np.eye(d)
        factor = np.linalg.cholesky(covariance)
        proposal = _with_component(proposal, r[top], factor)
        alone = StudentMixture.from_factors(np.ones(1), r[top][None], factor[None])
        added = alone.log_density(r, proposal.mirrors) + log_jacobian
        # q' = (1 - share) q + share t
        log_density = np.logaddexp(np.log1p(-SHARE) + log_density, np.log(SHARE) + added)
    return proposal


def _with_component(proposal: Proposal, mean: np.ndarray, factor: np.ndarray) -> Proposal:
    old = proposal.mixture
    mixture = StudentMixture.from_factors(
        np.append(old.weights * (1.0 - SHARE), SHARE),
        np.vstack([old.means, mean]),
        np.concatenate([old.factors, factor[None]]),
    )
    return replace(proposal, mixture=mixture)
