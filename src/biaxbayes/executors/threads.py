"""How many threads linear algebra takes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

import scipy.linalg  # noqa: F401  # whose library is to be found, too
from threadpoolctl import ThreadpoolController

__all__ = ["one_blas_thread"]


@cache
def _libraries() -> ThreadpoolController:
    """The libraries of this process, looked for once: that takes as long as a small task."""
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Let matrices be multiplied by one thread within a ``with`` statement: they are small."""
    limited: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limited
