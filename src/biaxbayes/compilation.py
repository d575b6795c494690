"""How code is compiled, and where compiled code is kept between runs.

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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import platformdirs
from numba.extending import overload, register_jitable

__all__ = ["first_alone", "inlined", "picked", "use_own_cache"]


WITHIN: Any = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""How functions are compiled that only compiled code calls."""


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let compiled code call a Python function, inlined where it is called."""
    made: Callable[..., Any] = register_jitable(**WITHIN)(function)
    return made


def picked(stub: Callable[..., Any]) -> Callable[..., Any]:
    """Let compiled code call ``stub``; what is decorated picks the function by argument types."""
    made: Callable[..., Any] = overload(stub, jit_options=WITHIN)
    return made


FILLED = "filled"


def use_own_cache() -> None:
    """Keep compiled code in the user's cache, unless ``NUMBA_CACHE_DIR`` says where."""
    config: Any = numba.config
    if config.CACHE_DIR:
        return
    digest = hashlib.sha256()
    package = Path(__file__).parent
    digest.update(Path(__file__).read_bytes())
    for folder in ("laws", "mechanics", "sampling", "model", "populations"):
        for source in sorted((package / folder).glob("*.py")):
            digest.update(source.read_bytes())
    config.CACHE_DIR = str(Path(platformdirs.user_cache_dir("biaxbayes")) / digest.hexdigest()[:16])


@contextlib.contextmanager
def first_alone() -> Iterator[None]:
    """Let one process fill an empty cache while the others that use it wait.

    Numba's cache is not made for several processes that compile the same function at once. Where
    the folder cannot be written or locked, nobody waits.
    """
    config: Any = numba.config
    folder = Path(config.CACHE_DIR or ".")
    if not config.CACHE_DIR or (folder / FILLED).exists():
        yield
        return
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            from filelock import FileLock

            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(FileLock(folder / ".filling", fallback_to_soft=False))
        if (folder / FILLED).exists():
            stack.close()
        yield
        with contextlib.suppress(OSError):
            (folder / FILLED).touch()
