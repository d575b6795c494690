"""Kill, starve and interrupt ``biaxbayes sample``, resume it, and count what is lost.

    python scripts/study.py crashes

Every trial starts a run in a process of its own and ends it badly: by SIGKILL at a random moment,
by SIGKILL or a full disk at one particular system call on the run folder (with strace, where it is
allowed), or on a file system that has too little room (where mounting is allowed). Then the same
command runs again with ``--resume``, and posterior.nc and every CSV are compared with those of a
run left alone. Half of the trials start in the folder of a finished run, which must stay readable.
"""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.errors import BiaxbayesError
from studies.common import DATA, options_of, parser, print_table

SAMPLE = ("-m", "biaxbayes", "sample", str(DATA / "donor2-adventitia.csv"))
OPTIONS = ("--quiet", "--overwrite", "--ess", "2000", "--workers", "1")
PLENTY = 600.0  # seconds after which a trial counts as hung
CALLS = "openat,write,pwrite64,fsync,fdatasync,ftruncate,rename,renameat,renameat2,unlink,mkdir"
WRITES = ("write", "pwrite64", "fsync", "openat", "mkdir", "rename")


@dataclass
class Tally:
    """Trials of one kind, and what went wrong in them."""

    what: str
    trials: int = 0
    ended_early: int = 0  # the kill or the full disk met a run that was still going
    identical: int = 0
    problems: list[str] = field(default_factory=list)


def start(
    folder: Path, *options: str, prefix: tuple[str, ...] = (), limit: int | None = None
) -> subprocess.Popen:
    """A run in a process of its own; its standard error goes to a file beside the folder."""

    def before() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    with Path(f"{folder}.err").open("wb") as log:
        return subprocess.Popen(
            [*prefix, sys.executable, *SAMPLE, "--out", str(folder), *OPTIONS, *options],
            stdout=subprocess.DEVNULL,
            stderr=log,
            preexec_fn=before,
        )


def values(folder: Path) -> dict[str, bytes]:
    """Every array of posterior.nc and every CSV, as bytes."""
    found = {p.name: p.read_bytes() for p in folder.glob("*.csv")}
    with h5py.File(folder / "posterior.nc") as file:

        def keep(name: str, item: h5py.HLObject) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = np.asarray(item[()]).tobytes()

        file.visititems(keep)
    return found


