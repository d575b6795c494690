"""The specimen CSV: ``# key: value`` lines, then columns; errors name file, row and column."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.mechanics.experiments import MMHG_PER_KPA
from biaxbayes.specimens.keys import (
    ARGUMENT_KEYS,
    DIMENSIONS,
    GRIP_DETAILS,
    KEYS,
    METADATA_KEYS,
    NO_GRIPS,
    NOT_OF_TUBES,
    TUBE_COLUMNS,
    checked_value,
    directions_of,
    needed_with_forces,
)
from biaxbayes.specimens.plausibility import check_readings
from biaxbayes.specimens.protocol import AUTO_REST_ROWS, CURVES, Protocol, ReadingError
from biaxbayes.specimens.specimen import STRESS_PAIRS, Specimen
from biaxbayes.specimens.table import STRETCHES, SpecimenTable, read_table
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import as_path, atomic_write_text, cells_of, one_line, read_lines

KEYS_PAGE = "docs/specimen-file.md lists all keys; "
MOUNTED_STATE = ("mounted_state_x", "mounted_state_y")
"""Measured stretch of the mounted state, in a record with one common reference."""


def read_header(lines: Sequence[str], path: Path) -> tuple[dict[str, Any], dict[str, int], int]:
    """Values of the header and their lines, by key; index of the line with the column names."""
    values: dict[str, Any] = {}
    rows: dict[str, int] = {}
    for row, line in enumerate(lines, start=1):
        stripped = line.strip()
        # spreadsheets quote header lines and append separators
        if stripped.startswith('"#'):
            stripped = cells_of(stripped)[0].strip()
        if stripped.endswith(",,"):
            stripped = stripped.rstrip(",").rstrip()
        if not stripped:
            continue
        if not stripped.startswith("#"):
            return values, rows, row - 1
        key, colon, value = stripped.lstrip("#").partition(":")
        if not colon:
            continue  # a plain comment
        key, value = key.strip(), one_line(value)
        if key in values:
            problem = f"header key {key!r} appears twice"
            raise InputError(problem, file=path, row=row, remedy="keep one")
        if key not in KEYS:
            _, hint = likely_name(key, KEYS)
            raise InputError(
                f"unknown header key {key[:60]!r}",
                file=path,
                row=row,
                remedy=f"{hint or KEYS_PAGE}drop the colon for a plain comment",
            )
        if value:
            try:
                values[key] = checked_value(key, value)
            except InputError as error:
                problem, remedy = error.problem, error.remedy
                raise InputError(problem, file=path, row=row, remedy=remedy) from None
            rows[key] = row
    remedy = "give a line of column names (stretch_x,stretch_y,force_x_N,force_y_N) and rows"
    raise InputError("the file has no table", file=path, remedy=remedy)


# --- reading -------------------------------------------------------------------------------------


def read_specimen(path: str | os.PathLike) -> Specimen:
    """Read a specimen CSV.

    Parameters
    ----------
    path : path-like
        UTF-8 text: header lines ``# key: value``, one line of column names, then numbers.

    Returns
    -------
    Specimen
        Re-referenced so that each protocol starts at stretch 1; ``notes`` lists the changes.

    Raises
    ------
    InputError
        With file, row, column and remedy.
    """
    path = as_path(path, "specimen")
    return parse_specimen(read_lines(path), path)


def parse_specimen(lines: Sequence[str], path: Path) -> Specimen:
    """A specimen from the lines of its file; ``path`` serves messages and the default name."""
    values, rows, first = read_header(lines, path)
    test = values.get("test", "biaxial")
    directions, is_tube = directions_of(test), test == "tube"
    table = read_table(
        lines,
        first,
        path,
        needed=() if is_tube else tuple(f"stretch_{axis}" for axis in directions),
        drop_missing=values.get("missing_rows") == "drop",
    )
    table, written = _without_tube_columns(table, values, is_tube)
    stress_pair = _stress_pair(table, directions)
    unit = "N" if stress_pair == "force" else "kPa"
    _check_keys(values, rows, stress_pair, path)
    arguments: dict[str, Any] = {key: values.get(key) for key in ARGUMENT_KEYS}
    try:
        specimen = Specimen(
            name=values.get("specimen") or one_line(path.stem),
            protocols=_protocols(table, values, rows, stress_pair, path),
            stress_pair=stress_pair,
            geometry=values.get("geometry", "unloaded"),
            test=test,
            load_noise=values.get(f"load_noise_{unit}"),
            metadata={key: values[key] for key in METADATA_KEYS if key in values},
            **arguments,
        )
        check_readings(specimen)
    except ReadingError as error:
        # by line of the header, or by row and column of the table
        key = f"load_noise_{unit}" if error.argument == "load_noise" else error.argument
        if error.index is None and key in values:
            raise InputError(error.fault, file=path, row=rows[key], remedy=error.remedy) from None
        standard = zip(CURVES, (*STRETCHES, *STRESS_PAIRS[stress_pair]), strict=True)
        columns = {argument: written.get(name, name) for argument, name in standard}
        of_protocol = dict(table.groups).get(error.protocol or "", slice(None))
        where = columns | {"time_s": "time_s"}
        raise error.at(path, table.lines[of_protocol], where) from None
    notes = [
        f"protocol {p.name}: stretches divided by their value at rest "
        f"({p.reference[0]:.5f}, {p.reference[1]:.5f}), so that the test starts at 1"
        for p in specimen.protocols
        if max(abs(value - 1.0) for value in p.reference) > 1e-9
    ]
    return replace(specimen, notes=(*table.notes, *notes))


def _without_tube_columns(
    table: SpecimenTable, values: Mapping[str, Any], is_tube: bool
) -> tuple[SpecimenTable, dict[str, str]]:
    """The table with stretches and kPa in place of what a tube's file has; names as written."""
    columns, written = dict(table.columns), dict[str, str]()
    of_tube = [name for name in (*TUBE_COLUMNS, *STRESS_PAIRS["tube"]) if name in columns]
    if not is_tube:
        if of_tube:
            problem = "is a column of tubes"
            remedy = "state '# test: tube' at the top, or leave it out"
            raise table.error(problem, remedy, of_tube[0])
        return table, {}
    for name, (standard, key) in TUBE_COLUMNS.items():
        if name not in columns:
            continue
        if standard in columns:
            other = written.get(standard, standard)
            raise table.error(f"says the same as {other}", "keep one of them", name)
        if key and key not in values:
            raise table.error(f"needs the {key}", f"add a line '# {key}: ...' at the top", name)
        divisor = values[key] if key else MMHG_PER_KPA if name == "pressure_mmHg" else 1.0
        columns[standard], written[standard] = columns.pop(name) / divisor, name
    for standard, names in (
        ("stretch_x", "outer_diameter_mm"),
        ("stretch_y", "stretch_z, or length_mm"),
        ("pressure_kPa", "pressure_kPa, or pressure_mmHg"),
    ):
        if standard not in columns:
            raise table.error("missing column", f"a tube needs {names}", names.partition(",")[0])
    if not columns.get("axial_force_N", np.ones(1)).any():
        remedy = "leave out a force that was not read"
        raise table.error("every value is zero", remedy, "axial_force_N")
    return replace(table, columns=columns), written


