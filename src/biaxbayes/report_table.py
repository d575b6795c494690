"""A table of a result: a DataFrame, and columns that say how a row is printed in every medium.

Such as ``Table([Column("quantity", "Quantity"), Column("low", "5 %", "kPa", ".3g")], frame)``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import pandas as pd
from markupsafe import Markup, escape

from biaxbayes.errors import printable
from biaxbayes.parameters import Parameter, Quantity, unit_text
from biaxbayes.text_files import aligned, one_line

Cell: TypeAlias = str | Quantity | Markup | tuple[str | Quantity | Markup, ...]
"""A text, a quantity (its symbol), or several, of which the further ones are in small print."""
Row: TypeAlias = Mapping[Any, Any]
"""A row of the DataFrame, by its columns."""
DASH = "–"
"""Stands in place of numbers where there are none."""
MINUS = re.compile(r"(?<![\w.)-])-(?=\d)")
"""The hyphen of a negative number."""


@dataclass(frozen=True)
class Column:
    """A printed column."""

    name: str  # of the rows; of none where ``format`` makes the cell of several
    heading: str | Quantity = ""  # in print; the name where empty
    unit: str = ""  # printed behind the heading, in brackets
    # format specification of a number, such as ``.3g``, or ``.0f %`` of a share; or a function
    # from a row to its cell
    format: str | Callable[[Row], Cell] = ""
    number: bool = False  # right-aligned
    term: bool = False  # the glossary of the page explains the heading

    def cell(self, row: Row) -> Cell:
        """What is printed of a row; a dash where there is no number."""
        if callable(self.format):
            return self.format(row)
        value = row[self.name]
        if isinstance(value, str | tuple | Quantity):
            return value
        if value is None or value != value:
            return DASH
        if self.format.endswith(" %"):
            return f"{100.0 * value:{self.format[:-2]}} %"
        return format(value, self.format)

    def head(self, write: Callable[[Cell], str]) -> str:
        """The heading with its unit, as ``write`` prints a cell."""
        unit = unit_text(self.unit)
        return write(self.heading or self.name) + (f" ({write(unit)})" if unit else "")


@dataclass(frozen=True)
class Table:
    """A table of a result."""

    columns: Sequence[Column]  # as printed; CSV and JSON have every column of the rows instead
    rows: pd.DataFrame
    label: str = ""  # what the table is, in a few words
    caption: str = ""  # sentence above the table of a page; the label where empty

    @classmethod
    def of_texts(
        cls,
        columns: Sequence[Column],
        rows: Sequence[Sequence[Cell]],
        label: str = "",
        caption: str = "",
    ) -> Table:
        """A table of cells, in the order of its columns."""
        frame = pd.DataFrame(list(rows), columns=[c.name for c in columns])
        return cls(columns, frame, label, caption)

    def __bool__(self) -> bool:
        return not self.rows.empty

    def without(self, *names: str) -> Table:
        """The table without some of its printed columns."""
        return replace(self, columns=[c for c in self.columns if c.name not in names])

    def cells(self) -> list[list[Cell]]:
        """What is printed, row by row."""
        return [[c.cell(row) for c in self.columns] for row in self.rows.to_dict("records")]

    def lines(self, *, heads: bool = True, brief: bool = False) -> list[str]:
        """Aligned lines for a terminal; ``brief``: without what is in small print."""
        cells = self.cells()
        if brief:
            cells = [[c[0] if isinstance(c, tuple) else c for c in row] for row in cells]
        shown = [[as_text(cell) for cell in row] for row in cells]
        if heads:
            shown.insert(0, [c.head(as_text) for c in self.columns])
        return aligned(shown, right=[k for k, c in enumerate(self.columns) if c.number])

    def html(self) -> Markup:
        """The table on a page; its first column names the rows."""
        heads, rows = Markup(""), []
        numbers = [Markup(' class="n"') if c.number else "" for c in self.columns]
        for c, n in zip(self.columns, numbers, strict=True):
            link = Markup('<a href="#words">{}</a>' if c.term else "{}")
            heads += Markup('<th scope="col"{}>{}</th>').format(n, link.format(c.head(as_html)))
        for cells in self.cells():
            first, *others = (as_html(cell) for cell in cells)
            row = Markup('<th scope="row" class="name">{}</th>').format(first)
            for cell, n in zip(others, numbers[1:], strict=True):
                shown = Markup(MINUS.sub("\N{MINUS SIGN}", cell)) if n else cell
                row += Markup("<td{}>{}</td>").format(n, shown)
            rows.append(Markup("<tr>{}</tr>").format(row))
        return Markup(
            '<div class="scroll" role="region" aria-label="Table: {}" tabindex="0">\n<table>\n'
            "<caption>{}</caption>\n<thead><tr>{}</tr></thead>\n<tbody>\n{}\n</tbody>\n</table>\n"
            "</div>"
        ).format(self.label, self.caption or self.label, heads, Markup("\n").join(rows))

    def _repr_html_(self) -> str:
        return str(self.html())

    def latex(self) -> list[str]:
        """Lines of a tabular with booktabs rules."""
        heads = [c.head(as_latex) for c in self.columns]
        rows = [[as_latex(cell) for cell in row] for row in self.cells()]
        head, *lines = (f"  {' & '.join(cells)} \\\\" for cells in (heads, *rows))
        begin = f"\\begin{{tabular}}{{{'l' * len(heads)}}}"
        rules = ("  \\toprule", head, "  \\midrule", *lines, "  \\bottomrule")
        return [begin, *rules, "\\end{tabular}"]


# --- a cell in each medium; text from files is made safe -----------------------------------------


def as_text(cell: Cell) -> str:
    """A cell in a terminal: names of quantities, small print in brackets."""
    if isinstance(cell, tuple):
        first, *others = (as_text(part) for part in cell)
        more = ", ".join(filter(None, others))
        return f"{first} ({more})" if more else first
    if isinstance(cell, Quantity):
        return printable(cell.name)
    return printable(cell.striptags() if isinstance(cell, Markup) else cell)


def as_html(cell: Cell) -> Markup:
    """A cell on a page: symbols of quantities, small print below."""
    if isinstance(cell, tuple):
        first, *others = (as_html(part) for part in cell)
        return first + Markup("").join(Markup(f"<small>{part}</small>") for part in others if part)
    if isinstance(cell, Quantity):
        symbol = Markup(cell.parameter.html) or escape(cell.parameter.name)
        state = truncate(cell.state, 40)
        return symbol + (Markup(" <bdi>{}</bdi>").format(state) if state else "")
    return escape(cell)


_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "°": r"$^\circ$",
    "\N{MINUS SIGN}": "$-$",
    **{c: "\\" + c for c in "&%$#_"},
}


def as_latex(cell: Cell) -> str:
    """A cell in LaTeX, which prints text from a file as it stands."""
    if isinstance(cell, Quantity):
        p = cell.parameter
        symbol = f"${p.symbol}$" if p.symbol else latex_text(p.name, 40)
        return f"{symbol} {latex_text(cell.state, 40)}".strip()
    return latex_text(as_text(cell), 300)


def latex_text(text: object, length: int = 120) -> str:
    """Text from a file that LaTeX prints as it stands."""
    return "".join(_LATEX.get(c, c) for c in truncate(text, length))


def truncate(text: object, length: int = 120) -> str:
    """One line without control or direction-changing characters, at most ``length`` long."""
    line = one_line(str(text))
    return line if len(line) <= length else line[: length - 1].rstrip() + "…"


# --- digits --------------------------------------------------------------------------------------


def number(
    value: float, low: float, high: float, *, log: bool = False, parameter: Parameter | None = None
) -> str:
    """A value with two digits of the width of its interval; the same wherever it is printed.

    ``log``: a positive scale, of which a value has at least two significant digits, and each end of
    an interval beyond a factor of 8 just these. A value without a width is printed as the parameter
    is, else with four digits.
    """
    if math.isnan(value):
        return DASH
    width = abs(high - low)
    if log and low > 0.0 and high > 8.0 * low:
        rounding = math.isfinite(high) and value < 1e-15 * high
        return "0" if rounding else f"{float(f'{value:.2g}'):g}"
    if not (width > 0.0 and math.isfinite(width)):
        return f"{value:.4g}" if parameter is None else parameter.number(value)
    digits = 1 - math.floor(math.log10(width))
    if log and value > 0.0:
        digits = max(digits, 1 - math.floor(math.log10(value)))
    if not -4 <= digits <= 8:
        return f"{value:.4g}"
    return f"{round(value, digits) + 0.0:.{max(digits, 0)}f}"


def three_digits(value: float) -> str:
    """A number with three digits; a dash where there is none."""
    return DASH if math.isnan(value) else f"{float(f'{value:.3g}'):g}"


def quantiles_of(row: Row, name: str) -> tuple[float, float, float]:
    """Median and ends of a 90 % interval, in columns such as ``mean_q50``."""
    return float(row[f"{name}_q50"]), float(row[f"{name}_q05"]), float(row[f"{name}_q95"])


def interval_texts(
    median: float, low: float, high: float, parameter: Parameter | None = None, *, log: bool = False
) -> tuple[str, str, str]:
    """Median and ends of an interval, with two digits of its width."""
    scale = log or (parameter is not None and parameter.logarithmic)
    middle, first, last = (
        number(v, low, high, log=scale, parameter=parameter) for v in (median, low, high)
    )
    return middle, first, last
