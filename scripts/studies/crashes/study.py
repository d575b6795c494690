"""Kill, starve and lock out ``biaxbayes sample``, and count what is lost.

    OMP_NUM_THREADS=1 python scripts/study.py crashes --write docs/robustness.md

Every trial starts a run in a process of its own and ends it badly: by SIGKILL at a random moment,
by SIGKILL or a full disk at one particular system call on the run folder (with strace, where it
may be used), or on a file system that has too little room. Then the same command runs again with
``--resume``, and posterior.nc and every CSV are compared with those of a run left alone. Half of
the trials start in the folder of a finished run, which must stay readable, as it was or replaced.

Processes are forked from one that has sampled before, with fewer walkers and shorter blocks than
usual, so that a trial takes seconds and has several checkpoints. Figures and report are drawn in a
fifth of the runs that are killed at random; elsewhere those of the first run are written again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

from studies.crashes.bench import Bench, Tally
from studies.crashes.trials import (
    WRITES,
    can_trace,
    faults,
    file_size_limits,
    full_disks,
    random_kills,
)
from studies.page import put, table
from studies.quick_runs import without_products

HEAD = ("what", "trials", "ended early", "resumed to identical values", "problems")


def fault_trials(bench: Bench, most: int) -> Iterator[Tally]:
    """Faults at particular system calls: all that write the checkpoint, so many of the others."""

    def at(what: str, fault: str, chosen: Callable[[str, str], bool], count: int) -> Tally:
        return faults(bench, what, fault, chosen, count)

    def checkpoint(name: str, where: str) -> bool:
        return "checkpoint" in where

    def writing(name: str, where: str) -> bool:
        return name in WRITES and "O_RDONLY" not in where

    yield at("SIGKILL at a call on the checkpoint", "signal=KILL", checkpoint, most * 10)
    yield at(
        "no space at a call that writes the checkpoint",
        "error=ENOSPC",
        lambda name, where: checkpoint(name, where) and writing(name, where),
        most * 10,
    )
    yield at("SIGKILL at a call on the folder", "signal=KILL", lambda n, w: True, most)
    yield at("no space at a call on the folder", "error=ENOSPC", writing, most)


def study(
    bench: Bench, *, kills: int, calls: int, disks: int, seed: int, figures: bool = True
) -> Iterator[Tally]:
    """All trials."""
    drawn = -(-kills // 5) if figures else 0
    if drawn:
        yield random_kills(bench, "SIGKILL at a random moment, figures drawn", drawn, seed)
    if figures:
        bench.copy_products()
    if kills > drawn:
        yield random_kills(bench, "SIGKILL at a random moment", kills - drawn, seed + 1)
    if disks:
        yield full_disks(bench, disks)
        yield file_size_limits(bench, -(-disks // 4))
    if calls and can_trace(bench):
        yield from fault_trials(bench, calls)


def report(tallies: list[Tally]) -> str:
    """The table as Markdown."""
    return table(HEAD, [t.row() for t in tallies])


def result(tallies: list[Tally]) -> str:
    """The sentence that the page opens with."""
    trials, identical = (sum(getattr(t, k) for t in tallies) for k in ("trials", "identical"))
    found = "every one" if identical == trials else f"{identical:,}"
    return (
        f"**Of {trials:,} runs that were killed or met a full disk {found} resumed to identical "
        "values.**\n"
    )


def main() -> int:
    """Run the study; exit code 1 when anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--calls", type=int, default=40, help="most calls on the folder of a kind")
    parser.add_argument("--disks", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-figures", action="store_true", help="for a quick look")
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    arguments = parser.parse_args()
    tallies: list[Tally] = []
    quick = without_products() if arguments.no_figures else nullcontext()
    with tempfile.TemporaryDirectory() as place, quick:
        begun = time.monotonic()
        bench = Bench(Path(place))
        counts = {k: getattr(arguments, k) for k in ("kills", "calls", "disks", "seed")}
        for tally in study(bench, **counts, figures=not arguments.no_figures):
            tallies.append(tally)
            print(*tally.row(), f"{time.monotonic() - begun:.0f} s", sep=" | ", flush=True)
            if arguments.write:
                put(arguments.write, "crashes", report(tallies))
                put(arguments.write, "result crashes", result(tallies))
    print(report(tallies))
    return int(any(t.identical != t.trials or t.problems for t in tallies))


if __name__ == "__main__":
    sys.exit(main())
