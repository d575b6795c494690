"""The proposal of the independence move: a trend, a folded edge and a heavy-tailed mixture.

Points are straightened by a :class:`~biaxbayes.inference.trend.Trend`; where a
coordinate ends at a hard edge the mixture is folded there: a draw beyond the edge is reflected
back, and the density adds up the images. Fitted to points mirrored at their edge, the mixture is
smooth across it, and no proposal is wasted on the far side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from biaxbayes.inference.mixture import Mirrors, StudentMixture, fit_mixture
from biaxbayes.inference.trend import Trend, fit_trend

__all__ = ["Proposal", "edge_array", "first_proposal", "fit_proposal"]

POINTS_PER_COMPONENT = 600
"""More points than this for each component cost time and add no accuracy."""
BROAD_WEIGHT, BROAD_SCALE = 0.1, 2.0
"""Weight and width of a component as wide as everything: walkers far out must be able to leave."""


@dataclass(frozen=True)
class Proposal:
    """A frozen proposal density in d dimensions.

    Attributes
    ----------
    trend : Trend
    mixture : StudentMixture
        In the straightened coordinates.
    edges : ndarray, shape (d, 2)
        Hard edges of the straightened coordinates; infinite where there is none.
    """

    trend: Trend
    mixture: StudentMixture
    edges: np.ndarray

    @property
    def _bounded(self) -> np.ndarray:
        return np.flatnonzero(np.isfinite(self.edges).any(axis=1))

    @cached_property
    def mirrors(self) -> Mirrors:
        """Images that the folding at the edges adds up."""
        return Mirrors.at(self.edges)

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        r = self.mixture.sample(rng, size)
        # One reflection at each edge; what is still outside has no density and is rejected.
        for j in self._bounded:
            low, high = self.edges[j]
            below, above = r[:, j] < low, r[:, j] > high
            r[below, j] = 2.0 * low - r[below, j]
            r[above, j] = 2.0 * high - r[above, j]
        return self.trend.bend(r)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,). -inf beyond an edge."""
        r, log_jacobian = self.trend.straighten(x)
        out = self.mixture.log_density(r, self.mirrors) + log_jacobian
        for j in self._bounded:
            low, high = self.edges[j]
            out[(r[:, j] < low) | (r[:, j] > high)] = -np.inf
        return out

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs to build the proposal again."""
        return {
            "order": self.trend.order,
            "centre": self.trend.centre,
            "scale": self.trend.scale,
            "coefficients": self.trend.coefficients,
            "widths": self.trend.widths,
            "weights": self.mixture.weights,
            "means": self.mixture.means,
            "factors": self.mixture.factors,
            "edges": self.edges,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Proposal:
        """Inverse of :meth:`arrays`."""
        trend = Trend(*(arrays[k] for k in ("order", "centre", "scale", "coefficients", "widths")))
        mixture = StudentMixture.from_factors(arrays["weights"], arrays["means"], arrays["factors"])
        return cls(trend, mixture, arrays["edges"])


def edge_array(edges: Mapping[int, tuple[float, float]], dimension: int) -> np.ndarray:
    """Lower and upper edges as an array of shape (d, 2)."""
    out = np.tile([-np.inf, np.inf], (dimension, 1))
    for index, pair in edges.items():
        out[index] = pair
    return out


def first_proposal(
    means: np.ndarray, factors: Sequence[np.ndarray], weights: np.ndarray, edges: np.ndarray
) -> Proposal:
    """A proposal from stated Student t components, before there are points to fit.

    Parameters
    ----------
    means : ndarray, shape (k, d)
    factors : sequence of ndarray, shape (d, d)
        Square roots of the scale matrices; need not be triangular.
    weights : ndarray, shape (k,)
    edges : ndarray, shape (d, 2)
    """
    d = means.shape[1]
    trend = Trend.none(d)
    lower = [np.asarray(np.linalg.qr(f.T, mode="r")).T for f in factors]
    lower = [f * np.where(np.diag(f) < 0.0, -1.0, 1.0) for f in lower]
    return Proposal(trend, StudentMixture.from_factors(weights, means, np.array(lower)), edges)


def fit_proposal(
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    edges: np.ndarray | None = None,
    components: int = 8,
    screen: bool = True,
) -> Proposal:
    """Fit a proposal to points of shape (n, d).

    Parameters
    ----------
    points : ndarray, shape (n, d)
    rng : numpy.random.Generator
    edges : ndarray, shape (d, 2), optional
        Hard edges of the coordinates; infinite where there is none.
    components : int
        Largest number of mixture components.
    screen : bool
        Whether the trend is worth the time to try several orders of the coordinates.
    """
    n, d = points.shape
    most = POINTS_PER_COMPONENT * components
    if n > most:
        points = points[rng.choice(n, most, replace=False)]
    if edges is None:
        edges = np.tile([-np.inf, np.inf], (d, 1))
    trend = fit_trend(points, np.isfinite(edges).any(axis=1), screen=screen)
    r, _ = trend.straighten(points)
    limits = (edges[trend.order] - trend.centre[:, None]) / trend.scale[:, None]
    for j in np.flatnonzero(np.isfinite(limits).any(axis=1)):
        low, high = limits[j]
        nearer = np.where(r[:, j] - low <= high - r[:, j], low, high)
        flip = rng.random(len(r)) < 0.5
        r[flip, j] = 2.0 * nearer[flip] - r[flip, j]
    mixture = fit_mixture(r, rng, components=components)
    broad = BROAD_SCALE * np.linalg.cholesky(np.atleast_2d(np.cov(r.T)) + 1e-9 * np.eye(d))
    mixture = StudentMixture.from_factors(
        np.append(mixture.weights * (1.0 - BROAD_WEIGHT), BROAD_WEIGHT),
        np.vstack([mixture.means, r.mean(axis=0)]),
        np.concatenate([mixture.factors, broad[None]]),
    )
    return Proposal(trend, mixture, limits)
