"""Templates of pages and paragraphs, and their contents: cells of tables, figures as data URIs.

Text in a template of a page is escaped.
"""

from __future__ import annotations

import base64
import struct
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

import biaxbayes
from biaxbayes.parameters import Quantity
from biaxbayes.reports.text import GLOSSARY, SEVERAL_GLOSSARY, as_html, capital, truncate

Cell: TypeAlias = str | Quantity | Markup | tuple[str | Markup, ...]
"""A text, a quantity (its symbol), or a text with further ones in small print below."""
Row: TypeAlias = tuple[Cell, ...]
"""Cells of a row of a table; the first names it."""


@cache
def page_template(name: str) -> Template:
    """The template of a file beside this one."""
    environment = Environment(
        loader=PackageLoader("biaxbayes.reports", "."),
        autoescape=lambda name: str(name).endswith("html.jinja"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"symbol": as_html, "cell": _cell}
    environment.filters |= {"one_line": truncate, "capital": capital}
    terms = list(GLOSSARY)
    environment.globals |= {
        "version": biaxbayes.__version__,
        "glossary": lambda terms: [(term, (GLOSSARY | SEVERAL_GLOSSARY)[term]) for term in terms],
        "run_terms": terms,
        "verdict_terms": terms[terms.index("verdict") : terms.index("fixed") + 1],
    }
    return environment.get_template(name)


def _cell(cell: Cell) -> str | Markup:
    if isinstance(cell, Quantity):
        return as_html(cell)
    if isinstance(cell, tuple):
        first, *others = cell
        small = Markup("").join(Markup("<small>{}</small>").format(text) for text in others if text)
        return Markup("{}").format(first) + small
    return cell


TOTAL_BYTES = 3_300_000
"""Largest size of all figures together; a third more once encoded. The page stays below 5 MB."""


class Picture(NamedTuple):
    """A PNG as a data URI, and its size in pixels."""

    uri: str
    width: int
    height: int


def pictures(folder: Path, stems: tuple[str, ...]) -> dict[str, Picture]:
    """Figures of a folder by stem, as far as they are not too large together."""
    left, out = TOTAL_BYTES, {}
    for stem in stems:
        path = folder / f"{stem}.png"
        if path.is_file() and path.stat().st_size <= left:
            data = path.read_bytes()
            left -= len(data)
            out[stem] = embedded(data)
    return out


def embedded(data: bytes) -> Picture:
    """A PNG as a part of a page."""
    width, height = struct.unpack(">II", data[16:24])
    return Picture("data:image/png;base64," + base64.b64encode(data).decode("ascii"), width, height)
