"""The proposal of the independence move: weighted sum of transported mixtures.

Where a coordinate is bounded a mixture is folded: a draw beyond the bound is reflected back, and
the density adds up the images. Fitted to points mirrored at their bound, the mixture is smooth
across it, and no proposal is wasted on the far side.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
from scipy.special import logsumexp

from biaxbayes.sampling.mixture import StudentMixture, fit_mixture
from biaxbayes.sampling.target import bounds_array
from biaxbayes.sampling.transport_map import TransportMap, fit_transport_map

POINTS_PER_COMPONENT = 600
"""More points than this for each component cost time and add no accuracy."""
BROAD_WEIGHT, BROAD_SCALE = 0.1, 2.0
"""Weight and width of a component as wide as everything: walkers far out must be able to leave."""


@dataclass(frozen=True)
class TransportedMixture:
    """A mixture of Student t distributions in the reference coordinates of a transport map."""

    transport: TransportMap
    mixture: StudentMixture  # in the reference coordinates
    bounds: np.ndarray  # (d, 2), of the reference coordinates; infinite where there is none

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        r = self.mixture.sample(rng, size)
        # One reflection at each bound; what is still outside has no density and is rejected.
        low, high = self.bounds.T
        r = np.where(r < low, 2.0 * low - r, np.where(r > high, 2.0 * high - r, r))
        return self.transport.from_reference(r)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,). -inf beyond a bound."""
        r, log_jacobian = self.transport.to_reference(x)
        density = np.sum([self.mixture.density(image) for image in self._images(r)], axis=0)
        density[((r < self.bounds[:, 0]) | (r > self.bounds[:, 1])).any(axis=1)] = 0.0
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(density) + log_jacobian)

    def _images(self, r: np.ndarray) -> Iterator[np.ndarray]:
        """The points, and their reflections at each bound and at several of them in turn."""
        bounded = np.flatnonzero(np.isfinite(self.bounds).any(axis=1))
        for mirrors in product(*([np.nan, *self.bounds[j]] for j in bounded)):
            if not np.isinf(mirrors).any():
                image = r.copy()
                mirrored = bounded[np.isfinite(mirrors)]
                image[:, mirrored] = 2.0 * np.array(mirrors)[np.isfinite(mirrors)] - r[:, mirrored]
                yield image


def first_proposal(
    means: np.ndarray, factors: Sequence[np.ndarray], weights: np.ndarray, bounds: np.ndarray
) -> TransportedMixture:
    """A proposal from given components; `factors` are square roots of the scale matrices."""
    lower = [np.asarray(np.linalg.qr(f.T, mode="r")).T for f in factors]
    lower = [f * np.where(np.diag(f) < 0.0, -1.0, 1.0) for f in lower]
    mixture = StudentMixture(weights, means, np.array(lower))
    return TransportedMixture(TransportMap.identity(means.shape[1]), mixture, bounds)


def fit_transported_mixture(
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    bounds: np.ndarray | None = None,
    components: int = 8,
) -> TransportedMixture:
    """Fit a proposal of at most ``components`` to points (n, d) within bounds (d, 2)."""
    if bounds is None:
        bounds = bounds_array({}, points.shape[1])
    if len(points) > POINTS_PER_COMPONENT * components:
        points = rng.choice(points, POINTS_PER_COMPONENT * components, replace=False)
    bounded = np.isfinite(bounds).any(axis=1)
    transport = fit_transport_map(points, bounded)
    r, _ = transport.to_reference(points)
    limits = (bounds[transport.order] - transport.centre[:, None]) / transport.scale[:, None]
    # Half of the points are mirrored at the nearer bound of each coordinate.
    low, high = limits.T
    nearer = np.where(r - low <= high - r, low, high)
    flip = np.isfinite(nearer) & (rng.random(r.shape) < 0.5)
    r = np.where(flip, 2.0 * nearer - r, r)
    covariance = np.cov(r.T).reshape(len(limits), -1) + 1e-9 * np.eye(len(limits))
    broad = BROAD_SCALE * np.linalg.cholesky(covariance)
    fitted = fit_mixture(r, rng, components=components)
    mixture = StudentMixture(
        np.append(fitted.weights * (1.0 - BROAD_WEIGHT), BROAD_WEIGHT),
        np.vstack([fitted.means, r.mean(axis=0)]),
        np.concatenate([fitted.factors, broad[None]]),
    )
    return TransportedMixture(transport, mixture, limits)


@dataclass(frozen=True)
class MixtureProposal:
    """The proposal of the sampler, with a part for each cluster of modes: no one map suits all."""

    weights: np.ndarray
    parts: tuple[TransportedMixture, ...]

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """Independent draws, shape (size, d)."""
        chosen = rng.choice(len(self.parts), size, p=self.weights)
        out = np.empty((size, len(self.parts[0].bounds)))
        for k, part in enumerate(self.parts):
            out[chosen == k] = part.sample(rng, int((chosen == k).sum()))
        return out

    def log_densities(self, x: np.ndarray) -> np.ndarray:
        """Log of weight times density of each part at points of shape (n, d); shape (p, n)."""
        return np.log(self.weights)[:, None] + [part.log_density(x) for part in self.parts]

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density at points of shape (n, d); shape (n,). -inf beyond a bound."""
        return np.asarray(logsumexp(self.log_densities(x), axis=0))

    def nearest_part(self, x: np.ndarray) -> np.ndarray:
        """Index of the part that is densest at points of shape (n, d); shape (n,)."""
        return np.asarray(self.log_densities(x).argmax(axis=0))

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays for a checkpoint, by name."""
        out = {"shares": self.weights}
        for k, part in enumerate(self.parts):
            of_part = {**vars(part.transport), **vars(part.mixture), "bounds": part.bounds}
            del of_part["inverses"]  # computed from the factors
            out |= {f"{k}_{name}": values for name, values in of_part.items()}
        return out

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> MixtureProposal:
        """Inverse of :meth:`arrays`."""
        parts = []
        for k in range(len(arrays["shares"])):
            own = {n.removeprefix(f"{k}_"): v for n, v in arrays.items() if n.startswith(f"{k}_")}
            transport = TransportMap(*(own[f.name] for f in fields(TransportMap)))
            mixture = StudentMixture(own["weights"], own["means"], own["factors"])
            parts.append(TransportedMixture(transport, mixture, own["bounds"]))
        return cls(arrays["shares"], tuple(parts))


def fit_mixture_proposal(
    points: np.ndarray,
    rng: np.random.Generator,
    *,
    bounds: np.ndarray | None = None,
    components: int = 20,
    label: np.ndarray | None = None,
) -> MixtureProposal:
    """Fit a mixture proposal to points (n, d), with one part for each label (from zero)."""
    if label is None:
        label = np.zeros(len(points), dtype=np.int64)
    weights = np.bincount(label) / len(points)
    most = max(1, components // len(weights))
    parts = [
        fit_transported_mixture(points[label == k], rng, bounds=bounds, components=most)
        for k in range(len(weights))
    ]
    return MixtureProposal(weights, tuple(parts))
