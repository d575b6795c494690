"""What the curves of a record show: branches, rows that lie apart, stretches that repeat."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import maximum_filter1d

from biaxbayes.specimens.protocol import second_difference_scatter

CYCLE_FRACTION = 0.3
"""Fraction of the whole range that a rise and a fall must have to count as a cycle."""
JUMP = 0.05
"""Distance of a row from its neighbours, as a fraction of the range, from which it lies apart."""
LONGEST_JUMP = 3  # rows of a jump; more of them are a state of the specimen
STEEP = 4.0  # the same over the steps of the rows beside it
SIDES = ("stretch in x", "stretch in y", "load in x", "load in y")
STILL = 0.05  # step over the largest of the steps near it, up to which a stretch stands still
GOES_ON = 0.15  # the same of a load, from which it goes on
NEAR_ROWS = 21  # rows that are near each other
REPEATED = 0.3  # share of rows in which a stretch stands still, from which it has steps
MOVES = 0.2  # extent of a direction over that of the other, from which it moves
TOLERATED_DROP = 0.05  # tolerated drop below the running maximum, as a fraction of the range


def path_progress(stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Progress of a test, shape (n,), from 0 at its first row to about 1 at its furthest point."""
    # stretch alone wanders in load-controlled tests, load alone is flat in the toe
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


def repeats(stretch: np.ndarray, load: np.ndarray, rest: int) -> bool:
    """True if a stretch stands still in many rows after those at rest, while the load goes on."""
    # steps are compared with the largest near them: noise, speed and sampling do not count
    extent = np.ptp(stretch, axis=0)
    moves = extent > MOVES * extent.max()
    share = [
        step / np.maximum(maximum_filter1d(step, NEAR_ROWS, axis=0), 1e-300)
        for curves in (stretch[:, moves], load)
        for step in [np.abs(np.diff(curves[max(rest - 1, 0) :], axis=0))]
    ]
    if not len(share[0]):
        return False
    still = (share[0] <= STILL) & (share[1].max(axis=1, keepdims=True) > GOES_ON)
    return bool(still.mean(axis=0).max(initial=0.0) > REPEATED)


def jumps(stretch: np.ndarray, load: np.ndarray) -> dict[str, np.ndarray]:
    """Rows that lie apart from those beside them, by curve; none of a curve without any."""
    # where rows are missing, a load may step as many times further as the stretches do
    moved = np.abs(np.diff(stretch, axis=0)).sum(axis=1)
    usual = float(np.median(moved[moved > 0.0])) if moved.any() else np.inf
    found: dict[str, np.ndarray] = {}
    for side, curve in zip(SIDES, (*stretch.T, *load.T), strict=True):
        of_load = side.startswith("load")
        apart = _rows_apart(curve, np.maximum(moved / usual if of_load else 1.0, 1.0))
        found |= {side: apart} if apart.size else {}
    return found


def _rows_apart(curve: np.ndarray, pace: np.ndarray | float) -> np.ndarray:
    """Rows that lie apart, in runs of at most three; `pace`: steps of the path over usual ones."""
    n = curve.size
    pace = np.broadcast_to(pace, (n - 1,))
    limit = max(JUMP * float(np.ptp(curve)), 8.0 * second_difference_scatter(curve))
    step = np.abs(np.diff(curve))
    apart = np.zeros(n, dtype=bool)
    for width in range(1, min(LONGEST_JUMP, n - 2) + 1):
        block = sliding_window_view(curve, width)[1:-1]
        beside = np.sort([curve[: -width - 1], curve[width + 1 :]], axis=0)
        gap = np.maximum(block.min(axis=1) - beside[1], beside[0] - block.max(axis=1))
        steps = np.maximum([0.0, *step[: n - width - 2]], [*step[width + 1 :], 0.0])
        for row in np.flatnonzero(gap > np.maximum(limit, STEEP * steps)) + 1:
            apart[row : row + width] = True
    if n > 4 * LONGEST_JUMP:
        for width in range(1, LONGEST_JUMP + 1):
            # a first step may be as large as any other, a footer is below the last rows
            first, last = (np.abs(c[:width] - c[width]).min() for c in (curve, curve[::-1]))
            usual = step[n - width - 5 : n - width - 1].max()
            first, last = first / pace[width - 1], last / pace[n - width - 1]
            apart[:width] |= first > max(limit, STEEP * step[width:].max())
            apart[n - width :] |= last > max(limit, STEEP * usual)
    rows = np.flatnonzero(apart)
    near_end = rows.size > 0 and rows[-1] >= n - LONGEST_JUMP
    return np.union1d(rows, np.arange(rows[-1], n)) if near_end else rows
