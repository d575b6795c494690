"""Memory of this process that is free and should go back to the system."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress

__all__ = ["own_garbage", "return_arrays", "return_memory"]

M_MMAP_THRESHOLD = -3
"""Of ``malloc.h`` in the GNU C library."""
LARGE_ARRAY = 2**20
"""Bytes. The library's own limit grows up to 32 MB with what is freed: a worker of ``batch`` holds
337 to 349 MB with this one where it holds 346 to 360, and takes no longer."""


def return_memory() -> None:
    """Give back what the C library keeps of freed memory, where it can be asked to."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def return_arrays() -> None:
    """Have large arrays of this process go back as soon as they are freed, for all its life."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_ARRAY)


@contextmanager
def own_garbage() -> Iterator[None]:
    """Collect the garbage of a figure, a heap of small parts, once and apart from all else.

    Within, Python's collector would go through everything that is in memory several times. What was
    free before is given back to the system: the picture of a page alone takes 20 MB.
    """
    return_memory()
    if not gc.isenabled():  # within another
        yield
        return
    gc.disable()
    gc.freeze()
    try:
        yield
    finally:
        for _ in range(2):  # contours let go of their panels only once they have gone
            gc.collect()
        gc.unfreeze()
        gc.enable()
