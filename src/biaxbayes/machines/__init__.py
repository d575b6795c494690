"""Machine exports to specimens: a machine's format is one module, named in one line here.

The module ``machines/NAME.py`` of a format holds its reader,

    recordings(table: Table, choice: Choice, gauge: Gauge) -> list[Recording]
    is_other_table(table: Table, choice: Choice) -> bool

The first takes from a table of text what was chosen
(:class:`~biaxbayes.machines.choice.Choice`): one recording per protocol, in N or kPa and with
stretches as measured. The second says whether a sheet beside others is another table altogether.
"""

from __future__ import annotations

from dataclasses import dataclass

BRANCHES = ("loading", "unloading", "both")
STRETCH_SOURCES = ("auto", "tracked", "rake")
GAUGE_AT = ("zero", "start")
DIRECTIONS = ("x", "y", "xy")


@dataclass(frozen=True)
class Format:
    """What is said of a format before its module is imported.

    Attributes
    ----------
    words : str
        What it reads, for help.
    options : tuple of str
        Options of ``biaxbayes convert`` that are its own; another format refuses them.
    """

    words: str
    options: tuple[str, ...] = ()


FORMATS = {
    "biotester": Format("exports of a CellScale BioTester", ("--set", "--stretch-from")),
    "generic": Format("any table, by a map of its columns", ("--columns",)),
}
"""Formats by the name that ``--machine`` takes, which is that of their module."""
