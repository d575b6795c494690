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
    process = subprocess.Popen(
        [*PROGRAM, *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | {"MPLBACKEND": "Agg"} | (environment or {}),
    )
    assert process.stderr is not None
    told = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - clock
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(arguments)}: {told.decode()[-300:]}")
    return Command(" ".join(arguments), seconds, usage.ru_maxrss / 1024.0, {})


def _sample(data: Path, name: str, folder: Path, **options) -> Command:
    run = f"{name}-posterior"
    found = _timed(
        "sample", str(data / f"{name}.csv"), "--out", run, "--quiet", folder=folder, **options
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
