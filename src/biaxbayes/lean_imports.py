"""Packages without the parts of them that take longer to import than all that is used of them.

What is imported here stays whole for whoever imports it otherwise.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from biaxbayes.executors.beside import alone

if TYPE_CHECKING:
    import emcee
    from arviz_stats.base import array_stats

__all__ = ["ARRAY_STATS_IMPORTS", "array_stats", "corner_package", "emcee", "imported_without"]


class _Later:
    """What a module holds, which is imported once this is called or looked into."""

    def __init__(self, module: str, name: str) -> None:
        self._of = module, name

    def _found(self) -> Any:
        module, name = self._of
        return getattr(import_module(module), name)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self._found()(*arguments, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found(), name)


class _Deferred(ModuleType):
    """A module that is imported once something of it is called or looked into."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Later(self.__name__, name)


def imported_without(name: str, unwanted: str, *deferred: ModuleType) -> Any:
    """Import a module as if another package, which its own can do without, were not installed.

    Parameters
    ----------
    name : str
        Of the module; of its package nothing else is kept, so that who imports it gets it whole.
    unwanted : str
        The other package. It is there all the same where it or the package is imported already,
        and where another thread might look for it meanwhile.
    *deferred : module
        Stand-ins for modules that the package takes little of.

    Returns
    -------
    module
    """
    package = name.partition(".")[0]
    if package in sys.modules or unwanted in sys.modules or not alone():
        return import_module(name)
    stand_ins = {one.__name__: one for one in deferred if one.__name__ not in sys.modules}
    sys.modules.update({unwanted: None} | stand_ins)  # type: ignore[arg-type]
    try:
        return import_module(name)
    finally:
        for one in [unwanted, *stand_ins]:
            del sys.modules[one]
        for part in [n for n in sys.modules if n.partition(".")[0] == package]:
            del sys.modules[part]


ARRAY_STATS_IMPORTS = ("scipy.fftpack", "scipy.optimize", "scipy.sparse")
"""What :data:`array_stats` needs and little else does: for a process of its own."""


@cache
def corner_package() -> Any:
    """The corner package without ArviZ, whose data no figure is drawn of, and without windows."""
    return imported_without("corner", "arviz", _Deferred("matplotlib.pyplot"))


@cache
def _array_stats() -> Any:
    """ArviZ's statistics of arrays without xarray, whose arrays are not used.

    Of SciPy, what takes 0.3 s to import and 30 MB waits until it is asked for: by densities, ranks.
    """
    names = ("interpolate", "signal", "signal.windows", "stats")
    waiting = [_Deferred(f"scipy.{name}") for name in names]
    return imported_without("arviz_stats.base", "xarray", *waiting).array_stats


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
