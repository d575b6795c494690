"""Readings that may not be of the tissue: rows apart, steps, loads that fall or stay at a limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter, median_filter

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.columns import OF_AXES, Source
from biaxbayes.machines.cycles import LEAST_ROWS, Cycle
from biaxbayes.machines.record import Record, Recording, ranges_without
from biaxbayes.specimens.branches import JUMP, SIDES, STEEP, jumps, repeats
from biaxbayes.specimens.plausibility import NEGATIVE
from biaxbayes.specimens.protocol import rest_rows, second_difference_scatter
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import in_lines

LOST_LOAD = 0.1
"""Fall of the load, as a fraction of its range, that loading does not explain."""
LEAST_TEAR = 0.03
"""Least fall, as a fraction of its range, of a load that had risen less than that."""
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
        found = jumps(record.stretch[left], record.load[left])
        jumping |= set(found)
        if not found:
            break
        left = np.delete(left, np.unique(np.concatenate(list(found.values()))))
    apart = np.setdiff1d(rows, left)
    if apart.size:
        which = " and the ".join(side for side in SIDES if side in jumping)
        jump = "jumps" if len(jumping) == 1 else "jump"
        problem = f"the {which} {jump} in {in_lines(record.lines[apart])} (lines of the file)"
        _ask_for_rows(record, problem, apart)


def ask_about_steps(record: Record, rows: np.ndarray) -> None:
    """Ask where a load changes at once and stays so, although the stretch goes on evenly."""
    stretch, load = record.pulled(rows)
    path = stretch.sum(axis=1)
    if rows.size < 4 * LEAST_ROWS:
        return
    way = np.pad(np.sign(np.diff(path)), 1)
    onward = (way[:-2] == way[1:-1]) & (way[1:-1] == way[2:]) & (way[1:-1] != 0.0)
    # no turn of the stretch, where loads fall
    even = onward & (_over_others(np.abs(np.diff(path))) < STEEP)
    for k, curve in zip(record.axes_of(rows), load.T, strict=True):
        step, noise = np.diff(curve), 10.0 * second_difference_scatter(curve)
        span, fall = float(np.ptp(load)), np.maximum(-step, 0.0)
        leaps = np.abs(step) > max(LOST_LOAD * span, noise)
        leaps &= _over_others(np.abs(step)) > 1.5 * STEEP
        # early in a curve the load is a small part of its range; what is left goes on
        above = curve - curve.min()
        torn = fall > np.maximum(LOST_LOAD * above[:-1], max(LEAST_TEAR * span, noise))
        torn &= (way[1:-1] > 0.0) & (_over_others(fall) > STEEP) & (above[1:] > fall / STEEP)
        at = np.flatnonzero(even & (leaps | torn))
        if at.size:
            row, verb = int(at[0]), "falls" if step[at[0]] < 0.0 else "rises"
            problem = f"the {record.load_named(k)} {verb} at once behind line "
            problem += f"{record.lines[rows[row]]} while the stretch goes on evenly: a tear, a "
            _ask_for_rows(record, f"{problem}slip, or another gain", rows[row + 1 :])


def _over_others(step: np.ndarray) -> np.ndarray:
    """Each step over the largest of the two before and after it."""
    others = maximum_filter(step, footprint=[1, 1, 0, 1, 1], mode="constant")
    return np.asarray(step / np.maximum(others, 1e-9 * max(float(step.sum()), 1e-300)))


def _ask_for_rows(record: Record, problem: str, rows: np.ndarray) -> None:
    without = ranges_without(record.lines, rows)
    count = int((record.reasons == "").sum())
    gives = {
        f"rows={without}": f"{count - rows.size} rows, without {in_lines(record.lines[rows])}",
        "rows=all": f"all {count} rows, whatever they look like",
    }
    raise Question(problem, gives, file=record.path)


def ask_about_falls_of_one(record: Record, rows: np.ndarray, cycles: Sequence[Cycle]) -> None:
    """Ask for `rows` where the stretch falls back in or before a rise and the load does not."""
    axes = record.axes_of(rows)
    path, total = (c[:, axes].sum(axis=1) for c in (record.stretch, record.load))
    noise, lowest = second_difference_scatter(total[rows]), float(total[rows].min())
    ends = [rows[0], *(int(cycle.loading[-1]) for cycle in cycles)]
    for end, cycle in zip(ends, cycles, strict=False):
        part = np.union1d(rows[(rows >= end) & (rows < cycle.loading[0])], cycle.loading)
        behind = np.maximum.accumulate(path[part]) - path[part]
        low = int(part[behind.argmax()])
        peak = int(part[path[part[part <= low]].argmax()])
        load, fell = float(total[peak]) - lowest, total[peak] - total[low]
        falls = behind.max() > 2.0 * JUMP * np.ptp(path[rows]) and load > 10.0 * noise
        if falls and fell <= FALLS_TOO * load:
            back = part[(part > low) & (path[part] >= path[peak])]
            lost = part[(part > peak) & (part < (back[0] if back.size else part[-1] + 1))]
            lines = in_lines(record.lines[lost])
            problem = f"the stretch falls in lines {lines} and the load does not: lost tracking"
            _ask_for_rows(record, problem, lost)


def ask_about_signs(record: Record, rows: np.ndarray, sources: Mapping[str, Source]) -> None:
    """Ask where a load falls while its direction is stretched, or both are counted negative."""
    axes, (_, loads) = record.axes_of(rows), record.pulled(rows)
    low = -NEGATIVE * float(np.ptp(loads, axis=0).max())
    for k in axes:
        stretch, load = record.stretch[rows, k], record.load[rows, k]
        change = load[np.argmax(stretch)] - load[np.argmin(stretch)]
        strain, rise = stretch - stretch[0], load - load[0]
        shortens = -strain.min() > strain.max()
        of_load = not record.experiment.is_mounted or not shortens
        if change < low:
            wrong = ["load"] if of_load or rise[np.abs(strain).argmax()] < 0.0 else ["stretch"]
            says = f"the {record.load_named(k)} falls by {-change:.3g} while the stretch in "
            says += f"{'xy'[k]} rises"
        elif shortens and axes == (0, 1) and max(rise[strain.argmin()], load.min()) < low:
            wrong = ["stretch", "load"]
            says = f"stretch and load in {'xy'[k]} both fall from the first row on, as in "
            says += "compression"
        else:
            continue
        turned = [_turned(record, sources, k, which) for which in wrong]
        what = " and ".join("extension" if which == "stretch" else "tension" for which in wrong)
        gives = {"rows=LINES": "other rows"}
        if all(turned):
            gives = {f"columns={','.join(turned)}": f"{what} is counted negative"} | gives
        raise Question(says, gives, file=record.path)


def _turned(record: Record, sources: Mapping[str, Source], k: int, which: str) -> str:
    """The source of a stretch or load with the opposite sign; empty where it is no column."""
    load = record.experiment.loads[record.loads].columns[k]
    targets = OF_AXES[k] if which == "stretch" else (load,)
    source = next((sources[t] for t in targets if t in sources), None)
    if source is None:
        return ""
    if which == "stretch":
        return f"{source.target}=2 - ({source.formula})"
    again = f"-({source.text})" if source.computed else f"-{source.formula}"
    if source.computed and source.text.startswith("-{"):
        again = source.text[1:]  # -(-a) is a
    return f"{source.target}={again}:{source.unit.name}"  # type: ignore[union-attr]


def followed_by_load(taken: Recording, cycle: Cycle, choice: Choice) -> Recording:
    """A loading branch whose load and stretch go on together; asks where they do not."""
    record = taken.record
    loads = record.pulled(taken.rows)[1]
    rest = rest_rows(taken.stretch[:, 0], taken.stretch[:, 1], taken.load)
    falling = None if choice.rows else _falls(taken, rest)
    runs = _runs(taken.stretch[rest:])
    at_peak = (record.load[cycle.hold][:, taken.axes], loads[rest:][max(runs, key=len)])
    steps = repeats(taken.stretch, taken.load, rest)
    steps = steps or any(_rises(load, loads) for load in at_peak if len(load) > 2)
    relaxes = falling is not None and _relaxes(taken, falling[1])
    relaxes = relaxes or _relax_in_steps(loads[rest:], runs)
    if choice.still in ("first", "last") or (choice.still is None and (steps or relaxes)):
        return _one_row_a_step(taken, cycle.hold, choice, "goes on" if steps else "relaxes")
    if choice.rows is not None:
        return taken
    if falling is not None and choice.still is None:
        k, rows = falling
        of = f" ({taken.name})" if taken.name else ""
        problem = f"the {record.load_named(k)} falls behind line {taken.lines[rows[0] - 1]} while "
        problem += f"the stretch rises{of}: a tear, a grip that slips, or lost rows"
        _ask_for_rows(record, problem, np.union1d(taken.rows[rows], cycle.hold))
    _ask_about_level_loads(taken, cycle)
    _ask_about_delay(taken, cycle)
    return taken


def _one_row_a_step(taken: Recording, hold: np.ndarray, choice: Choice, does: str) -> Recording:
    """The first or last row of each run of the same stretch, as the user chose."""
    record, rows = taken.record, np.concatenate([taken.rows, hold])
    runs = _runs(record.stretch[rows])
    if choice.still is None:
        longest = rows[max(runs, key=len)]
        if len(runs) == 1:
            remedy = "check the columns of the stretches"
            raise InputError("the stretch never changes", file=record.path, remedy=remedy)
        problem = f"the stretch stands still in up to {longest.size} rows (lines "
        problem += f"{in_lines(record.lines[longest])}) while the load {does}: a camera slower"
        problem += " than the load cell, a coarse or frozen stretch, or steps with relaxation"
        gives = {
            "still=first": f"{len(runs)} rows, the first of each stretch",
            "still=last": f"{len(runs)} rows, the last of each stretch",
            "still=all": f"all {taken.rows.size} rows",
            f"rows={ranges_without(record.lines, longest[1:])}": "without these lines",
        }
        raise Question(problem, gives, file=record.path)
    kept = rows[[run[0] if choice.still == "first" else run[-1] for run in runs]]
    record.leave_out(np.setdiff1d(rows, kept), "repeats the stretch of another row")
    return replace(taken, rows=kept)


def _runs(curves: np.ndarray, level: float | None = None) -> list[np.ndarray]:
    """Rows in runs of the same values, within a level, or within the scatter of each curve."""
    # steps against the whole way are noise; uneven sampling is none
    ways = np.sign(curves[-1] - curves[0]) * np.diff(curves, axis=0, prepend=curves[:1])
    within = level or 4.0 * np.sqrt(np.mean(np.minimum(ways, 0.0) ** 2, axis=0))
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


def _relax_in_steps(load: np.ndarray, runs: Sequence[np.ndarray]) -> bool:
    """Whether the stretch goes on in steps, in most of which the load relaxes."""
    runs = [run for run in runs if run.size >= 3]
    if 2 * sum(map(len, runs)) < len(load) or len(runs) < 3:
        return False
    falls = np.array([load[run[0]] - load[run[-1]] for run in runs])
    noise = 3.0 * np.array([*map(second_difference_scatter, load.T)]) * np.sqrt(2.0 * len(runs))
    return bool(np.any(falls.sum(axis=0) > JUMP * np.ptp(load, axis=0) + noise))


def _falls(taken: Recording, rest: int) -> tuple[int, np.ndarray] | None:
    """Direction and rows of a load that falls although the stretch does not, or None."""
    stretch, loads = taken.record.pulled(taken.rows)
    path = stretch.sum(axis=1)
    for k, curve in zip(taken.axes, loads.T, strict=True):
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
    stretch = taken.record.pulled(taken.rows)[0].sum(axis=1)
    after = stretch[falling[0] - 1 : falling[0] + 5]
    half_step = 0.5 * float(np.ptp(stretch)) / stretch.size
    scatter = 4.0 * second_difference_scatter(stretch)
    return bool(np.ptp(after) < max(half_step * after.size, scatter))


def _ask_about_level_loads(taken: Recording, cycle: Cycle) -> None:
    """Ask where a load stays while the stretch goes on as far as it rose with before."""
    stretch, loads = taken.record.pulled(taken.rows)
    path = np.abs(stretch - stretch[0]).sum(axis=1)
    for k, curve in zip(taken.axes, loads.T, strict=True):
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
            problem = f"the {taken.record.load_named(k)} stays at {value} in lines "
            problem += f"{in_lines(taken.lines[at])} while the stretch goes on: the load cell at "
            problem += "its limit, creep, or a grip that slips"
            late = cycle.hold if at[-1] == curve.size - 1 else cycle.hold[:0]
            _ask_for_rows(taken.record, problem, np.union1d(taken.rows[at], late))


def _ask_about_delay(taken: Recording, cycle: Cycle) -> None:
    """Ask where the load goes on rising after the stretch has turned back."""
    axes = taken.axes
    stretch, load = (c[:, axes] for c in (taken.record.stretch, taken.record.load))
    path = stretch[cycle.unloading].sum(axis=1)
    if cycle.hold.size >= LEAST_ROWS or cycle.unloading.size < LEAST_ROWS:
        return
    for k, axis in enumerate(axes):
        curve = load[cycle.unloading, k]
        turned = int(curve.argmax())
        late = int(cycle.unloading[turned] - taken.rows[-1])
        rise = curve[turned] - load[taken.rows[-3:], k].mean()
        noise = 8.0 * second_difference_scatter(load[taken.rows, k])
        extent = np.ptp(load[taken.rows])
        if late > 1 and path[turned] < path[0] and rise > JUMP * extent + noise:
            problem = f"the {taken.record.load_named(axis)} goes on rising for {late} rows behind "
            problem += f"line {taken.lines[-1]}, where the stretch turns back: it is recorded late"
            gives = {"rows=all": f"as it is; or shift the loads {late} rows up in the table"}
            raise Question(problem, gives, file=taken.record.path)
