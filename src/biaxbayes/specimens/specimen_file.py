"""The specimen CSV: ``# key: value`` lines, then columns; read with named errors, written whole."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.header import (
    GEOMETRIES,
    METADATA_KEYS,
    Header,
    measured_stretch,
    read_header,
)
from biaxbayes.specimens.plausibility import STRESS_LIMIT_KPA, check_load, check_stretch, check_time
from biaxbayes.specimens.specimen import (
    STRESS_PAIRS,
    Protocol,
    Specimen,
    referenced_protocol,
    rest_rows,
)
from biaxbayes.specimens.table import STRETCHES, Table, read_table
from biaxbayes.text_files import atomic_write_text, one_line, read_lines, rows_text

__all__ = [
    "STRESS_LIMIT_KPA",
    "check_keys",
    "check_numbers",
    "measured_stretch",
    "parse_specimen",
    "read_specimen",
    "specimen_text",
    "stress_pair_of",
    "write_specimen",
]


# --- whether header and table belong together ----------------------------------------------------


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
                values = "|".join(GEOMETRIES) if key == "geometry" else "..."
                state = ", the state that dimensions refer to" if key == "geometry" else ""
                raise InputError(
                    f"a force file must state {key}",
                    file=path,
                    remedy=f"add a line '# {key}: {values}' at the top{state}",
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


# --- reading and writing -------------------------------------------------------------------------


def read_specimen(path: str | os.PathLike) -> Specimen:
    """Read a specimen CSV.

    Parameters
    ----------
    path : path-like
        UTF-8 text: header lines ``# key: value``, one line of column names, then numbers.

    Returns
    -------
    Specimen
        Re-referenced so that each protocol starts at stretch 1; ``notes`` says when it was not.

    Raises
    ------
    InputError
        With file, row, column and remedy.
    """
    path = Path(path)
    return parse_specimen(read_lines(path), path)


def parse_specimen(lines: Sequence[str], path: Path) -> Specimen:
    """A specimen from the lines of its file; ``path`` serves messages and the default name.

    Raises
    ------
    InputError
        As :func:`read_specimen`.
    """
    header, first = read_header(lines, path)
    table = read_table(lines, first, path)
    stress_pair = stress_pair_of(table, path)
    check_keys(header, stress_pair, path)
    check_numbers(table, header, stress_pair, path)
    protocols, notes = _protocols(table, header, stress_pair, path)
    unit = "N" if stress_pair == "force" else "kPa"
    return Specimen(
        name=one_line(header.text("specimen") or path.stem),
        protocols=protocols,
        stress_pair=stress_pair,
        geometry=header.text("geometry") or "unloaded",
        edge_x_mm=header.number("edge_x_mm"),
        edge_y_mm=header.number("edge_y_mm"),
        thickness_mm=header.number("thickness_mm"),
        load_noise=header.number(f"load_noise_{unit}"),
        layer=header.text("layer"),
        axis_x=header.text("axis_x"),
        axis_y=header.text("axis_y"),
        metadata={key: header.values[key] for key in METADATA_KEYS if key in header},
        notes=notes,
    )


def write_specimen(specimen: Specimen, path: str | os.PathLike) -> None:
    """Write a specimen CSV that :func:`read_specimen` reads back equal.

    The file appears under its name only when it is complete.

    Parameters
    ----------
    specimen : Specimen
    path : path-like

    Raises
    ------
    InputError
        If two protocols have the same name, or the file cannot be written.
    """
    atomic_write_text(Path(path), specimen_text(specimen))


def specimen_text(specimen: Specimen) -> str:
    """Text of a specimen file; numbers are written with the digits that read back the same.

    Raises
    ------
    InputError
        If two protocols have the same name, or a metadata key is unknown.
    """
    _check_writable(specimen)
    keys: dict[str, object] = {
        "specimen": specimen.name,
        "layer": specimen.layer,
        "axis_x": specimen.axis_x,
        "axis_y": specimen.axis_y,
        "geometry": specimen.geometry,
        "edge_x_mm": specimen.edge_x_mm,
        "edge_y_mm": specimen.edge_y_mm,
        "thickness_mm": specimen.thickness_mm,
        f"load_noise_{specimen.unit}": specimen.load_noise,
        **specimen.metadata,
    }
    stated = [p.rest_rows for p in specimen.protocols]
    if stated != [rest_rows(p.stretch_x, p.stretch_y) for p in specimen.protocols]:
        keys["rest_rows"] = ", ".join(map(str, stated))
    lines = []
    for key, value in keys.items():
        if value is not None and value != "":
            text = repr(float(value)) if isinstance(value, float) else one_line(str(value))
            lines.append(f"# {key}: {text}\n")
    return "".join(lines) + rows_text(_rows(specimen))


def _check_writable(specimen: Specimen) -> None:
    for key in specimen.metadata:
        if key not in METADATA_KEYS:
            raise InputError(
                f"metadata key {key[:40]!r} has no place in a specimen file",
                remedy=f"known keys are {', '.join(METADATA_KEYS)}",
            )
    names = [one_line(p.name) for p in specimen.protocols]
    for name in names:
        if not name or names.count(name) > 1:
            raise InputError(
                f"protocol name {name[:40]!r} is empty or there twice",
                remedy="give each protocol a name of its own",
            )


def _rows(specimen: Specimen) -> Iterator[Sequence]:
    """Column names, and the rows of all protocols."""
    named = len(specimen.protocols) > 1 or specimen.protocols[0].name != "1"
    timed = specimen.protocols[0].time_s is not None
    yield [
        *(["protocol"] if named else []),
        *(["time_s"] if timed else []),
        *STRETCHES,
        *STRESS_PAIRS[specimen.stress_pair],
    ]
    for p in specimen.protocols:
        columns: list[Sequence] = [[one_line(p.name)] * p.rows] if named else []
        curves = (p.time_s, p.stretch_x, p.stretch_y, p.load_x, p.load_y)
        columns += [curve.tolist() for curve in curves if curve is not None]
        yield from zip(*columns, strict=True)


def _protocols(
    table: Table, header: Header, stress_pair: str, path: Path
) -> tuple[tuple[Protocol, ...], tuple[str, ...]]:
    stated = header.rest_rows
    count = len(table.groups)
    if stated is not None and len(stated) not in (1, count):
        raise InputError(
            f"rest_rows states {len(stated)} numbers where the protocols are {count}",
            file=path,
            row=header.rows["rest_rows"],
            remedy="give one for all protocols, or one each",
        )
    protocols, notes = [], []
    for index, (name, rows) in enumerate(table.groups):
        resting = None if stated is None else stated[index % len(stated)]
        if resting is not None and resting >= rows.stop - rows.start:
            raise InputError(
                f"rest_rows of {resting} leaves no stretched row in protocol {name[:40]!r}",
                file=path,
                row=header.rows["rest_rows"],
                remedy="rest_rows counts the leading rows recorded before the test starts",
            )
        stretch = table.pair(STRETCHES, rows)
        if np.all(stretch == stretch[0]):
            raise InputError(
                f"the stretch never changes in protocol {name[:40]!r}",
                file=path,
                row=int(table.lines[rows.start]),
                column="stretch_x",
                remedy="nothing was tested; remove it",
            )
        time = table.columns["time_s"][rows] if "time_s" in table.columns else None
        load = table.pair(STRESS_PAIRS[stress_pair], rows)
        protocol = referenced_protocol(name, stretch, load, stress_pair, time, resting)
        if np.any(np.abs(np.array(protocol.reference) - 1.0) > 1e-9):
            for column, values in zip(
                STRETCHES, (protocol.stretch_x, protocol.stretch_y), strict=True
            ):
                check_stretch(values, table.lines[rows], column, path)
            notes.append(
                f"protocol {name}: stretches divided by their value at rest "
                f"({protocol.reference[0]:.5f}, {protocol.reference[1]:.5f}), "
                "so that the test starts at 1"
            )
        protocols.append(protocol)
    return tuple(protocols), tuple(notes)
