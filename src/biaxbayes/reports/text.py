"""Text of quantities, tests and states for pages, and the glossary."""

from __future__ import annotations

import tomllib
from pathlib import Path


def capital(text: str) -> str:
    """Text with a capital at its beginning."""
    return text[:1].upper() + text[1:]


DERIVED = {"H": "structure tensor", "stiffness_": "tangent stiffness", "cauchy_": "Cauchy stress"}


def derived_text(name: str) -> str:
    """Text for a derived quantity such as ``cauchy_x at 1.1``; other names unchanged."""
    stem, at, stretch = name.partition(" at ")
    text, axis = DERIVED.get(stem[:-1]), stem[-1:]
    if text is None or axis not in "xyz":
        return name
    if stem.startswith("stiffness_") and stretch in ("", "1"):
        return f"small-strain stiffness, {axis}"
    return f"{text}, {axis}" + (f", at {stretch}" if at else "")


CONVERGENCE_TEXTS = {
    "converged": "Converged chains: the ensembles agree and hold enough independent draws.",
    "tentative": "Tentative: not converged. Do not publish these numbers; sample longer.",
    "unusable": "Not usable: the ensembles disagree, so the draws must not be used.",
}
"""How far a run can be trusted, by its state."""


def text_or_empty(value: object) -> str:
    """A text of a table; empty where it has none, but NaN."""
    return value if isinstance(value, str) else ""


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
