"""Kill, starve and lock out ``biaxbayes sample``, and count what is lost.

    OMP_NUM_THREADS=1 python scripts/study_crashes.py --write docs/robustness.md

Every trial starts a run in a process of its own and ends it badly: by SIGKILL at a random moment,
by SIGKILL or a full disk at one particular system call on the run folder (with strace, where it
may be used), or on a file system that has too little room. Then the same command runs again with
``--resume``, and posterior.nc and every CSV are compared with those of a run left alone. Half of
the trials start in the folder of a finished run, which must stay readable, as it was or replaced.

Processes are forked from one that has imported everything, so that a trial takes two seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import pkgutil
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

import biaxbayes
from biaxbayes.cli import main as biaxbayes_main
from biaxbayes.errors import BiaxbayesError
from biaxbayes.inference import checkpoint
from biaxbayes.output import run_products
from biaxbayes.output.report import page
from biaxbayes.output.run import open_run

for module in pkgutil.walk_packages(biaxbayes.__path__, "biaxbayes."):
    if ".commands.sample" in module.name or ".output." in module.name:
        importlib.import_module(module.name)

SPECIMEN = Path(__file__).resolve().parent.parent / "data" / "donor2-adventitia.csv"
CALLS = "openat,write,pwrite64,fsync,fdatasync,ftruncate,rename,renameat,renameat2,unlink,mkdir"
WRITES = ("write", "pwrite64", "fsync", "openat", "mkdir", "rename")
SEED = 1
PLENTY = 600.0  # seconds after which a trial counts as hung


@dataclass
class Tally:
    """Trials of one kind, and what went wrong in them."""

    what: str
    trials: int = 0
    ended_badly: int = 0  # the kill or the full disk met a run that was still going
    identical: int = 0
    problems: list[str] = field(default_factory=list)

    def row(self) -> str:
        """Line of the table."""
        wrong = "; ".join(sorted(set(self.problems))[:3]) or "-"
        return f"| {self.what} | {self.trials} | {self.ended_badly} | {self.identical} | {wrong} |"


def start(folder: Path, *options: str, before: Callable[[], None] = lambda: None) -> int:
    """Process id of a run in a forked process; its standard error goes to a file beside it."""
    child = os.fork()
    if child:
        return child
    try:
        log = os.open(f"{folder}.err", os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o644)
        os.dup2(log, 2)
        before()
        biaxbayes_main(
            [
                "sample",
                str(SPECIMEN),
                "--out",
                str(folder),
                "--ess",
                "20000",
                "--quiet",
                "--seed",
                str(SEED),
                *options,
            ]
        )
    except SystemExit as end:
        os._exit(end.code if isinstance(end.code, int) else 1)
    finally:
        os._exit(99)


def ended(child: int) -> int:
    """Exit code of a run, negative for a signal."""
    limit = time.monotonic() + PLENTY
    while time.monotonic() < limit:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -99


def values(folder: Path) -> dict[str, bytes]:
    """Every array of posterior.nc and every CSV, as bytes."""
    out = {p.name: p.read_bytes() for p in folder.glob("*.csv")}
    with h5py.File(folder / "posterior.nc") as file:

        def keep(name: str, item: h5py.HLObject) -> None:
            if isinstance(item, h5py.Dataset):
                out[name] = np.asarray(item[()]).tobytes()

        file.visititems(keep)
    return out


class Bench:
    """Runs left alone, against which the others are held, and a place for those."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.whole = place / "whole"
        self.earlier = place / "earlier"
        # The compiled code is cached before anything is timed.
        assert ended(start(self.earlier, "--seed", str(SEED + 1))) == 0, "the first run failed"
        begun = time.monotonic()
        assert ended(start(self.whole)) == 0, "the second run failed"
        self.seconds = time.monotonic() - begun
        self.values = values(self.whole)
        self.bytes = sum(p.stat().st_size for p in self.whole.iterdir())

    def fresh(self, folder: Path, *, occupied: bool) -> Path:
        """An empty folder for a trial, or one with a finished run of another seed."""
        shutil.rmtree(folder, ignore_errors=True)
        if occupied:
            shutil.copytree(self.earlier, folder)
        return folder

    def judge(self, tally: Tally, folder: Path, code: int, *, occupied: bool) -> None:
        """Look at what a trial left behind, resume it, and compare."""
        tally.trials += 1
        tally.ended_badly += code != 0
        message = Path(f"{folder}.err").read_text()
        if code > 0 and (code != 2 or message.count("\n") != 1 or "Traceback" in message):
            tally.problems.append(f"exit {code}: {message.strip()[-80:]}")
        if occupied:
            try:
                run = open_run(folder)
                written = run.tree.attrs["sampling_seed"], run.summary, run.specimen
                assert written[0] == run.provenance["seed"]
            except (BiaxbayesError, AssertionError) as error:
                tally.problems.append(f"earlier run not readable: {error}")
        resumed = ended(start(folder, *self._again(folder)))
        if resumed != 0:
            why = Path(f"{folder}.err").read_text().strip()[-80:]
            tally.problems.append(f"resume ended with {resumed}: {why}")
        elif values(folder) == self.values and not list(folder.glob(".*")):
            tally.identical += 1
        else:
            tally.problems.append("resumed to other values")

    @staticmethod
    def _again(folder: Path) -> tuple[str, ...]:
        """Resume, unless the earlier run's checkpoint was not yet replaced: then start again."""
        for name in (checkpoint.NAME, checkpoint.PREVIOUS):
            with contextlib.suppress(OSError, checkpoint.DamagedCheckpoint):
                _, identity = checkpoint.unpack((folder / name).read_bytes())
                return ("--resume",) if identity["seed"] == SEED else ()
        return ("--resume",)


