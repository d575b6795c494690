"""How quantities are called on a page, in Markdown and in LaTeX; text from files made safe."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

__all__ = ["as_html", "as_latex", "as_markdown", "cut", "latex_text", "markdown_text"]

_PLAIN = {
    "C1": ("<i>C</i><sub>1</sub>", "C_1"),
    "k1": ("<i>k</i><sub>1</sub>", "k_1"),
    "k2": ("<i>k</i><sub>2</sub>", "k_2"),
    "alpha": ("<i>α</i>", r"\alpha"),
    "kappa": ("<i>κ</i>", r"\kappa"),
    "mounting_stretch_x": ("<i>λ</i><sub>m,x</sub>", r"\lambda_{\mathrm{m},x}"),
    "mounting_stretch_y": ("<i>λ</i><sub>m,y</sub>", r"\lambda_{\mathrm{m},y}"),
    "mounting_force_x": ("<i>p</i><sub>0,x</sub>", "p_{0,x}"),
    "mounting_force_y": ("<i>p</i><sub>0,y</sub>", "p_{0,y}"),
    "noise_sd": ("<i>w</i>", "w"),
    "noise_growth": ("<i>b</i>", "b"),
}
MEANING = {
    "C1": "matrix stiffness",
    "k1": "fibre stiffness",
    "k2": "fibre stiffening",
    "alpha": "fibre angle from x",
    "kappa": "fibre dispersion",
    "mounting_stretch_x": "mounting stretch in x",
    "mounting_stretch_y": "mounting stretch in y",
    "mounting_force_x": "load at the mounted state, x",
    "mounting_force_y": "load at the mounted state, y",
    "noise_sd": "standard deviation of the errors",
    "noise_growth": "growth of the errors with the load",
    "edge_x": "edge in x over the stated one",
    "edge_y": "edge in y over the stated one",
    "thickness": "thickness over the stated one",
    "load_offset_x": "load offset in x",
    "load_offset_y": "load offset in y",
}
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


def split(name: str) -> tuple[str, str]:
    """Quantity and protocol label of a column such as ``mounting_stretch_x[2:1]``."""
    stem, _, rest = name.partition("[")
    return stem, cut(rest.removesuffix("]"), 40)


def as_html(name: str) -> Markup:
    """Symbol of a quantity as HTML; a label from the file is escaped."""
    stem, label = split(name)
    symbol = Markup(_PLAIN[stem][0]) if stem in _PLAIN else escape(cut(stem, 40))
    return symbol + (Markup(" <bdi>{}</bdi>").format(label) if label else "")


def as_latex(name: str) -> str:
    """Symbol of a quantity as LaTeX."""
    stem, label = split(name)
    symbol = f"${_PLAIN[stem][1]}$" if stem in _PLAIN else latex_text(stem, 40)
    return f"{symbol} {latex_text(label)}".strip()


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
