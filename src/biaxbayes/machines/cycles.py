"""Cycles of a record, their ratios, and whether preconditioning has settled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.recording import Recording
from biaxbayes.specimens.branches import cycles, path_progress
from biaxbayes.tables.table import Table

SAME_RATIO_DEG = 2.5
"""Largest angle between peaks of the same ratio; 1:1 and 1:0.9 differ by 3 degrees."""
STEADY_DEG = 0.75
"""Largest change of angle from cycle to cycle of the quantity that the machine controls."""
SETTLED_CHANGE = 0.03
"""Relative change of peak load or curve up to which the last cycles repeat (a convention)."""
SAME_REACH = 0.05
"""Relative difference of the paths up to which two cycles reach the same stretch."""


@dataclass(frozen=True)
class Cycle:
    """Rows of one cycle up to its peak, and from the peak on."""

    label: str
    loading: np.ndarray
    unloading: np.ndarray

    def rows(self, branch: str) -> np.ndarray:
        """Rows of a branch; an unloading branch is reversed, so that it starts at rest."""
        up, down = self.loading, self.unloading
        return {"loading": up, "unloading": down[::-1], "both": np.union1d(up, down)}[branch]


def split_cycles(
    stretch: np.ndarray, load: np.ndarray, labels: Sequence[str] | None, table: Table
) -> list[Cycle]:
    """Cycles by the labels of a column, otherwise from the curves."""
    if labels is None:
        groups = {"": np.arange(len(stretch))}
    else:
        groups = {k: np.flatnonzero(np.array(labels) == k) for k in dict.fromkeys(labels)}
    all_cycles = []
    for label, rows in groups.items():
        rises = cycles(path_progress(stretch[rows], load[rows]))
        if not rises and label == list(groups)[-1]:
            problem = "the record never rises: no loading branch"
            raise InputError(problem, file=table.path, remedy=f"check the columns; {table.listing}")
        first = len(rises) if labels is None else 1
        for number, (up, down) in enumerate(rises[-first:], start=1):
            all_cycles.append(Cycle(label or str(number), rows[up], rows[down]))
    return all_cycles


def cycle_index(which: str, all_cycles: Sequence[Cycle], table: Table) -> int:
    """Index of the selected cycle, ``last`` or a label."""
    labels = [cycle.label for cycle in all_cycles]
    if which == "last":
        return len(labels) - 1
    if which not in labels:
        shown = ", ".join(labels) if len(labels) < 12 else f"{labels[0]} to {labels[-1]}"
        raise InputError(
            f"no cycle {which}",
            file=table.path,
            remedy=f"cycles are {shown or 'none'}; or `cycle=last`",
        )
    return labels.index(which)


def take_branch(
    convert: Callable[[Cycle, str], Recording],
    all_cycles: Sequence[Cycle],
    group: Sequence[int],
    branch: str,
    label: str,
) -> Recording:
    """A branch of the last cycle of a group, with a note on how it differs from the cycle before.

    ``convert`` converts the rows of a cycle and branch; ``label`` names the group in the note.
    """
    number = group[-1]
    recording = convert(all_cycles[number], branch)
    # such as ``6 of 6``
    name, number_of = all_cycles[number].label, f"{number + 1} of {len(all_cycles)}"
    cycle = number_of if name == str(number + 1) else f"{name} ({number_of})"
    recording = replace(
        recording,
        cycle=cycle if len(all_cycles) > 1 else None,
        branch=branch,
        time_s=None if branch == "unloading" else recording.time_s,
    )
    if len(group) < 2:
        return recording
    text, settled = settling(*(convert(all_cycles[n], "loading") for n in group[-2:]))
    text = f"{label}: {text}" if label else text
    if settled:
        return replace(recording, notes=(*recording.notes, text))
    return replace(recording, assumptions=(*recording.assumptions, text))


# --- ratios ---------------------------------------------------------------------------------------


def by_ratio(
    stretch: np.ndarray, load: np.ndarray, all_cycles: Sequence[Cycle]
) -> dict[str, list[int]]:
    """Cycle numbers by the ratio x:y of peak stretches or loads, whichever is steadier."""
    candidates = []
    for curves in (stretch, load):
        peaks = np.array([curves[c.loading[-1]] - curves[c.loading[0]] for c in all_cycles])
        angles = np.degrees(np.arctan2(peaks[:, 1], peaks[:, 0]))
        groups: list[list[int]] = []
        for i, angle in enumerate(angles):
            near = (g for g in groups if abs(angles[g[-1]] - angle) < SAME_RATIO_DEG)
            group = next(near, None)
            if group is None:
                groups.append(group := [])
            group.append(i)
        angle_range = max((float(np.ptp(angles[g])) for g in groups if len(g) > 1), default=np.inf)
        # The quantity that is steady from cycle to cycle is the controlled one; if neither is, take
        # the more groups, so that no ratio is lost.
        order = (0, round(4 * angle_range)) if angle_range < STEADY_DEG else (1, -len(groups))
        fractions = np.array([peaks[g[-1]] / np.abs(peaks[g[-1]]).max() for g in groups])
        uneven = float(np.abs(4 * fractions - np.round(4 * fractions)).sum())
        candidates.append(((*order, uneven), groups, fractions))
    _, groups, fractions = min(candidates, key=lambda candidate: candidate[0])
    if len(groups) == 1:
        return {"": groups[0]}
    named: dict[str, list[int]] = {}
    for group, (x, y) in zip(groups, fractions, strict=True):
        name = f"{round(20 * x) / 20:g}:{round(20 * y) / 20:g}"
        while name in named:
            name += "'"
        named[name] = group
    return named


# --- preconditioning ------------------------------------------------------------------------------


def settling(before: Recording, last: Recording) -> tuple[str, bool]:
    """Change between the loading branches of two cycles as text, and whether they repeat."""
    branches = (before, last)
    peaks = np.array([r.load[-1] - r.load[0] for r in branches])
    largest = np.abs(peaks[1]).max()
    # The curve: loads at the same sum of stretches, where both cycles have it.
    paths = [np.maximum.accumulate(r.stretch.sum(axis=1)) for r in branches]
    low, high = max(path[0] for path in paths), min(path[-1] for path in paths)
    grid = np.linspace(low, max(high, low), 50)
    curves = [
        np.column_stack([np.interp(grid, path, load) for load in r.load.T])
        for path, r in zip(paths, branches, strict=True)
    ]
    curve = float(np.abs(curves[1] - curves[0]).mean(axis=0).max()) / largest
    change = (peaks[1] - peaks[0]) / largest
    reach = [path[-1] - path[0] for path in paths]
    if abs(reach[1] - reach[0]) > SAME_REACH * reach[1]:
        text = f"the last two cycles reach different stretches; their curves differ by {curve:.1%}"
        settled = curve <= SETTLED_CHANGE
    else:
        text = (
            f"between the last two cycles the peak load changes by {change[0]:+.1%} in x and "
            f"{change[1]:+.1%} in y, the curve by {curve:.1%} (of the largest load)"
        )
        settled = max(curve, *np.abs(change).tolist()) <= SETTLED_CHANGE
    return (text if settled else f"preconditioning has not settled: {text}"), settled
