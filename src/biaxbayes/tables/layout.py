"""Where the table of a sheet is: below the named columns, or the longest rows of numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import (
    GROUPED,
    MISSING,
    NUMBER_AND_UNIT,
    Table,
    bare_name,
    in_lines,
    plain,
)
from biaxbayes.tables.units import unit_named
from biaxbayes.tables.worksheet import Worksheet
from biaxbayes.text_files import (
    DECIMAL_COMMA,
    DECIMAL_POINT,
    is_number,
    one_line,
    without_empty_end,
)

ALL_SHEETS = "all"
SAMPLE_ROWS = 200
"""Rows from which the form of a table is read."""
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
SUMMARY = re.compile(r"\W*[^\W\d_]{2,}[^\d]*")
"""A word in a column of numbers, as below the readings: Max, Mean, St. dev."""
OF_ALL = re.compile(
    r"\W*(max(imum)?|min(imum)?|mean|average|avg|median|mittel(wert)?|s\.?d\.?|st\.? ?d(ev)?)\W*",
    re.IGNORECASE,
)
"""Names of rows below the readings."""
POSITION = re.compile(r"\s*#\d+")
"""A column by its position, such as #3."""
Names = Sequence[Sequence[str]]
"""For each column that is needed the names that it may have."""


def tables_in(
    available: dict[str, Worksheet],
    path: Path,
    sheets: Sequence[str] = (),
    hidden: str | None = None,
    named: Names = (),
) -> tuple[dict[str, Table], dict[str, str]]:
    """Tables by sheet, and why other sheets hold none."""
    listing = f"sheets are {', '.join(available)[:300]}"
    wanted = () if tuple(sheets) == (ALL_SHEETS,) else tuple(sheets)
    if sheets and "" in available:
        raise InputError("is text and has no sheets", file=path, remedy="leave out `sheets`")
    for name in wanted:
        if name not in available:
            raise InputError(f"no sheet {name[:40]!r}", file=path, remedy=listing)
        if wanted.count(name) > 1:
            raise InputError(f"sheet {name[:40]!r} is given twice", file=path, remedy="keep one")
    tables: dict[str, Table] = {}
    available, others = _seen(available, wanted, hidden, path)
    for name in wanted or available:
        try:
            tables[name] = table_from_sheet(available[name], path, named)
        except InputError as error:
            if wanted or len(available) == 1:
                label = f"sheet {name[:40]!r} " if name else ""
                raise InputError(
                    label + error.problem, file=path, row=error.row, remedy=error.remedy
                ) from None
            others[name] = error.problem
    if not tables:
        raise InputError("no sheet holds a table", file=path, remedy=listing)
    if named and not sheets and len(tables) > 1:
        # sheets without the columns are no choice
        needed = [n for n in named if "*" not in n[-1]]
        whole = {k: t for k, t in tables.items() if all(any(map(t.has_column, n)) for n in needed)}
        others |= {k: "has not the columns" for k in tables if whole and k not in whole}
        tables = whole or tables
    if len(tables) > 1 and not sheets:
        gives = {f"sheets={name}": f"{t.rows} rows; {t.listing}" for name, t in tables.items()}
        gives[f"sheets={ALL_SHEETS}"] = "each a protocol"
        raise Question("more than one sheet holds a table", gives, file=path)
    return tables, others


def _seen(
    sheets: dict[str, Worksheet], wanted: Sequence[str], hidden: str | None, path: Path
) -> tuple[dict[str, Worksheet], dict[str, str]]:
    """Sheets without the hidden ones, and why those are left out; asks about them."""
    unseen = {k: "hidden" for k, s in sheets.items() if s.unseen and (not wanted or k in wanted)}
    rows = {k: len(s.hidden) for k, s in sheets.items() if s.hidden and (not wanted or k in wanted)}
    if hidden is None and (unseen or rows):
        found = [f"sheet {k!r} is hidden" for k in unseen]
        found += [f"{count} rows of {k!r} are hidden or filtered" for k, count in rows.items()]
        gives = {"hidden=drop": "without them", "hidden=keep": "with them"}
        raise Question("; ".join(found)[:300], gives, file=path)
    if hidden == "drop":
        return {k: s for k, s in sheets.items() if k not in unseen}, unseen
    return {k: replace(s, hidden=[]) for k, s in sheets.items()}, {}


