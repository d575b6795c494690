"""The method paper's own fit: root-find the mounting stretch, update the data, refit; repeat.

Math. Comput. Appl. 2024, 29(4), 55, Section 2.2.2 and Figure 2. Its fixed point is not a
minimum of one objective: with noise it differs from the least-squares solutions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.inference.descent import descend
from biaxbayes.inference.readings import Readings
from biaxbayes.inference.residuals import GivenMounting, mounting_roots
from biaxbayes.inference.starting_points import LOWER, UPPER

__all__ = ["Alternation", "alternate", "best_alternation"]

MAX_ALTERNATIONS = 500
SCOUTING = 40
TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class Alternation:
    """Where an alternation ended.

    Attributes
    ----------
    point : ndarray, shape (5,)
        (C1, k1, k2, t, kappa).
    mounting : ndarray, shape (2, m)
    cost : float
        Sum of squared Cauchy residuals over the squared scale.
    alternations : int
    converged : bool
    """

    point: np.ndarray
    mounting: np.ndarray
    cost: float
    alternations: int
    converged: bool


def best_alternation(
    data: Readings,
    starts: Sequence[np.ndarray],
    free: np.ndarray,
    scale: float,
    *,
    fibre_switch: bool = False,
) -> Alternation:
    """Alternate loosely from every start, then the best to the end."""
    scouted = [
        alternate(data, p, free, scale, most=SCOUTING, tolerance=1e-4, fibre_switch=fibre_switch)
        for p in starts
    ]
    best = min(scouted, key=lambda found: (not found.converged, found.cost))
    end = alternate(data, best.point, free, scale, first=best.mounting, fibre_switch=fibre_switch)
    count = best.alternations + end.alternations
    return Alternation(end.point, end.mounting, end.cost, count, end.converged)


def alternate(
    data: Readings,
    point: np.ndarray,
    free: np.ndarray,
    scale: float,
    *,
    first: np.ndarray | None = None,
    most: int = MAX_ALTERNATIONS,
    tolerance: float = TOLERANCE,
    fibre_switch: bool = False,
) -> Alternation:
    """Alternate from one material until neither mounting stretch nor stress changes.

    Parameters
    ----------
    data : Readings
    point : ndarray, shape (5,)
        Starting (C1, k1, k2, t, kappa).
    free : ndarray of int
    scale : float
        Stress in kPa that residuals are measured in.
    first : ndarray, shape (2, m), optional
        Mounting stretches to fall back on while the material balances no root; default one.
    most : int
    tolerance : float
        On the change of the mounting stretches and, relative, of the parameters.
    fibre_switch : bool
    """
    lm = np.ones_like(data.mounting_load) if first is None else first
    cost, settled, count = np.inf, False, 0
    for count in range(1, most + 1):  # noqa: B007 - reported
        root, _ = mounting_roots(data, point, data.mounting_load, fibre_switch)
        found_root = bool(np.isfinite(root).all())
        new_lm = root if found_root else lm
        problem = GivenMounting(data, "cauchy", point, free, scale, new_lm, fibre_switch)
        found = descend(
            problem, point[free], LOWER[free], UPPER[free], tolerance=min(1e-4 * tolerance, 1e-8)
        )
        new_point = problem.theta(found.unknowns)
        change = max(
            float(np.abs(new_lm - lm).max()),
            float((np.abs(new_point - point) / (np.abs(new_point) + 1e-3)).max()),
        )
        lm, point, cost = new_lm, new_point, found.cost
        settled = found_root and found.converged and change <= tolerance
        # Nothing changes any more, settled or stuck at a material that balances no root
        if change <= tolerance or not np.isfinite(cost):
            break
    return Alternation(point, lm, cost, count, settled)
