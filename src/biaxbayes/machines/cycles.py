"""Cycles of a record, cut at the turning points of the quieter of displacement and load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from biaxbayes.specimens.protocol import second_difference_scatter

AMPLITUDE = 0.2
"""Fraction of the whole range that a rise and a fall must have to count as a cycle."""
LEAST_ROWS = 5
"""Least number of rows of a loading side, and of a hold at its peak."""
TOLERATED_FALL = 0.05
"""Largest fall behind the peak, as a fraction of the rise, that is no unloading."""
DIP = 0.02
"""Largest fall before the first rise, as a fraction of it, that is drift of the rest."""
LEVEL = 0.25
"""Rows within this fraction of the mean step of a rise are at the level of its end."""
SAME_RATIO_DEG = 2.5
"""Largest angle between peaks of the same ratio; 1:1 and 1:0.9 differ by 3 degrees."""
SETTLED_CHANGE = 0.03
"""Relative change of peak load or curve up to which the last cycles repeat (a convention)."""
SAME_REACH = 0.05
"""Relative difference of the paths up to which two cycles reach the same stretch."""


@dataclass(frozen=True)
class Cycle:
    """Rows of one cycle: rest and rise, hold at the peak, and the fall from the peak."""

    label: str
    loading: np.ndarray
    hold: np.ndarray
    unloading: np.ndarray

    def only(self, kept: np.ndarray) -> Cycle:
        """The cycle without rows that are left out; `kept` is True for the others."""
        parts = (self.loading, self.hold, self.unloading)
        return Cycle(self.label, *(part[kept[part]] for part in parts))

    def rows(self, branch: str) -> np.ndarray:
        """Rows of a branch; an unloading branch is reversed, so that it starts at rest."""
        if branch == "both":
            return np.union1d(self.loading, self.unloading)
        return self.loading if branch == "loading" else self.unloading[::-1]


def quieter_path(stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Progress of a record, shape (n,), in stretch or load, whichever has less noise.

    Stretches are added with the sign with which they follow the loads: a contracting direction
    counts as progress.
    """
    total = sum((curve - curve[0]) / max(float(np.ptp(load)), 1e-300) for curve in load.T)
    path = np.zeros(len(stretch))
    for curve in stretch.T:
        centred, rising = curve - curve.mean(), total - np.mean(total)
        scale = float(np.linalg.norm(centred) * np.linalg.norm(rising))
        falls = scale > 0.0 and float(centred @ rising) < -0.5 * scale
        path += (curve - curve[0]) * (-1.0 if falls else 1.0)
    noise = [second_difference_scatter(p) / max(float(np.ptp(p)), 1e-300) for p in (path, total)]
    return path if noise[0] <= noise[1] or np.ptp(total) == 0.0 else np.asarray(total)


def cut(path: np.ndarray, label: str = "") -> list[Cycle]:
    """Cycles of a record from its path: rises of enough rows with what follows them.

    Turning points are those of a running median, so that no single row makes one. A rise begins
    with the rows at the level of its valley that lead to it, and ends where its peak is reached.
    """
    smooth = median_filter(path, 5, mode="nearest") if path.size > 2 * LEAST_ROWS else path
    turns = _turning_points(smooth, AMPLITUDE * float(np.ptp(smooth)))
    near = [(_nearest(path, low, -1.0), _nearest(path, high, 1.0)) for low, high in turns]
    rises = [(low, high) for low, high in near if high - low >= LEAST_ROWS - 1]
    rows = np.arange(path.size)
    # steps against the rises are noise; second differences would count uneven sampling, too
    against = [np.minimum(np.diff(path[low : high + 1]), 0.0) for low, high in rises]
    scatter = float(np.sqrt(np.mean(np.concatenate([*against, [0.0]]) ** 2)))
    before = [0, *(high + 1 for _, high in rises)][: len(rises)]
    starts = [_rest(path, smooth, *rise, b, scatter) for rise, b in zip(rises, before, strict=True)]
    cycles = []
    for number, ((low, high), start) in enumerate(zip(rises, starts, strict=True)):
        end = starts[number + 1] if number + 1 < len(rises) else path.size
        top, after = _hold(path, smooth, low, high, end, scatter)
        falling = rows[after - 1 : end] if after < end else rows[:0]
        parts = rows[start : top + 1], rows[top + 1 : after], falling
        cycles.append(Cycle(label or str(number + 1), *parts))
    return cycles


def _rest(
    path: np.ndarray, smooth: np.ndarray, low: int, high: int, before: int, scatter: float
) -> int:
    """First of the rows at the level of a valley that lead to its rise."""
    rise = path[high] - path[low]
    if before == 0 and path[:low].max(initial=path[low]) - path[low] <= DIP * rise + 4.0 * scatter:
        return 0  # the record begins with its rest
    level = LEVEL * rise / (high - low) + 4.0 * scatter
    above = np.flatnonzero(np.minimum(path, smooth)[before:low] > path[low] + level)
    return before + int(above[-1]) + 1 if above.size else before


