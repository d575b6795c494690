"""Cycles of a record, cut at the turning points of stretch or load, whichever turns less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from biaxbayes.specimens.protocol import second_difference_scatter

AMPLITUDE = 0.2
"""Fraction of the whole range that a rise and a fall must have to count as a cycle."""
LEAST_ROWS = 5
"""Least number of rows of a loading side, and of a hold at its peak."""
TOLERATED_FALL = 0.05
"""Largest fall behind the peak, as a fraction of the rise, that does not count as unloading."""
SMALL_LOOP = 0.03
"""Fraction of the whole range that a loop must have to cut the record."""
TOE_LOOP = 0.01
"""The same of a load, which changes little in the toe of its curve."""
DIP = 0.02
"""Largest fall before the first rise, as a fraction of it, that is drift of the rest."""
LEVEL = 0.25
"""Rows within this fraction of the mean step of a rise are at the level of its end."""
SAME_RATIO_DEG = 2.5
"""Largest angle between peaks of the same ratio; 1:1 and 1:0.9 differ by 3 degrees."""
HELD = 0.1
"""Change of a direction over that of the other, up to which it is held at a level."""
SAME_LEVEL = 0.01
"""Difference of stretches of the same level."""
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

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the loading side, the hold and the unloading side."""
        return self.loading, self.hold, self.unloading

    def rows(self, branch: str) -> np.ndarray:
        """Rows of a branch; an unloading branch is reversed, so that it starts at rest."""
        if branch == "both":
            return np.union1d(self.loading, self.unloading)
        return self.loading if branch == "loading" else self.unloading[::-1]


