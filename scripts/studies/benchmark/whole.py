"""Wall time and memory of whole commands, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Command", "whole_commands"]

PROGRAM = (sys.executable, "-c", "from biaxbayes.cli import main; main()")
LAYERS = ("donor2-intima", "donor2-media", "donor2-adventitia")


@dataclass(frozen=True)
class Command:
    """One command, timed.

    Attributes
    ----------
    seconds : float
        Wall time, from the start of the process to its end.
    peak_MB : float
        Largest resident memory.
    parts : dict
        Wall time of each phase, where the command tells.
    """

    text: str
    seconds: float
    peak_MB: float
    parts: dict[str, float]


def _timed(*arguments: str, folder: Path, environment: dict[str, str] | None = None) -> Command:
    clock = time.perf_counter()
    with tempfile.TemporaryFile() as told:
        process = subprocess.Popen(
            [*PROGRAM, *arguments],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=told,
            env=os.environ | {"MPLBACKEND": "Agg"} | (environment or {}),
        )
        peak = 0.0
        while process.poll() is None:
            peak = max(peak, _peak_MB(process.pid))
            time.sleep(0.02)
        seconds = time.perf_counter() - clock
        if process.returncode != 0:
            told.seek(0)
            raise RuntimeError(f"{' '.join(arguments)}: {told.read().decode()[-300:]}")
    return Command(" ".join(arguments), seconds, peak, {})


def _peak_MB(pid: int) -> float:
    """Largest resident memory of a process so far.

    Not the one that ``wait4`` tells: that counts the parent's pages at the fork.
    """
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    line = next((x for x in text.splitlines() if x.startswith("VmHWM")), "VmHWM: 0 kB")
    return float(line.split()[1]) / 1024.0


def _sample(data: Path, name: str, folder: Path, **options) -> Command:
    run = f"{name}-posterior"
    found = _timed(
        "sample",
        str(data / f"{name}.csv"),
        "--out",
        run,
        "--overwrite",
        "--quiet",
        folder=folder,
        **options,
    )
    told = json.loads((folder / run / "provenance.json").read_text())["seconds"]
    parts = {k: told[k] for k in ("fit", "compile", "warm-up", "sampling") if k in told}
    # what comes before the fit of the sampler: reading, the fit behind n_eff
    parts["reading and n_eff"] = told["before output"] - sum(parts.values())
    parts["output"] = told["total"] - told["before output"]
    parts["imports"] = found.seconds - told["total"]
    return Command(f"sample {name}.csv", found.seconds, found.peak_MB, parts)


def whole_commands(data: Path, *, cold: bool) -> list[Command]:
    """``sample`` with a cold and a warm compile cache, ``compare``, ``report`` and ``export``."""
    data = data.resolve()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        found = []
        if cold:
            cache = {"NUMBA_CACHE_DIR": str(folder / "cache")}
            first = _sample(data, "donor2-media", folder, environment=cache)
            found.append(
                Command(
                    f"{first.text}, first run (compiles)",
                    first.seconds,
                    first.peak_MB,
                    first.parts,
                )
            )
        for name in LAYERS:
            _sample(data, name, folder)
        found.append(_sample(data, "donor2-media", folder))
        runs = [f"{name}-posterior" for name in LAYERS]
        others = (
            ("compare three runs", ("compare", *runs, "--out", "layers")),
            ("report", ("report", runs[1])),
            ("export 200 draws to Abaqus", ("export", runs[1], "--to", "abaqus", "--draws", "200")),
        )
        for text, arguments in others:
            timed = _timed(*arguments, folder=folder)
            found.append(Command(text, timed.seconds, timed.peak_MB, {}))
    return found
