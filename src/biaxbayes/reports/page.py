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


@dataclass(frozen=True)
class Sentence:
    """A paragraph; ``look``: ``soft`` for remarks, ``paste`` for paragraphs of a paper."""

    text: str | Markup
    look: str = ""

    def html(self) -> Markup:
        """The paragraph; text that may come from a file has its own direction."""
        frame = "{}" if isinstance(self.text, Markup) else "<bdi>{}</bdi>"
        text = Markup(frame).format(self.text)
        look = Markup(' class="{}"').format(self.look) if self.look else ""
        return Markup("<p{}>{}</p>").format(look, text)


@dataclass(frozen=True)
class Heading:
    """A heading inside a section."""

    text: str

    def html(self) -> Markup:
        """The heading."""
        return Markup("<h3><bdi>{}</bdi></h3>").format(self.text)


@dataclass(frozen=True)
class Items:
    """A list of sentences; nothing where there are none."""

    texts: Sequence[str | Markup]

    def html(self) -> Markup:
        """The list."""
        items = Markup("\n").join(Markup("<li><bdi>{}</bdi></li>").format(t) for t in self.texts)
        return Markup("<ul>\n{}\n</ul>").format(items) if items else Markup("")


@dataclass(frozen=True)
class Notice:
    """A box: how far a result can be trusted (``converged``, ``tentative``, ``unusable``)."""

    state: str
    head: str
    items: Sequence[str | Markup] = ()
    text: str | Markup = ""

    def html(self) -> Markup:
        """The box."""
        text = Markup(" <bdi>{}</bdi>").format(self.text) if self.text else ""
        return Markup('<div class="state {}"><strong>{}</strong>{}{}</div>').format(
            self.state, self.head, text, Items(self.items).html()
        )


@dataclass(frozen=True)
class Facts:
    """Names and values."""

    pairs: Sequence[tuple[str, str]]

    def html(self) -> Markup:
        """The pairs as a list of definitions."""
        item = Markup("<dt>{}</dt><dd><bdi>{}</bdi></dd>")
        return Markup("<dl>\n{}\n</dl>").format(
            Markup("\n").join(item.format(name, value) for name, value in self.pairs)
        )


@dataclass(frozen=True)
class Figure:
    """A figure with its caption; a remark where its file is missing."""

    picture: Picture | None
    alt: str
    caption: str | Markup
    label: str = ""

    def html(self) -> Markup:
        """The figure."""
        if self.picture is None:
            return Sentence(f"The folder has no {self.label}.png to show here.", "soft").html()
        return Markup(
            '<figure>\n<div class="scroll" role="region" aria-label="Figure: {}" tabindex="0">\n'
            '<img src="{}" width="{}" height="{}" alt="{}">\n</div>\n'
            "<figcaption>{}</figcaption>\n</figure>"
        ).format(self.label or self.alt, *self.picture, self.alt, self.caption)


Block: TypeAlias = Sentence | Heading | Items | Notice | Facts | Figure | Table


def remarks(head: str, texts: Sequence[str | Markup]) -> Notice | None:
    """A box of remarks; None where there are none."""
    return Notice("tentative", head, texts) if texts else None


def titled(table: Table, about: str | Markup = "", heading: str = "") -> list[Block]:
    """A table below its label and a sentence on it; nothing of an empty table."""
    sentences = [Sentence(about)] if about else []
    return [Heading(heading or table.label), *sentences, table] if table else []


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
            replace(s, blocks=[b for b in s.blocks if b is not None]) for s in self.sections
        ]
        shown = [s for s in sections if s.blocks]
        titles = {s.id: s.title for s in shown} | {"words": "Words"}
        return page_template("page.html.jinja").render(page=self, shown=shown, sections=titles)
