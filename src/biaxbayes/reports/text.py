"""Text of quantities and states for pages and LaTeX, and the glossary."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup, escape

from biaxbayes.parameters import Quantity
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import one_line

# --- names on a page and in LaTeX; text from files made safe ------------------------

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


def truncate(text: object, length: int = 120) -> str:
    """One line without control or direction-changing characters, at most ``length`` long."""
    line = one_line(str(text))
    return line if len(line) <= length else line[: length - 1].rstrip() + "…"


def capital(text: str) -> str:
    """Text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


DERIVED_TEXTS = {
    "H": "structure tensor, {}",
    "stiffness_": "tangent stiffness, {}",
    "cauchy_": "Cauchy stress, {}",
}
SMALL_STRAIN = "small-strain stiffness, {}"


def derived_text(name: str) -> str:
    """Text for a derived quantity such as ``cauchy_x at 1.1``; other names unchanged."""
    stem, at, stretch = name.partition(" at ")
    text = DERIVED_TEXTS.get(stem[:-1])
    if text is None or stem[-1:] not in "xyz":
        return name
    if stem.startswith("stiffness_") and stretch in ("", "1"):
        return SMALL_STRAIN.format(stem[-1])
    return text.format(stem[-1]) + (f", at {stretch}" if at else "")


TEST_WORDS = {
    "biaxial": "a planar biaxial test",
    "strip x": "a strip pulled along x",
    "strip y": "a strip pulled along y",
    "tube": "a pressurised tube",
}
"""Kinds of test as a heading names them."""


def tests_in_words(specimen: Specimen) -> str:
    """What was tested, with the names of the pieces where there are several."""
    pieces = specimen.pieces
    if len(pieces) == 1:
        return TEST_WORDS[specimen.test]
    named = [f"{TEST_WORDS[p.test]} ({truncate(p.name, 40)})" for p in pieces[:NAMED]]
    more = f" and {len(pieces) - NAMED} more" if len(pieces) > NAMED else ""
    return f"{len(pieces)} pieces of one tissue: {', '.join(named)}{more}"


NAMED = 6
"""Pieces that a heading names."""
CONVERGENCE_TEXTS = {
    "converged": "Converged chains: the ensembles agree and hold enough independent draws.",
    "tentative": "Tentative: not converged. Do not publish these numbers; sample longer.",
    "unusable": "Not usable: the ensembles disagree, so the draws must not be used.",
}
"""How far a run can be trusted, by its state."""


def plural(number: int, noun: str) -> str:
    """A number with its noun, as ``2 specimens``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def as_html(quantity: Quantity | str) -> Markup:
    """Symbol of a quantity as HTML, or a name; what comes from a file is escaped."""
    if isinstance(quantity, str):
        return escape(truncate(quantity, 80))
    p = quantity.parameter
    symbol = Markup(p.html) if p.html else escape(p.name)
    label = truncate(quantity.state, 40)
    return symbol + (Markup(" <bdi>{}</bdi>").format(label) if label else "")


def as_latex(quantity: Quantity) -> str:
    """Symbol of a quantity as LaTeX."""
    p = quantity.parameter
    symbol = f"${p.symbol}$" if p.symbol else latex_text(p.name, 40)
    return f"{symbol} {latex_text(quantity.state, 40)}".strip()


def latex_text(text: object, length: int = 120) -> str:
    """Text from a file that LaTeX prints as it stands."""
    return "".join(_LATEX.get(c, c) for c in truncate(text, length))


def latex_tabular(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table with booktabs rules, from cells in LaTeX."""
    head, *lines = (f"  {' & '.join(cells)} \\\\" for cells in (heads, *rows))
    begin = f"\\begin{{tabular}}{{{'l' * len(heads)}}}"
    rules = ("  \\toprule", head, "  \\midrule", *lines, "  \\bottomrule")
    return [begin, *rules, "\\end{tabular}"]


# --- glossary ------------------------------------------------------------------------------------

_TERMS = tomllib.loads(Path(__file__).with_name("glossary.toml").read_text(encoding="utf-8"))
GLOSSARY: dict[str, str] = _TERMS["run"]
"""Terms of a run's report, figures and tables."""
SEVERAL_GLOSSARY: dict[str, str] = _TERMS["several"]
"""Further terms of pages on several specimens, or laws."""
