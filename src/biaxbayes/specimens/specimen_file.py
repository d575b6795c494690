"""The specimen CSV: ``# key: value`` lines, then columns; read with named errors, written whole."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.specimens.specimen import STRESS_PAIRS, Protocol, Specimen, rest_rows
from biaxbayes.specimens.text_file import atomic_write_text, read_text

__all__ = ["read_specimen", "write_specimen"]

TEXT_KEYS = ("specimen", "layer", "axis_x", "axis_y", "geometry")
POSITIVE_KEYS = ("edge_x_mm", "edge_y_mm", "thickness_mm", "load_noise_N", "load_noise_kPa")
UNCERTAINTY_KEYS = ("edge_sd_mm", "thickness_sd_mm", "load_offset_sd_N", "load_offset_sd_kPa")
MEASURED_STRETCH_KEYS = ("mounting_stretch_x", "mounting_stretch_y")
KNOWN_KEYS = (
    *TEXT_KEYS,
    *POSITIVE_KEYS,
    *UNCERTAINTY_KEYS,
    *MEASURED_STRETCH_KEYS,
    "rest_rows",
    "source",
)
STRETCHES = ("stretch_x", "stretch_y")
OPTIONAL_COLUMNS = ("protocol", "time_s")
STRESS_LIMIT_KPA = 20_000.0  # soft tissue tears far below 20 MPa: beyond, the unit is wrong
STRETCH_RANGE = (0.2, 5.0)


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
    text = read_text(path)
    header, first_row = _read_header(text, path)
    table = _read_table(text, first_row, path)
    stress_pair = _stress_pair(table, path)
    _check_keys(header, stress_pair, path)
    _check_units(table, header, stress_pair, path)
    protocols, notes = _protocols(table, header, stress_pair, path)
    noise = header.get("load_noise_N" if stress_pair == "force" else "load_noise_kPa")
    metadata = {
        key: value
        for key, value in header.items()
        if key in (*UNCERTAINTY_KEYS, *MEASURED_STRETCH_KEYS, "source", "rest_rows")
    }
    return Specimen(
        name=str(header.get("specimen", path.stem)),
        protocols=protocols,
        stress_pair=stress_pair,
        geometry=str(header.get("geometry", "unloaded")),
        edge_x_mm=_number(header, "edge_x_mm"),
        edge_y_mm=_number(header, "edge_y_mm"),
        thickness_mm=_number(header, "thickness_mm"),
        load_noise=None if noise is None else float(noise),
        layer=_text(header, "layer"),
        axis_x=_text(header, "axis_x"),
        axis_y=_text(header, "axis_y"),
        metadata=metadata,
        notes=notes,
    )


def write_specimen(specimen: Specimen, path: str | os.PathLike) -> None:
    """Write a specimen CSV that :func:`read_specimen` reads back equal.

    The file appears under its name only when it is complete.

    Parameters
    ----------
    specimen : Specimen
    path : path-like
    """
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
    lines = []
    for key, value in keys.items():
        if value is None:
            continue
        text = repr(value) if isinstance(value, float) else str(value)
        lines.append(f"# {key}: {' '.join(text.split())}\n")
    named = len(specimen.protocols) > 1 or specimen.protocols[0].name != "1"
    frames = []
    for p in specimen.protocols:
        columns: dict[str, object] = {"protocol": p.name} if named else {}
        if p.time_s is not None:
            columns["time_s"] = p.time_s
        columns["stretch_x"], columns["stretch_y"] = p.stretch_x, p.stretch_y
        name_x, name_y = STRESS_PAIRS[specimen.stress_pair]
        columns[name_x], columns[name_y] = p.load_x, p.load_y
        frames.append(pd.DataFrame(columns))
    # Shortest text that reads back to the same double.
    table = pd.concat(frames).to_csv(index=False, lineterminator="\n")
    atomic_write_text(Path(path), "".join(lines) + table)


# --- header -------------------------------------------------------------------------------


def _read_header(text: str, path: Path) -> tuple[dict[str, float | str], int]:
    """Header values and the 0-based line of the column names."""
    header: dict[str, float | str] = {}
    for number, line in enumerate(io.StringIO(text)):
        stripped = line.strip()
        if not stripped:
            continue
        if not stripped.startswith("#"):
            return header, number
        body = stripped.lstrip("#").strip()
        if ":" not in body:
            continue  # a plain comment
        key, value = (part.strip() for part in body.split(":", 1))
        _header_value(header, key, value, number + 1, path)
    raise InputError(
        "the file has no table",
        file=path,
        remedy="give a line of column names (stretch_x,stretch_y,force_x_N,force_y_N) and rows",
    )


def _header_value(
    header: dict[str, float | str], key: str, value: str, row: int, path: Path
) -> None:
    if key not in KNOWN_KEYS:
        raise InputError(
            f"unknown header key {key[:60]!r}",
            file=path,
            row=row,
            remedy=f"known keys are {', '.join(KNOWN_KEYS)}; drop the colon for a plain comment",
        )
    if key in header:
        raise InputError(f"header key {key!r} appears twice", file=path, row=row, remedy="keep one")
    if key in TEXT_KEYS or key == "source" or key in MEASURED_STRETCH_KEYS:
        header[key] = value
    else:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or number <= 0.0:
            raise InputError(
                f"{key} must be a positive number, not {value[:40]!r}",
                file=path,
                row=row,
                remedy="write it as in '# thickness_mm: 1.35'",
            )
        header[key] = number
    if key in MEASURED_STRETCH_KEYS:
        measured_stretch(value, path, row)
    if key == "geometry" and value not in ("unloaded", "mounted"):
        raise InputError(
            f"geometry must be 'unloaded' or 'mounted', not {value[:40]!r}",
            file=path,
            row=row,
            remedy="say in which state the dimensions were measured",
        )


def measured_stretch(text: str, path: object = None, row: int | None = None) -> tuple[float, float]:
    """Mean and standard deviation from text such as ``1.03 +- 0.01``."""
    parts = text.replace("±", "+-").split("+-")
    try:
        mean, sd = (float(part) for part in parts)
    except ValueError:
        mean = sd = math.nan
    if not (math.isfinite(mean) and math.isfinite(sd) and mean > 0 and sd > 0):
        raise InputError(
            f"a mounting stretch known from an image reads like '1.03 +- 0.01', not {text[:40]!r}",
            file=path,
            row=row,
            remedy="give value and standard deviation",
        )
    return mean, sd


def _number(header: Mapping[str, float | str], key: str) -> float | None:
    value = header.get(key)
    return None if value is None else float(value)


def _text(header: Mapping[str, float | str], key: str) -> str | None:
    value = header.get(key)
    return None if value is None else str(value)


# --- table --------------------------------------------------------------------------------


def _read_table(text: str, first_row: int, path: Path) -> pd.DataFrame:
    lines = text.splitlines()
    names = [name.strip() for name in lines[first_row].split(",")]
    _check_columns(names, first_row + 1, path)
    body = io.StringIO("\n".join(lines[first_row + 1 :]))
    try:
        table = pd.read_csv(
            body,
            header=None,
            names=names,
            dtype={"protocol": str},
            skip_blank_lines=False,
            skipinitialspace=True,
            index_col=False,
            comment=None,
            engine="c",
            low_memory=False,
            na_filter=True,
            keep_default_na=False,
            na_values={"protocol": []},
            on_bad_lines="error",
            float_precision="round_trip",
        )
    except (ValueError, pd.errors.ParserError, OverflowError):
        _find_bad_cell(lines, first_row, names, path)
        raise InputError("the table cannot be read as numbers", file=path) from None
    numeric = [name for name in names if name != "protocol"]
    width = [line.count(",") + 1 for line in (lines[first_row + 1 : first_row + 2])]
    bad = width and width[0] != len(names)
    if (
        bad
        or any(not pd.api.types.is_numeric_dtype(table[name]) for name in numeric)
        or not np.isfinite(table[numeric].to_numpy(dtype=float)).all()
    ):
        table = _find_bad_cell(lines, first_row, names, path)
    table = table.astype(dict.fromkeys(numeric, float))
    if len(table) < 2:
        raise InputError(
            f"only {len(table)} row of data",
            file=path,
            row=first_row + 1 + len(table),
            remedy="a test needs the mounted state and at least one stretched state",
        )
    return table


def _check_columns(names: list[str], row: int, path: Path) -> None:
    known = [*STRETCHES, *OPTIONAL_COLUMNS, *(n for pair in STRESS_PAIRS.values() for n in pair)]
    if len(names) > 50 or not any(name in known for name in names):
        shown = ", ".join(names[:4])[:80]
        raise InputError(
            f"not a specimen CSV: the first line after the header reads {shown!r}",
            file=path,
            row=row,
            remedy="expected comma-separated column names such as "
            "stretch_x,stretch_y,force_x_N,force_y_N ('biaxbayes convert' reads machine exports)",
        )
    for name in names:
        if names.count(name) > 1:
            raise InputError("column appears twice", file=path, row=row, column=name)
        if name not in known:
            raise InputError(
                "unknown column",
                file=path,
                row=row,
                column=name[:60],
                remedy=f"known columns are {', '.join(known)}",
            )
    for name in STRETCHES:
        if name not in names:
            raise InputError(
                "missing column",
                file=path,
                row=row,
                column=name,
                remedy="stretches are relative to the mounted state",
            )


def _find_bad_cell(lines: list[str], first_row: int, names: list[str], path: Path) -> pd.DataFrame:
    """Read cell by cell to name the first that is wrong; blank lines are passed over."""
    rows = []
    for number, line in enumerate(lines[first_row + 1 :], start=first_row + 2):
        if not line.strip():
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(names):
            raise InputError(
                f"{len(cells)} cells where the header names {len(names)}",
                file=path,
                row=number,
                remedy="the file may be cut off, or uses another separator or a decimal comma",
            )
        values: list[float | str] = []
        for name, cell in zip(names, cells, strict=True):
            if name == "protocol":
                values.append(cell)
                continue
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise InputError(
                    f"{cell[:40]!r} is not a finite number",
                    file=path,
                    row=number,
                    column=name,
                    remedy="remove the row or mend the value",
                )
            values.append(value)
        rows.append(values)
    return pd.DataFrame(rows, columns=names)


def _stress_pair(table: pd.DataFrame, path: Path) -> str:
    present = [
        pair for pair, columns in STRESS_PAIRS.items() if any(c in table.columns for c in columns)
    ]
    if not present:
        raise InputError(
            "no stress pair",
            file=path,
            remedy="give force_x_N and force_y_N, or piola_x_kPa and piola_y_kPa, "
            "or cauchy_x_kPa and cauchy_y_kPa",
        )
    if len(present) > 1:
        raise InputError(
            f"more than one stress pair ({', '.join(present)})",
            file=path,
            remedy="keep the one that was measured",
        )
    for column in STRESS_PAIRS[present[0]]:
        if column not in table.columns:
            raise InputError("missing column", file=path, column=column, remedy="both directions")
    return present[0]


def _check_keys(header: Mapping[str, object], stress_pair: str, path: Path) -> None:
    if stress_pair == "force":
        for key in ("edge_x_mm", "edge_y_mm", "thickness_mm", "geometry"):
            if key not in header:
                raise InputError(
                    f"a force file must state {key}",
                    file=path,
                    remedy=f"add a line '# {key}: ...' at the top",
                )
    wrong = "kPa" if stress_pair == "force" else "N"
    for key in (f"load_noise_{wrong}", f"load_offset_sd_{wrong}"):
        if key in header:
            raise InputError(
                f"{key} does not fit the file's columns",
                file=path,
                remedy=f"give the noise in {'N' if wrong == 'kPa' else 'kPa'}",
            )


def _check_units(
    table: pd.DataFrame, header: Mapping[str, float | str], stress_pair: str, path: Path
) -> None:
    for column in STRETCHES:
        values = table[column].to_numpy()
        bad = np.flatnonzero((values < STRETCH_RANGE[0]) | (values > STRETCH_RANGE[1]))
        if bad.size:
            raise InputError(
                f"a stretch of {values[bad[0]]:g}",
                file=path,
                row=_line(table, path, int(bad[0])),
                column=column,
                remedy="stretches are ratios near 1, not strains or per cent",
            )
        if np.ptp(values) == 0.0:
            raise InputError(
                "the stretch never changes", file=path, column=column, remedy="nothing was tested"
            )
    for column, edge in zip(STRESS_PAIRS[stress_pair], ("edge_y_mm", "edge_x_mm"), strict=True):
        load = table[column].to_numpy()
        row = int(np.argmax(np.abs(load)))
        peak = float(np.abs(load[row]))
        if peak == 0.0:
            raise InputError(
                "every value is zero", file=path, column=column, remedy="no load was recorded"
            )
        stress = peak
        if stress_pair == "force":
            stress = peak / (float(header[edge]) * float(header["thickness_mm"]) * 1e-3)
        if stress > STRESS_LIMIT_KPA:
            unit = "mN" if stress_pair == "force" else "Pa"
            raise InputError(
                f"{load[row]:g} means a stress of {stress / 1000:.3g} MPa",
                file=path,
                row=_line(table, path, row),
                column=column,
                remedy=f"if the values are in {unit}, divide them by 1000",
            )


def _line(table: pd.DataFrame, path: Path, index: int) -> int:
    """Line of the file that holds a row of the table (blank lines and header counted)."""
    seen = -1
    named = False
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or (not named and line.strip().startswith("#")):
            continue
        if not named:
            named = True
            continue
        seen += 1
        if seen == index:
            return number
    return index


# --- protocols ----------------------------------------------------------------------------


def _protocols(
    table: pd.DataFrame, header: Mapping[str, float | str], stress_pair: str, path: Path
) -> tuple[tuple[Protocol, ...], tuple[str, ...]]:
    if "protocol" in table.columns:
        groups = list(table.groupby("protocol", sort=False))
    else:
        groups = [("1", table)]
    protocols, notes = [], []
    for name, rows in groups:
        label = str(name)
        if len(rows) < 2:
            raise InputError(
                f"protocol {label!r} has one row",
                file=path,
                row=_line(table, path, int(rows.index[0])),
                column="protocol",
                remedy="give the mounted state and at least one stretched state",
            )
        protocol, note = _protocol(label, rows, header, stress_pair, path)
        protocols.append(protocol)
        notes.extend(note)
    return tuple(protocols), tuple(notes)


def _protocol(
    name: str,
    rows: pd.DataFrame,
    header: Mapping[str, float | str],
    stress_pair: str,
    path: Path,
) -> tuple[Protocol, list[str]]:
    notes = []
    stretch = rows[list(STRETCHES)].to_numpy()
    load = rows[list(STRESS_PAIRS[stress_pair])].to_numpy()
    resting = int(header.get("rest_rows", rest_rows(*stretch.T)))
    if resting >= len(rows):
        raise InputError(
            f"rest_rows of {resting} leaves no stretched row in protocol {name!r}",
            file=path,
            remedy="rest_rows counts the leading rows recorded before the test starts",
        )
    reference = stretch[:resting].mean(axis=0)
    if np.any(np.abs(reference - 1.0) > 1e-12):
        if np.any(np.abs(reference - 1.0) > 1e-9):
            notes.append(
                f"protocol {name}: stretches divided by their value at rest "
                f"({reference[0]:.5f}, {reference[1]:.5f}), so that the test starts at 1"
            )
        stretch = stretch / reference
        if stress_pair == "cauchy":
            # The lab multiplied the nominal stress by its own stretch; keep that stress.
            load = load / reference
    time = rows["time_s"].to_numpy() if "time_s" in rows else None
    return Protocol(name, *stretch.T, *load.T, time, resting), notes