def random_kills(bench: Bench, count: int, seed: int) -> Tally:
    """SIGKILL at moments spread evenly over the length of a run."""
    tally = Tally("SIGKILL at a random moment")
    rng = random.Random(seed)
    for i in range(count):
        occupied = i % 2 == 1
        folder = bench.fresh(bench.place / "killed", occupied=occupied)
        child = start(folder, "--workers", str(1 + i // 2 % 2))
        time.sleep(bench.seconds * (i + rng.random()) / count)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        bench.judge(tally, folder, ended(child), occupied=occupied)
    return tally


def traced(folder: Path, log: Path, *tampering: str) -> int:
    """A run under strace, attached before it does anything."""
    child = start(folder, before=lambda: os.kill(os.getpid(), signal.SIGSTOP))
    os.waitpid(child, os.WUNTRACED)
    command = ["strace", "-f", "-y", "-s", "0", "-o", str(log), "-e", f"trace={CALLS}"]
    tracer = subprocess.Popen(
        [*command, *(x for t in tampering for x in ("-e", t)), "-p", str(child)],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert tracer.stderr is not None
    attached = "attached" in tracer.stderr.readline()
    os.kill(child, signal.SIGCONT)
    code = ended(child)
    tracer.stderr.close()
    tracer.wait()
    return code if attached else -98


def can_trace(bench: Bench) -> bool:
    """Whether strace is there and may be used."""
    if shutil.which("strace") is None:
        return False
    return traced(bench.fresh(bench.place / "traced", occupied=False), bench.place / "log") == 0


def calls_on_folder(bench: Bench, *, occupied: bool) -> list[tuple[str, int, str]]:
    """(system call, how many of its kind came before, file) of every call on the run folder."""
    folder = bench.fresh(bench.place / "traced", occupied=occupied)
    log = bench.place / "log"
    assert traced(folder, log) == 0
    seen: dict[str, int] = {}
    found = []
    for line in log.read_text().splitlines():
        match = re.match(r"\d+ +(\w+)\((.*)", line)
        if match is None:
            continue
        name, arguments = match.groups()
        seen[name] = seen.get(name, 0) + 1
        if f"{folder}/" in arguments or f"{folder}>" in arguments or f'{folder}"' in arguments:
            found.append((name, seen[name], arguments))
    return found


def faults(
    bench: Bench, what: str, fault: str, chosen: Callable[[str, str], bool], most: int
) -> Tally:
    """A fault at every chosen call on the run folder, or at so many spread evenly over them."""
    tally = Tally(what)
    plans = {
        o: [c for c in calls_on_folder(bench, occupied=o) if chosen(c[0], c[2])] for o in (0, 1)
    }
    step = max(1.0, len(plans[0]) / most)
    picked = sorted({int(i * step) for i in range(int(len(plans[0]) / step))})
    for number, index in enumerate(picked):
        occupied = number % 2
        name, ordinal, _ = plans[occupied][min(index, len(plans[occupied]) - 1)]
        folder = bench.fresh(bench.place / "faulty", occupied=bool(occupied))
        code = traced(folder, bench.place / "log", f"inject={name}:{fault}:when={ordinal}")
        bench.judge(tally, folder, code, occupied=bool(occupied))
    tally.what += f" ({len(picked)} of {len(plans[0])} calls)"
    return tally


@contextlib.contextmanager
def small_file_system(place: Path, size: int):
    """A file system of so many bytes, or None where mounting is not allowed."""
    place.mkdir(exist_ok=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)], capture_output=True
    )
    try:
        yield place if mounted.returncode == 0 else None
    finally:
        if mounted.returncode == 0:
            subprocess.run(["umount", str(place)], check=True)


def full_disks(bench: Bench, count: int) -> Tally:
    """Runs on a small file system with too little room left, by ever so little less."""
    tally = Tally("file system fills up")
    need = int(1.5 * bench.bytes)
    with small_file_system(bench.place / "small", 4 * need) as place:
        if place is None:
            return Tally("file system fills up (mounting not allowed here)")
        for i in range(count):
            occupied = i % 2 == 1
            folder = bench.fresh(place / "run", occupied=occupied)
            room = int(need * (i + 0.5) / count)
            ballast = place / "ballast"
            free = os.statvfs(place).f_bavail * os.statvfs(place).f_frsize
            with ballast.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, max(free - room, 1))
            code = ended(start(folder))
            ballast.unlink()
            bench.judge(tally, folder, code, occupied=occupied)
            Path(f"{folder}.err").unlink()
    return tally