class Bench:
    """A run left alone, with which the others are compared, and an earlier run."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.earlier, whole = place / "earlier", place / "whole"
        assert start(self.earlier, "--seed", "2").wait() == 0, "the first run failed"
        clock = time.monotonic()
        assert start(whole).wait() == 0, "the second run failed"
        self.seconds = time.monotonic() - clock
        self.values = values(whole)
        sizes = [p.stat().st_size for p in whole.iterdir()]
        self.bytes, self.largest = sum(sizes), max(sizes)

    def fresh(self, folder: Path, *, occupied: bool) -> Path:
        """An empty folder for a trial, or one with the earlier run."""
        shutil.rmtree(folder, ignore_errors=True)
        if occupied:
            shutil.copytree(self.earlier, folder)
        return folder

    def judge(self, tally: Tally, folder: Path, code: int, *, occupied: bool) -> None:
        """Look at what a trial left behind, resume it, and compare."""
        tally.trials += 1
        tally.ended_early += code != 0
        message = Path(f"{folder}.err").read_text()
        if code > 0 and (code != 2 or message.count("\n") != 1 or "Traceback" in message):
            tally.problems.append(f"exit {code}: {message.strip()[-80:]}")
        if occupied:
            try:
                run = biaxbayes.open_run(folder)
                assert len(run.draws) and len(run.summary)
            except (BiaxbayesError, AssertionError) as error:
                tally.problems.append(f"earlier run not readable: {error}")
        # a folder that still holds the earlier run alone cannot be resumed with another seed
        again = start(folder, "--resume").wait(PLENTY)
        if again == 2 and occupied and "seed" in Path(f"{folder}.err").read_text():
            again = start(folder).wait(PLENTY)
        if again != 0:
            why = Path(f"{folder}.err").read_text().strip()[-80:]
            tally.problems.append(f"resume ended with {again}: {why}")
        elif values(folder) == self.values and not list(folder.glob(".writing*")):
            tally.identical += 1
        else:
            tally.problems.append("resumed to other values")


def random_kills(bench: Bench, count: int, seed: int) -> Tally:
    """SIGKILL at random moments, spread evenly over the length of a run, until so many met one."""
    tally = Tally("SIGKILL at a random moment")
    rng = random.Random(seed)
    while tally.ended_early < count and tally.trials < 2 * count + 3:
        i = tally.trials
        folder = bench.fresh(bench.place / "killed", occupied=i % 2 == 1)
        run = start(folder)
        time.sleep(bench.seconds * (i % count + rng.random()) / count)
        run.kill()
        bench.judge(tally, folder, run.wait(), occupied=i % 2 == 1)
    return tally


# --- faults at system calls ---------------------------------------------------------------------


def traced(folder: Path, log: Path, *tampering: str) -> int:
    """Exit code of a run under strace."""
    inject = [x for t in tampering for x in ("-e", t)]
    strace = ("strace", "-f", "-y", "-s", "0", "-o", str(log), "-e", f"trace={CALLS}", *inject)
    return start(folder, prefix=strace).wait(PLENTY)


def calls_on(folder: Path, log: Path) -> Iterator[tuple[str, int, str]]:
    """(system call, its number among those of its kind and thread, arguments) on a folder."""
    seen: dict[tuple[str, str], int] = {}
    for line in log.read_text().splitlines():
        match = re.match(r"(\d+) +(\w+)\((.*)", line)
        if match is None:
            continue
        key = match[1], match[2]
        seen[key] = seen.get(key, 0) + 1
        if any(f"{folder}{end}" in match[3] for end in ("/", ">", '"')):
            yield match[2], seen[key], match[3]


def faults(
    bench: Bench, what: str, fault: str, chosen: Callable[[str, str], bool], most: int
) -> Tally:
    """A fault at every chosen call on the run folder, or at so many spread evenly over them."""
    tally = Tally(what)
    folder, log = bench.place / "faulty", bench.place / "log"
    plans = {}
    for occupied in (False, True):
        assert traced(bench.fresh(folder, occupied=occupied), log) == 0
        plans[occupied] = [c for c in calls_on(folder, log) if chosen(c[0], c[2])]
    count = len(plans[False])
    picked = sorted({int(i * max(1.0, count / most)) for i in range(min(count, most))})
    for number, index in enumerate(picked):
        occupied = number % 2 == 1
        name, ordinal, _ = plans[occupied][min(index, len(plans[occupied]) - 1)]
        bench.fresh(folder, occupied=occupied)
        code = traced(folder, log, f"inject={name}:{fault}:when={ordinal}")
        bench.judge(tally, folder, code, occupied=occupied)
    tally.what += f" ({len(picked)} of {count} calls)"
    return tally


def fault_trials(bench: Bench, most: int) -> Iterator[Tally]:
    """Faults at all calls on the checkpoint, and at so many of the others on the folder."""

    def checkpoint(name: str, where: str) -> bool:
        return "checkpoint" in where

    def writing(name: str, where: str) -> bool:
        return name in WRITES and "O_RDONLY" not in where

    def writing_checkpoint(name: str, where: str) -> bool:
        return checkpoint(name, where) and writing(name, where)

    kill, full = "signal=KILL", "error=ENOSPC"
    yield faults(bench, "SIGKILL at a call on the checkpoint", kill, checkpoint, 10 * most)
    yield faults(bench, "no space at a call on the checkpoint", full, writing_checkpoint, 10 * most)
    yield faults(bench, "SIGKILL at a call on the folder", kill, lambda name, where: True, most)
    yield faults(bench, "no space at a call on the folder", full, writing, most)


# --- full disks ---------------------------------------------------------------------------------


@contextlib.contextmanager
def small_file_system(place: Path, size: int) -> Iterator[bool]:
    """A file system of so many bytes; False where mounting is not allowed."""
    place.mkdir(exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
    mounted = subprocess.run(command, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", str(place)], check=True)


def full_disks(bench: Bench, count: int) -> Tally:
    """Runs on a small file system, with a little more room from trial to trial."""
    tally = Tally("file system fills up")
    need = int(1.1 * bench.bytes)  # a finished run; the next is written beside it
    place = bench.place / "small"
    with small_file_system(place, 4 * need) as mounted:
        if not mounted:
            return Tally("file system fills up (mounting not allowed here)")
        for i in range(count):
            folder = bench.fresh(place / "run", occupied=i % 2 == 1)
            ballast = place / "ballast"
            free = os.statvfs(place).f_bavail * os.statvfs(place).f_frsize
            with ballast.open("wb") as file:
                room = int(need * (i + 0.5) / count)
                os.posix_fallocate(file.fileno(), 0, max(free - room, 1))
            code = start(folder).wait(PLENTY)
            ballast.unlink()
            bench.judge(tally, folder, code, occupied=i % 2 == 1)
    return tally


def file_size_limits(bench: Bench, count: int) -> Tally:
    """Runs that may not write a file beyond a size, as under a quota."""
    tally = Tally("a file may not grow beyond a limit")
    for i in range(count):
        folder = bench.fresh(bench.place / "limited", occupied=i % 2 == 1)
        size = int(bench.largest * 1.1 * ((i + 0.5) / count) ** 2)
        code = start(folder, limit=size).wait(PLENTY)
        bench.judge(tally, folder, code, occupied=i % 2 == 1)
    return tally


def main() -> int:
    """Run the trials; exit code 1 when anything was lost."""
    arguments = parser(__doc__)
    arguments.add_argument("--kills", type=int, default=100)
    arguments.add_argument("--calls", type=int, default=24, help="most calls on the folder")
    arguments.add_argument("--disks", type=int, default=100)
    options = options_of(arguments)
    kills, disks = (1, 1) if options.quick else (options.kills, options.disks)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a file beyond its limit is an error, no signal
    with tempfile.TemporaryDirectory() as place:
        bench = Bench(Path(place))
        tallies = [random_kills(bench, kills, seed=1)]
        tallies += [full_disks(bench, disks), file_size_limits(bench, -(-disks // 4))]
        if shutil.which("strace") and not options.quick:
            tallies += fault_trials(bench, options.calls)
    table = pd.DataFrame(map(asdict, tallies))
    table["problems"] = ["; ".join(sorted(set(t.problems))[:3]) for t in tallies]
    print_table("crashes", table)
    return int(any(t.identical != t.trials or t.problems for t in tallies))
