"""A page: a title and sections of sentences, tables and figures, in one template.

A page needs no network and runs no scripts. Text is escaped; sentences that are :class:`Markup`,
such as those of :func:`prose`, are written as they stand.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from markupsafe import Markup, escape

from biaxbayes.report_table import Table
from biaxbayes.reports.templates import Picture, page_template

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


def _html(block: Block) -> Markup:
    return block.html() if isinstance(block, Table) else block


@dataclass(frozen=True)
class Section:
    """A section of a page; a block that is None has nothing to say."""

    id: str
    title: str
    blocks: Sequence[Block | None]


# --- the page ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Page:
    """A result on one page."""

    kind: str  # in the title of the page, such as ``report``
    heading: str
    about: str | Markup  # sentence below the heading
    sections: Sequence[Section]  # those without blocks are left out
    terms: Sequence[str]  # of the glossary

    def html(self) -> str:
        """The page."""
        sections = [
            replace(s, blocks=[_html(b) for b in s.blocks if b is not None]) for s in self.sections
        ]
        shown = [s for s in sections if s.blocks]
        titles = {s.id: s.title for s in shown} | {"words": "Words"}
        return page_template("page.html.jinja").render(page=self, shown=shown, sections=titles)