def file_size_limits(bench: Bench, count: int) -> Tally:
    """Runs that may not write a file beyond a size, as under a quota."""
    tally = Tally("a file may not grow beyond a limit")
    largest = max(p.stat().st_size for p in bench.whole.iterdir())
    for i in range(count):
        occupied = i % 2 == 1
        folder = bench.fresh(bench.place / "limited", occupied=occupied)
        size = int(largest * 1.1 * ((i + 0.5) / count) ** 2)

        def limit(size: int = size) -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

        code = ended(start(folder, before=limit))
        bench.judge(tally, folder, code, occupied=occupied)
    return tally


def study(place: Path, *, kills: int, calls: int, disks: int, seed: int) -> list[Tally]:
    """All trials."""
    bench = Bench(place)
    tallies = [random_kills(bench, kills, seed)] if kills else []
    if calls and can_trace(bench):
        tallies += [
            faults(
                bench,
                "SIGKILL at a call that writes the checkpoint",
                "signal=KILL",
                lambda name, where: "checkpoint" in where,
                calls,
            ),
            faults(
                bench, "SIGKILL at a call on the folder", "signal=KILL", lambda n, w: True, calls
            ),
            faults(
                bench,
                "no space at a call on the folder",
                "error=ENOSPC",
                lambda name, where: name in WRITES and ("O_RDONLY" not in where),
                calls,
            ),
        ]
    if disks:
        tallies += [full_disks(bench, disks), file_size_limits(bench, disks)]
    return tallies


def report(tallies: list[Tally]) -> str:
    """The table as Markdown."""
    head = "| what | trials | ended early | resumed to identical values | problems |\n"
    return head + "|---|---|---|---|---|\n" + "\n".join(t.row() for t in tallies) + "\n"


def main() -> int:
    """Run the study; exit code 1 when anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--calls", type=int, default=80, help="most system calls of a kind")
    parser.add_argument("--disks", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-figures", action="store_true", help="for a quick look")
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    arguments = parser.parse_args()
    if arguments.no_figures:
        run_products.write_products = lambda *a: None
        page.write_report = lambda *a: None
    with tempfile.TemporaryDirectory() as place:
        tallies = study(
            Path(place),
            kills=arguments.kills,
            calls=arguments.calls,
            disks=arguments.disks,
            seed=arguments.seed,
        )
    table = report(tallies)
    print(table)
    if arguments.write:
        text = arguments.write.read_text()
        parts = re.split(r"(<!-- crashes -->\n|<!-- /crashes -->)", text)
        arguments.write.write_text("".join([*parts[:2], table, *parts[3:]]))
    return int(any(t.identical != t.trials or t.problems for t in tallies))


if __name__ == "__main__":
    sys.exit(main())
