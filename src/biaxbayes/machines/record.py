"""All rows of one table, converted, and the loading paths and lines that are taken from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments import Experiment
from biaxbayes.machines.cycles import Cycle, peak_change, ratio_name


@dataclass(frozen=True, eq=False)
class Record:
    """All rows of one table (of one set of it), converted; NaN where a row is not read."""

    name: str  # of the sheet or set; empty for a table that is alone
    path: Path
    lines: np.ndarray  # of the file, or rows of the sheet, from 1
    stretch: np.ndarray  # (n, 2), as measured: at rest it need not be one
    load: np.ndarray  # (n, 2), N or kPa
    time_s: np.ndarray | None
    gradient: np.ndarray | None  # (n, 2, 2), if the file has its off-diagonal components
    columns: tuple[str, ...]  # raw columns of stretch x, y and load x, y
    experiment: Experiment
    loads: str  # their name among those of the experiment
    cycles: dict[str, list[Cycle]]  # by protocol; of one without a name if the file names none
    reasons: np.ndarray  # why each row was left out; empty for a row that was not
    notes: tuple[str, ...]  # how the file was read
    assumptions: tuple[str, ...]  # of stretches and loads; written into the specimen file

    def axes_of(self, rows: np.ndarray) -> tuple[int, ...]:
        """Directions that are pulled in some rows."""
        return self.experiment.pulled(self.load[rows])

    def pulled(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stretch and load (rows, directions) in the directions that are pulled."""
        axes = self.axes_of(rows)
        return self.stretch[rows][:, axes], self.load[rows][:, axes]

    def load_named(self, axis: int) -> str:
        """What the load of a direction is called."""
        curve = self.experiment.curves[axis]
        return f"load in {curve}" if curve in ("x", "y") else curve

    @property
    def source(self) -> str:
        """File, and sheet or set in it."""
        return self.path.name + (f", {self.name}" if self.name else "")

    @property
    def units(self) -> tuple[str, str]:
        """Units of both loads."""
        return self.experiment.loads[self.loads].units

    def load_text(self, axis: int, load: float, digits: int = 4) -> str:
        """A load with its unit."""
        return f"{load:.{digits}g} {self.units[axis]}"

    def loads_text(self, load: np.ndarray, digits: int) -> str:
        """Loads of the directions that were read, with their unit."""
        texts = [self.load_text(k, load[k], digits) for k in (0, 1) if self.columns[2 + k]]
        if len(set(self.units)) == 1:
            texts[:-1] = [text.removesuffix(f" {self.units[0]}") for text in texts[:-1]]
        return ", ".join(texts)

    def stretches_text(self, stretch: Sequence[float] | np.ndarray, form: str) -> str:
        """Stretches that were measured."""
        return ", ".join(format(stretch[k], form) for k in (0, 1) if self.columns[k])

    def leave_out(self, rows: np.ndarray, reason: str) -> None:
        """Note why rows are left out, unless another reason is known."""
        self.reasons[rows[self.reasons[rows] == ""]] = reason

    def shown(self, rows: np.ndarray) -> str:
        """Number, ratio and peaks of some rows, for a question."""
        stretch, load = self.stretch[rows], self.load[rows]
        peaks, loads = stretch.max(axis=0), self.loads_text(load.max(axis=0), 3)
        top = int(np.abs(stretch - stretch[0]).sum(axis=1).argmax())
        ratio = ratio_name(peak_change(self.stretch, rows[: top + 1]))
        to = self.stretches_text(peaks, ".4g")
        return f"{rows.size} rows, {ratio}, stretch to {to}, load to {loads}"


@dataclass(frozen=True, eq=False)
class Recording:
    """One loading path of a record."""

    name: str  # of the protocol
    record: Record
    rows: np.ndarray  # of the record, in the order of the path
    cycle: str | None = None  # such as "6 of 6"; None for a protocol of one cycle
    branch: str = "loading"
    notes: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    @property
    def stretch(self) -> np.ndarray:
        """Stretches as measured, shape (n, 2)."""
        return self.record.stretch[self.rows]

    @property
    def load(self) -> np.ndarray:
        """Loads, shape (n, 2)."""
        return self.record.load[self.rows]

    @property
    def axes(self) -> tuple[int, ...]:
        """Directions that are pulled."""
        return self.record.axes_of(self.rows)

    @property
    def time_s(self) -> np.ndarray | None:
        """Times; none of a path that was reversed."""
        time = self.record.time_s
        return None if time is None or self.branch == "unloading" else time[self.rows]

    @property
    def lines(self) -> np.ndarray:
        """Lines of the file."""
        return self.record.lines[self.rows]


def outside(lines: np.ndarray, wanted: str | None, file: object) -> np.ndarray:
    """A reason for each line outside ``12:480`` or ``2:30,32:61``, empty for the others."""
    if wanted in (None, "all"):
        return np.full(lines.size, "", dtype=object)
    inside = np.zeros(lines.size, dtype=bool)
    for part in str(wanted).split(","):
        first, colon, last = part.strip().partition(":")
        if not (colon and first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
            problem = f"`rows`: {part.strip()[:40]!r} is not of the form 12:480"
            remedy = "give first and last line of the file, several ranges with commas, or all"
            raise InputError(problem, remedy=remedy)
        inside |= (lines >= int(first)) & (lines <= int(last))
    if inside.sum() < 2:
        problem = f"`rows` {str(wanted)[:40]} leaves {inside.sum()} rows"
        remedy = f"the table is in lines {lines[0]} to {lines[-1]}"
        raise InputError(problem, file=file, remedy=remedy)
    return np.where(inside, "", "not in the rows that were asked for").astype(object)


def ranges_without(lines: np.ndarray, rows: np.ndarray) -> str:
    """The value of ``rows`` that keeps all lines but those of some rows."""
    kept = np.ones(lines.size, dtype=bool)
    kept[rows] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    return ",".join(f"{lines[a]}:{lines[b - 1]}" for a, b in edges.reshape(-1, 2))
