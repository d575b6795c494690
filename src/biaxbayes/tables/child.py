"""Typed files, read in a child process with limited memory: a workbook may unpack to gigabytes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from biaxbayes.errors import InputError
from biaxbayes.tables.worksheet import MAX_CELLS, Worksheet

MEMORY_BYTES = 1_000_000_000
SECONDS = 120
MAX_LETTERS = 200_000_000


class Reader(NamedTuple):
    """A module of this package that reads a kind of file, by an installed package."""

    module: str
    kind: str
    package: str


def read_in_child(path: Path, reader: Reader) -> dict[str, Worksheet]:
    """Sheets of a file by name, as the reader's module finds them in a process of its own."""
    package = str(Path(__file__).parents[2])
    more = os.environ.get("PYTHONPATH")
    settings = os.environ | {
        "PYTHONPATH": package if not more else os.pathsep.join((more, package)),
        "PYTHONIOENCODING": "utf-8",
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
    }
    command = [sys.executable, "-m", __name__, reader.module, str(path), str(os.getpid())]
    too_large = InputError(
        f"takes more than {MEMORY_BYTES / 1e9:g} GB of memory or {SECONDS} s to read",
        file=path,
        remedy="save the rows of the test as CSV",
    )
    try:
        done = subprocess.run(
            command, env=settings, capture_output=True, timeout=2 * SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        raise too_large from None
    if done.returncode:
        raise too_large
    answer = json.loads(done.stdout)
    if "sheets" in answer:
        return {name: Worksheet(**sheet) for name, sheet in answer["sheets"].items()}
    problem, remedy = answer["problem"], answer["remedy"]
    if answer["kind"] == "MemoryError":
        raise too_large
    if answer["kind"] == "ImportError":
        problem = f"is a {reader.kind}, and {reader.package} is not installed"
        remedy = "pip install 'biaxbayes[tables]', or save the table as CSV"
    elif answer["kind"] != "InputError":
        # a damaged file fails in many ways
        problem = f"is not a readable {reader.kind} ({answer['kind']})"
        remedy = "save it again, or the table as CSV"
    raise InputError(problem, file=path, remedy=remedy)


def _answer(module: str, path: Path) -> dict[str, object]:
    """What the child prints: the sheets, or why there are none."""
    try:
        sheets = import_module(f"biaxbayes.tables.{module}").sheets(path)
        letters = [len(cell) for s in sheets.values() for row in s.rows for cell in row]
        if len(letters) > MAX_CELLS or sum(letters) > MAX_LETTERS:
            raise MemoryError
        return {"sheets": {name: asdict(sheet) for name, sheet in sheets.items()}}
    except InputError as error:
        return {"kind": "InputError", "problem": error.problem, "remedy": error.remedy}
    except BaseException as error:  # a panic of Rust is one
        kinds = (ImportError, MemoryError)
        kind = next((k for k in kinds if isinstance(error, k)), type(error))
        return {"kind": kind.__name__, "problem": "", "remedy": None}


def _end_with(parent: int) -> None:
    """End this process when its parent has ended, in whatever way; Windows has the time limit."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with, args=(int(sys.argv[3]),), daemon=True).start()
    with contextlib.suppress(ImportError, OSError, ValueError):  # not every platform can limit
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    json.dump(_answer(sys.argv[1], Path(sys.argv[2])), sys.stdout)