def quieter_path(stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Progress of a record, shape (n,), in stretch or load: what turns less often, with less noise.

    Stretches are added with the sign with which they follow the loads.
    """
    total = sum((curve - curve[0]) / max(float(np.ptp(load)), 1e-300) for curve in load.T)
    path = np.zeros(len(stretch))
    for curve in stretch.T:
        centred, rising = curve - curve.mean(), total - np.mean(total)
        scale = float(np.linalg.norm(centred) * np.linalg.norm(rising))
        falls = scale > 0.0 and float(centred @ rising) < -0.5 * scale
        path += (curve - curve[0]) * (-1.0 if falls else 1.0)
    if np.ptp(total) == 0.0 or np.ptp(path) == 0.0:
        return path if np.ptp(total) == 0.0 else np.asarray(total)
    noise = [scatter_of(p) / float(np.ptp(p)) for p in (path, total)]
    loops = SMALL_LOOP, max(TOE_LOOP, 6.0 * noise[1])
    turns = [
        len(_turning_points(p, loop * float(np.ptp(p))))
        for p, loop in zip((path, total), loops, strict=True)
    ]
    return path if (turns[0], noise[0]) <= (turns[1], noise[1]) else np.asarray(total)


def scatter_of(path: np.ndarray) -> float:
    """Standard deviation of one row, from fourth differences, in which a sine of 12 rows fades."""
    if path.size < 7:
        return 0.0
    # var(fourth difference of white noise) = (1 + 16 + 36 + 16 + 1) sd^2
    fourth = 1.4826 * float(np.median(np.abs(np.diff(path, 4)))) / np.sqrt(70.0)
    return min(fourth, second_difference_scatter(path))


def cut(path: np.ndarray, label: str = "", breaks: Sequence[int] = ()) -> list[Cycle]:
    """Cycles of a record from its path, none beyond `breaks`: rises with what follows them.

    Loops of less than ``AMPLITUDE`` of the range cut the record, but are no cycles.
    """
    cycles: list[Cycle] = []
    span = float(np.ptp(path))
    for first, last in pairwise([0, *breaks, path.size]):
        part = path[first:last]
        for c in _cut_part(part, span) if part.size >= LEAST_ROWS else ():
            number = label or str(len(cycles) + 1)
            cycles.append(Cycle(number, *(rows + first for rows in c.parts)))
    return cycles


def _cut_part(path: np.ndarray, span: float) -> list[Cycle]:
    """Cycles of a part, of at least a fraction of the range of the whole record."""
    scatter, least = scatter_of(path), AMPLITUDE * span
    loop = min(max(SMALL_LOOP * span, 6.0 * scatter), least)
    rises: list[tuple[int, int]] = []
    for low, high in _turning_points(path, loop):
        valley, peak = rises[-1] if rises else (low, low)
        if rises and path[peak] - path[valley] < least:  # not begun
            rises[-1] = (valley if path[low] - path[valley] > 0.5 * loop else low, high)
        elif rises and path[peak] - path[low] < least:
            # a dip of a rise, or a small loop behind its peak
            rises[-1] = (valley, high if path[high] > path[peak] else peak)
        else:
            rises.append((low, high))
    rises = [(low, high) for low, high in rises
             if path[high] - path[low] >= least and high - low >= LEAST_ROWS - 1]  # fmt: skip
    rows = np.arange(path.size)
    ends = [0, *(high + 1 for _, high in rises)][: len(rises)]
    starts = [_rest(path, *rise, b, scatter) for rise, b in zip(rises, ends, strict=True)]
    cycles = []
    for (low, high), start, end in zip(rises, starts, [*starts[1:], path.size], strict=False):
        top, after = _hold(path, low, high, end, scatter)
        # the valley belongs to both cycles
        falling = rows[after - 1 : end + 1] if after < end else rows[:0]
        cycles.append(Cycle("", rows[start : top + 1], rows[top + 1 : after], falling))
    return cycles


def what_it_does(path: np.ndarray) -> str:
    """What a path without a loading branch does, in words."""
    if path.size < LEAST_ROWS:
        return f"it has {path.size} rows"
    turns = _turning_points(path, AMPLITUDE * float(np.ptp(path)))
    if not turns:
        return "nothing changes" if np.ptp(path) == 0.0 else "stretch and load fall only"
    longest = max(high - low for low, high in turns) + 1
    return f"{len(turns)} rises of at most {longest} rows"


def _rest(path: np.ndarray, low: int, high: int, before: int, scatter: float) -> int:
    """First of the rows at rest that lead to the rise from a valley; never one that still falls."""
    rise = path[high] - path[low]
    if before == 0 and path[:low].max(initial=path[low]) - path[low] <= DIP * rise + 4.0 * scatter:
        return 0  # the record begins with its rest
    level = LEVEL * rise / (high - low) + 4.0 * scatter
    above = np.flatnonzero(path[before:low] > path[low] + level)
    first = before + int(above[-1]) + 1 if above.size else before
    # a fall ends within that level, too, and a sine comes to its valley slowly
    slow = 0.3 * LEVEL * rise / (high - low) + 2.0 * scatter
    still = path[first:low] <= np.median(path[first : low + 1]) + slow
    first += int(np.argmax(still)) if still.any() else low - first
    third = (low - first) // 3
    if third == 0:
        return low
    falls = path[first : first + third].mean() - path[low - third : low].mean()
    return first if falls <= slow else low


def _hold(path: np.ndarray, low: int, high: int, end: int, scatter: float) -> tuple[int, int]:
    """Row that reaches the peak, and the first row after the hold there."""
    rise = path[high] - path[low]
    step = rise / (high - low)
    level = LEVEL * step + 2.0 * scatter
    fell = np.flatnonzero(path[high:end] < path[high] - 2.0 * level - 2.0 * scatter)
    after = high + int(fell[0]) if fell.size else end
    if path[high] - path[high:end].min() <= TOLERATED_FALL * rise + 5.0 * scatter:
        after = end  # what follows is no unloading
    reached = low + int(np.argmax(path[low : high + 1] >= path[high] - level))
    # noise alone lets a few rows before and after the peak lie at its level
    held = after - 1 - reached >= LEAST_ROWS + 2.0 * level / step
    return (reached, after) if held else (max(high, after - 1) if after == end else high, after)


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


def at_level(stretch: np.ndarray, cycle: Cycle) -> Cycle:
    """A cycle without the rows in which the direction that is held goes to its level."""
    second_half = stretch[cycle.loading[cycle.loading.size // 2 :]]
    held = int(np.ptp(second_half, axis=0).argmin())
    level = float(np.median(second_half[:, held]))
    off = [np.flatnonzero(np.abs(stretch[part, held] - level) > 0.5 * SAME_LEVEL)
           for part in (cycle.loading, cycle.unloading)]  # fmt: skip
    loading = cycle.loading[off[0][-1] + 1 if off[0].size else 0 :]
    unloading = cycle.unloading[: off[1][0] if off[1].size else None]
    loading = loading if loading.size >= LEAST_ROWS else cycle.loading
    return replace(cycle, loading=loading, unloading=unloading)


def by_level(stretch: np.ndarray, cycles: Sequence[Cycle]) -> dict[str, list[int]]:
    """Cycle numbers by the direction that moves and the level at which the other is held."""
    named: dict[str, list[int]] = {}
    levels: list[tuple[int, float, str]] = []
    for n, cycle in enumerate(cycles):
        change = np.abs(peak_change(stretch, cycle.loading))
        held = int(change.argmin())
        level = float(np.median(stretch[cycle.loading, held]))
        moves = change.min() > HELD * change.max()
        same = next((k for h, v, k in levels if h == held and abs(v - level) < SAME_LEVEL), None)
        name = "both" if moves else same or f"{'yx'[held]} at {'xy'[held]} {level:.3g}"
        levels.append((held, level, name))
        named.setdefault(name, []).append(n)
    return named


def ratio_name(change: np.ndarray) -> str:
    """A ratio such as ``1:0.5``, in steps of 0.05."""
    x, y = (round(20.0 * float(v)) / 20.0 + 0.0 for v in change / max(np.abs(change).max(), 1e-300))
    return f"{x:g}:{y:g}"


def settling(
    stretch: np.ndarray, load: np.ndarray, names: str, before: np.ndarray, last: np.ndarray
) -> tuple[str, bool]:
    """Change between the loading sides of two cycles as text, and whether they repeat.

    Loads are compared as curves over the sum of the stretches, and over the last tenth of these.
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
        text = f"between the last two cycles the peak load changes by {changes}, the curve by "
        text += f"{curve:.1%} (of the largest load)"
        settled = max(curve, *np.abs(change).tolist()) <= limit
    return (text if settled else f"preconditioning has not settled: {text}"), settled
