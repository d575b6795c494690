"""What verdicts are called; nothing is imported for it."""

from __future__ import annotations

__all__ = [
    "BOUNDED",
    "COMBINATION",
    "FIXED",
    "IDENTIFIED",
    "NOT_IDENTIFIED",
    "NO_VERDICT",
    "VERDICTS",
]

IDENTIFIED = "identified"
BOUNDED = "bounded"
COMBINATION = "only in combination"
NOT_IDENTIFIED = "not identified"
NO_VERDICT = "no verdict"
FIXED = "fixed"
VERDICTS = (IDENTIFIED, BOUNDED, COMBINATION, NOT_IDENTIFIED)
"""What is reported; beside them :data:`NO_VERDICT` of chains that have not converged, and
:data:`FIXED`."""
