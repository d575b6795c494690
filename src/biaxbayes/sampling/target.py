"""Interface between a log density and the sampler."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

LogDensity = Callable[[np.ndarray], np.ndarray]
"""Vectorised: coordinates (n, d) to (n,); finite, or -inf where the density is zero."""


def bounds_array(bounds: Mapping[int, tuple[float, float]], dimension: int) -> np.ndarray:
    """Bounds of some coordinates as an array of shape (d, 2), infinite for the others."""
    out = np.tile([-np.inf, np.inf], (dimension, 1))
    for index, pair in bounds.items():
        out[index] = pair
    return out


def _coordinates(u: np.ndarray, log_prob: np.ndarray) -> dict[str, np.ndarray]:
    """The coordinates themselves, named x0, x1, ..."""
    return {f"x{i}": u[:, i] for i in range(u.shape[1])}


@dataclass(frozen=True, eq=False)
class Target:
    """A density to be sampled.

    Attributes
    ----------
    log_prob : callable
        Vectorised log density, up to a constant: coordinates (n, d) to (n,).
    bounds : ndarray, shape (d, 2)
        Lower and upper bound of each coordinate; infinite where there is none. A coordinate
        with a finite bound may have its largest density there.
    quantities : callable, optional
        Coordinates (n, d) and their log densities (n,) to the quantities of interest, a dict of
        arrays (n,). Default: the coordinates.
    skip_diagnostics : tuple of str
        Quantities that are computed and stored, but whose convergence is not assessed.
    counts : int64 ndarray, shape (1 + reasons,), optional
        Where ``log_prob`` counts its evaluations: first those of positive density, then those
        of zero density, by reason.
    reasons : tuple of str
        Names of the reasons of a zero density.
    constants : mapping
        Constants of the density, which are stored with the state of a run so that it can be
        continued.
    """

    log_prob: LogDensity
    bounds: np.ndarray
    quantities: Callable[[np.ndarray, np.ndarray], Mapping[str, np.ndarray]] = _coordinates
    skip_diagnostics: tuple[str, ...] = ()
    counts: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    reasons: tuple[str, ...] = ()
    constants: Mapping[str, Any] = field(default_factory=dict)

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return len(self.bounds)

    def evaluations(self, counts: np.ndarray) -> dict[str, int]:
        """Evaluations counted, and those of zero density by reason; empty without reasons."""
        if not self.reasons:
            return {}
        values = [int(c) for c in counts]
        return dict(zip(("evaluated", *self.reasons), [sum(values), *values[1:]], strict=True))
