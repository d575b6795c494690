"""Compilation by numba, and the cache of compiled code.

Compiled code avoids NumPy functions that can raise, since their messages are compiled as well,
which takes two seconds for ``numpy.diff`` or for a slice that is assigned to a slice.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import platformdirs
from filelock import FileLock
from numba.extending import register_jitable

from biaxbayes.errors import InputError

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
    raise InputError("NUMBA_DISABLE_JIT is set", remedy="unset it: the density has to be compiled")

logger = logging.getLogger("biaxbayes")


WITHIN: Any = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that only compiled code calls."""


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let compiled code call a Python function, inlined where it is called.

    Numba links calls by name: with code that was compiled for another caller, with other rounding,
    the first run of a seed would give other draws than later ones, which load it from the cache.
    """
    made: Callable[..., Any] = register_jitable(**WITHIN)(function)
    return made


def implementation(generic: Any, numba_type: Any) -> Callable[..., Any] | None:
    """Compiled implementation of a generic function by numba's type of the first argument."""
    kind = getattr(numba_type, "instance_class", object)
    return generic.dispatch(kind) if kind in generic.registry else None


COMPILED = ("laws/*.py", "mechanics/*.py", "model/*.py")


def _cache_folder() -> Path | None:
    """Cache folder of this version of the sources; None, with a warning, if not writable.

    Numba does not notice a change of the files that a compiled function calls, such as a law.
    """
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for pattern in COMPILED:
        for source in sorted(Path(__file__).parent.glob(pattern)):
            digest.update(source.read_bytes())
    config: Any = numba.config
    base = config.CACHE_DIR or platformdirs.user_cache_dir("biaxbayes")
    folder = Path(base) / f"biaxbayes-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        logger.warning(
            "biaxbayes: compiled code cannot be cached in %s (%s), so every start takes longer; "
            "NUMBA_CACHE_DIR names another folder",
            folder,
            error.strerror or error,
        )
        return None
    return folder


CACHE = _cache_folder()
_deciding = threading.Lock()


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` with our cache folder, which numba reads as it decorates a function."""

    def decorated(function: Callable[..., Any]) -> Any:
        config: Any = numba.config
        if CACHE is None:
            return numba.njit(**options)(function)
        with _deciding:
            before, config.CACHE_DIR = config.CACHE_DIR, str(CACHE)
            try:
                return numba.njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = before

    return decorated


FILLED = "filled"


@contextlib.contextmanager
def first_alone() -> Iterator[None]:
    """Let one process fill an empty cache first: numba's cache allows no concurrent writers."""
    if CACHE is None or (CACHE / FILLED).exists():
        yield
        return
    with contextlib.ExitStack() as stack:
        # file systems of clusters may have no locks, for which filelock raises NotImplementedError
        with contextlib.suppress(OSError, NotImplementedError):
            stack.enter_context(FileLock(CACHE / ".filling"))
        if (CACHE / FILLED).exists():
            stack.close()
        yield
        with contextlib.suppress(OSError):
            (CACHE / FILLED).touch()
