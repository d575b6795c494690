"""The formats of testing machines, and the selection of data from an export."""

from __future__ import annotations

from dataclasses import dataclass

from biaxbayes.errors import InputError
from biaxbayes.options import Options, option
from biaxbayes.tables.units import STRAINS, units_of

BRANCHES = ("loading", "unloading", "both")
STRETCH_SOURCES = ("auto", "tracked", "rake")
GAUGE_AT = ("zero", "start")
DIRECTIONS = ("x", "y", "xy")
GAUGE_RANGE_MM: dict[str, float] = {"minimum": 0.01, "maximum": 1e4}
"""Possible gauge lengths, mm."""


@dataclass(frozen=True)
class Format:
    """Text for the help, and the options of ``biaxbayes convert`` that only this format takes."""

    description: str
    options: tuple[str, ...] = ()


FORMATS = {
    "biotester": Format("exports of a CellScale BioTester", ("--set", "--stretch-from")),
    "generic": Format("any table, by a map of its columns", ("--columns",)),
}
"""Formats by the name that ``--machine`` takes, which is that of their module."""


@dataclass(frozen=True)
class Choice(Options):
    """Selection of data from a raw file, as the options of :func:`biaxbayes.convert`."""

    machine: str
    columns: tuple[str, ...] = option(
        (),
        "generic: stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,... Targets are stretch_x, _y, "
        "force_x_N, piola_x_kPa, cauchy_x_kPa (and _y), time_s, protocol, cycle, shear_xy, "
        "shear_yx. Units and kinds of strain are read from the column's name where it is clear, or "
        "given behind a colon: "
        f"{units_of('force', 'stress', 'length', 'displacement', *STRAINS, 'time')}.",
        metavar="TARGET=COLUMN[:UNIT],...",
    )
    gauge_x_mm: float | None = option(
        None,
        "Length between marks or grips in x where the displacement is zero.",
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
    cycle: str = option("last", "Cycle to take.", metavar="last|N")
    branch: str = option("loading", choices=BRANCHES)
    stretch_from: str = option(
        "auto",
        "biotester: points tracked on the tissue, or the distance of the rakes.",
        choices=STRETCH_SOURCES,
    )
    sets: tuple[str, ...] = option(
        (),
        "biotester: sets to take as protocols (default: the last).",
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
    drop_missing: bool = option(
        False, "Leave out rows in which a reading is missing, and count them."
    )

    def __post_init__(self) -> None:
        if self.machine not in FORMATS:
            raise InputError(f"machine must be one of {', '.join(FORMATS)}, not {self.machine!r}")
        super().__post_init__()
