"""What became of every row of an export, as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biaxbayes.machines.conversion import Conversion
from biaxbayes.machines.record import Record
from biaxbayes.tables.table import in_lines
from biaxbayes.text_files import aligned


def account(conversion: Conversion) -> list[str]:
    """Rows read, kept by protocol and left out by reason; columns and units as understood."""
    lines, records = [], conversion.records
    common = [n for n in records[0].notes if all(n in record.notes for record in records)]
    for record in records:
        lines.append(f"{record.source}: {record.lines.size} rows read")
        lines += [f"  {line}" for line in aligned(_rows_of(record, conversion), right=(1,))]
        lines += [f"  {note}" for note in record.notes if note not in common]
    notes = [note for r in conversion.recordings for note in r.notes]
    assumed = str(conversion.specimen.metadata.get("conversion", "")).split("; ")
    return [*lines, *filter(None, dict.fromkeys([*common, *notes, *assumed]))]


def _rows_of(record: Record, conversion: Conversion) -> list[Sequence[str]]:
    """Rows kept and left out, with their number, lines and peaks or reason."""
    table: list[Sequence[str]] = []
    left = np.ones(record.lines.size, dtype=bool)
    for r, p in zip(conversion.recordings, conversion.specimen.protocols, strict=True):
        if r.record is not record:
            continue
        left[r.rows] = False
        side = "reversed unloading" if r.branch == "unloading" else r.branch
        cycle = f", cycle {r.cycle}" if r.cycle else ""
        reference = f"reference {record.stretches_text(p.reference, '.4f')} (rows: {p.rest_rows});"
        table.append(
            (
                "kept",
                str(p.rows),
                f"protocol {p.name}{cycle}, {side}:",
                f"lines {in_lines(r.lines)};",
                reference if p.rest_rows else "",
                f"largest stretch {record.stretches_text(p.stretch.max(axis=0), '.4f')},",
                f"load {record.loads_text(p.recorded_load.max(axis=0), 4)}",
            )
        )
    for reason in dict.fromkeys(record.reasons[left].tolist()):
        lines = record.lines[left & (record.reasons == reason)]
        table.append(("left out", str(lines.size), f"{reason}:", f"lines {in_lines(lines)}"))
    return table
