"""LabVIEW measurements (.tdms) through npTDMS: a group is a sheet, a channel a column."""

from __future__ import annotations

from itertools import zip_longest
from pathlib import Path

from biaxbayes.tables.worksheet import Worksheet, sheet_from


def sheets(path: Path) -> dict[str, Worksheet]:
    """All groups of a TDMS file."""
    import nptdms

    by_name = {}
    for group in nptdms.TdmsFile.read(path).groups():
        channels = [channel for channel in group.channels() if len(channel)]
        names = [channel.name for channel in channels]
        units = [str(channel.properties.get("unit_string", "")) for channel in channels]
        rows = zip_longest(*(channel[:].tolist() for channel in channels), fillvalue="")
        head = [names, units] if any(units) else [names]
        by_name[group.name] = sheet_from([*head, *map(list, rows)], f"group {group.name}")
    return by_name