# --- one sheet ------------------------------------------------------------------------------------


def table_from_sheet(sheet: Worksheet, path: Path, named: Names = ()) -> Table:
    """Names, an optional row of units, and the rows of readings below them."""
    rows, lines = sheet.rows, sheet.lines
    at = _line_of_names(rows, named)
    if at is not None:
        names, first = list(rows[at]), at + 1
    else:
        names, first = _names_above_numbers(sheet, path, named)
    names = without_empty_end([one_line(name) for name in names])
    numeric = [j for j in _numeric_columns(rows[first:], named, names) if j < len(names)]
    behind = [[_unit_behind(row, j) for j in numeric] for row in rows[first:]]
    forms = [form for row in behind for form in row if form is not None]
    with_units = 2 * sum(map(bool, forms)) > len(forms)
    reads = [
        any(form is not None and (with_units or not form) for form in of_row)
        and sum(map(bool, map(str.strip, cells))) > 1
        for of_row, cells in zip(behind, rows[first:], strict=True)
    ]
    for k in reversed(range(len(reads))):  # a summary stands below the readings
        if reads[k] and not _is_summary(rows[first + k], rows[first + k - 1] if k else (), numeric):
            break
        reads[k] = False
    start = first + (reads.index(True) if True in reads else len(reads))
    units = next((tuple(r) for r in rows[first:start] if _is_row_of_units(r, names)), ())
    found = zip(rows[start:], lines[start:], reads[start - first :], strict=True)
    needed = max(numeric, default=-1) + 1 if sheet.text else 0
    body, kept, blocks, notes = _readings(list(found), names, units, needed, path)
    passed = [lines[j] for j in range(first, start) if tuple(rows[j]) != units]
    if passed:
        notes.append(f"lines {in_lines(passed)} below the names are passed over")
    comma = _decimal_comma(body[: 10 * SAMPLE_ROWS], numeric, path)
    columns = tuple(zip(*body, strict=True))
    return Table(
        path,
        tuple(names),
        columns,
        np.array(kept),
        comma,
        units,
        np.flatnonzero(np.isin(kept, sheet.hidden)),
        (*sheet.notes, *(["decimal commas"] if comma else []), *notes),
        tuple(blocks) if len(set(blocks)) > 1 else (),
        tuple(_unit_of_cells(column) for column in columns),
    )


def _is_summary(cells: Sequence[str], above: Sequence[str], numeric: Sequence[int]) -> bool:
    """Whether a row has a word where others have readings, or says that it is of all of them."""
    columns = [j for j in numeric if j < len(cells) and cells[j].strip().lower() not in MISSING]
    if any(SUMMARY.fullmatch(cells[j]) for j in columns):
        return True
    # labels are those of the rows above, too
    return any(OF_ALL.fullmatch(cell) for cell in cells if cell not in above)


def _names_above_numbers(sheet: Worksheet, path: Path, named: Names) -> tuple[list[str], int]:
    """Names above the longest run of rows of numbers, and the first row below them."""
    rows = sheet.rows
    first = _first_row_of_numbers(rows, path)
    numeric = _numeric_columns(rows[first:])
    at = first - 1
    if first > 1 and _are_names(rows[first - 2], numeric):
        at -= _is_row_of_units(rows[first - 1], rows[first - 2])
    if first == 0 and len(sheet.names) == len(rows[0]):
        return list(sheet.names), first  # as numpy.savetxt writes them, in a comment
    if at >= 0 and _are_names(rows[at], numeric):
        return list(rows[at]), at + 1
    if named and all(map(POSITION.match, (n[0] for n in named))):
        return [f"#{k + 1}" for k in range(len(rows[first]))], first
    problem = f"has no line of column names, but {', '.join(rows[max(at, 0)])[:60]!r}"
    remedy = "give columns by position, as #1, or add a line that names them with units"
    raise InputError(problem, file=path, row=sheet.lines[max(at, 0)], remedy=remedy)


