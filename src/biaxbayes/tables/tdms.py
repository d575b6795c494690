"""LabVIEW measurements (.tdms) through npTDMS: a group is a sheet, a channel a column."""

from __future__ import annotations

import io
from itertools import zip_longest
from pathlib import Path

from biaxbayes.tables.sheets import MAX_CELLS, Sheet, sheet_from, too_large


def sheets(raw: bytes, path: Path) -> dict[str, Sheet]:
    """All groups of a TDMS file."""
    import nptdms

    groups = nptdms.TdmsFile.read_metadata(io.BytesIO(raw)).groups()
    if sum(len(channel) for group in groups for channel in group.channels()) > MAX_CELLS:
        raise too_large(f"holds more than {MAX_CELLS:,} readings", path)
    by_name = {}
    for group in nptdms.TdmsFile.read(io.BytesIO(raw)).groups():
        channels = [channel for channel in group.channels() if len(channel)]
        names = [channel.name for channel in channels]
        units = [str(channel.properties.get("unit_string", "")) for channel in channels]
        rows = zip_longest(*(channel[:].tolist() for channel in channels), fillvalue="")
        head = [names, units] if any(units) else [names]
        by_name[group.name] = sheet_from([*head, *map(list, rows)], f"group {group.name}")
    return by_name
