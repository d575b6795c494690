"""Things that are made once a test session, whichever of its worker processes comes first."""

import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from filelock import FileLock

_PLACE: list[Path] = []


def use(folder: Path) -> None:
    """Keep what is made in a folder that all workers of the session see."""
    folder = folder / "shared"
    folder.mkdir(exist_ok=True)
    _PLACE[:] = [folder]


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """Path that ``make`` is to fill, filled already where another test needed it."""
    path, done = _PLACE[0] / name, _PLACE[0] / f"{name}.done"
    with FileLock(_PLACE[0] / f"{name}.lock"):
        if not done.exists():
            make(path)
            done.touch()
    return path


def cached(key: Any, find: Callable[[], Any]) -> Any:
    """What ``find`` returns for a key that can be pickled; everyone gets a copy of their own."""
    name = hashlib.sha256(pickle.dumps(key)).hexdigest()[:16]
    path = made_once(name, lambda path: path.write_bytes(pickle.dumps(find())))
    return pickle.loads(path.read_bytes())


def local_cluster(workers: int):
    """A Dask scheduler with workers in processes of their own."""
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"}, memory_limit=0,
    )  # fmt: skip
