"""The formats of testing machines, and the selection of data from an export."""

from __future__ import annotations

from dataclasses import dataclass

from biaxbayes.errors import InputError
from biaxbayes.experiments import EXPERIMENTS, Experiment
from biaxbayes.machines.columns import targets_of
from biaxbayes.options import Options, option
from biaxbayes.tables.expressions import FIRST, FUNCTIONS
from biaxbayes.tables.units import units_of

BRANCHES = ("loading", "unloading", "both")
OF_OTHER_TESTS = ", ".join(
    f"of a {test.name} {', '.join(t for t in targets_of(test.name) if t not in targets_of(None))}"
    for test in EXPERIMENTS.values()
    if not set(targets_of(test.name)) <= set(targets_of(None))
)
"""What is read from tests that are not planar."""
FORMATS = {"biotester": "exports of a CellScale BioTester", "generic": "any table, by its columns"}
"""Formats by the name that ``--machine`` takes, which is that of their module."""
OF_ONE_FORMAT = {"biotester": ("sets", "stretch_from"), "generic": ("join", "blocks")}
"""Fields of :class:`Choice` that only one format takes."""


def cycle_number(value: str | int | None) -> str | None:
    """``last``, ``all``, or numbers as ``2,4,6``; InputError for anything else."""
    text = value if value is None else str(value)
    if text in (None, "last", "all"):
        return text
    numbers = [number.strip() for number in text.split(",")]
    if not all(n.isascii() and n.isdigit() and len(n) < 10 and int(n) > 0 for n in numbers):
        problem = f"`cycles` {text[:20]!r} is not a cycle"
        raise InputError(problem, remedy="give numbers such as 2,4,6, 'last' or 'all'")
    return ",".join(dict.fromkeys(str(int(n)) for n in numbers))


@dataclass(frozen=True)
class Choice(Options):
    """Selection of data from a raw file, as the options of :func:`biaxbayes.convert`."""

    machine: str
    columns: tuple[str, ...] = option(
        (),
        "What each target is read from: a column by its name, as force_x_N=Fx [mN], in the unit of "
        "its name or of Fx:mN, or an expression with columns in braces, as stretch_x=1 + {Disp X "
        f"(mm)}} / 20.6, with + - * / ** ( ), {', '.join([*FUNCTIONS, FIRST])} ({FIRST}: value in "
        "the first row) and header keys such as edge_x_mm, which is in the target's unit. Targets: "
        "stretch_x, force_x_N, piola_x_kPa, cauchy_x_kPa (and _y), time_s, stretch_time_s, "
        "protocol, cycle, shear_xy, shear_yx (F12, F21: then stretches are F11, F22), "
        f"{OF_OTHER_TESTS} (pole tension: pressure times radius of curvature over twice the "
        "thickness), and ignore for a column of labels that separates nothing. {#3} and #3 are the "
        "third column; in names of columns that stand side by side, * stands for the name of the "
        "protocol. "
        "Units: "
        f"{units_of('force', 'stress', 'length', 'time')}. Repeatable.",
        metavar="TARGET=SOURCE,...",
    )
    test: str | None = option(
        None,
        "Kind of test; a strip has columns of its direction alone (the other stretch "
        "where its width was measured), the others those named above.",
        choices=tuple(EXPERIMENTS),
    )
    rows: str | None = option(
        None,
        "Lines of the file to take, both ends included; all: every row, whatever it looks like.",
        metavar="FIRST:LAST,...|all",
    )
    specimen_by: str | None = option(
        None,
        "Column that names the specimen of each row; --specimen chooses one of them.",
        metavar="COLUMN",
    )
    protocols_by: str | None = option(
        None,
        "What separates protocols: a column, the ratio of the stretches or of the loads at the "
        "peak of each cycle, the level at which the other direction is held, or nothing (none: "
        "all cycles are of one protocol).",
        metavar="COLUMN|ratio|load-ratio|level|none",
    )
    join: str | None = option(
        None,
        "How columns of their own time or length belong together, in one table, two sheets or two "
        "files: time (stretches, at stretch_time_s, are interpolated at the loads' time_s), "
        "stretch (curves of one ratio: each load over the stretch of its direction), or rows.",
        choices=("time", "stretch", "rows"),
    )
    blocks: str | None = option(
        None,
        "What lines that repeat the column names begin: a protocol, a cycle, or nothing (one "
        "record).",
        choices=("protocols", "cycles", "record"),
    )
    repeats: str | None = option(
        None,
        "Files, sheets or sets of the same stretch ratio are protocols, or cycles of one.",
        choices=("protocols", "cycles"),
    )
    cycles: str | int | None = option(
        None,
        "Cycle of each protocol to take; several: each a protocol of its own.",
        metavar="last|all|N,...",
        read=cycle_number,
    )
    branch: str | None = option(None, "Side of a cycle to take.", choices=BRANCHES)
    still: str | None = option(
        None,
        "Where the stretch repeats while the load goes on: take the first row of each step (a "
        "slower camera), the last (relaxed states), or all rows.",
        choices=("first", "last", "all"),
    )
    stretch_from: str = option(
        "auto",
        "biotester: points tracked on the tissue, or the distance of the rakes.",
        choices=("auto", "tracked", "rake"),
    )
    sets: tuple[str, ...] = option(
        (), "biotester: sets to take, a protocol each; repeatable.", metavar="NAME|all", flag="set"
    )
    sheets: tuple[str, ...] = option(
        (),
        "Sheet of a workbook (struct of a .mat, group of a .tdms file), a protocol each; "
        "repeatable.",
        metavar="NAME|all",
        flag="sheet",
    )
    fill_labels: bool = option(
        False, "A label holds for the empty cells below it, as in merged cells."
    )
    hidden: str | None = option(
        None,
        "Whether hidden or filtered rows, and hidden sheets, of an .xlsx are taken.",
        choices=("keep", "drop"),
    )
    drop_missing: bool = option(
        False, "Leave out rows in which a reading is missing, and count them."
    )

    specimen: str | None = None
    """Specimen to take where ``specimen_by`` names several; its name in the header."""

    @property
    def experiment(self) -> Experiment:
        """The kind of test; a biaxial one if none is stated."""
        return EXPERIMENTS[self.test or "biaxial"]

    def __post_init__(self) -> None:
        if self.machine not in FORMATS:
            raise InputError(f"machine must be one of {', '.join(FORMATS)}, not {self.machine!r}")
        for machine, names in OF_ONE_FORMAT.items():
            given = [n for n in names if getattr(self, n) != getattr(Choice, n)]
            if given and machine != self.machine:
                raise InputError(f"`{given[0]}` is for `machine={machine}`", remedy="leave it out")
        super().__post_init__()
