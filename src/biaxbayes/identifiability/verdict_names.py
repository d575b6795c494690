"""What verdicts are called; nothing is imported for it."""

from __future__ import annotations

__all__ = [
    "BOUNDED",
    "COMBINATION",
    "FIXED",
    "IDENTIFIED",
    "NOT_IDENTIFIED",
    "NO_VERDICT",
    "ONE_SIDED",
    "PRIOR",
    "VERDICTS",
]

IDENTIFIED = "identified"
BOUNDED = "bounded"
ONE_SIDED = "one-sided"
COMBINATION = "only in combination"
PRIOR = "prior-dominated"
NOT_IDENTIFIED = "not identified"
NO_VERDICT = "no verdict"
FIXED = "fixed"
VERDICTS = (IDENTIFIED, ONE_SIDED, COMBINATION, PRIOR, NOT_IDENTIFIED, NO_VERDICT, FIXED)
