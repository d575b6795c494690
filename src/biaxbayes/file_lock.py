"""One process writes into a folder: the operating system's lock, which ends with the process."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from biaxbayes.errors import RunError

NAME = ".lock"
RELEASE_SECONDS = 0.25
"""How long a lock that is just being released is waited for."""


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; RunError if another live process holds it."""
    lock = FileLock(folder / NAME)
    try:
        held = lock.acquire(timeout=RELEASE_SECONDS)
    except Timeout:
        raise RunError(
            f"{folder}: another process is writing there; wait for it, choose another `out`, or "
            f"delete {NAME} in that folder if the process is gone"
        ) from None
    except NotImplementedError:
        raise RunError(f"{folder}: its file system has no locks; choose another `out`") from None
    except OSError as error:
        problem = f"{folder}: cannot be written ({error.strerror}); choose another `out`"
        raise RunError(problem) from None
    with held:
        yield
