"""Cycles of a record, their ratios, and whether preconditioning has settled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.branches import cycles, path_progress
from biaxbayes.tables.table import Table

SAME_RATIO_DEG = 2.5
"""Largest difference of angle between peaks of one ratio; 1:1 and 1:0.9 differ by 3 degrees."""
STEADY_DEG = 0.75
"""Largest change of angle from cycle to cycle of the quantity that the machine controls."""
SETTLED = 0.03
"""Change of peak load or curve between the last cycles below which they repeat (a convention)."""
SAME_PEAK = 0.05


@dataclass(frozen=True)
class RecordedCycle:
    """Rows of one cycle up to its peak, and from the peak on."""

    label: str
    loading: np.ndarray
    unloading: np.ndarray

    def rows(self, branch: str) -> np.ndarray:
        """Rows of a branch; an unloading branch is reversed, so that it starts at rest."""
        up, down = self.loading, self.unloading
        return {"loading": up, "unloading": down[::-1], "both": np.union1d(up, down)}[branch]


def recorded_cycles(
    stretch: np.ndarray, load: np.ndarray, labels: Sequence[str] | None, table: Table
) -> list[RecordedCycle]:
    """Cycles by the labels of a column, otherwise from the curves."""
    if labels is None:
        groups = {"": np.arange(len(stretch))}
    else:
        groups = {k: np.flatnonzero(np.array(labels) == k) for k in dict.fromkeys(labels)}
    recorded = []
    for label, rows in groups.items():
        rises = cycles(path_progress(stretch[rows], load[rows]))
        if not rises and label == list(groups)[-1]:
            raise InputError(
                "the record never rises: no loading branch",
                file=table.path,
                remedy=f"check the columns; {table.listing}",
            )
        first = len(rises) if labels is None else 1
        for number, cycle in enumerate(rises[-first:], start=1):
            branches = rows[cycle.loading], rows[cycle.unloading]
            recorded.append(RecordedCycle(label or str(number), *branches))
    return recorded


def chosen_number(which: str, labels: Sequence[str], table: Table) -> int:
    """Index of the selected cycle, ``last`` or a label."""
    if which == "last":
        return len(labels) - 1
    if which not in labels:
        shown = ", ".join(labels) if len(labels) < 12 else f"{labels[0]} to {labels[-1]}"
        raise InputError(
            f"no cycle {which}", file=table.path, remedy=f"found {shown or 'none'}; or `cycle=last`"
        )
    return list(labels).index(which)


def cycle_label(labels: Sequence[str], number: int) -> str | None:
    """A cycle among others, such as ``6 of 6``; None for a single one."""
    if len(labels) < 2:
        return None
    place = f"{number + 1} of {len(labels)}"
    return place if labels[number] == str(number + 1) else f"{labels[number]} ({place})"


# --- ratios ---------------------------------------------------------------------------------------


def by_ratio(
    stretch: np.ndarray, load: np.ndarray, recorded: Sequence[RecordedCycle]
) -> dict[str, list[int]]:
    """Cycle numbers by the ratio x:y of peak stretches or loads, whichever is steadier."""
    ways = []
    for curves in (stretch, load):
        peaks = np.array([curves[c.loading[-1]] - curves[c.loading[0]] for c in recorded])
        angles = np.degrees(np.arctan2(peaks[:, 1], peaks[:, 0]))
        groups: list[list[int]] = []
        for i, angle in enumerate(angles):
            near = (g for g in groups if abs(angles[g[-1]] - angle) < SAME_RATIO_DEG)
            group = next(near, None)
            if group is None:
                groups.append([i])
            else:
                group.append(i)
        spread = max((float(np.ptp(angles[g])) for g in groups if len(g) > 1), default=np.inf)
        # Steady from cycle to cycle: what the machine controls. Else rather too many than lost.
        order = (0, round(4 * spread)) if spread < STEADY_DEG else (1, -len(groups))
        shares = np.array([peaks[g[-1]] / np.abs(peaks[g[-1]]).max() for g in groups])
        uneven = float(np.abs(4 * shares - np.round(4 * shares)).sum())
        ways.append(((*order, uneven), groups, shares))
    _, groups, shares = min(ways, key=lambda way: way[0])
    if len(groups) == 1:
        return {"": groups[0]}
    named: dict[str, list[int]] = {}
    for group, (x, y) in zip(groups, shares, strict=True):
        name = f"{round(20 * x) / 20:g}:{round(20 * y) / 20:g}"
        while name in named:
            name += "'"
        named[name] = group
    return named


# --- preconditioning ------------------------------------------------------------------------------


def settling(
    before: tuple[np.ndarray, np.ndarray], last: tuple[np.ndarray, np.ndarray]
) -> tuple[str, bool]:
    """Change between the loading branches (stretch, load) of two cycles, and whether it repeats."""
    peaks = np.array([branch[1][-1] - branch[1][0] for branch in (before, last)])
    largest = np.abs(peaks[1]).max()
    # The curve: loads at the same sum of stretches, where both cycles have it.
    paths = [np.maximum.accumulate(branch[0].sum(axis=1)) for branch in (before, last)]
    low, high = max(path[0] for path in paths), min(path[-1] for path in paths)
    grid = np.linspace(low, max(high, low), 50)
    curves = [
        np.column_stack([np.interp(grid, path, branch[1][:, k]) for k in range(2)])
        for path, branch in zip(paths, (before, last), strict=True)
    ]
    curve = float(np.abs(curves[1] - curves[0]).mean(axis=0).max()) / largest
    change = (peaks[1] - peaks[0]) / largest
    reach = [path[-1] - path[0] for path in paths]
    if abs(reach[1] - reach[0]) > SAME_PEAK * reach[1]:
        words = f"the last two cycles reach different stretches; their curves differ by {curve:.1%}"
        settled = curve <= SETTLED
    else:
        words = (
            f"between the last two cycles the peak load changes by {change[0]:+.1%} in x and "
            f"{change[1]:+.1%} in y, the curve by {curve:.1%} (of the largest load)"
        )
        settled = max(curve, *np.abs(change).tolist()) <= SETTLED
    return (words if settled else f"preconditioning has not settled: {words}"), settled