def _line_of_names(rows: Sequence[Sequence[str]], named: Names) -> int | None:
    """The first line that holds a name of each needed column, or of most of them."""
    needed = [n for n in named if not POSITION.match(n[0])]
    most, best = 0.3 * len(needed), None
    for at, cells in enumerate(rows if needed else []):
        here = {bare_name(cell) for cell in cells}
        found = sum(any(_is_among(bare_name(n), here) for n in names) for names in needed)
        if found > most:
            most, best = found, at
        if found == len(needed):
            return at
    return best


def _is_among(name: str, cells: Collection[str]) -> bool:
    """Whether a name, in which an asterisk stands for any text, is among some cells."""
    pattern = re.escape(name).replace(r"\*", ".+")
    return name in cells or ("*" in name and any(re.fullmatch(pattern, cell) for cell in cells))


def _unit_behind(cells: Sequence[str], j: int) -> str | None:
    """The unit behind the number of a cell, empty without one; None for any other cell."""
    cell = plain(cells[j]) if j < len(cells) else ""
    if is_number(cell) or any(pattern.fullmatch(cell) for pattern in GROUPED.values()):
        return ""
    match = NUMBER_AND_UNIT.fullmatch(cell)
    return match[2] if match and unit_named(match[2]) is not None else None


def _unit_of_cells(cells: Sequence[str]) -> str:
    """The unit that all numbers of a column have behind them; empty without one."""
    filled = (j for j, cell in enumerate(cells) if cell.strip().lower() not in MISSING)
    units = (_unit_behind(cells, j) for j in filled)
    first = next(units, None)
    return first if first and all(unit == first for unit in units) else ""


def _readings(
    found: Sequence[tuple[Sequence[str], int, bool]],
    names: Sequence[str],
    units: Sequence[str],
    needed: int,
    path: Path,
) -> tuple[list[list[str]], list[int], list[int], list[str]]:
    """Cells, lines and blocks of the rows with readings, and notes on all others."""
    width, unit_row = len(names), [one_line(unit) for unit in without_empty_end(list(units))]
    body, kept, blocks, others, extra = [], [], [], [], []
    block = 1
    for cells, line, reads in found:
        if not reads:
            texts = [one_line(cell) for cell in without_empty_end(list(cells))]
            block += texts == list(names)  # a line that repeats the names begins one
            if texts not in (list(names), unit_row):
                others.append(line)
            continue
        if len(cells) < needed:
            problem = f"{len(cells)} cells where the columns are {width}"
            remedy = "the file may be cut off here, or holds more than one table"
            raise InputError(problem, file=path, row=line, remedy=remedy)
        if "".join(cells[width:]).strip():
            extra.append(line)
        body.append([*cells[:width], *[""] * (width - len(cells))])
        kept.append(line)
        blocks.append(block)
    if len(body) < 2:
        remedy = "a table has a line of column names and at least two rows"
        raise InputError("holds no rows of numbers below its names", file=path, remedy=remedy)
    if needed and len(extra) > 0.2 * len(body):
        problem = f"more cells than the {width} names in {len(extra)} of {len(body)} rows"
        remedy = "the separator may be a decimal comma, or a name is missing"
        raise InputError(problem, file=path, row=extra[0], remedy=remedy)
    notes = []
    if others:
        count = f"{len(others)} line{'s' * (len(others) > 1)}"
        notes.append(f"{count} without readings left out: {in_lines(others)}")
    if extra:
        notes.append(f"cells behind the last column left out: lines {in_lines(extra)}")
    return body, kept, blocks, notes


# --- without names --------------------------------------------------------------------------------


