"""Loading and unloading branches of a record, found from its own curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Cycle", "cycles", "progress", "relapse"]

SWING = 0.3
"""Share of the whole range that a rise and a fall must have to count as a cycle."""
RELAPSE = 0.05
"""Share of the whole range by which a path may fall behind itself without being unloaded."""


@dataclass(frozen=True)
class Cycle:
    """Rows of one cycle: ``loading`` up to the peak, ``unloading`` from it on."""

    loading: slice
    unloading: slice


def progress(stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
    """How far a test has come, 0 at its first row and 1 about where it goes furthest.

    The mean of the path in stretch and the path in load, each summed over both directions:
    stretch alone wanders in load-controlled tests, load alone is flat in the toe.

    Parameters
    ----------
    stretch, load : ndarray, shape (n, 2)

    Returns
    -------
    ndarray, shape (n,)
    """
    total = np.zeros(len(stretch))
    for curves in (stretch, load):
        away = curves - curves[0]
        furthest = away[np.abs(away).argmax(axis=0), [0, 1]]
        path = (away * np.where(furthest < 0.0, -1.0, 1.0)).sum(axis=1)
        range_ = np.abs(path).max()
        total += path / range_ if range_ > 0.0 else 0.0
    return total / 2.0


def scatter(path: np.ndarray) -> float:
    """Standard deviation of one row about its neighbours (second differences)."""
    if path.size < 5:
        return 0.0
    # var(second difference of white noise) = (1 + 4 + 1) sd^2
    return 1.4826 * float(np.median(np.abs(np.diff(path, 2)))) / np.sqrt(6.0)


def relapse(path: np.ndarray) -> tuple[int, int] | None:
    """Where a path falls behind itself: the row of the peak, and the first row after it.

    None while it falls back by no more than 5 % of its range and its own scatter.
    """
    if path.size < 3:
        return None
    # One wrong reading is no branch: the median of three passes over it.
    calm = path.copy()
    calm[1:-1] = np.median([path[:-2], path[1:-1], path[2:]], axis=0)
    best = np.maximum.accumulate(calm)
    limit = RELAPSE * max(float(np.ptp(path)), 1e-300) + 5.0 * scatter(path)
    fallen = np.flatnonzero(best - calm > limit)
    if not fallen.size:
        return None
    near = max(int(np.argmax(calm[: fallen[0] + 1])) - 1, 0)
    peak = near + int(np.argmax(path[near : near + 3]))
    return peak, peak + 1


def cycles(path: np.ndarray) -> list[Cycle]:
    """Cycles of a record: a rise and a fall of at least 30 % of the whole range each.

    Rows at rest before a rise belong to its loading branch. A record that only rises is one
    cycle without an unloading branch.

    Parameters
    ----------
    path : ndarray, shape (n,)
        From :func:`progress`.
    """
    swing = SWING * float(np.ptp(path))
    # The valley is the lowest of many noisy rows: allow for both ends of the noise.
    level = 0.001 * float(np.ptp(path)) + 6.0 * scatter(path)
    turns = _turning_points(path, swing)
    found = []
    for number, (valley, peak) in enumerate(turns):
        before = turns[number - 1][1] if number else 0
        # The rest before the rise: rows as low as the valley, without a gap, up to it.
        high = np.flatnonzero(path[before:valley] > path[valley] + level)
        start = before + int(high[-1]) + 1 if high.size else before
        if number == 0 and path[: valley + 1].max() - path[valley] <= RELAPSE * np.ptp(path):
            start = 0  # the dip before the first rise is noise
        stop = turns[number + 1][0] if number + 1 < len(turns) else path.size
        if relapse(path[start:stop]) is None:
            peak = stop - 1  # the end of the record is the peak, up to noise
        found.append(Cycle(slice(start, peak + 1), slice(peak, stop)))
    return found


def _turning_points(path: np.ndarray, swing: float) -> list[tuple[int, int]]:
    """Rows (valley, peak) of every rise of at least ``swing``."""
    pairs: list[tuple[int, int]] = []
    low = high = 0
    rising = False
    for row, value in enumerate(path.tolist()):
        if rising:
            if value > path[high]:
                high = row
            elif path[high] - value >= swing:
                pairs.append((low, high))
                rising, low = False, row
        elif value <= path[low]:
            low = row
        elif value - path[low] >= swing:
            rising, high = True, row
    if rising:
        pairs.append((low, high))
    return pairs
