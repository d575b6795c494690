"""The proposal of the independence move: mixtures seen through transport maps, side by side.

A :class:`TransportedMixture` is a mixture of Student t distributions in the reference coordinates
of a triangular :class:`.transport_map.TransportMap`. Where a coordinate is bounded the mixture is
folded: a draw beyond the bound is reflected back, and the density adds up the images. Fitted to
points mirrored at their bound, the mixture is smooth across it, and no proposal is wasted on the
far side.

A :class:`MixtureProposal` is several of them side by side, for a density that no single map makes
Gaussian: where the two ends of a density are ridges of different direction, curvature and width,
one triangular map follows either; two maps, each fitted to its own end, follow both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from biaxbayes.sampling.mixture_fit import fit_mixture, groups, mixture_seed
from biaxbayes.sampling.student_mixture import Mirrors, StudentMixture
from biaxbayes.sampling.transport_map import TransportMap, fit_transport_map

__all__ = [
    "Located",
    "MixtureProposal",
    "Proposal",
    "TransportedMixture",
    "first_proposal",
    "fit_mixture_proposal",
    "fit_transported_mixture",
]


POINTS_PER_COMPONENT = 600
"""More points than this for each component cost time and add no accuracy."""
BROAD_WEIGHT, BROAD_SCALE = 0.1, 2.0
"""Weight and width of a component as wide as everything: walkers far out must be able to leave."""


@dataclass(frozen=True)
class TransportedMixture:
    """A frozen proposal density in d dimensions.

    Attributes
    ----------
    transport : TransportMap
    mixture : StudentMixture
        In the reference coordinates.
    bounds : ndarray, shape (d, 2)
        Of the reference coordinates; infinite where there is none.
    """

    transport: TransportMap
    mixture: StudentMixture
    bounds: np.ndarray

    @cached_property
    def mirrors(self) -> Mirrors:
        """Images that the folding at the bounds adds up."""
        return Mirrors.at(self.bounds)

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        r = self.mixture.sample(rng, size)
        # One reflection at each bound; what is still outside has no density and is rejected.
        for j in self.mirrors.coordinates:
            low, high = self.bounds[j]
            below, above = r[:, j] < low, r[:, j] > high
            r[below, j] = 2.0 * low - r[below, j]
            r[above, j] = 2.0 * high - r[above, j]
        return self.transport.from_reference(r)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,). -inf beyond a bound."""
        return self.log_density_at(*self.transport.to_reference(x))

    def log_density_at(self, r: np.ndarray, log_jacobian: np.ndarray) -> np.ndarray:
        """As :meth:`log_density`, at points whose reference coordinates are known."""
        out = self.mixture.log_density(r, self.mirrors) + log_jacobian
        for j in self.mirrors.coordinates:
            low, high = self.bounds[j]
            out[(r[:, j] < low) | (r[:, j] > high)] = -np.inf
        return out

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs to build the proposal again."""
        return {
            "order": self.transport.order,
            "centre": self.transport.centre,
            "scale": self.transport.scale,
            "coefficients": self.transport.coefficients,
            "widths": self.transport.widths,
            "weights": self.mixture.weights,
            "means": self.mixture.means,
            "factors": self.mixture.factors,
            "bounds": self.bounds,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> TransportedMixture:
        """Inverse of :meth:`arrays`."""
        names = ("order", "centre", "scale", "coefficients", "widths")
        transport = TransportMap(*(arrays[k] for k in names))
        mixture = StudentMixture.from_factors(arrays["weights"], arrays["means"], arrays["factors"])
        return cls(transport, mixture, arrays["bounds"])


def first_proposal(
    means: np.ndarray, factors: Sequence[np.ndarray], weights: np.ndarray, bounds: np.ndarray
) -> TransportedMixture:
    """A proposal from stated Student t components, before there are points to fit.

    Parameters
    ----------
    means : ndarray, shape (k, d)
    factors : sequence of ndarray, shape (d, d)
        Square roots of the scale matrices; need not be triangular.
    weights : ndarray, shape (k,)
    bounds : ndarray, shape (d, 2)
    """
    d = means.shape[1]
    lower = [np.asarray(np.linalg.qr(f.T, mode="r")).T for f in factors]
    lower = [f * np.where(np.diag(f) < 0.0, -1.0, 1.0) for f in lower]
    mixture = StudentMixture.from_factors(weights, means, np.array(lower))
    return TransportedMixture(TransportMap.identity(d), mixture, bounds)


def fit_transported_mixture(
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    bounds: np.ndarray | None = None,
    components: int = 8,
    screen: bool = True,
) -> TransportedMixture:
    """Fit a proposal to points of shape (n, d).

    Parameters
    ----------
    points : ndarray, shape (n, d)
    rng : numpy.random.Generator
    bounds : ndarray, shape (d, 2), optional
        Of the coordinates; infinite where there is none.
    components : int
        Largest number of mixture components.
    screen : bool
        Whether the map is worth the time to try several orders of the coordinates.
    """
    return _fitted(_Drawn.of(points, rng, bounds, components), screen)


@dataclass(frozen=True)
class _Drawn:
    """What a fit is made of, its random numbers drawn: several fits can be made side by side."""

    points: np.ndarray
    bounds: np.ndarray
    components: int
    flip: np.ndarray
    seed: int

    @classmethod
    def of(
        cls,
        points: np.ndarray,
        rng: np.random.Generator,
        bounds: np.ndarray | None,
        components: int,
    ) -> _Drawn:
        n, d = points.shape
        most = POINTS_PER_COMPONENT * components
        if n > most:
            points = points[rng.choice(n, most, replace=False)]
        if bounds is None:
            bounds = np.tile([-np.inf, np.inf], (d, 1))
        bounded = int(np.isfinite(bounds).any(axis=1).sum())
        flip = rng.random((bounded, len(points))) < 0.5
        return cls(points, bounds, components, flip, mixture_seed(rng))


def _fitted(drawn: _Drawn, screen: bool) -> TransportedMixture:
    """The proposal that is fitted to points."""
    points, bounds, d = drawn.points, drawn.bounds, drawn.points.shape[1]
    transport = fit_transport_map(points, np.isfinite(bounds).any(axis=1), screen=screen)
    r, _ = transport.to_reference(points)
    limits = (bounds[transport.order] - transport.centre[:, None]) / transport.scale[:, None]
    bounded = np.flatnonzero(np.isfinite(limits).any(axis=1))
    for j, flip in zip(bounded, drawn.flip, strict=True):
        low, high = limits[j]
        nearer = np.where(r[:, j] - low <= high - r[:, j], low, high)
        r[flip, j] = 2.0 * nearer[flip] - r[flip, j]
    mixture = fit_mixture(r, drawn.seed, components=drawn.components)
    broad = BROAD_SCALE * np.linalg.cholesky(np.atleast_2d(np.cov(r.T)) + 1e-9 * np.eye(d))
    mixture = StudentMixture.from_factors(
        np.append(mixture.weights * (1.0 - BROAD_WEIGHT), BROAD_WEIGHT),
        np.vstack([mixture.means, r.mean(axis=0)]),
        np.concatenate([mixture.factors, broad[None]]),
    )
    return TransportedMixture(transport, mixture, limits)


MIN_SHARE = 0.1
"""A group of points smaller than this is not worth a map of its own."""


Located: TypeAlias = list[tuple[np.ndarray, np.ndarray]]
"""Points in the reference coordinates of each part of a proposal, with ln |dr/dx|."""


@dataclass(frozen=True)
class MixtureProposal:
    """A mixture of transported mixtures; the proposal density of the sampler.

    Attributes
    ----------
    weights : ndarray, shape (p,)
    parts : tuple of TransportedMixture, length p
    """

    weights: np.ndarray
    parts: tuple[TransportedMixture, ...]

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        if len(self.parts) == 1:
            return self.parts[0].sample(rng, size)
        chosen = np.searchsorted(np.cumsum(self.weights)[:-1], rng.random(size), side="right")
        out = np.empty((size, self.parts[0].bounds.shape[0]))
        for k, part in enumerate(self.parts):
            out[chosen == k] = part.sample(rng, int((chosen == k).sum()))
        return out

    def log_densities(self, x: np.ndarray) -> np.ndarray:
        """Log of weight times density of each part at points of shape (n, d); shape (p, n)."""
        return self.log_densities_at(self.located(x))

    def nearest_part(self, x: np.ndarray) -> np.ndarray:
        """The part that is densest at points of shape (n, d); shape (n,)."""
        if len(self.parts) == 1:
            return np.zeros(len(x), dtype=int)
        return np.asarray(self.log_densities(x).argmax(axis=0))

    def located(self, x: np.ndarray) -> Located:
        """Points of shape (n, d) in the reference coordinates of each part, with ln |dr/dx|."""
        return [part.transport.to_reference(x) for part in self.parts]

    def log_densities_at(self, located: Located) -> np.ndarray:
        """As :meth:`log_densities`, at points that :meth:`located` has seen."""
        logs = np.log(self.weights)
        return np.array(
            [w + q.log_density_at(*at) for w, q, at in zip(logs, self.parts, located, strict=True)]
        )

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,). -inf beyond a bound."""
        parts = self.log_densities(x)
        return np.asarray(np.logaddexp.reduce(parts, axis=0))

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs to build the proposal again."""
        out = {"shares": self.weights}
        for k, part in enumerate(self.parts):
            out |= {f"{k}_{name}": values for name, values in part.arrays().items()}
        return out

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> MixtureProposal:
        """Inverse of :meth:`arrays`."""
        parts = []
        for k in range(len(arrays["shares"])):
            prefix = f"{k}_"
            own = {n.removeprefix(prefix): v for n, v in arrays.items() if n.startswith(prefix)}
            parts.append(TransportedMixture.from_arrays(own))
        return cls(arrays["shares"], tuple(parts))


Proposal: TypeAlias = TransportedMixture | MixtureProposal


def fit_mixture_proposal(
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    bounds: np.ndarray | None = None,
    components: int = 20,
    parts: int = 2,
    label: np.ndarray | None = None,
    screen: bool = True,
) -> MixtureProposal:
    """Fit a mixture proposal, a part to each group of near points.

    Groups are stated, or those of k-means on standardised coordinates.

    Parameters
    ----------
    points : ndarray, shape (n, d)
    rng : numpy.random.Generator
    bounds : ndarray, shape (d, 2), optional
        Of the coordinates; infinite where there is none.
    components : int
        Largest number of mixture components of all parts together.
    parts : int
        Groups of k-means; one where they would be too unequal.
    label : int64 ndarray, shape (n,), optional
        The group of each point, from zero; each number has points.
    screen : bool
        As in :func:`fit_transported_mixture`.
    """
    one = np.zeros(len(points), dtype=int)
    if label is None:
        label = _groups(points, rng, parts) if parts > 1 else one
        label = label if np.bincount(label).min() >= MIN_SHARE * len(points) else one
    share = np.bincount(label) / len(points)
    most = max(1, components // len(share))
    drawn = [_Drawn.of(points[label == k], rng, bounds, most) for k in range(len(share))]
    return MixtureProposal(share, tuple(_fitted(part, screen) for part in drawn))


def _groups(points: np.ndarray, rng: np.random.Generator, parts: int) -> np.ndarray:
    spread = points.std(axis=0)
    z = (points - points.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    return groups(z, parts, np.random.RandomState(mixture_seed(rng)))