def _numeric_columns(
    rows: Sequence[Sequence[str]], named: Names = (), names: Sequence[str] = ()
) -> list[int]:
    """Columns that hold a number in half of the rows, or in half of their cells if named."""
    wanted = set()
    for name in (n for alternatives in named for n in alternatives):
        if POSITION.fullmatch(name.strip()):
            wanted.add(int(name.strip()[1:]) - 1)
        else:
            bare = bare_name(name)
            wanted |= {j for j, n in enumerate(names) if _is_among(bare, [bare_name(n)])}
    middle = rows if wanted else rows[len(rows) // 3 :][:SAMPLE_ROWS]
    width = max(map(len, middle), default=0)
    counts = {
        j: sum(_unit_behind(row, j) is not None for row in middle)
        for j in (sorted(wanted) if wanted else range(width))
    }
    for j in sorted(wanted):
        filled = sum(j < len(row) and bool(row[j].strip()) for row in middle)
        if 2 * counts[j] <= filled or not filled:
            del counts[j]
    if wanted and not counts:
        return _numeric_columns(rows)
    return [j for j, count in counts.items() if wanted or 2 * count >= len(middle)]


def _first_row_of_numbers(rows: Sequence[Sequence[str]], path: Path) -> int:
    """The first of three rows of numbers, of the table with most of them."""
    numeric = _numeric_columns(rows)

    def of_numbers(cells: Sequence[str]) -> bool:
        numbers = [_unit_behind(cells, j) is not None for j in numeric if j < len(cells)]
        filled = sum(cells[j].strip().lower() not in MISSING for j in numeric if j < len(cells))
        return sum(numbers) >= 2 and filled - sum(numbers) <= 0.25 * len(numeric)

    are = [of_numbers(row) for row in rows]
    starts = [j for j in range(len(rows)) if all(are[j : j + 3]) and not (j and are[j - 1])]
    named = [j for j in starts if j > 0 and _are_names(rows[j - 1], numeric)]
    starts = named or starts[:1]
    if starts and len(rows) > 1:
        sizes = [sum(are[a:b]) for a, b in zip(starts, [*starts[1:], len(rows)], strict=True)]
        return starts[int(np.argmax(sizes))]
    width = max(map(len, rows), default=0)
    raise InputError(
        f"holds no table: {len(rows)} rows of up to {width} cells, no three of them with two "
        "numbers below each other",
        file=path,
        remedy="a table has a line of column names and at least two rows",
    )


def _are_names(cells: Sequence[str], numeric: Sequence[int]) -> bool:
    """True if most columns of numbers have text in this row."""
    named = sum(j < len(cells) and bool(cells[j].strip()) for j in numeric)
    numbers = sum(j < len(cells) and is_number(plain(cells[j])) for j in numeric)
    return not numbers and named >= max(2, 0.6 * len(numeric))


def _is_row_of_units(cells: Sequence[str], above: Sequence[str]) -> bool:
    """True if a row below names holds units: known ones, or the same text several times."""
    filled = [cell.strip() for cell in cells if cell.strip().lower() not in MISSING]
    if not filled or any(_unit_behind(cells, j) is not None for j in range(len(cells))):
        return False
    units = sum(unit_named(cell) is not None or not re.search(r"\w", cell) for cell in filled)
    names = [cell.strip() for cell in above if cell.strip()]
    repeated = len(set(filled)) < len(filled) and len(set(names)) == len(names)
    return 2 * units >= len(filled) or repeated


def _decimal_comma(rows: Sequence[Sequence[str]], numeric: Sequence[int], path: Path) -> bool:
    """True for decimal commas; mixed ones and thousands separators are refused."""
    cells = [plain(row[j]) for row in rows for j in numeric if j < len(row)]
    grouped = [any(p.fullmatch(cell) for cell in cells) for p in GROUPED.values()]
    commas = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell)]
    problem = ""
    if all(grouped) or (commas and any(map(DECIMAL_POINT.fullmatch, cells)) and not grouped[1]):
        shown = ", ".join(next(cell for cell in cells if mark in cell) for mark in ",.")
        problem = f"mixes decimal commas and decimal points (or has thousands separators): {shown}"
    elif commas and not grouped[1] and all(map(THOUSANDS.fullmatch, commas)):
        problem = f"writes numbers like {commas[0]!r}, which may be decimals or thousands"
    if problem:
        remedy = "export it with decimal points and no thousands separators"
        raise InputError(problem, file=path, remedy=remedy)
    return bool(commas) or grouped[1]
