"""Components where a proposal falls short of the density.

An independence sampler holds a walker for as long as its importance weight, density over
proposal, exceeds the typical one. After Raftery and Bao (Incremental mixture importance sampling,
Biometrics 66 (2010) 1162), components are added one after the other around the point of the
largest weight, shaped like its neighbourhood, until no weight stands out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.inference.mixture import StudentMixture
from biaxbayes.inference.patchwork import Patchwork
from biaxbayes.inference.proposal import Proposal

__all__ = ["cover"]

MAX_COMPONENTS = 12
TALL = np.log(6.0)
"""A weight this many e-folds above the mean one stands out."""
NEIGHBOURS = 0.04
SHARE = 0.02
"""Neighbourhood of a new component, as a share of the points; and its mixture weight."""


def cover(
    proposal: Patchwork, points: np.ndarray, log_prob: np.ndarray, log_mean_weight: float
) -> Patchwork:
    """Add components to a proposal where points of the density stand out.

    Parameters
    ----------
    proposal : Patchwork
        The part that comes nearest at the point takes the component.
    points : ndarray, shape (n, d)
        Points of positive density: history of walkers, draws of the proposal.
    log_prob : ndarray, shape (n,)
    log_mean_weight : float
        Log of the mean importance weight (an estimate of the evidence).

    Returns
    -------
    Patchwork
        ``proposal`` itself where nothing stands out.
    """
    parts, weights = list(proposal.parts), proposal.weights
    by_part = proposal.log_densities(points)
    nearest = by_part.argmax(axis=0)
    log_density = np.logaddexp.reduce(by_part, axis=0)
    straight: dict[int, _Straight] = {}
    for _ in range(MAX_COMPONENTS):
        log_weight = log_prob - log_density
        top = int(np.argmax(log_weight))
        if log_weight[top] - log_mean_weight < TALL:
            break
        k = int(nearest[top])
        if k not in straight:
            straight[k] = _Straight.of(parts[k], points, nearest == k)
        factor = straight[k].shape_at(top, log_weight)
        if factor is None:
            break
        mean = straight[k].r[top]
        share = (1.0 - SHARE) * weights[k] + SHARE
        parts[k] = _with_component(parts[k], mean, factor, SHARE / share)
        weights = (1.0 - SHARE) * weights
        weights[k] = share
        alone = StudentMixture.single(mean, factor)
        new = alone.log_density(straight[k].r, parts[k].mirrors) + straight[k].log_jacobian
        # q' = (1 - share) q + share t
        log_density = np.logaddexp(np.log1p(-SHARE) + log_density, np.log(SHARE) + new)
    return Patchwork(weights, tuple(parts)) if straight else proposal


@dataclass(frozen=True)
class _Straight:
    """Points in the straightened coordinates of one part."""

    r: np.ndarray
    log_jacobian: np.ndarray
    white: np.ndarray
    own: np.ndarray

    @classmethod
    def of(cls, part: Proposal, points: np.ndarray, own: np.ndarray) -> _Straight:
        """``own``: the points at which the part comes nearest."""
        r, log_jacobian = part.trend.straighten(points)
        d = r.shape[1]
        known = r[own] if own.sum() > 6 * d else r
        scale = np.linalg.inv(np.linalg.cholesky(np.cov(known.T) + 1e-9 * np.eye(d)))
        return cls(r, log_jacobian, r @ scale.T, np.flatnonzero(own))

    def shape_at(self, top: int, log_weight: np.ndarray) -> np.ndarray | None:
        """Cholesky factor of the scatter around a point; None where it has too few neighbours."""
        n, d = len(self.own), self.r.shape[1]
        near = max(int(NEIGHBOURS * len(self.r)), 6 * d)
        if n < 2 * near:
            return None
        distance = ((self.white[self.own] - self.white[top]) ** 2).sum(axis=1)
        chosen = self.own[np.argpartition(distance, near)[:near]]
        # Neighbours that are themselves short of proposal shape the component.
        excess = np.exp(np.clip(log_weight[chosen] - log_weight[top], -20.0, 0.0)) + 1.0 / near
        share = excess / excess.sum()
        offset = self.r[chosen] - self.r[top]
        covariance = (offset * share[:, None]).T @ offset
        covariance += 1e-3 * np.diag(np.diag(covariance)) + 1e-12 * np.eye(d)
        return np.asarray(np.linalg.cholesky(covariance))


def _with_component(
    proposal: Proposal, mean: np.ndarray, factor: np.ndarray, share: float
) -> Proposal:
    old = proposal.mixture
    mixture = StudentMixture.from_factors(
        np.append(old.weights * (1.0 - share), share),
        np.vstack([old.means, mean]),
        np.concatenate([old.factors, factor[None]]),
    )
    return replace(proposal, mixture=mixture)
