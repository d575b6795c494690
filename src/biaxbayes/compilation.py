"""How code is compiled, and where compiled code is cached between runs.

Numba notices a change of the file that a compiled function stands in, not of the files that it
calls. Keyed by all sources that are compiled, the cache can never serve a density of yesterday's
mechanics.

What compiled code calls is inlined. A function that is called is linked by its name: a process that
has compiled it for another caller, with other rounding, runs that code, and a process that finds
its caller in the cache does not, so that one seed gave other draws on the first run than on later
ones.

What NumPy can refuse is avoided in it: the text of the refusal is compiled as well, which takes two
seconds for ``numpy.diff`` or for a slice that is assigned to a slice.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import platformdirs
from numba.extending import register_jitable

from biaxbayes.errors import InputError
from biaxbayes.file_lock import try_lock

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
    raise InputError("NUMBA_DISABLE_JIT is set", remedy="unset it: the density has to be compiled")

logger = logging.getLogger("biaxbayes")


WITHIN: Any = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""How functions are compiled that only compiled code calls."""


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let compiled code call a Python function, inlined where it is called."""
    made: Callable[..., Any] = register_jitable(**WITHIN)(function)
    return made


def implementation(generic: Any, numba_type: Any) -> Callable[..., Any] | None:
    """Compiled implementation of a generic function by numba's type of the first argument."""
    kind = getattr(numba_type, "instance_class", object)
    return generic.dispatch(kind) if kind in generic.registry else None


# --- where compiled code is cached ----------------------------------------------------------------


COMPILED = ("laws/*.py", "mechanics/*.py", "error_model.py", "model/*.py", "populations/*.py")
FREE_BYTES = 100_000_000
"""Least free space of the disk of the cache; all laws take some 20 MB."""


def _cache_folder() -> Path | None:
    """Cache folder of this version of the sources; None, with a warning, if not writable."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for pattern in COMPILED:
        for source in sorted(Path(__file__).parent.glob(pattern)):
            digest.update(source.read_bytes())
    numba_config: Any = numba.config
    base = numba_config.CACHE_DIR or platformdirs.user_cache_dir("biaxbayes")
    folder = Path(base) / f"biaxbayes-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(_damaged(path) for path in folder.rglob("*.nb[ic]")):
            shutil.rmtree(folder)
            folder.mkdir()
        with tempfile.TemporaryFile(dir=folder):
            pass
        if shutil.disk_usage(folder).free < FREE_BYTES:
            raise OSError("the disk is full")
    except OSError as error:
        logger.warning(
            "biaxbayes: compiled code is not kept in %s (%s), so that every start takes longer; "
            "NUMBA_CACHE_DIR names another folder",
            folder,
            error.strerror or error,
        )
        return None
    return folder


def _damaged(path: Path) -> bool:
    """Whether a file of numba's cache has no end: all of them are pickles, which end with a dot."""
    try:
        with path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) != b"."
    except FileNotFoundError:  # replaced by another process
        return False
    except OSError:  # empty
        return True


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
        with contextlib.suppress(OSError):
            file = stack.enter_context((CACHE / ".filling").open("w"))
            while not try_lock(file.fileno()):
                time.sleep(0.1)
        if (CACHE / FILLED).exists():
            stack.close()
        yield
        with contextlib.suppress(OSError):
            (CACHE / FILLED).touch()
