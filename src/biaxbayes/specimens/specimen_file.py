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

from biaxbayes.errors import InputError, ReadingError
from biaxbayes.experiments import BIAXIAL, EXPERIMENTS, Experiment
from biaxbayes.experiments.experiment import DIMENSIONS, Loads
from biaxbayes.specimens.keys import (
    ARGUMENT_KEYS,
    GRIP_DETAILS,
    KEYS,
    METADATA_KEYS,
    MOUNTED_STATE,
    NO_GRIPS,
    STRETCHES,
    checked_value,
    keys_of_others,
)
from biaxbayes.specimens.plausibility import check_readings
from biaxbayes.specimens.protocol import AUTO_REST_ROWS, CURVES, Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.table import SpecimenTable, read_table
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import as_path, atomic_write_text, cells_of, one_line, read_lines


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
            hint = likely_name(key, KEYS)[1] or "docs/specimen-file.md lists all keys; "
            remedy = f"{hint}drop the colon for a plain comment"
            raise InputError(f"unknown header key {key[:60]!r}", file=path, row=row, remedy=remedy)
        if value:
            try:
                values[key] = checked_value(key, value)
            except InputError as error:
                fault = error.problem
                raise InputError(fault, file=path, row=row, remedy=error.remedy) from None
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
    test = EXPERIMENTS[values.get("test", BIAXIAL.name)]
    table, written = _read(lines, first, path, values, test)
    loads = _loads(table, test)
    kind = test.loads[loads]
    noise_key = f"load_noise_{kind.units[0]}"
    _check_keys(table, values, rows, test, loads)
    try:
        protocols = _protocols(table, values, test, kind)
        changes = [
            f"protocol {p.name}: stretches divided by their value at rest "
            f"({p.reference[0]:.5f}, {p.reference[1]:.5f}), so that the test starts at 1"
            for p in protocols
            if max(abs(value - 1.0) for value in p.reference) > 1e-9
        ]
        specimen = Specimen(
            name=values.get("specimen") or one_line(path.stem),
            protocols=protocols,
            loads=loads,
            geometry=values.get("geometry", "unloaded"),
            test=test.name,
            load_noise=values.get(noise_key),
            metadata={key: values[key] for key in METADATA_KEYS if key in values},
            notes=(*table.notes, *changes),
            **{key: values.get(key) for key in ARGUMENT_KEYS},  # type: ignore[arg-type]
        )
        check_readings(specimen)
    except ReadingError as error:
        # by line of the header, or by row and column of the table
        key = noise_key if error.argument == "load_noise" else error.argument
        if error.index is None and key in values:
            raise InputError(error.fault, file=path, row=rows[key], remedy=error.remedy) from None
        standard = zip(CURVES, (*STRETCHES, *kind.columns), strict=True)
        columns = {argument: written.get(name, name) for argument, name in standard}
        of_protocol = dict(table.groups).get(error.protocol or "", slice(None))
        raise error.at(path, table.lines[of_protocol], columns | {"time_s": "time_s"}) from None
    return specimen


def _read(
    lines: Sequence[str], first: int, path: Path, values: Mapping[str, Any], test: Experiment
) -> tuple[SpecimenTable, dict[str, str]]:
    """The table with stretches and loads in place of what stands for them; names as written."""
    standing = {
        stretch: [name for name, column in test.columns.items() if stretch in column.stands_for]
        for k, stretch in enumerate(STRETCHES)
        if k != test.free_side
    }
    needed = tuple(stretch for stretch, names in standing.items() if not names)
    drop = values.get("missing_rows") == "drop"
    table = read_table(lines, first, path, needed, drop_missing=drop)
    columns, written = table.columns, dict[str, str]()
    for name in columns:
        of_tests = [other.name for other in EXPERIMENTS.values() if name in other.columns]
        if of_tests and name not in test.columns:
            other, *others = of_tests
            more = f" (or {', '.join(others)})" if others else ""
            remedy = f"state '# test: {other}'{more} at the top, or leave it out"
            raise table.error(f"a {test.name} test has no such column", remedy, name)
    for name in [name for name in test.columns if name in columns]:
        column = test.columns[name]
        for need in column.needs:
            if need not in (*values, *columns):
                where = f"a line '# {need}: ...' at the top" if need in KEYS else "that column"
                raise table.error(f"needs the {need}", f"add {where}", name)
        for standard in column.stands_for:
            if standard in columns:
                other = written.get(standard, standard)
                raise table.error(f"says the same as {other}", "keep one of them", name)
            given = columns[name] if column.follows is None else column.follows(columns, values)
            columns[standard], written[standard] = given, name
        if column.stands_for:
            del columns[name]
    for standard, names in standing.items():
        if standard not in columns:
            raise table.error("missing column", f"give {' or '.join((*names, standard))}", names[0])
    return table, written


