"""The compiled posterior as a density of the natural parameters, for samplers of others.

Coordinates are C1 and k1 (kPa), k2, alpha (radians), kappa, the mounting stretches and the noise
sd. The mounting stretches rather than the forces, so that no sampler pays for a root: it is the
same posterior (a test of the package compares the two).
"""

from __future__ import annotations

import numpy as np

from biaxbayes.laws.goh import GOHLaw
from biaxbayes.model import density as kernel
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import start_parameters
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.specimen import Specimen

NAMES = (*GOHLaw().names, *mounting_names("stretch"), "noise_sd")
LOGS = ("C1", "k1", "k2", "noise_sd")


class NaturalDensity:
    """Log density of points of shape (n, 8), in the order of :data:`NAMES`.

    Parameters
    ----------
    specimen : Specimen
    beta : float
        Weight of the log likelihood.
    """

    def __init__(self, specimen: Specimen, beta: float = 1.0) -> None:
        self.posterior = Posterior(
            specimen, mounting="free", noise="independent", beta=beta, thin="none"
        )
        self.problem = self.posterior.natural_assembly.problem
        stated = self.posterior.priors
        self.priors = {n: p for n in NAMES if isinstance(p := stated[n], Prior)}
        free = self.posterior.free
        self._columns = [NAMES.index(name) for name in free]
        self._logs = [NAMES.index(name) for name in LOGS]
        self._log_places = [free.index(name) for name in LOGS]
        self.evaluations = 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Log density; -inf outside the ranges."""
        x = np.atleast_2d(x)
        self.evaluations += len(x)
        u = x[:, self._columns]
        positive = np.all(x[:, self._logs] > 0.0, axis=1)
        if not positive.all():
            u = np.where(positive[:, None], u, 1.0)
        logs = np.log(u[:, self._log_places])
        u[:, self._log_places] = logs
        out = kernel.log_density(self.problem, np.ascontiguousarray(u), np.zeros(4, dtype=np.int64))
        # a density in C1 rather than ln C1, and so on
        out -= logs.sum(axis=1)
        out[~positive] = -np.inf
        return out

    def starts(self, count: int, rng: np.random.Generator, spread: float = 0.01) -> np.ndarray:
        """Points around the deterministic fit, all of positive density, shape (count, 8)."""
        fit = start_parameters(self.posterior)
        centre = np.array([fit[name] for name in NAMES])
        centre[3] = np.deg2rad(centre[3])
        found: list[np.ndarray] = []
        while len(found) < count:
            points = centre * (1.0 + spread * rng.standard_normal((count, len(NAMES))))
            found.extend(points[np.asarray(np.isfinite(self(points)))])
        return np.array(found[:count])


def summaries(chain: np.ndarray) -> dict[str, np.ndarray]:
    """Quantities of a chain (..., 8) by name."""
    return {name: chain[..., i] for i, name in enumerate(NAMES)}
