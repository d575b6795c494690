"""Whether the header and the table of a specimen file belong together."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.columns import STRETCHES
from biaxbayes.specimens.header import Header
from biaxbayes.specimens.plausibility import check_load, check_stretch, check_time
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.specimens.table import Table

__all__ = ["check_keys", "check_numbers", "stress_pair_of"]

SECTION_EDGES = ("edge_y_mm", "edge_x_mm")
"""The force in x acts on edge_y x thickness."""


def stress_pair_of(table: Table, path: Path) -> str:
    """The one stress pair of a table, with both its columns."""
    present = [
        pair for pair, columns in STRESS_PAIRS.items() if any(c in table.columns for c in columns)
    ]
    row = table.names_line
    if not present:
        raise InputError(
            "no stress pair",
            file=path,
            row=row,
            remedy="give force_x_N and force_y_N, or piola_x_kPa and piola_y_kPa, "
            "or cauchy_x_kPa and cauchy_y_kPa",
        )
    if len(present) > 1:
        raise InputError(
            f"more than one stress pair ({', '.join(present)})",
            file=path,
            row=row,
            remedy="keep the one that was measured",
        )
    for column in STRESS_PAIRS[present[0]]:
        if column not in table.columns:
            raise InputError(
                "missing column", file=path, row=row, column=column, remedy="give both directions"
            )
    return present[0]


def check_keys(header: Header, stress_pair: str, path: Path) -> None:
    """Refuse a force file without dimensions, and noise in the unit of another pair."""
    if stress_pair == "force":
        for key in ("edge_x_mm", "edge_y_mm", "thickness_mm", "geometry"):
            if key not in header:
                raise InputError(
                    f"a force file must state {key}",
                    file=path,
                    remedy=f"add a line '# {key}: ...' at the top",
                )
    wrong, right = ("kPa", "N") if stress_pair == "force" else ("N", "kPa")
    for key in (f"load_noise_{wrong}", f"load_offset_sd_{wrong}"):
        if key in header:
            raise InputError(
                f"{key} does not fit the file's columns",
                file=path,
                row=header.rows[key],
                remedy=f"give it in {right}",
            )


def check_numbers(table: Table, header: Header, stress_pair: str, path: Path) -> None:
    """Refuse numbers that cannot be what their column and the header say."""
    for column in STRETCHES:
        check_stretch(table.columns[column], table.lines, column, path)
        if np.ptp(table.columns[column]) == 0.0:
            raise InputError(
                "the stretch never changes",
                file=path,
                row=int(table.lines[0]),
                column=column,
                remedy="at least one protocol has to stretch this direction",
            )
    if "time_s" in table.columns:
        check_time(table.columns["time_s"], table.lines, "time_s", path)
    peak = 0.0
    for column, edge in zip(STRESS_PAIRS[stress_pair], SECTION_EDGES, strict=True):
        section = None
        if stress_pair == "force":
            section = float(header.values[edge]) * float(header.values["thickness_mm"])
        check_load(
            table.columns[column],
            table.lines,
            column,
            path,
            section_mm2=section,
            limit_kPa=header.number("stress_limit_kPa"),
        )
        peak = max(peak, float(np.abs(table.columns[column]).max()))
    key = "load_noise_N" if stress_pair == "force" else "load_noise_kPa"
    noise = header.number(key)
    if noise is not None and noise > peak:
        raise InputError(
            f"{key} of {noise:g} exceeds every load in the file (at most {peak:.4g})",
            file=path,
            row=header.rows[key],
            remedy=f"give the standard deviation of one reading in {key.rsplit('_', 1)[1]}",
        )
