"""Long work in a process of its own: it outlives the page, and can be stopped and resumed.

Its verb with arguments, progress, log and lock are in the folder :data:`HIDDEN`.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.progress_bar import Pace, Progress, graceful_stop
from biaxbayes.stored_data import read_object
from biaxbayes.text_files import atomic_write_text

HIDDEN = ".biaxbayes-app"
STOPPABLE = ("sample", "batch", "design")
"""Verbs that end when asked to: the first two with a checkpoint."""
FLAGS = {"sets": "set", "sheets": "sheet"}
PAIRS = ("mounting_force",)
"""Options with another flag than their name, and with several values behind one flag."""
EVERY_SECONDS = 0.3


def command_line(verb: str, arguments: list[Any], options: dict[str, Any]) -> str:
    """The command that does what a verb does with these arguments."""
    words = ["biaxbayes", verb]
    for argument in arguments:
        words += argument if isinstance(argument, list) else [argument]
    for name, value in options.items():
        flag = f"--{FLAGS.get(name, name).replace('_', '-')}"
        for one in value if isinstance(value, list) and name not in PAIRS else [value]:
            several = one if isinstance(one, list) else [] if one is True else [one]
            texts = (f"{v:.10g}" if isinstance(v, float) else str(v) for v in several)
            words += [flag, *texts]
    return shlex.join(words)


@dataclass(frozen=True)
class Job:
    """The work that makes one result of a folder."""

    folder: Path
    name: str  # of the result

    def _file(self, end: str) -> Path:
        return self.folder / HIDDEN / (self.name + end)

    @property
    def asked(self) -> dict[str, Any]:
        """Verb, arguments and options; empty if this result was not asked for here."""
        return read_object(self._file(".json"))

    @property
    def is_running(self) -> bool:
        """Whether the process is alive, whoever started it."""
        return is_locked(self._file(".lock"))

    @property
    def progress(self) -> dict[str, Any]:
        """Phase with time left, and share; how it ended, with the exit code."""
        return {"phase": "", "message": ""} | read_object(self._file(".progress"))

    @property
    def log(self) -> str:
        """The end of the log."""
        path = self._file(".log")
        text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
        return text[-4_000:]

    def start(self, verb: str, arguments: list[Any], options: dict[str, Any]) -> None:
        """Start the work in the folder."""
        if self.is_running:
            raise InputError(f"{self.name!r} is being made", remedy="wait for it, or stop it")
        self._file("").parent.mkdir(exist_ok=True)
        asked = {"verb": verb, "arguments": arguments, "options": options}
        atomic_write_text(self._file(".json"), json.dumps(asked, indent=1))
        self._file(".stop").unlink(missing_ok=True)
        self._write({"phase": "starting"})
        with self._file(".log").open("a", encoding="utf-8") as log:
            command = [sys.executable, "-m", __name__, self.name]
            process = subprocess.Popen(
                command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        while process.poll() is None and not self.is_running:
            time.sleep(0.02)

    def stop(self) -> None:
        """Ask the process to write its checkpoint and end."""
        self._file(".stop").touch()

    def work(self) -> int:
        """Do the work, in the process that :meth:`start` started; returns the exit code."""
        import biaxbayes

        asked = self.asked
        pace, shown, phase = Pace(), 0.0, ""

        def show(progress: Progress) -> None:
            nonlocal shown, phase
            line, now = pace.line(progress), time.monotonic()
            if progress.note:
                print(progress.note, flush=True)
            if progress.phase == phase and now - shown < EVERY_SECONDS:
                return
            shown, phase = now, progress.phase
            self._write({"phase": line, "share": progress.share})

        with FileLock(self._file(".lock")), graceful_stop() as signalled:
            options = dict(asked["options"])
            if asked["verb"] in STOPPABLE:
                options["stop"] = lambda: signalled() or 2 * self._file(".stop").exists()
            try:
                verb = getattr(biaxbayes, asked["verb"])
                result = verb(*asked["arguments"], progress=show, **options)
                code, message = 0, getattr(result, "conclusion", "")
            except BiaxbayesError as error:
                code, message = error.exit_code, getattr(error, "done", str(error))
                print(error, flush=True)
            except BaseException as error:
                code, message = 70, f"internal error: {type(error).__name__}: {error}"
                raise
            finally:
                self._write({"phase": "ended", "code": code, "message": message})
        return code

    def _write(self, progress: dict[str, Any]) -> None:
        atomic_write_text(self._file(".progress"), json.dumps(progress))


def jobs(folder: Path) -> list[Job]:
    """All work that was asked for in a folder, the latest first."""
    asked = (folder / HIDDEN).glob("*.json")
    latest = sorted(asked, key=lambda path: path.stat().st_mtime, reverse=True)
    return [Job(folder, path.stem) for path in latest]


def is_locked(path: Path) -> bool:
    """Whether a process holds a lock."""
    if not path.exists():
        return False
    try:
        with FileLock(path).acquire(timeout=0):
            return False
    except Timeout:
        return True


if __name__ == "__main__":
    sys.exit(Job(Path.cwd(), sys.argv[1]).work())
