"""Readings that may not be of the tissue: rows apart, steps, loads that fall or stay at a limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter, median_filter

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.cycles import LEAST_ROWS, Cycle
from biaxbayes.machines.lines import ranges_without
from biaxbayes.machines.record import Record, Recording
from biaxbayes.specimens.branches import JUMP, SIDES, STEEP, repeats, rows_apart
from biaxbayes.specimens.plausibility import NEGATIVE
from biaxbayes.specimens.protocol import rest_rows, second_difference_scatter
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import in_lines

LOST_LOAD = 0.1
"""Fall of the load, as a fraction of its range, that loading does not explain."""
FALLS_TOO = 0.3
"""Fall of the load before a rise over its height, below which the load did not fall."""
LEVEL = 0.01
"""Change of a load, as a fraction of its range, within which it stays."""
LEAST_WAY = 0.02
"""Fraction of the whole way that a stretch goes on while a load stays."""


def ask_about_jumps(record: Record, rows: np.ndarray) -> None:
    """Ask for `rows` where up to three rows lie apart from those on both sides of them."""
    left, jumping = rows, set[str]()
    while left.size > LEAST_ROWS:  # a row far off may hide others
        curves = np.column_stack([record.stretch, record.load])[left]
        found = {side: rows_apart(curve) for side, curve in zip(SIDES, curves.T, strict=True)}
        jumping |= {side for side, at in found.items() if at.size}
        apart = np.unique(np.concatenate(list(found.values())))
        if not apart.size:
            break
        left = np.delete(left, apart)
    apart = np.setdiff1d(rows, left)
    if apart.size:
        which = " and ".join(side for side in SIDES if side in jumping)
        problem = f"the {which} jumps in {in_lines(record.lines[apart])} (lines of the file)"
        _ask_for_rows(record, problem, apart)


def ask_about_steps(record: Record, rows: np.ndarray) -> None:
    """Ask where a load changes at once and stays so, although the stretch goes on evenly."""
    stretch, load = (curves[rows] for curves in record.pulled)
    path = stretch.sum(axis=1)
    if rows.size < 4 * LEAST_ROWS:
        return
    way = np.pad(np.sign(np.diff(path)), 1)
    onward = (way[:-2] == way[1:-1]) & (way[1:-1] == way[2:]) & (way[1:-1] != 0.0)
    even = onward & (_step_over_others(path) < STEEP)  # no turn of the stretch, where loads fall
    for k, curve in zip(record.axes, load.T, strict=True):
        step = np.abs(np.diff(curve))
        limit = max(LOST_LOAD * float(np.ptp(load)), 10.0 * second_difference_scatter(curve))
        at = np.flatnonzero(even & (step > limit) & (_step_over_others(curve) > 1.5 * STEEP))
        if at.size:
            row = int(at[0])
            verb = "falls" if curve[row + 1] < curve[row] else "rises"
            problem = f"the {record.load_named(k)} {verb} at once behind line "
            problem += (
                f"{record.lines[rows[row]]} while the stretch goes on evenly: a tear, a slip, "
            )
            problem += "or another gain"
            _ask_for_rows(record, problem, rows[row + 1 :])


def _step_over_others(curve: np.ndarray) -> np.ndarray:
    """Each step of a curve over the largest of the two before and after it."""
    step = np.abs(np.diff(curve))
    others = maximum_filter(step, footprint=[1, 1, 0, 1, 1], mode="constant")
    return step / np.maximum(others, 1e-9 * max(float(np.ptp(curve)), 1e-300))


def _ask_for_rows(record: Record, problem: str, rows: np.ndarray) -> None:
    without = ranges_without(record.lines, rows)
    count = int((record.reasons == "").sum())
    gives = {
        f"rows={without}": f"{count - rows.size} rows, without {in_lines(record.lines[rows])}",
        "rows=all": f"all {count} rows, whatever they look like",
    }
    raise Question(problem, gives, file=record.path)


def ask_about_falls_of_one(record: Record, rows: np.ndarray, cycles: Sequence[Cycle]) -> None:
    """Ask for `rows` where the stretch falls back before a rise and the load does not."""
    path, total = (curves.sum(axis=1) for curves in record.pulled)
    noise, lowest = second_difference_scatter(total[rows]), float(total[rows].min())
    ends = [rows[0], *(int(cycle.loading[-1]) for cycle in cycles)]
    for end, cycle in zip(ends, cycles, strict=False):
        low = int(cycle.loading[0])
        before = rows[(rows >= end) & (rows < low)]
        peak = int(before[path[before].argmax()]) if before.size else low
        fall = path[peak] - path[low] > 2.0 * JUMP * np.ptp(path[rows])
        load = float(total[peak]) - lowest
        fell_too = total[peak] - total[low] > FALLS_TOO * load
        if fall and not fell_too and load > 10.0 * noise:
            back = cycle.loading[path[cycle.loading] >= path[peak]]
            lost = np.arange(peak + 1, int(back[0]) if back.size else int(cycle.loading[-1]) + 1)
            lines = in_lines(record.lines[lost])
            problem = f"the stretch falls in lines {lines} and the load does not: lost tracking"
            _ask_for_rows(record, problem, lost)


def check_signs(record: Record, rows: np.ndarray) -> None:
    """Refuse loads that fall where the stretch is largest, as from a cell with tension negative."""
    largest = float(np.ptp(record.pulled[1][rows], axis=0).max())
    for k in record.axes:
        axis, name = "xy"[k], record.load_named(k)
        stretch, load = record.stretch[rows, k], record.load[rows, k]
        change = load[np.argmax(stretch)] - load[np.argmin(stretch)]
        if change >= -NEGATIVE * largest:
            continue
        strain = stretch - stretch[0]
        if load[np.abs(strain).argmax()] > load[0] and -strain.min() > strain.max():
            raise InputError(
                f"the {name} rises by {-change:.3g} while the stretch in {axis} falls to "
                f"{stretch.min():.4g}: the machine may count extension as negative, or the strain "
                "may be inverse",
                file=record.path,
                column=record.columns[k],
                remedy="multiply the column by -1 (a displacement) in the table, and convert again",
            )
        raise InputError(
            f"the {name} falls by {-change:.3g} while the stretch in {axis} rises to "
            "its largest value: the load cell may count tension as negative",
            file=record.path,
            column=record.columns[2 + k],
            remedy=f"reverse its sign with `tension_negative={axis}` (or xy for both)",
        )


# --- a loading branch -----------------------------------------------------------------------------


def followed_by_load(taken: Recording, cycle: Cycle, choice: Choice) -> Recording:
    """A loading branch whose load and stretch go on together; asks where they do not."""
    record, loads = taken.record, taken.pulled[1]
    rest = rest_rows(taken.stretch[:, 0], taken.stretch[:, 1], taken.load)
    falling = None if choice.rows else _falls(taken, rest)
    stuck = max(_runs(taken.stretch[rest:]), key=len)
    steps = repeats(taken.stretch, rest) or any(
        _rises(load, loads)
        for load in (record.pulled[1][cycle.hold], loads[rest:][stuck])
        if len(load) > 2
    )
    relaxes = falling is not None and _relaxes(taken, falling[1])
    if choice.still in ("first", "last") or (choice.still is None and (steps or relaxes)):
        return _one_row_a_step(taken, cycle.hold, choice, "goes on" if steps else "relaxes")
    if choice.rows is not None:
        return taken
    if falling is not None and choice.still is None:
        k, rows = falling
        problem = f"the {record.load_named(k)} falls behind line {taken.lines[rows[0] - 1]} while "
        problem += f"the stretch rises{f' ({taken.name})' if taken.name else ''}: a tear, a grip "
        problem += "that slips, or lost rows"
        _ask_for_rows(record, problem, np.union1d(taken.rows[rows], cycle.hold))
    _ask_about_level_loads(taken, cycle)
    _ask_about_delay(taken, cycle)
    return taken


def _one_row_a_step(
    taken: Recording, hold: np.ndarray, choice: Choice, load_does: str
) -> Recording:
    """The first or last row of each run of the same stretch, as the user chose."""
    record, rows = taken.record, np.concatenate([taken.rows, hold])
    runs = _runs(record.stretch[rows])
    if choice.still is None:
        longest = max(runs, key=len)
        raise Question(
            f"the stretch stands still in up to {len(longest)} rows (lines "
            f"{in_lines(record.lines[rows[longest]])}) while the load {load_does}: a camera slower "
            "than the load cell, a coarse or frozen stretch, or steps with relaxation",
            {
                "still=first": f"{len(runs)} rows, the first of each stretch",
                "still=last": f"{len(runs)} rows, the last of each stretch",
                "still=all": f"all {taken.rows.size} rows",
                f"rows={ranges_without(record.lines, rows[longest[1:]])}": "without these lines",
            },
            file=record.path,
        )
    kept = rows[[run[0] if choice.still == "first" else run[-1] for run in runs]]
    record.leave_out(np.setdiff1d(rows, kept), "repeats the stretch of another row")
    return replace(taken, rows=kept)


def _runs(curves: np.ndarray, level: float | None = None) -> list[np.ndarray]:
    """Rows in runs of the same values, within a level, or within the scatter of each curve."""
    within = level or 4.0 * np.array([second_difference_scatter(curve) for curve in curves.T])
    runs, first = [], 0
    for row in range(1, len(curves)):
        if np.any(np.abs(curves[row] - curves[first]) > within):
            runs.append(np.arange(first, row))
            first = row
    return [*runs, np.arange(first, len(curves))]


def _rises(held: np.ndarray, load: np.ndarray) -> bool:
    """Whether a load rises at a peak of the stretch."""
    third = len(held) // 3 or 1
    rise = held[-third:].mean(axis=0) - held[:third].mean(axis=0)
    noise = 5.0 * np.sqrt(2.0 / third) * max(map(second_difference_scatter, load.T))
    return bool(np.any(rise > JUMP * np.ptp(load) + noise))


def _falls(taken: Recording, rest: int) -> tuple[int, np.ndarray] | None:
    """Direction and rows of a load that falls although the stretch does not, or None."""
    stretch, loads = taken.pulled
    path = stretch.sum(axis=1)
    for k, curve in zip(taken.record.axes, loads.T, strict=True):
        smooth = median_filter(curve, 5, mode="nearest")
        behind = np.maximum.accumulate(smooth) - smooth
        limit = LOST_LOAD * float(np.ptp(loads)) + 6.0 * second_difference_scatter(curve)
        low = rest + int(behind[rest:].argmax()) if curve.size > rest else 0
        top = int(smooth[: low + 1].argmax())
        if behind[low] > limit and path[low] >= path[top] - JUMP * float(np.ptp(path)):
            return k, np.arange(top + 1, curve.size)
    return None


def _relaxes(taken: Recording, falling: np.ndarray) -> bool:
    """Whether the stretch stands still in the first rows in which the load falls."""
    stretch = taken.pulled[0].sum(axis=1)
    after = stretch[falling[0] - 1 : falling[0] + 5]
    half_step = 0.5 * float(np.ptp(stretch)) / stretch.size
    scatter = 4.0 * second_difference_scatter(stretch)
    return bool(np.ptp(after) < max(half_step * after.size, scatter))


def _ask_about_level_loads(taken: Recording, cycle: Cycle) -> None:
    """Ask where a load stays while the stretch goes on as far as it rose with before."""
    stretch, loads = taken.pulled
    path = np.abs(stretch - stretch[0]).sum(axis=1)
    for k, curve in zip(taken.record.axes, loads.T, strict=True):
        scatter, span = second_difference_scatter(curve), float(np.ptp(curve))
        if span < max(0.1 * float(np.ptp(loads)), 10.0 * scatter):
            continue
        level = max(4.0 * scatter, LEVEL * span)
        stays = np.zeros(curve.size, dtype=bool)
        for first, *_, last in (run for run in _runs(curve[:, None], level) if run.size >= 4):
            same_way = path[:first] >= 2.0 * path[first] - path[last]
            rise = curve[first] - curve[:first][same_way].min(initial=curve[first])
            to_the_end = curve[last:].max() <= curve[first : last + 1].max() + level
            if rise > 4.0 * level and path[last] - path[first] > LEAST_WAY * np.ptp(path):
                stays[first : curve.size if to_the_end else last + 1] = True
        at = np.flatnonzero(stays)
        if at.size:
            value = taken.record.load_text(k, float(curve[at].mean()))
            problem = (
                f"the {taken.record.load_named(k)} stays at {value} in "
                f"lines {in_lines(taken.lines[at])} while the stretch goes on: the load cell at "
                "its limit, creep, or a grip that slips"
            )
            late = cycle.hold if at[-1] == curve.size - 1 else cycle.hold[:0]
            _ask_for_rows(taken.record, problem, np.union1d(taken.rows[at], late))


def _ask_about_delay(taken: Recording, cycle: Cycle) -> None:
    """Ask where the load goes on rising after the stretch has turned back."""
    stretch, load = taken.record.pulled
    path = stretch[cycle.unloading].sum(axis=1)
    if cycle.hold.size >= LEAST_ROWS or cycle.unloading.size < LEAST_ROWS:
        return
    for k, axis in enumerate(taken.record.axes):
        curve = load[cycle.unloading, k]
        turned = int(curve.argmax())
        late = int(cycle.unloading[turned] - taken.rows[-1])
        rise = curve[turned] - load[taken.rows[-3:], k].mean()
        noise = 8.0 * second_difference_scatter(load[taken.rows, k])
        extent = np.ptp(load[taken.rows])
        if late > 1 and path[turned] < path[0] and rise > JUMP * extent + noise:
            raise Question(
                f"the {taken.record.load_named(axis)} goes on rising for {late} rows behind line "
                f"{taken.lines[-1]}, where the stretch turns back: it is recorded late",
                {"rows=all": f"as it is; otherwise shift the loads {late} rows up in the table"},
                file=taken.record.path,
            )