def _hold(
    path: np.ndarray, smooth: np.ndarray, low: int, high: int, end: int, scatter: float
) -> tuple[int, int]:
    """Row that reaches the peak, and the first row after the hold there."""
    rise, upper = path[high] - path[low], np.maximum(path, smooth)
    step = rise / (high - low)
    level = LEVEL * step + 2.0 * scatter
    fell = np.flatnonzero(upper[high:end] < path[high] - 2.0 * level)
    after = high + int(fell[0]) if fell.size else end
    if path[high] - smooth[high:end].min() <= TOLERATED_FALL * rise + 5.0 * scatter:
        after = end  # what follows is no unloading
    reached = low + int(np.argmax(path[low : high + 1] >= path[high] - level))
    # noise alone lets a few rows before and after the peak lie at its level
    held = after - 1 - reached >= LEAST_ROWS + 2.0 * level / step
    return (reached, after) if held else (max(high, after - 1) if after == end else high, after)


def _nearest(path: np.ndarray, row: int, sign: float) -> int:
    """Row of the extremum of the path within two rows of that of its running median."""
    first = max(row - 2, 0)
    return first + int(np.argmax(sign * path[first : row + 3]))


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
        elif value - path[low] >= amplitude > 0.0:
            rising, high = True, row
    if rising:
        pairs.append((low, high))
    return pairs


# --- ratios ---------------------------------------------------------------------------------------


def peak_change(curves: np.ndarray, loading: np.ndarray) -> np.ndarray:
    """Change of x and y over a loading side, each end a mean of a few rows."""
    few = max(loading.size // 30, 1)
    return curves[loading[-few:]].mean(axis=0) - curves[loading[:few]].mean(axis=0)


def by_ratio(curves: np.ndarray, cycles: Sequence[Cycle]) -> dict[str, list[int]]:
    """Cycle numbers by the ratio x:y of the changes up to their peaks."""
    groups: list[list[int]] = []
    peaks = np.array([peak_change(curves, c.loading) for c in cycles])
    angles = np.degrees(np.arctan2(peaks[:, 1], peaks[:, 0]))
    for i, angle in enumerate(angles):
        near = (g for g in groups if abs(angles[g[-1]] - angle) < SAME_RATIO_DEG)
        group = next(near, None)
        if group is None:
            groups.append(group := [])
        group.append(i)
    named: dict[str, list[int]] = {}
    for group in groups:
        name = ratio_name(peaks[group[-1]])
        while name in named:
            name += "'"
        named[name] = group
    return named


def ratio_name(change: np.ndarray) -> str:
    """A ratio such as ``1:0.5``, in steps of 0.05."""
    x, y = (round(20.0 * float(v)) / 20.0 + 0.0 for v in change / max(np.abs(change).max(), 1e-300))
    return f"{x:g}:{y:g}"


# --- preconditioning ------------------------------------------------------------------------------


def settling(
    stretch: np.ndarray, load: np.ndarray, names: str, before: np.ndarray, last: np.ndarray
) -> tuple[str, bool]:
    """Change between the loading sides of two cycles as text, and whether they repeat.

    Loads are compared as curves over the sum of the stretches, and at the peak by the mean of the
    last tenth of that curve: no single reading decides.
    """
    paths = [np.maximum.accumulate(stretch[rows].sum(axis=1)) for rows in (before, last)]
    low, high = max(path[0] for path in paths), min(path[-1] for path in paths)
    grid = np.linspace(low, max(high, low), 50)
    curves = [
        np.column_stack([np.interp(grid, path, curve) for curve in load[rows].T])
        for path, rows in zip(paths, (before, last), strict=True)
    ]
    largest = float(np.ptp(curves[1][-5:].mean(axis=0) - curves[1][:5].mean(axis=0), axis=None))
    largest = max(float(np.abs(curves[1][-5:].mean(axis=0)).max()), largest, 1e-300)
    difference = (curves[1] - curves[0]) / largest
    noise = max(map(second_difference_scatter, load[last].T)) / largest
    change, curve = difference[-5:].mean(axis=0), float(np.abs(difference.mean(axis=0)).max())
    limit = SETTLED_CHANGE + 2.0 * noise * np.sqrt(2.0 / 5.0)
    reach = [path[-1] - path[0] for path in paths]
    if abs(reach[1] - reach[0]) > SAME_REACH * reach[1]:
        text = f"the last two cycles reach different stretches; their curves differ by {curve:.1%}"
        settled = curve <= limit
    else:
        changes = " and ".join(f"{c:+.1%} in {n}" for c, n in zip(change, names, strict=True))
        text = (
            f"between the last two cycles the peak load changes by {changes}, the curve by "
            f"{curve:.1%} (of the largest load)"
        )
        settled = max(curve, *np.abs(change).tolist()) <= limit
    return (text if settled else f"preconditioning has not settled: {text}"), settled
