"""One process at a time writes into a run folder."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from biaxbayes.errors import RunError

if TYPE_CHECKING:
    from filelock import BaseFileLock


NAME = ".lock"
RELEASE_SECONDS = 0.25
"""How long a lock that is just being released and removed is waited for."""
LONGEST = 4096
NOT_A_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


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
        lock = _acquired(path)
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror}); choose another `out`"
        ) from None
    try:
        yield
    finally:
        # Removed while it is still locked, so that nobody can take it in between.
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        if lock is not None:
            lock.release()


def _acquired(path: Path) -> BaseFileLock | None:
    """The lock of a file that has our name in it; None where the file system has no locks."""
    from filelock import FileLock, Timeout

    host, pid, began = _owner(path)
    if host not in ("", socket.gethostname()):
        raise _in_use(path.parent, host, pid)
    lock = FileLock(
        path,
        timeout=RELEASE_SECONDS,
        poll_interval=RELEASE_SECONDS / 5,
        thread_local=False,
        fallback_to_soft=False,
        on_acquired=_sign,
    )
    try:
        lock.acquire()
    except Timeout:
        raise _in_use(path.parent, *_owner(path)[:2]) from None
    except OSError:  # no locks there, or no way to write; which of them is seen on opening
        # A link in place of the lock is refused: it would lead our name elsewhere.
        handle = os.open(path, os.O_CREAT | os.O_RDWR | NOT_A_LINK, 0o644)
        try:
            if _alive(pid, began):
                raise _in_use(path.parent, host, pid) from None
            _sign(handle)
        finally:
            os.close(handle)
        return None
    return lock


def _in_use(folder: Path, host: str, pid: int) -> RunError:
    who = f"process {pid} on {host[:60]}" if host else "another process"
    return RunError(
        f"{folder}: {who} is writing there; wait for it, choose another `out`, or delete "
        f"{NAME} in that folder if the process is gone"
    )


def _sign(handle: int) -> None:
    pid = os.getpid()
    text = json.dumps({"host": socket.gethostname(), "pid": pid, "began": _began(pid)})
    os.ftruncate(handle, 0)
    os.lseek(handle, 0, os.SEEK_SET)
    os.write(handle, text.encode())


def _owner(path: Path) -> tuple[str, int, str]:
    """Host, process id and starting time in a lock; an empty host where it does not say."""
    try:
        handle = os.open(path, os.O_RDONLY | NOT_A_LINK)
        try:
            owner = json.loads(os.read(handle, LONGEST))
        finally:
            os.close(handle)
        return str(owner["host"]), int(owner["pid"]), str(owner.get("began", ""))
    except OSError:
        return "", -1, ""  # not there, or hidden while another holds it, as on Windows
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
