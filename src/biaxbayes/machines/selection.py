"""The loading paths of a record: protocols, cycles and branches, as chosen or asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import BRANCHES, Choice
from biaxbayes.machines.cycles import (
    LEAST_ROWS,
    Cycle,
    at_level,
    by_level,
    by_ratio,
    peak_change,
    ratio_name,
    settling,
)
from biaxbayes.machines.readings import followed_by_load
from biaxbayes.machines.record import Record, Recording
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import in_lines
from biaxbayes.text_files import first_few

LEVEL = "level"
UNFINISHED = 0.95
"""Reach of a last cycle without unloading, over that of the one before, from which it is whole."""
SHOWN = 8
"""Cycles and protocols that a question lists."""


def select(record: Record, choice: Choice) -> list[Recording]:
    """The chosen branch of the chosen cycles of each protocol of a record."""
    protocols = _protocols(record, choice)
    taken = [
        _recording(record, name, protocols[name], number, choice)
        for name, numbers in _chosen(record, protocols, choice).items()
        for number in numbers
    ]
    kept = np.concatenate([r.rows for r in taken])
    for cycle in (cycle for cycles in protocols.values() for cycle in cycles):
        mine = np.isin(cycle.rows("both"), kept).any()
        sides = ("loading", "hold at the peak", "unloading")
        for rows, side in zip(cycle.parts, sides, strict=True):
            reason = side if mine else "a cycle that was not chosen"
            record.leave_out(np.setdiff1d(rows, kept), reason)
    others = np.setdiff1d(np.arange(record.lines.size), kept)
    record.leave_out(others, "rest or a smaller loop, in no cycle")
    return taken


def _protocols(record: Record, choice: Choice) -> Mapping[str, list[Cycle]]:
    """Cycles by protocol: those that the file names, or those of a ratio of the peaks."""
    named, by = record.cycles, choice.protocols_by
    if set(named) != {""} or by == "none":
        return named
    cycles = named[""]
    held = [at_level(record.stretch, cycle) for cycle in cycles]
    levels = by_level(record.stretch, held)
    groups = {kind: by_ratio(curves, cycles) for kind, curves in (
        ("ratio", record.stretch), ("load-ratio", record.load))}  # fmt: skip
    proposed = groups
    if by == LEVEL or (len(levels) > 1 and "both" not in levels):
        groups, proposed = groups | {LEVEL: levels}, {LEVEL: levels}
    if by is None and max(len(groups[kind]) for kind in groups if kind != "load-ratio") > 1:
        gives = {f"protocols_by={kind}": _in_groups(group) for kind, group in proposed.items()}
        if LEVEL not in groups:  # a level alone is no test
            gives["protocols_by=none"] = "all are cycles of one protocol"
        problem = f"holds {len(cycles)} cycles of {len(groups['ratio'])} stretch ratios"
        problem += f" at {len(levels)} levels" * (LEVEL in groups)
        problem += ", and nothing says what separates its protocols"
        raise Question(problem, {**gives, "protocols_by=COLUMN": ""}, file=record.path)
    if by not in groups or len(groups[by]) == 1:
        return named
    cycles = held if by == LEVEL else cycles
    counted = all(cycle.label == str(n + 1) for n, cycle in enumerate(cycles))
    return {
        name: [
            replace(cycles[n], label=str(k + 1)) if counted else cycles[n]
            for k, n in enumerate(group)
        ]
        for name, group in groups[by].items()
    }


def _in_groups(groups: Mapping[str, Sequence[int]]) -> str:
    """Cycles by ratio, for a question."""
    listed = [
        f"{name}: cycle{'s' * (len(group) > 1)} {' '.join(str(n + 1) for n in group)}"
        for name, group in groups.items()
    ]
    return first_few(listed, SHOWN, "; ")


def _chosen(
    record: Record, protocols: Mapping[str, list[Cycle]], choice: Choice
) -> dict[str, Sequence[int]]:
    """Indices of the chosen cycles of each protocol."""
    which = choice.cycles
    for name, cycles in protocols.items() if which in (None, "last") else ():
        if len(cycles) < 2 or cycles[-1].unloading.size or cycles[-1].hold.size >= LEAST_ROWS:
            continue
        reach = [np.abs(peak_change(record.stretch, c.loading)).max() for c in cycles[-2:]]
        if reach[1] < UNFINISHED * reach[0]:  # it ends on its rise
            gives = {f"cycles={c.label}": record.shown(c.loading) for c in cycles[-2:]}
            problem = f"the record ends on the rise of cycle {cycles[-1].label}"
            problem += f" of {name}" if name else ""
            problem += f", at {reach[1] / reach[0]:.0%} of the stretch of the one before"
            raise Question(problem, gives, file=record.path)
    several = {name: cycles for name, cycles in protocols.items() if len(cycles) > 1}
    if which is None and several:
        numbers = [f"{name}: {len(c)}".removeprefix(": ") for name, c in several.items()]
        peaks = {name: record.shown(cycles[-1].loading) for name, cycles in protocols.items()}
        last = [f"{name}: {shown}".removeprefix(": ") for name, shown in peaks.items()]
        labels = [[cycle.label for cycle in cycles] for cycles in protocols.values()]
        of_all = [c for c in next(iter(several.values())) if all(c.label in k for k in labels)]
        time, begins = record.time_s, [c.loading[0] for k in several.values() for c in k[1:]]
        back = [record.lines[at] for at in begins if time is not None and time[at] < time[at - 1]]
        of = "line" if len(back) == 1 else "lines"
        cut = f", cut where the time steps back in {of} {in_lines(back)}" if back else ""
        gives = {"cycles=last": first_few(last, 3, "; "), "cycles=all": "each cycle a protocol"}
        gives |= {f"cycles={c.label}": record.shown(c.loading) for c in of_all[:SHOWN]}
        problem = f"holds several cycles ({first_few(numbers, SHOWN)}){cut}"
        raise Question(problem, gives, file=record.path)
    if choice.repeats == "cycles" and not several:
        which = "last"  # the number is that among several files
    return {
        name: _numbers(which, [cycle.label for cycle in cycles], name, record.path)
        for name, cycles in protocols.items()
    }


def _numbers(which: str | int | None, labels: Sequence[str], of: str, file: Path) -> Sequence[int]:
    """Indices of the chosen cycles among those with these labels."""
    if which in (None, "last"):
        return [len(labels) - 1]
    if which == "all":
        return range(len(labels))
    numbers = str(which).split(",")
    for number in numbers:
        if number not in labels:
            problem = f"no cycle {number}{f' of {of}' if of else ''}"
            remedy = f"cycles are {first_few(labels, 12)}"
            raise InputError(problem, file=file, remedy=remedy)
    return [labels.index(number) for number in numbers]


def _recording(
    record: Record, name: str, cycles: Sequence[Cycle], number: int, choice: Choice
) -> Recording:
    """The chosen branch of a cycle, with a note on how it differs from the cycle before."""
    cycle, counted = cycles[number], f"{number + 1} of {len(cycles)}"
    several = choice.cycles == "all" or "," in str(choice.cycles)
    if several and len(cycles) > 1:
        name = f"{name} cycle {cycle.label}".strip()
    if choice.branch is None and cycle.unloading.size >= LEAST_ROWS:
        gives = {f"branch={b}": record.shown(cycle.rows(b)) for b in BRANCHES}
        of = f" of {name}" if name else ""
        raise Question(f"holds loading and unloading{of}", gives, file=record.path)
    branch = choice.branch or "loading"
    rows = cycle.rows(branch)
    if rows.size < 2:
        problem = f"{rows.size} rows in the {branch} branch of cycle {cycle.label}"
        remedy = "choose another with `cycles` or `branch`"
        raise InputError(problem, file=record.path, remedy=remedy)
    if cycle.label != str(number + 1):
        counted = f"{cycle.label} ({counted})"
    taken = Recording(name, record, rows, counted if len(cycles) > 1 else None, branch)
    if branch == "loading":
        taken = followed_by_load(taken, cycle, choice)
    if number == 0 or several:
        return taken
    axes, names = taken.axes, "".join("xy"[k] for k in taken.axes)
    curves = record.stretch[:, axes], record.load[:, axes]
    text, settled = settling(*curves, names, cycles[number - 1].loading, cycle.loading)
    text = f"{name}: {text}" if name else text
    return replace(taken, notes=(text,)) if settled else replace(taken, assumptions=(text,))


def without_repeats(recordings: Sequence[Recording], choice: Choice) -> list[Recording]:
    """Recordings of the same ratio in several files, sheets or sets are protocols, or cycles."""
    groups: dict[str, list[Recording]] = {}
    for r in recordings:
        ratio = ratio_name(peak_change(r.record.stretch, np.sort(r.rows)))
        groups.setdefault(ratio, []).append(r)
    repeated = [
        f"{ratio}: {', '.join(sources)}"
        for ratio, group in groups.items()
        if len(sources := dict.fromkeys(r.record.source for r in group)) > 1
    ]
    if not repeated or choice.repeats == "protocols":
        return list(recordings)
    file = recordings[0].record.path
    if choice.repeats is None:
        gives = {
            "repeats=protocols": f"{len(recordings)} protocols",
            "repeats=cycles": f"{len(groups)} protocols, their cycles in this order",
        }
        problem = f"the same stretch ratio comes back ({'; '.join(repeated)[:300]})"
        raise Question(problem, gives, file=file)
    kept = []
    for ratio, group in groups.items():
        count = len(group)
        if choice.cycles is None and count > 1:
            gives = {"cycles=last": group[-1].record.source, "cycles=all": "each a protocol"}
            raise Question(f"{ratio} has {count} cycles", gives, file=file)
        numbers = _numbers(choice.cycles, [str(n + 1) for n in range(count)], ratio, file)
        for n, r in enumerate(group):
            if n in numbers:
                kept.append(replace(r, cycle=f"{n + 1} of {count}" if count > 1 else r.cycle))
            else:
                r.record.leave_out(r.rows, "a cycle that was not chosen")
    return kept
