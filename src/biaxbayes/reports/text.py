"""Text of quantities, tests and states for pages, and the glossary."""

from __future__ import annotations

import tomllib
from pathlib import Path

from biaxbayes.report_table import truncate
from biaxbayes.specimens.specimen import Specimen


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


def tests_in_words(specimen: Specimen) -> str:
    """What was tested, with the names of the pieces where there are several."""
    pieces = specimen.pieces
    if len(pieces) == 1:
        return specimen.experiment.words
    named = [f"{p.experiment.words} ({truncate(p.name, 40)})" for p in pieces[:NAMED]]
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


# --- glossary ------------------------------------------------------------------------------------

_TERMS = tomllib.loads(Path(__file__).with_name("glossary.toml").read_text(encoding="utf-8"))
GLOSSARY: dict[str, str] = _TERMS["run"]
"""Terms of a run's report, figures and tables."""
SEVERAL_GLOSSARY: dict[str, str] = _TERMS["several"]
"""Further terms of pages on several specimens, or laws."""
VERDICT_TERMS = tuple(GLOSSARY)[list(GLOSSARY).index("verdict") : list(GLOSSARY).index("fixed") + 1]
