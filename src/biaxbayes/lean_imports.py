"""Packages without the parts of them that take longer to import than all that is used of them.

What is imported here stays whole for whoever imports it otherwise.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from biaxbayes.executors.beside import alone

if TYPE_CHECKING:
    import emcee
    from arviz_stats.base import array_stats

__all__ = ["ARRAY_STATS_IMPORTS", "array_stats", "corner_package", "emcee", "imported_without"]


def imported_without(name: str, unwanted: str) -> Any:
    """Import a module as if another package, which its own can do without, were not installed.

    Parameters
    ----------
    name : str
        Of the module; of its package nothing else is kept, so that who imports it gets it whole.
    unwanted : str
        The other package. It is there all the same where it or the package is imported already,
        and where another thread might look for it meanwhile.

    Returns
    -------
    module
    """
    package = name.partition(".")[0]
    if package in sys.modules or unwanted in sys.modules or not alone():
        return import_module(name)
    sys.modules[unwanted] = None  # type: ignore[assignment]
    try:
        return import_module(name)
    finally:
        del sys.modules[unwanted]
        for part in [n for n in sys.modules if n.partition(".")[0] == package]:
            del sys.modules[part]


ARRAY_STATS_IMPORTS = ("scipy.stats", "scipy.signal")
"""What :data:`array_stats` needs and little else does: half a second, for a process of its own."""


@cache
def corner_package() -> Any:
    """The corner package without ArviZ, whose data no figure is drawn of."""
    return imported_without("corner", "arviz")


@cache
def _array_stats() -> Any:
    """ArviZ's statistics of arrays without xarray, whose arrays are not used."""
    return imported_without("arviz_stats.base", "xarray").array_stats


@cache
def _emcee() -> Any:
    """The emcee package without the move that draws from a kernel density of SciPy's statistics."""
    return imported_without("emcee", "scipy.stats")


def __getattr__(name: str) -> Any:
    if name == "array_stats":
        return _array_stats()
    if name == "emcee":
        return _emcee()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
