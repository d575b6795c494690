"""The formats of testing machines, and the selection of data from an export."""

from __future__ import annotations

from dataclasses import dataclass

from biaxbayes.errors import InputError
from biaxbayes.mechanics.experiments import TESTS
from biaxbayes.options import Options, option
from biaxbayes.tables.units import STRAINS, units_of

BRANCHES = ("loading", "unloading", "both")
STRETCH_SOURCES = ("auto", "tracked", "rake")
PROTOCOLS_BY = ("ratio", "load-ratio", "none")
GAUGE_AT = ("zero", "start")
DIRECTIONS = ("x", "y", "xy")
GAUGE_RANGE_MM: dict[str, float] = {"minimum": 0.01, "maximum": 1e4}
"""Possible gauge lengths, mm."""


@dataclass(frozen=True)
class Format:
    """Text for the help, and the fields of :class:`Choice` that only this format takes."""

    description: str
    options: tuple[str, ...] = ()


FORMATS = {
    "biotester": Format("exports of a CellScale BioTester", ("sets", "stretch_from")),
    "generic": Format(
        "any table, by a map of its columns", ("columns", "test", "gauge_x_mm", "gauge_y_mm")
    ),
}
"""Formats by the name that ``--machine`` takes, which is that of their module."""


def cycle_number(value: str | int | None) -> str | None:
    """``last``, ``all`` or a number without zeros before it; InputError for anything else."""
    text = value if value is None else str(value)
    if text in (None, "last", "all"):
        return text
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) > 0):
        problem = f"`cycles` {text[:20]!r} is not a cycle"
        raise InputError(problem, remedy="give a number, 'last' or 'all'")
    return str(int(text))


@dataclass(frozen=True)
class Choice(Options):
    """Selection of data from a raw file, as the options of :func:`biaxbayes.convert`."""

    machine: str
    columns: tuple[str, ...] = option(
        (),
        "generic: stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,... Targets are stretch_x, _y, "
        "force_x_N, piola_x_kPa, cauchy_x_kPa (and _y), time_s, protocol, cycle, shear_xy, "
        "shear_yx (F12, F21: then stretches are F11, F22), of a tube outer_diameter_mm, length_mm "
        "or stretch_z, pressure_kPa, axial_force_N, and ignore for a column of labels that "
        "separates nothing. A column may be given by its position, as #3; A+B adds the "
        "displacements of opposite actuators. Units and kinds of strain are read from the column's "
        "name where it is clear, or given behind a colon: "
        f"{units_of('force', 'stress', 'length', 'displacement', *STRAINS, 'time')}.",
        metavar="TARGET=COLUMN[:UNIT],...",
    )
    test: str | None = option(
        None,
        "generic: kind of test; a strip has columns of its direction alone (the other stretch "
        "where its width was measured), a tube those named above.",
        choices=TESTS,
    )
    gauge_x_mm: float | None = option(
        None,
        "generic: length between marks or grips in x where the displacement is zero.",
        kind=float,
        metavar="MM",
        **GAUGE_RANGE_MM,
    )
    gauge_y_mm: float | None = option(
        None, "The same in y.", kind=float, metavar="MM", **GAUGE_RANGE_MM
    )
    gauge_at: str | None = option(
        None,
        "Where the gauge length was measured if the displacement does not start at zero: at "
        "displacement zero, or at the first row of the file.",
        choices=GAUGE_AT,
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
        "peak of each cycle, or nothing (none: all cycles are of one protocol).",
        metavar="COLUMN|ratio|load-ratio|none",
    )
    repeats: str | None = option(
        None,
        "Files, sheets or sets of the same stretch ratio are protocols, or cycles of one.",
        choices=("protocols", "cycles"),
    )
    cycles: str | int | None = option(
        None,
        "Cycle of each protocol to take; all: each a protocol of its own.",
        metavar="last|all|N",
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
        choices=STRETCH_SOURCES,
    )
    sets: tuple[str, ...] = option(
        (),
        "biotester: sets to take, a protocol each; repeatable.",
        metavar="NAME|all",
        flag="set",
    )
    sheets: tuple[str, ...] = option(
        (),
        "Sheet of a workbook (struct of a .mat, group of a .tdms file), a protocol each; "
        "repeatable.",
        metavar="NAME|all",
        flag="sheet",
    )
    tension_negative: str | None = option(
        None,
        "Directions whose load cell counts tension negative: their sign is reversed.",
        choices=DIRECTIONS,
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
    def separating_column(self) -> str | None:
        """The column that separates protocols, if one does."""
        return None if self.protocols_by in (None, *PROTOCOLS_BY) else self.protocols_by

    @property
    def signs(self) -> tuple[float, float]:
        """Factors of the loads in x and y."""
        x, y = (-1.0 if axis in (self.tension_negative or "") else 1.0 for axis in "xy")
        return x, y

    @property
    def sign_notes(self) -> tuple[str, ...]:
        """What was done to the signs of the loads."""
        axes = " and ".join(self.tension_negative or "")
        return (f"the sign of the load in {axes} is reversed",) if axes else ()

    def __post_init__(self) -> None:
        if self.machine not in FORMATS:
            raise InputError(f"machine must be one of {', '.join(FORMATS)}, not {self.machine!r}")
        for machine, format_ in FORMATS.items():
            given = [n for n in format_.options if getattr(self, n) != getattr(Choice, n)]
            if given and machine != self.machine:
                raise InputError(f"`{given[0]}` is for `machine={machine}`", remedy="leave it out")
        super().__post_init__()
