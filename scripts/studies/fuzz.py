"""Damage the input of every reader in thousands of ways, and count what comes of it.

    python scripts/study.py fuzz --write docs/robustness.md

Each reader works in a process of its own, so that its memory is known and a crash is seen.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from hostile.readers import LONG, READERS, Bases, Tally, finished_run, hammer
from studies.page import put, table

MOST_BYTES = 2_000_000_000
HEAD = ("input", "damaged files", "still valid, read", "refused in one line", "problems")


def in_a_process(reader: str, count: int, seed: int, place: Path, bases: Bases) -> Tally:
    """The tally of a reader from a process of its own, whose memory is bounded."""
    folder = place / reader.replace(" ", "-")
    folder.mkdir()
    child = os.fork()
    if not child:
        tally = hammer(reader, seed, count, folder, bases)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        if peak > MOST_BYTES:
            tally.problems.append(f"took {peak:,} bytes")
        (place / f"{folder.name}.json").write_text(json.dumps([asdict(tally), peak]))
        os._exit(0)
    _, status = os.waitpid(child, 0)
    try:
        told, peak = json.loads((place / f"{folder.name}.json").read_text())
    except OSError:
        return Tally(reader, problems=[f"the process ended with {status}"])
    tally = Tally(**told)
    print(*row(tally), f"{peak / 1e6:.0f} MB", sep=" | ", flush=True)
    for problem in tally.problems[:20]:
        print("   ", problem, flush=True)
    return tally


def row(tally: Tally) -> list[str]:
    """Line of the table."""
    counts = (tally.inputs, tally.read, tally.refused)
    return [tally.reader, *(f"{n:,}" for n in counts), str(len(tally.problems))]


def result(total: Tally) -> str:
    """The sentence that the page opens with."""
    fine = total.inputs - len(total.problems)
    all_of_them = "all" if fine == total.inputs else f"{fine:,}"
    return (
        f"**Of {total.inputs:,} damaged inputs {all_of_them} were read or refused in one line.**\n"
    )


def main() -> int:
    """Run the study; exit code 1 when anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--share", type=float, default=1.0, help="of the long run's inputs")
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        bases = finished_run(Path(place))
        tallies = [
            in_a_process(
                reader, int(LONG[reader] * arguments.share), arguments.seed, Path(place), bases
            )
            for reader in READERS
        ]
    total = Tally("all")
    for tally in tallies:
        total.add(tally)
    text = table(HEAD, [row(t) for t in (*tallies, total)])
    print(text + f"slowest {total.slowest:.1f} s, {total.with_place} name a place in the file")
    if arguments.write:
        put(arguments.write, "fuzz", text)
        put(arguments.write, "result fuzz", result(total))
    return int(bool(total.problems))


if __name__ == "__main__":
    sys.exit(main())
