"""A page: a title and sections of sentences, tables and figures, in one template.

A page needs no network and runs no scripts. Text is escaped; sentences that are :class:`Markup`,
such as those of :func:`prose`, are written as they stand.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    id: str
    title: str
    blocks: Sequence[Block]


# --- the page ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Page:
    """A result on one page.

    Attributes
    ----------
    kind : str
        In the title of the page, such as ``report``.
    heading : str
    about : str or Markup
        Sentence below the heading.
    sections : sequence of Section
        Those without blocks are left out.
    terms : sequence of str
        Of the glossary.
    """

    kind: str
    heading: str
    about: str | Markup
    sections: Sequence[Section]
    terms: Sequence[str]

    def html(self) -> str:
        """The page."""
        shown = [s for s in self.sections if s.blocks]
        titles = {s.id: s.title for s in shown} | {"words": "Words"}
        return page_template("page.html.jinja").render(page=self, shown=shown, sections=titles)