def _loads(table: SpecimenTable, test: Experiment) -> str:
    """The name of the loads of a table, with their columns in the directions of the test."""
    present = [name for name, of in test.loads.items() if set(of.columns) & set(table.columns)]
    if not present:
        needed = [
            " and ".join(c for k, c in enumerate(loads.columns) if c and k not in loads.optional)
            for loads in test.loads.values()
        ]
        needed += [name for name, c in test.columns.items() if set(c.stands_for) & set(needed)]
        raise table.error("no column of loads", f"give {', or '.join(needed)}")
    if len(present) > 1:
        problem = f"more than one kind of loads ({', '.join(present)})"
        raise table.error(problem, "keep the measured one")
    (name,) = present
    for k, column in enumerate(test.loads[name].columns):
        if k in test.loads[name].optional:
            if not table.columns.get(column, np.ones(1)).any():
                remedy = "leave out a reading that was not made"
                raise table.error("every value is zero", remedy, column)
        elif k in test.axes and column not in table.columns:
            strip = "give both directions, or '# test: strip x' (or y) at the top for a strip"
            remedy = strip if test.is_biaxial else f"a {test.name} test reads it"
            raise table.error("missing column", remedy, column)
    return name


def _check_keys(
    table: SpecimenTable,
    values: Mapping[str, Any],
    rows: Mapping[str, int],
    test: Experiment,
    loads: str,
) -> None:
    """Refuse keys that are missing, or do not fit the others or the table."""
    for key in test.needed(loads):
        if key not in values:
            line = f"add a line '# {key}: ...' at the top"
            if key == "geometry":
                line = line.replace("...", "unloaded|mounted")
                line += ", the state that dimensions refer to"
            raise InputError(f"a {loads} file must state {key}", file=table.path, remedy=line)
    right = test.loads[loads].units[0]
    wrong = "N" if right == "kPa" else "kPa"
    unit = ("does not fit the file's columns", f"give it in {right}")
    unfit = {f"load_noise_{wrong}": unit, f"load_offset_sd_{wrong}": unit}
    if values.get("reference") != "common":
        line = "add a line '# reference: common', or leave it out"
        unfit |= dict.fromkeys(MOUNTED_STATE, ("needs one common reference", line))
    if values.get("grips", NO_GRIPS) == NO_GRIPS:
        line = "add a line such as '# grips: hooks 5', or leave it out"
        unfit |= dict.fromkeys(GRIP_DETAILS, ("needs the key grips", line))
    others = f"does not belong to a {test.name} test", "leave it out"
    unfit |= dict.fromkeys(keys_of_others(test), others)
    numbers, count = len(values.get("rest_rows", "").split(",")), len(table.groups)
    if numbers not in (1, count):
        problem = f"has {numbers} values for {count} protocol{'s' * (count != 1)}"
        unfit.setdefault("rest_rows", (problem, "give one for all protocols, or one per protocol"))
    for key, (problem, remedy) in unfit.items():
        if key in values:
            raise InputError(f"{key} {problem}", file=table.path, row=rows[key], remedy=remedy)


def _protocols(
    table: SpecimenTable, values: Mapping[str, Any], test: Experiment, loads: Loads
) -> tuple[Protocol, ...]:
    """The protocols of a table, relative to the mounted state if the header gives one."""
    resting = [int(part) for part in values.get("rest_rows", str(AUTO_REST_ROWS)).split(",")]
    mounted = [values.get(key, 1.0) for key in MOUNTED_STATE]
    protocols = []
    for index, (name, rows) in enumerate(table.groups):
        at_rest = resting[index % len(resting)] if test.is_mounted else 0
        time = table.columns["time_s"][rows] if "time_s" in table.columns else None
        # across a strip the stretch may be unknown, and a load that is not read is zero
        x, y, load_x, load_y = (
            table.columns.get(column, np.full(len(table.lines), value))[rows]
            for names, value in ((STRETCHES, np.nan), (loads.columns, 0.0))
            for column in names
        )
        p = Protocol(name, x, y, load_x, load_y, time, at_rest)
        p = p.divided_by(mounted, loads_too=loads.times_stretch)
        if test.is_mounted and p.rest_rows and values.get("reference") != "common":
            p = p.divided_by_rest(loads_too=loads.times_stretch)
        protocols.append(p)
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
            problem = f"protocol name {name[:40]!r} is empty or duplicated"
            raise InputError(problem, remedy="give each protocol a name of its own")
    protocols = specimen.protocols if recorded is None else recorded
    keys: dict[str, object] = {
        "specimen": specimen.name,
        "test": specimen.test if specimen.test != BIAXIAL.name else None,
        **{k: getattr(specimen, k) for k in ("layer", "axis_x", "axis_y", "geometry", *DIMENSIONS)},
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
        **{name: k in axes for k, name in enumerate(specimen.kind_of_loads.columns)},
    }
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(compress(is_written, is_written.values()))
    for p in protocols:
        curves = [[one_line(p.name)] * p.rows, p.time_s, *(getattr(p, key) for key in CURVES)]
        kept = compress(curves, is_written.values())
        writer.writerows(zip(*(np.asarray(curve).tolist() for curve in kept), strict=True))
    return header + table.getvalue()
