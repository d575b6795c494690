"""A page: a title and sections of sentences, tables and figures, in one template.

A page needs no network and runs no scripts. Text is escaped; sentences that are :class:`Markup`,
such as those of :func:`prose`, are written as they stand.
"""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup, escape

import biaxbayes
from biaxbayes.report_table import Table, truncate
from biaxbayes.reports.text import GLOSSARY, SEVERAL_GLOSSARY, capital

# --- templates and pictures ----------------------------------------------------------------------


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
    environment.globals["version"] = biaxbayes.__version__
    return environment.get_template(name)


class Picture(NamedTuple):
    """A PNG as a data URI, and its size in pixels."""

    uri: str
    width: int
    height: int


def pictures(folder: Path, stems: tuple[str, ...]) -> dict[str, Picture]:
    """Figures of a folder by stem, as far as a page with them stays below 5 MB."""
    left, out = 3_300_000, {}  # encoded, they are a third larger
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


# --- what a section consists of ------------------------------------------------------------------


def prose(text: str) -> Markup:
    """A sentence of this program; ``[words]`` lead to the glossary, ```code``` is code."""
    linked = re.sub(r"\[(.+?)\]", r'<a href="#words">\1</a>', str(escape(text)))
    return Markup(re.sub("`(.+?)`", r"<code>\1</code>", linked))


def paragraph(text: str | Markup, look: str = "") -> Markup:
    """A paragraph; ``look``: ``soft`` for remarks, ``paste`` for paragraphs of a paper.

    Text that may come from a file has its own direction.
    """
    own = text if isinstance(text, Markup) else Markup("<bdi>{}</bdi>").format(text)
    shown = Markup(' class="{}"').format(look) if look else ""
    return Markup("<p{}>{}</p>").format(shown, own)


def subheading(text: str) -> Markup:
    """A heading inside a section."""
    return Markup("<h3><bdi>{}</bdi></h3>").format(text)


def bullets(texts: Sequence[str | Markup]) -> Markup:
    """A list of sentences; nothing where there are none."""
    items = Markup("\n").join(Markup("<li><bdi>{}</bdi></li>").format(t) for t in texts)
    return Markup("<ul>\n{}\n</ul>").format(items) if items else Markup("")


def notice(
    state: str, head: str, items: Sequence[str | Markup] = (), text: str | Markup = ""
) -> Markup:
    """A box: how far a result can be trusted (``converged``, ``tentative``, ``unusable``)."""
    more = Markup(" <bdi>{}</bdi>").format(text) if text else ""
    box = Markup('<div class="state {}"><strong>{}</strong>{}{}</div>')
    return box.format(state, head, more, bullets(items))


def fact_list(pairs: Sequence[tuple[str, str]]) -> Markup:
    """Names and values, as a list of definitions."""
    item = Markup("<dt>{}</dt><dd><bdi>{}</bdi></dd>")
    return Markup("<dl>\n{}\n</dl>").format(Markup("\n").join(item.format(*p) for p in pairs))


def captioned(picture: Picture | None, alt: str, caption: str | Markup, label: str = "") -> Markup:
    """A figure with its caption; a remark where its file is missing."""
    if picture is None:
        return paragraph(f"The folder has no {label}.png to show here.", "soft")
    return Markup(
        '<figure>\n<div class="scroll" role="region" aria-label="Figure: {}" tabindex="0">\n'
        '<img src="{}" width="{}" height="{}" alt="{}">\n</div>\n'
        "<figcaption>{}</figcaption>\n</figure>"
    ).format(label or alt, *picture, alt, caption)


Block: TypeAlias = Markup | Table


def remarks(head: str, texts: Sequence[str | Markup]) -> Markup | None:
    """A box of remarks; None where there are none."""
    return notice("tentative", head, texts) if texts else None


def titled(table: Table, about: str | Markup = "", heading: str = "") -> list[Block]:
    """A table below its label and a sentence on it; nothing of an empty table."""
    sentences = [paragraph(about)] if about else []
    return [subheading(heading or table.label), *sentences, table] if table else []


class Section(NamedTuple):
    """A section of a page; a block that is None has nothing to say."""

    id: str
    title: str
    blocks: Sequence[Block | None]


# --- the page ------------------------------------------------------------------------------------


def page_html(
    kind: str, heading: str, about: str | Markup, sections: Sequence[Section], terms: Sequence[str]
) -> str:
    """A result on one page, with a sentence below its heading and terms of the glossary.

    ``kind`` is in its title, such as ``report``; sections without blocks are left out.
    """
    shown = []
    for section in sections:
        html = [b.html() if isinstance(b, Table) else b for b in section.blocks if b is not None]
        if html:
            shown.append(section._replace(blocks=html))
    page = {"kind": kind, "heading": heading, "about": about, "sections": shown, "terms": terms}
    return page_template("page.html.jinja").render(page, glossary=GLOSSARY | SEVERAL_GLOSSARY)
