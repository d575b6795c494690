"""Material laws: one law, one file.

:data:`LAWS` is the registry; a law is imported when it is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from biaxbayes.compilation import use_own_cache

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law

__all__ = ["DEFAULT_LAW", "LAWS", "law_named"]

use_own_cache()

DEFAULT_LAW = "goh"
LAWS = {"goh": ("biaxbayes.laws.goh", "GOHLaw")}
"""Where a law stands, by its name."""


def law_named(name: str, *, fibre_switch: bool = False) -> Law:
    """A law by its name."""
    module, kind = LAWS[name]
    law: Law = getattr(import_module(module), kind)(fibre_switch)
    return law
