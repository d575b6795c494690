"""Descents from several starting points, carried on only where they lead somewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from biaxbayes.inference.descent import Descent, Problem, descend

__all__ = ["best_descent"]

SCOUTING_STEPS = 20
FINALISTS = 3


def best_descent(
    problem: Callable[[], Problem],
    starts: Sequence[np.ndarray],
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    finalists: int = FINALISTS,
) -> Descent:
    """A few steps from every start, then the best few to the end.

    Parameters
    ----------
    problem : callable
        Makes a fresh problem (problems remember their last evaluation).
    starts : sequence of ndarray, shape (p,)
    lower, upper : ndarray, shape (p,)
    finalists : int
        How many scouted points are followed to convergence.

    Returns
    -------
    Descent
        The lowest; its cost is infinite when no start could be evaluated.
    """
    scouted = [
        descend(problem(), start, lower, upper, steps=SCOUTING_STEPS, tolerance=1e-8)
        for start in starts
    ]
    scouted.sort(key=lambda found: found.cost)
    best: Descent | None = None
    for scout in scouted[:finalists]:
        if best is not None and not np.isfinite(scout.cost):
            continue
        end = descend(problem(), scout.unknowns, lower, upper)
        end = Descent(end.unknowns, end.cost, scout.iterations + end.iterations, end.converged)
        if best is None or end.cost < best.cost * (1.0 - 1e-9):
            best = end
    assert best is not None, "at least one start"
    return best
