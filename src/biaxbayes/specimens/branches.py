"""Loading and unloading branches of a record, from its own curves."""

from __future__ import annotations

import numpy as np

from biaxbayes.specimens.protocol import second_difference_scatter

CYCLE_FRACTION = 0.3
"""Fraction of the whole range that a rise and a fall must have to count as a cycle."""
TOLERATED_DROP = 0.05
"""Tolerated drop below the running maximum, as a fraction of the range."""


def path_progress(stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Progress of a test, shape (n,), from 0 at its first row to about 1 at its furthest point.

    Mean of the paths in stretch and load: stretch alone wanders in load-controlled tests,
    load alone is flat in the toe.
    """
    total = np.zeros(len(stretch))
    for curves in (stretch, load):
        change = curves - curves[0]
        furthest = change[np.abs(change).argmax(axis=0), [0, 1]]
        path = (change * np.where(furthest < 0.0, -1.0, 1.0)).sum(axis=1)
        range_ = np.abs(path).max()
        total += path / range_ if range_ > 0.0 else 0.0
    return total / 2.0


def path_scatter(path: np.ndarray) -> float:
    """Standard deviation of one row about its neighbours; 0 for fewer than five rows."""
    return second_difference_scatter(path) if path.size >= 5 else 0.0


def reversal(path: np.ndarray) -> int | None:
    """Row of the peak before a drop by more than 5 % of the range and the scatter, or None."""
    if path.size < 3:
        return None
    # One wrong reading is not a branch: the median of three passes over it.
    filtered = path.copy()
    filtered[1:-1] = np.median([path[:-2], path[1:-1], path[2:]], axis=0)
    highest = np.maximum.accumulate(filtered)
    limit = TOLERATED_DROP * max(float(np.ptp(path)), 1e-300) + 5.0 * path_scatter(path)
    dropped = np.flatnonzero(highest - filtered > limit)
    if not dropped.size:
        return None
    near = max(int(np.argmax(filtered[: dropped[0] + 1])) - 1, 0)
    return near + int(np.argmax(path[near : near + 3]))


def cycles(path: np.ndarray) -> list[tuple[slice, slice]]:
    """Cycles of a record as rows up to the peak, and from it on.

    A cycle is a rise and a fall of at least 30 % of the range; a mere rise is one, too.
    """
    range_ = float(np.ptp(path))
    # The valley is the lowest of many noisy rows: allow for both ends of the noise.
    level = 0.001 * range_ + 6.0 * path_scatter(path)
    turns = _turning_points(path, CYCLE_FRACTION * range_)
    cycles = []
    for number, (valley, peak) in enumerate(turns):
        before = turns[number - 1][1] if number else 0
        # The rest before the rise: rows as low as the valley, without a gap, up to it.
        high = np.flatnonzero(path[before:valley] > path[valley] + level)
        start = before + int(high[-1]) + 1 if high.size else before
        if number == 0 and path[: valley + 1].max() - path[valley] <= TOLERATED_DROP * range_:
            start = 0  # the dip before the first rise is noise
        stop = turns[number + 1][0] if number + 1 < len(turns) else path.size
        if reversal(path[start:stop]) is None:
            peak = stop - 1  # the end of the record is the peak, up to noise
        cycles.append((slice(start, peak + 1), slice(peak, stop)))
    return cycles


def _turning_points(path: np.ndarray, amplitude: float) -> list[tuple[int, int]]:
    """Rows (valley, peak) of each rise of at least ``amplitude``."""
    pairs: list[tuple[int, int]] = []
    low = high = 0
    rising = False
    for row, value in enumerate(path.tolist()):
        if rising:
            if value > path[high]:
                high = row
            elif path[high] - value >= amplitude:
                pairs.append((low, high))
                rising, low = False, row
        elif value <= path[low]:
            low = row
        elif value - path[low] >= amplitude:
            rising, high = True, row
    if rising:
        pairs.append((low, high))
    return pairs
