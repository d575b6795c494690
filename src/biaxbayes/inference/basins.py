"""Basins of a density: its separate modes, and how much mass each may hold.

A sampler that starts from one mode can miss another without any diagnostic noticing: walkers that
agree with one another agree in the same basin. So the search starts from every basin that a few
descents from very different materials lead to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from biaxbayes.inference.mode import local_mode

__all__ = ["Basin", "find_basins"]

MOST = 6
NEGLIGIBLE = 9.0
"""Log mass, and log height, below those of the best at which a basin is left out."""
SAME = 2.0
"""Two modes nearer than this many local standard deviations a dimension are one."""


@dataclass(frozen=True)
class Basin:
    """A mode with its local Gaussian approximation.

    Attributes
    ----------
    mode : ndarray, shape (d,)
    factor : ndarray, shape (d, d)
        A square root of the local covariance, its widths limited.
    log_mass : float
        Laplace's approximation, log p(mode) + ln |factor| + d/2 ln 2 pi.
    height : float
        log p(mode).
    """

    mode: np.ndarray
    factor: np.ndarray
    log_mass: float
    height: float = 0.0


def find_basins(
    log_density: Callable[[np.ndarray], np.ndarray],
    starts: np.ndarray,
    scale: np.ndarray,
    edges: np.ndarray,
) -> list[Basin]:
    """Climb from every start and keep the different modes that matter.

    Parameters
    ----------
    log_density : callable
        Vectorised, (n, d) to (n,).
    starts : ndarray, shape (n, d)
    scale : ndarray, shape (d,)
        Width beyond which a direction counts as not determined.
    edges : ndarray, shape (d, 2)

    Returns
    -------
    list of Basin
        The heaviest first; empty where no start has a positive density.
    """
    # A start on an edge has its density, if any, next to it.
    inner = np.clip(starts, edges[:, 0] + 1e-3, edges[:, 1] - 1e-3)
    found = [
        _climb(log_density, start, scale, edges) for start in inner[np.isfinite(log_density(inner))]
    ]
    found.sort(key=lambda basin: -basin.log_mass)
    kept: list[Basin] = []
    for basin in found:
        highest = max(b.height for b in found)
        matters = (
            basin.log_mass > found[0].log_mass - NEGLIGIBLE or basin.height > highest - NEGLIGIBLE
        )
        if matters and len(kept) < MOST and not any(_same(basin, other) for other in kept):
            kept.append(basin)
    return kept


def _climb(
    log_density: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    scale: np.ndarray,
    edges: np.ndarray,
) -> Basin:
    mode, factor = local_mode(log_density, start, scale, edges)
    height = float(log_density(mode[None])[0])
    _, log_volume = np.linalg.slogdet(factor)
    log_mass = height + float(log_volume) + 0.5 * mode.size * np.log(2.0 * np.pi)
    return Basin(mode, factor, log_mass, height)


def _same(one: Basin, other: Basin) -> bool:
    """Whether two modes are within the local widths of both."""
    offset = one.mode - other.mode
    z = np.array([np.linalg.solve(b.factor, offset) for b in (one, other)])
    return bool((np.sqrt((z**2).mean(axis=1)) < SAME).all())
