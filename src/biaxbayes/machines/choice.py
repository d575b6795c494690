"""The formats of testing machines, and the selection of data from an export."""

from __future__ import annotations

from dataclasses import dataclass

from biaxbayes.errors import InputError

BRANCHES = ("loading", "unloading", "both")
STRETCH_SOURCES = ("auto", "tracked", "rake")
GAUGE_AT = ("zero", "start")
DIRECTIONS = ("x", "y", "xy")


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
class Choice:
    """Selection of data from a raw file.

    Attributes
    ----------
    machine : str
        One of :data:`FORMATS`.
    columns : tuple of str
        ``target=column[:unit]`` texts of the generic machine.
    cycle : str
        ``last`` or a number.
    branch : {"loading", "unloading", "both"}
    stretch_from : {"auto", "tracked", "rake"}
        Source of the stretches of a BioTester.
    sets : tuple of str
        Sets of a BioTester; by default the last.
    sheets : tuple of str
        Sheets of a workbook, one or more protocols each; ``all`` for every one with a table.
    gauge_x_mm, gauge_y_mm : float, optional
        Length between the marks or grips at displacement zero.
    gauge_at : {"", "zero", "start"}
        The gauge length is that at displacement zero, or in the first row of the file; needed if
        these differ.
    drop_missing : bool
        Leave out rows with a missing reading, which are refused otherwise.
    tension_negative : {"", "x", "y", "xy"}
        Directions whose load cell reads tension as negative.
    """

    machine: str
    columns: tuple[str, ...] = ()
    cycle: str = "last"
    branch: str = "loading"
    stretch_from: str = "auto"
    sets: tuple[str, ...] = ()
    sheets: tuple[str, ...] = ()
    gauge_x_mm: float | None = None
    gauge_y_mm: float | None = None
    gauge_at: str = ""
    drop_missing: bool = False
    tension_negative: str = ""

    def __post_init__(self) -> None:
        for name, allowed in (
            ("machine", tuple(FORMATS)),
            ("branch", BRANCHES),
            ("stretch_from", STRETCH_SOURCES),
            ("gauge_at", ("", *GAUGE_AT)),
            ("tension_negative", ("", *DIRECTIONS)),
        ):
            value = getattr(self, name)
            if value not in allowed:
                raise InputError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")
        for axis in "xy":
            length = getattr(self, f"gauge_{axis}_mm")
            if length is not None and not 0.01 <= length <= 10_000.0:
                raise InputError(
                    f"a gauge length of {length:g} mm in {axis} is out of range",
                    remedy=f"give `gauge_{axis}_mm` in mm, between 0.01 and 10000",
                )
