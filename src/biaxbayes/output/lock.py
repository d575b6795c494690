"""One process at a time writes into a run folder."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from biaxbayes.errors import RunError

__all__ = ["NAME", "folder_lock"]

NAME = ".lock"
ATTEMPTS = 5
LONGEST = 4096


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder.

    The lock is a file that the operating system locks and that says whose it is. A process that
    dies, however it dies, loses the system's lock, so that what it leaves behind is known to be
    stale even when its process id has been given to another. Where a file system has no locks
    the process id and its starting time decide. An owner on another host cannot be looked
    up from here and is always believed.

    Raises
    ------
    RunError
        If another live process, or one on another host, holds it, or if the folder cannot be
        written.
    """
    path = folder / NAME
    try:
        handle = _acquire(path)
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror}); choose another --out"
        ) from None
    try:
        yield
    finally:
        # Removed while it is still held, so that nobody can take it in between.
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        os.close(handle)


def _acquire(path: Path) -> int:
    """A handle on the locked file, with our name in it."""
    for _ in range(ATTEMPTS):
        # A link in place of the lock is refused: it would lead the name of its owner elsewhere.
        handle = os.open(path, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o644)
        try:
            _refuse_owner(handle, path.parent)
            if _is_still(path, handle):
                _sign(handle)
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # released and removed by its owner while we were looking
    raise RunError(f"{path.parent}: the lock keeps changing hands; try again")


def _refuse_owner(handle: int, folder: Path) -> None:
    """Take the lock of an open file, or say who holds it."""
    free = _system_lock(handle)
    host, pid, began = _owner(handle)
    here = host in ("", socket.gethostname())
    if here and (free or (free is None and not _alive(pid, began))):
        return
    who = f"process {pid} on {host[:60]}" if host else "another process"
    raise RunError(
        f"{folder}: {who} is writing there; wait for it, choose another --out, or delete "
        f"{NAME} in that folder if the process is gone"
    )


def _system_lock(handle: int) -> bool | None:
    """Whether the system gives us the lock; None where the file system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _is_still(path: Path, handle: int) -> bool:
    """Whether a name still leads to the file that was opened."""
    try:
        there = path.stat(follow_symlinks=False)
    except FileNotFoundError:
        return False
    mine = os.fstat(handle)
    return (there.st_ino, there.st_dev) == (mine.st_ino, mine.st_dev)


def _sign(handle: int) -> None:
    pid = os.getpid()
    text = json.dumps({"host": socket.gethostname(), "pid": pid, "began": _began(pid)})
    os.ftruncate(handle, 0)
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, text.encode())


def _owner(handle: int) -> tuple[str, int, str]:
    """Host, process id and starting time in a lock; an empty host where it does not say."""
    os.lseek(handle, 0, os.SEEK_SET)
    try:
        owner = json.loads(os.read(handle, LONGEST))
        return str(owner["host"]), int(owner["pid"]), str(owner.get("began", ""))
    except (ValueError, KeyError, TypeError, OverflowError, AttributeError, RecursionError):
        return "", -1, ""  # just made, or half-written by a process that died


def _alive(pid: int, began: str) -> bool:
    if not 0 < pid < 2**31:
        return False
    if os.name == "nt":
        return True  # signal 0 is not a question there
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # somebody else's process
    return began in ("", _began(pid))


def _began(pid: int) -> str:
    """Starting time of a process in clock ticks since boot; empty where it cannot be known."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return ""
    # Field 22; the command in field 2 may hold spaces and brackets.
    return stat.rpartition(")")[2].split()[19]
