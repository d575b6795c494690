"""The emcee package without SciPy's statistics, which it takes for a move that is not used here.

They are half a second at every start and fifty megabytes in every worker. Emcee does without where
they are not installed, and that is what it finds while it is imported here. What it misses is put
back as a function that imports it when it is called.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

__all__ = ["emcee"]


@contextmanager
def _without(name: str) -> Iterator[None]:
    """Let a module that is not imported yet look as if it were not installed."""
    if name in sys.modules:
        yield
        return
    sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        if sys.modules.get(name) is None:
            del sys.modules[name]


def _kernel_estimate(*arguments: Any, **options: Any) -> Any:
    """Import ``gaussian_kde`` of SciPy, then call it."""
    from scipy.stats import gaussian_kde

    return gaussian_kde(*arguments, **options)


with _without("scipy.stats"):
    emcee: Any = import_module("emcee")
_kernel_move: Any = import_module("emcee.moves.kde")
if getattr(_kernel_move, "gaussian_kde", emcee) is None:
    _kernel_move.gaussian_kde = _kernel_estimate