def _stress_pair(table: SpecimenTable, directions: str) -> str:
    """The one stress pair of a table, with its columns in the directions of the test."""
    present = [
        pair for pair, columns in STRESS_PAIRS.items() if any(c in table.columns for c in columns)
    ]
    if not present:
        of_sheets = (pair for name, pair in STRESS_PAIRS.items() if name != "tube")
        pairs = ", or ".join(" and ".join(columns) for columns in of_sheets)
        raise table.error("no stress pair", f"give {pairs}")
    if len(present) > 1:
        problem = f"more than one stress pair ({', '.join(present)})"
        raise table.error(problem, "keep the measured one")
    for axis, column in zip("xy", STRESS_PAIRS[present[0]], strict=True):
        if axis in directions and column not in (*table.columns, "axial_force_N"):
            remedy = "give both directions, or '# test: strip x' (or y) at the top for a strip"
            raise table.error("missing column", remedy, column)
    return present[0]


def _check_keys(
    values: Mapping[str, Any], rows: Mapping[str, int], stress_pair: str, path: Path
) -> None:
    """Refuse keys that are missing with forces, or do not fit the others or the columns."""
    for key in needed_with_forces(values.get("test")) if stress_pair == "force" else ():
        if key not in values:
            line = f"add a line '# {key}: ...' at the top"
            if key == "geometry":
                line = (
                    line.replace("...", "unloaded|mounted") + ", the state that dimensions refer to"
                )
            raise InputError(f"a force file must state {key}", file=path, remedy=line)
    wrong, right = ("kPa", "N") if stress_pair == "force" else ("N", "kPa")
    unit = ("does not fit the file's columns", f"give it in {right}")
    unfit = {f"load_noise_{wrong}": unit, f"load_offset_sd_{wrong}": unit}
    if values.get("reference") != "common":
        line = "add a line '# reference: common', or leave it out"
        unfit |= dict.fromkeys(MOUNTED_STATE, ("needs one common reference", line))
    if values.get("grips", NO_GRIPS) == NO_GRIPS:
        line = "add a line such as '# grips: hooks 5', or leave it out"
        unfit |= dict.fromkeys(GRIP_DETAILS, ("needs the key grips", line))
    if stress_pair == "tube":
        unfit = dict.fromkeys(NOT_OF_TUBES, ("does not belong to a tube", "leave it out"))
        unfit["load_noise_N"] = ("is not of a tube", "give axial_force_noise_N, load_noise_kPa")
    for key, (problem, remedy) in unfit.items():
        if key in values:
            raise InputError(f"{key} {problem}", file=path, row=rows[key], remedy=remedy)


