"""Locks of the operating system, which end with the process; one process writes into a folder."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from biaxbayes.errors import RunError

NAME = ".lock"
RELEASE_SECONDS = 0.25
"""How long a lock that is just being released and removed is waited for."""
MAX_OWNER_BYTES = 4096
NOT_A_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

if sys.platform == "win32":
    import msvcrt

    def try_lock(handle: int) -> bool:
        """Lock an open file unless another holds its lock; closing the file releases it."""
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        return True

else:
    import fcntl

    def try_lock(handle: int) -> bool:
        """Lock an open file unless another holds its lock; OSError without support for locks."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; RunError if another live process holds it.

    The operating system releases its lock when a process dies, so a left-over file is known to
    be stale even if its process id was reused. Without such locks the process id and its start
    time decide. An owner on another host cannot be checked and counts as alive.
    """
    path = folder / NAME
    try:
        handle = _acquire(path)
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror}); choose another `out`"
        ) from None
    try:
        yield
    finally:
        # Removed while it is locked, so that nobody can take it in between.
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        os.close(handle)


def _acquire(path: Path) -> int:
    """The handle of a lock that is ours and has our name in it."""
    end = time.monotonic() + RELEASE_SECONDS
    while True:
        host, pid, began = _owner(path)
        if host not in ("", socket.gethostname()):
            raise _in_use(path.parent, host, pid)
        # A link in place of the lock is refused: it would lead our name elsewhere.
        handle = os.open(path, os.O_CREAT | os.O_RDWR | NOT_A_LINK, 0o644)
        try:
            try:
                free = try_lock(handle)
            except OSError:  # a file system without locks
                free = not _alive(pid, began)
            if free and _is_at(path, handle):
                own = os.getpid()
                text = json.dumps({"host": socket.gethostname(), "pid": own, "began": _began(own)})
                os.ftruncate(handle, 0)
                os.lseek(handle, 0, os.SEEK_SET)
                os.write(handle, text.encode())
                return handle
        except OSError:
            os.close(handle)
            raise
        os.close(handle)
        if time.monotonic() > end:
            raise _in_use(path.parent, *_owner(path)[:2])
        time.sleep(RELEASE_SECONDS / 5)


def _is_at(path: Path, handle: int) -> bool:
    """True if an open file still has this name: its owner may have removed it."""
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


def _in_use(folder: Path, host: str, pid: int) -> RunError:
    who = f"process {pid} on {host[:60]}" if host else "another process"
    return RunError(
        f"{folder}: {who} is writing there; wait for it, choose another `out`, or delete "
        f"{NAME} in that folder if the process is gone"
    )


def _owner(path: Path) -> tuple[str, int, str]:
    """Host, process id and starting time in a lock; an empty host where it does not say."""
    try:
        handle = os.open(path, os.O_RDONLY | NOT_A_LINK)
        try:
            owner = json.loads(os.read(handle, MAX_OWNER_BYTES))
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
