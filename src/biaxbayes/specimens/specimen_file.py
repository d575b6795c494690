"""The specimen CSV: ``# key: value`` lines, then columns; errors name file, row and column."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from biaxbayes.errors import InputError
from biaxbayes.specimens.keys import GRIP_DETAILS, KEYS, METADATA_KEYS, NO_GRIPS, checked_value
from biaxbayes.specimens.plausibility import check_readings
from biaxbayes.specimens.protocol import AUTOMATIC, Protocol, ReadingError
from biaxbayes.specimens.specimen import STRESS_PAIRS, Specimen
from biaxbayes.specimens.table import STRETCHES, Table, read_table
from biaxbayes.tables.units import likely_name
from biaxbayes.text_files import atomic_write_text, cells_of, one_line, read_lines, rows_text

MOUNTED_STATE = ("mounted_state_x", "mounted_state_y")
"""Measured stretch of the mounted state, in a record with one common reference."""


# --- the header ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Header:
    """Values by key, and their lines in the file."""

    values: Mapping[str, float | str]
    rows: Mapping[str, int]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def number(self, key: str) -> float | None:
        """A number, or None without the key."""
        value = self.values.get(key)
        return None if value is None else float(value)

    def text(self, key: str) -> str | None:
        """A text, or None without the key or if it is empty."""
        return str(self.values.get(key) or "") or None


def read_header(lines: Sequence[str], path: Path) -> tuple[Header, int]:
    """Header of a file, and the index of the line with the column names."""
    values: dict[str, float | str] = {}
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
            return Header(values, rows), row - 1
        key, colon, value = stripped.lstrip("#").partition(":")
        if not colon:
            continue  # a plain comment
        key, value = key.strip(), one_line(value)
        if key in values:
            raise InputError(
                f"header key {key!r} appears twice", file=path, row=row, remedy="keep one"
            )
        if key not in KEYS:
            _, hint = likely_name(key, KEYS)
            raise InputError(
                f"unknown header key {key[:60]!r}",
                file=path,
                row=row,
                remedy=f"{hint}known keys are {', '.join(KEYS)}; drop the colon for a plain "
                "comment",
            )
        if value:
            values[key] = checked_value(key, value, row, path)
            rows[key] = row
    raise InputError(
        "the file has no table",
        file=path,
        remedy="give a line of column names (stretch_x,stretch_y,force_x_N,force_y_N) and rows",
    )


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
    path = Path(path)
    return parse_specimen(read_lines(path), path)


def parse_specimen(lines: Sequence[str], path: Path) -> Specimen:
    """A specimen from the lines of its file; ``path`` serves messages and the default name."""
    header, first = read_header(lines, path)
    table = read_table(lines, first, path, drop_missing=header.text("missing_rows") == "drop")
    stress_pair = _stress_pair(table, path)
    unit = "N" if stress_pair == "force" else "kPa"
    _check_keys(header, stress_pair, path)
    try:
        protocols = _protocols(table, header, stress_pair, path)
        specimen = Specimen(
            name=one_line(header.text("specimen") or path.stem),
            protocols=tuple(protocols),
            stress_pair=stress_pair,
            geometry=header.text("geometry") or "unloaded",
            edge_x_mm=header.number("edge_x_mm"),
            edge_y_mm=header.number("edge_y_mm"),
            thickness_mm=header.number("thickness_mm"),
            load_noise=header.number(f"load_noise_{unit}"),
            layer=header.text("layer"),
            axis_x=header.text("axis_x"),
            axis_y=header.text("axis_y"),
            reference=header.text("reference"),
            metadata={key: header.values[key] for key in METADATA_KEYS if key in header},
        )
        check_readings(specimen)
    except ReadingError as error:
        raise _in_file(error, table, header, stress_pair, path) from None
    notes = [
        f"protocol {p.name}: stretches divided by their value at rest "
        f"({p.reference[0]:.5f}, {p.reference[1]:.5f}), so that the test starts at 1"
        for p in specimen.protocols
        if max(abs(value - 1.0) for value in p.reference) > 1e-9
    ]
    return replace(specimen, notes=(*table.notes, *notes))


def _stress_pair(table: Table, path: Path) -> str:
    """The one stress pair of a table, with both its columns."""

    def refusal(problem: str, remedy: str, column: str | None = None) -> InputError:
        row = table.names_line
        return InputError(problem, file=path, row=row, column=column, remedy=remedy)

    present = [
        pair for pair, columns in STRESS_PAIRS.items() if any(c in table.columns for c in columns)
    ]
    if not present:
        pairs = ", or ".join(" and ".join(columns) for columns in STRESS_PAIRS.values())
        raise refusal("no stress pair", f"give {pairs}")
    if len(present) > 1:
        raise refusal(f"more than one stress pair ({', '.join(present)})", "keep the measured one")
    for column in STRESS_PAIRS[present[0]]:
        if column not in table.columns:
            raise refusal("missing column", "give both directions", column)
    return present[0]


def _check_keys(header: Header, stress_pair: str, path: Path) -> None:
    """Refuse keys that are missing with forces, or do not fit the others or the columns."""
    if stress_pair == "force":
        for key in ("edge_x_mm", "edge_y_mm", "thickness_mm", "geometry"):
            if key not in header:
                values = "unloaded|mounted" if key == "geometry" else "..."
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
    for key in MOUNTED_STATE:
        if key in header and header.text("reference") != "common":
            raise InputError(
                f"{key} needs one common reference",
                file=path,
                row=header.rows[key],
                remedy="add a line '# reference: common', or leave it out",
            )
    for key in GRIP_DETAILS:
        if key in header and header.text("grips") in (None, NO_GRIPS):
            raise InputError(
                f"{key} needs the key grips",
                file=path,
                row=header.rows[key],
                remedy="add a line such as '# grips: hooks 5', or leave it out",
            )


def _protocols(table: Table, header: Header, stress_pair: str, path: Path) -> list[Protocol]:
    """The protocols of a table, relative to the mounted state if the header gives one."""
    given, count = header.text("rest_rows"), len(table.groups)
    resting = [AUTOMATIC] if given is None else [int(part) for part in given.split(",")]
    if len(resting) not in (1, count):
        raise InputError(
            f"rest_rows has {len(resting)} values for {count} protocol{'s' * (count != 1)}",
            file=path,
            row=header.rows["rest_rows"],
            remedy="give one for all protocols, or one per protocol",
        )
    mounted = [header.number(key) or 1.0 for key in MOUNTED_STATE]
    names = (*STRETCHES, *STRESS_PAIRS[stress_pair])
    protocols = []
    for index, (name, rows) in enumerate(table.groups):
        at_rest = resting[index % len(resting)]
        if at_rest >= rows.stop - rows.start:
            raise InputError(
                f"rest_rows of {at_rest} leaves no stretched row in protocol {name[:40]!r}",
                file=path,
                row=header.rows["rest_rows"],
                remedy="rest_rows counts the leading rows recorded before the test starts",
            )
        time = table.columns["time_s"][rows] if "time_s" in table.columns else None
        x, y, load_x, load_y = (table.columns[column][rows] for column in names)
        protocol = Protocol(name, x, y, load_x, load_y, time, at_rest)
        protocols.append(protocol.divided_by(mounted, stress_pair))
    return protocols


def _in_file(
    error: ReadingError, table: Table, header: Header, stress_pair: str, path: Path
) -> InputError:
    """An error about an array, by row and column of the file."""
    unit = "N" if stress_pair == "force" else "kPa"
    key = f"load_noise_{unit}" if error.argument == "load_noise" else error.argument
    if error.index is None and key in header:
        return InputError(error.fault, file=path, row=header.rows[key], remedy=error.remedy)
    load_x, load_y = STRESS_PAIRS[stress_pair]
    columns = {key: key for key in (*STRETCHES, "time_s")} | {"load_x": load_x, "load_y": load_y}
    rows = dict(table.groups).get(error.protocol or "", slice(None))
    return error.at(path, table.lines[rows], columns)


# --- writing -------------------------------------------------------------------------------------


def write_specimen(specimen: Specimen, path: str | os.PathLike) -> None:
    """Write a specimen CSV that :func:`read_specimen` reads back equal.

    Parameters
    ----------
    specimen : Specimen
        The specimen; its protocols must have different names.
    path : path-like
        The file; it is written completely or not at all.

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
    _check_writable(specimen)
    protocols = specimen.protocols if recorded is None else recorded
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
        "reference": specimen.reference,
        **specimen.metadata,
    }
    common = specimen.reference == "common"
    counted = [replace(p, rest_rows=AUTOMATIC) for p in protocols]
    given, automatic = (
        [(p.at_one() if common else p).rest_rows for p in some] for some in (protocols, counted)
    )
    if given != automatic:
        keys["rest_rows"] = ", ".join(map(str, given))
    lines = []
    for key, value in keys.items():
        if value is not None and value != "":
            text = repr(float(value)) if isinstance(value, float) else one_line(str(value))
            lines.append(f"# {key}: {text}\n")
    return "".join(lines) + rows_text(_rows(specimen.stress_pair, protocols))


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
                f"protocol name {name[:40]!r} is empty or duplicated",
                remedy="give each protocol a name of its own",
            )


def _rows(stress_pair: str, protocols: Sequence[Protocol]) -> Iterator[Sequence]:
    """Column names, and the rows of all protocols."""
    named = len(protocols) > 1 or protocols[0].name != "1"
    timed = protocols[0].time_s is not None
    yield [
        *(["protocol"] if named else []),
        *(["time_s"] if timed else []),
        *STRETCHES,
        *STRESS_PAIRS[stress_pair],
    ]
    for p in protocols:
        columns: list[Sequence] = [[one_line(p.name)] * p.rows] if named else []
        curves = (p.time_s, p.stretch_x, p.stretch_y, p.load_x, p.load_y)
        columns += [curve.tolist() for curve in curves if curve is not None]
        yield from zip(*columns, strict=True)