def _protocols(
    table: SpecimenTable,
    values: Mapping[str, Any],
    lines: Mapping[str, int],
    stress_pair: str,
    path: Path,
) -> tuple[Protocol, ...]:
    """The protocols of a table, relative to the mounted state if the header gives one."""
    resting = [int(part) for part in values.get("rest_rows", str(AUTO_REST_ROWS)).split(",")]
    count = len(table.groups)
    if len(resting) not in (1, count):
        problem = f"rest_rows has {len(resting)} values for {count} protocol{'s' * (count != 1)}"
        remedy = "give one for all protocols, or one per protocol"
        raise InputError(problem, file=path, row=lines["rest_rows"], remedy=remedy)
    mounted = [values.get(key, 1.0) for key in MOUNTED_STATE]
    protocols = []
    for index, (name, rows) in enumerate(table.groups):
        at_rest = 0 if stress_pair == "tube" else resting[index % len(resting)]
        time = table.columns["time_s"][rows] if "time_s" in table.columns else None
        # across a strip the stretch may be unknown, and the load is zero
        missing = dict.fromkeys(STRETCHES, np.nan) | dict.fromkeys(STRESS_PAIRS[stress_pair], 0.0)
        x, y, load_x, load_y = (
            table.columns.get(column, np.full(len(table.lines), value))[rows]
            for column, value in missing.items()
        )
        protocol = Protocol(name, x, y, load_x, load_y, time, at_rest)
        protocols.append(protocol.divided_by(mounted, stress_pair))
    return tuple(protocols)


# --- writing -------------------------------------------------------------------------------------


def write_specimen(specimen: Specimen, path: str | os.PathLike) -> None:
    """Write a specimen CSV that :func:`read_specimen` reads back equal.

    Parameters
    ----------
    specimen : Specimen
        Its protocols must have different names.
    path : path-like
        Written completely or not at all.

    Raises
    ------
    InputError
        If two protocols have the same name, or the file cannot be written.
    """
    atomic_write_text(Path(path), specimen_text(specimen))


def specimen_text(specimen: Specimen, recorded: Sequence[Protocol] | None = None) -> str:
    """Text of a specimen file with all digits of the numbers.

    ``recorded``: protocols before their stretches were divided, to be written in place of those
    of the specimen, so that a reader sees where each started.
    """
    names = [one_line(p.name) for p in specimen.protocols]
    for name in names:
        if not name or names.count(name) > 1:
            raise InputError(
                f"protocol name {name[:40]!r} is empty or duplicated",
                remedy="give each protocol a name of its own",
            )
    protocols = specimen.protocols if recorded is None else recorded
    keys: dict[str, object] = {
        "specimen": specimen.name,
        "test": specimen.test if specimen.test != "biaxial" else None,
        **{key: getattr(specimen, key) for key in ("layer", "axis_x", "axis_y", "geometry")},
        **{key: getattr(specimen, key) for key in DIMENSIONS},
        f"load_noise_{specimen.unit}": specimen.load_noise,
        "reference": specimen.reference,
        **specimen.metadata,
    }
    common = specimen.reference == "common"
    counted = [replace(p, rest_rows=AUTO_REST_ROWS) for p in protocols]
    given, automatic = (
        [(p.with_common_reference() if common else p).rest_rows for p in variant]
        for variant in (protocols, counted)
    )
    if given != automatic and specimen.experiment.is_mounted:
        keys["rest_rows"] = ", ".join(map(str, given))
    header = ""
    for key, value in keys.items():
        if value is not None and value != "":
            text = repr(float(value)) if isinstance(value, float) else one_line(str(value))
            header += f"# {key}: {text}\n"
    first, axes = protocols[0], specimen.experiment.axes
    named = len(protocols) > 1 or first.name != "1"
    # columns of a strip: those along it, and its other stretch where that was measured
    is_written = {
        "protocol": named,
        "time_s": first.time_s is not None,
        **dict(zip(STRETCHES, np.isfinite(first.stretch[0]), strict=True)),
        **{name: k in axes for k, name in enumerate(STRESS_PAIRS[specimen.stress_pair])},
    }
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(compress(is_written, is_written.values()))
    for p in protocols:
        curves = [[one_line(p.name)] * p.rows, p.time_s, *(getattr(p, key) for key in CURVES)]
        kept = compress(curves, is_written.values())
        writer.writerows(zip(*(np.asarray(curve).tolist() for curve in kept), strict=True))
    return header + table.getvalue()
