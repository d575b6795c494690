"""Several proposals side by side, for a density that no single trend straightens.

Where the data fix the matrix but not the fibres, or the other way round, the two ends of a
posterior are ridges of different direction, curvature and width. One triangular map follows
either; two maps, each fitted to its own end, follow both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.special import logsumexp

from biaxbayes.inference.proposal import Proposal, fit_proposal

__all__ = ["AnyProposal", "Patchwork", "fit_patchwork", "proposal_of"]

MIN_SHARE = 0.1
"""A group of points smaller than this is not worth a trend of its own."""


@dataclass(frozen=True)
class Patchwork:
    """A mixture of proposals.

    Attributes
    ----------
    weights : ndarray, shape (p,)
    parts : tuple of Proposal, length p
    """

    weights: np.ndarray
    parts: tuple[Proposal, ...]

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        if len(self.parts) == 1:
            return self.parts[0].sample(rng, size)
        chosen = np.searchsorted(np.cumsum(self.weights)[:-1], rng.random(size), side="right")
        out = np.empty((size, self.parts[0].edges.shape[0]))
        for k, part in enumerate(self.parts):
            out[chosen == k] = part.sample(rng, int((chosen == k).sum()))
        return out

    def log_densities(self, x: np.ndarray) -> np.ndarray:
        """Log of weight times density of each part at points of shape (n, d); shape (p, n)."""
        logs = np.log(self.weights)
        return np.array([w + q.log_density(x) for w, q in zip(logs, self.parts, strict=True)])

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,). -inf beyond an edge."""
        parts = self.log_densities(x)
        return parts[0] if len(parts) == 1 else np.asarray(logsumexp(parts, axis=0))

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs to build the proposal again."""
        out = {"shares": self.weights}
        for k, part in enumerate(self.parts):
            out |= {f"{k}_{name}": values for name, values in part.arrays().items()}
        return out


AnyProposal: TypeAlias = Proposal | Patchwork


def proposal_of(arrays: Mapping[str, np.ndarray]) -> Patchwork:
    """Inverse of :meth:`Patchwork.arrays`."""
    parts = []
    for k in range(len(arrays["shares"])):
        prefix = f"{k}_"
        own = {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}
        parts.append(Proposal.from_arrays(own))
    return Patchwork(arrays["shares"], tuple(parts))


def fit_patchwork(
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    edges: np.ndarray | None = None,
    components: int = 20,
    parts: int = 2,
    screen: bool = True,
) -> Patchwork:
    """Fit proposals to groups of near points (k-means on standardised coordinates).

    Parameters
    ----------
    points : ndarray, shape (n, d)
    rng : numpy.random.Generator
    edges : ndarray, shape (d, 2), optional
        Hard edges of the coordinates; infinite where there is none.
    components : int
        Largest number of mixture components of all parts together.
    parts : int
        Groups; one where they would be too unequal.
    screen : bool
        As in :func:`.proposal.fit_proposal`.
    """
    label = _groups(points, rng, parts) if parts > 1 else np.zeros(len(points), dtype=int)
    share = np.bincount(label) / len(points)
    if share.min() < MIN_SHARE:
        label, share = np.zeros(len(points), dtype=int), np.ones(1)
    most = max(1, components // len(share))
    fitted = [
        fit_proposal(points[label == k], rng, edges=edges, components=most, screen=screen)
        for k in range(len(share))
    ]
    return Patchwork(share, tuple(fitted))


def _groups(points: np.ndarray, rng: np.random.Generator, parts: int) -> np.ndarray:
    from sklearn.cluster import KMeans

    spread = points.std(axis=0)
    z = (points - points.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    means = KMeans(parts, n_init=4, random_state=int(rng.integers(2**31)))
    return np.asarray(means.fit_predict(z))
