"""One process at a time writes into a run folder."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from biaxbayes.errors import RunError

__all__ = ["NAME", "folder_lock"]

NAME = ".lock"


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder.

    The lock is a file with the owner's host and process id, made in one indivisible step. A
    lock whose process no longer lives on this host is stale and taken over.

    Raises
    ------
    RunError
        If another live process, or one on another host, holds it.
    """
    path = folder / NAME
    mine = json.dumps({"host": socket.gethostname(), "pid": os.getpid()})
    for _ in range(3):
        try:
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            _clear_stale(path)
            continue
        except OSError as error:
            raise RunError(
                f"{folder}: cannot be written ({error.strerror}); choose another --out"
            ) from None
        with os.fdopen(handle, "w") as file:
            file.write(mine)
        break
    else:
        raise RunError(f"{folder}: the lock keeps changing hands; try again")
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _clear_stale(path: Path) -> None:
    """Remove a stale lock, or say who holds it."""
    try:
        text = path.read_text()
    except FileNotFoundError:
        return
    try:
        owner = json.loads(text)
        host, pid = str(owner["host"]), int(owner["pid"])
    except (ValueError, KeyError, TypeError):
        host, pid = socket.gethostname(), -1  # half-written by a process that died
    if host == socket.gethostname() and not _alive(pid):
        path.unlink(missing_ok=True)
        return
    raise RunError(
        f"{path.parent}: process {pid} on {host[:60]} is writing there; wait for it, choose "
        f"another --out, or delete {NAME} if that process is gone"
    )


def _alive(pid: int) -> bool:
    if pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
