"""The ways in which a run ends badly, each tried many times."""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from studies.crashes.bench import Bench, Tally, ended, start

__all__ = ["can_trace", "faults", "file_size_limits", "full_disks", "random_kills"]

CALLS = "openat,write,pwrite64,fsync,fdatasync,ftruncate,rename,renameat,renameat2,unlink,mkdir"
WRITES = ("write", "pwrite64", "fsync", "openat", "mkdir", "rename")


def random_kills(bench: Bench, what: str, count: int, seed: int) -> Tally:
    """SIGKILL at random moments, spread evenly over the length of a run, until so many met one."""
    tally = Tally(what)
    rng = random.Random(seed)
    while tally.ended_badly < count and tally.trials < 2 * count + 3:
        i = tally.trials
        occupied = i % 2 == 1
        folder = bench.fresh(bench.place / "killed", occupied=occupied)
        moment = bench.seconds * (i % count + rng.random()) / count
        child = start(folder, "--workers", str(1 + i // 2 % 2))
        time.sleep(moment)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        bench.judge(tally, folder, ended(child), occupied=occupied)
    return tally


def traced(folder: Path, log: Path, *tampering: str) -> int:
    """A run under strace, attached before it does anything."""
    # With one worker every call on the folder comes from the main thread, in the same order.
    child = start(folder, "--workers", "1", before=lambda: os.kill(os.getpid(), signal.SIGSTOP))
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


def calls(log: Path) -> list[tuple[str, str, str]]:
    """(thread, system call, arguments) of every line of a log."""
    found = []
    for line in log.read_text().splitlines():
        match = re.match(r"(\d+) +(\w+)\((.*)", line)
        if match is not None:
            found.append((match[1], match[2], match[3]))
    return found


def calls_on_folder(bench: Bench, *, occupied: bool) -> list[tuple[str, int, str]]:
    """(system call, its number among those of its kind, arguments) of calls on the run folder."""
    folder = bench.fresh(bench.place / "faulty", occupied=occupied)
    log = bench.place / "log"
    assert traced(folder, log) == 0
    seen: dict[tuple[str, str], int] = {}
    found = []
    for thread, name, arguments in calls(log):
        # strace counts the calls of every thread apart.
        seen[thread, name] = seen.get((thread, name), 0) + 1
        if _on(folder, arguments):
            found.append((name, seen[thread, name], arguments))
    return found


def _on(folder: Path, arguments: str) -> bool:
    return any(f"{folder}{end}" in arguments for end in ("/", ">", '"'))


def faults(
    bench: Bench, what: str, fault: str, chosen: Callable[[str, str], bool], most: int
) -> Tally:
    """A fault at every chosen call on the run folder, or at so many spread evenly over them."""
    tally = Tally(what)
    plans = {
        o: [c for c in calls_on_folder(bench, occupied=o) if chosen(c[0], c[2])]
        for o in (False, True)
    }
    step = max(1.0, len(plans[False]) / most)
    picked = sorted({int(i * step) for i in range(int(len(plans[False]) / step))})
    for number, index in enumerate(picked):
        occupied = number % 2 == 1
        name, ordinal, meant = plans[occupied][min(index, len(plans[occupied]) - 1)]
        folder = bench.fresh(bench.place / "faulty", occupied=occupied)
        log = bench.place / "log"
        code = traced(folder, log, f"inject={name}:{fault}:when={ordinal}")
        met = [a for _, n, a in calls(log) if n == name and "INJECTED" in a] or [
            a for _, n, a in calls(log)[-1:] if n == name
        ]
        if not met or not _on(folder, met[0]):
            tally.problems.append(f"the fault missed {name} {meant[:60]}")
        bench.judge(tally, folder, code, occupied=occupied)
    tally.what += f" ({len(picked)} of {len(plans[False])} calls)"
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
    # A finished run, the files of the next beside it, and what is half-written.
    need = int(1.1 * bench.bytes)
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
