"""How quantities are called on a page, in Markdown and in LaTeX; text from files made safe."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

from biaxbayes.parameters import Quantity

__all__ = [
    "as_html",
    "as_latex",
    "as_markdown",
    "counted",
    "cut",
    "derived_words",
    "latex_text",
    "markdown_text",
]

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


def cut(text: object, length: int = 120) -> str:
    """One line without control or direction-changing characters, at most ``length`` long."""
    line = " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())
    return line if len(line) <= length else line[: length - 1].rstrip() + "…"


DERIVED = {
    "H": "structure tensor, {}",
    "stiffness_": "tangent stiffness, {}",
    "cauchy_": "Cauchy stress, {}",
}
SMALL_STRAIN = "small-strain stiffness, {}"


def derived_words(name: str) -> str:
    """What follows from parameters in words, as ``cauchy_x at 1.1``; other names as they are."""
    stem, at, stretch = name.partition(" at ")
    words = DERIVED.get(stem[:-1])
    if words is None or stem[-1:] not in "xyz":
        return name
    if stem.startswith("stiffness_") and stretch in ("", "1"):
        return SMALL_STRAIN.format(stem[-1])
    return words.format(stem[-1]) + (f", at {stretch}" if at else "")


def counted(number: int, noun: str) -> str:
    """So many of a thing."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def as_html(quantity: Quantity | str) -> Markup:
    """Symbol of a quantity as HTML, or a name; what comes from a file is escaped."""
    if isinstance(quantity, str):
        return escape(cut(quantity, 80))
    p = quantity.parameter
    symbol = Markup(p.html) if p.html else escape(p.name)
    label = cut(quantity.state, 40)
    return symbol + (Markup(" <bdi>{}</bdi>").format(label) if label else "")


def as_latex(quantity: Quantity) -> str:
    """Symbol of a quantity as LaTeX."""
    p = quantity.parameter
    symbol = f"${p.symbol}$" if p.symbol else latex_text(p.name, 40)
    return f"{symbol} {latex_text(quantity.state, 40)}".strip()


def as_markdown(name: str) -> str:
    """Name of a quantity as Markdown."""
    return markdown_text(name, 80)


def latex_text(text: object, length: int = 120) -> str:
    """Text from a file that LaTeX prints as it stands."""
    return "".join(_LATEX.get(c, c) for c in cut(text, length))


def markdown_text(text: object, length: int = 120) -> str:
    """Text from a file that Markdown, or the HTML made of it, prints as it stands."""
    escaped = re.sub(r"([\\`*_{}\[\]()#+!|~$])", r"\\\1", cut(text, length))
    return escaped.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
