"""The compiled posterior as a density of the natural parameters, for samplers of others.

Coordinates are the parameters of the law (angles in radians), the mounting stretches and, with
independent errors, the noise sd. The mounting stretches rather than the forces, so that no sampler
pays for a root: it is the same posterior (a test of the package compares the two).
"""

from __future__ import annotations

import numpy as np

from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import start_parameters
from biaxbayes.parameters import DEGREE


class NaturalDensity:
    """Log density of points of shape (n, d), in the order of ``names``."""

    def __init__(self, posterior: Posterior) -> None:
        self.posterior = posterior.replaced(mounting="free")
        self.problem = self.posterior.natural_assembly.problem
        sampled = self.posterior.sampled
        self.names = tuple(q.name for q in sampled)
        self.logs = np.array([q.parameter.logarithmic for q in sampled])
        self.angles = [q.name for q in sampled if q.parameter.unit == DEGREE]
        self.evaluations = 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density; -inf outside the ranges."""
        x = np.atleast_2d(x)
        self.evaluations += len(x)
        positive = np.all(x[:, self.logs] > 0.0, axis=1)
        u = np.where(positive[:, None], x, 1.0)
        u[:, self.logs] = np.log(u[:, self.logs])
        out, _, _ = self.posterior.evaluate(self.problem, np.ascontiguousarray(u))
        # a density in C1 rather than ln C1, and so on
        out = out - u[:, self.logs].sum(axis=1)
        out[~positive] = -np.inf
        return out

    def starts(self, count: int, rng: np.random.Generator, spread: float = 0.01) -> np.ndarray:
        """Points around the deterministic fit, all of positive density, shape (count, d)."""
        fit = start_parameters(self.posterior)
        centre = np.array([np.deg2rad(fit[n]) if n in self.angles else fit[n] for n in self.names])
        found: list[np.ndarray] = []
        while len(found) < count:
            points = centre * (1.0 + spread * rng.standard_normal((count, len(centre))))
            found.extend(points[np.asarray(np.isfinite(self(points)))])
        return np.array(found[:count])

    def summaries(self, chain: np.ndarray) -> dict[str, np.ndarray]:
        """Quantities of a chain (..., d) by name, angles in degrees."""
        out = {name: chain[..., i] for i, name in enumerate(self.names)}
        return out | {name: np.rad2deg(out[name]) for name in self.angles}
