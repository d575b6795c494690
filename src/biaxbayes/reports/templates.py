"""Templates of pages and paragraphs, and figures as data URIs.

Text in a template of a page is escaped.
"""

from __future__ import annotations

import base64
import struct
from functools import cache
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

import biaxbayes
from biaxbayes.report_table import truncate
from biaxbayes.reports.text import GLOSSARY, SEVERAL_GLOSSARY, capital


@cache
def page_template(name: str, package: str = "biaxbayes.reports") -> Template:
    """The template of a file of a package."""
    environment = Environment(
        loader=PackageLoader(package, "."),
        autoescape=lambda name: str(name).endswith("html.jinja"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"one_line": truncate, "capital": capital}
    environment.policies["json.dumps_kwargs"] = {}  # unsorted: Bokeh refers to what came before
    environment.globals |= {
        "version": biaxbayes.__version__,
        "glossary": lambda terms: [(term, (GLOSSARY | SEVERAL_GLOSSARY)[term]) for term in terms],
    }
    return environment.get_template(name)


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
