"""Looking at an HDF5 file before its data are read.

HDF5 can point to other files, keep data in them, loop, and claim more numbers than it holds.
No run of this program does any of that.
"""

from __future__ import annotations

from pathlib import Path

import h5py

__all__ = ["SuspiciousArchive", "check_archive"]

MOST_OBJECTS = 2_000
MOST_BYTES = 2_000_000_000
BYTES_A_BYTE = 50
"""Compression beyond this is not that of numbers that were measured or drawn."""


class SuspiciousArchive(Exception):
    """The file does what no archive of a run does."""


def check_archive(path: Path) -> None:
    """Walk through an HDF5 file without reading its data.

    Raises
    ------
    SuspiciousArchive
        If it leads outside itself, loops, or claims more data than it could hold.
    """
    most = min(MOST_BYTES, BYTES_A_BYTE * path.stat().st_size)
    seen: set[int] = set()
    claimed = 0
    with h5py.File(path, "r") as file:
        waiting: list[h5py.Group] = [file]
        while waiting:
            group = waiting.pop()
            for name in group:
                item = _inside(group, name)
                address = h5py.h5o.get_info(item.id).addr
                if address in seen:
                    raise SuspiciousArchive("its groups loop")
                seen.add(address)
                if isinstance(item, h5py.Group):
                    waiting.append(item)
                elif isinstance(item, h5py.Dataset):
                    claimed += _claimed_bytes(item)
                if claimed > most or len(seen) > MOST_OBJECTS:
                    raise SuspiciousArchive("it claims more data than it can hold")


def _inside(group: h5py.Group, name: str) -> h5py.HLObject:
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise SuspiciousArchive("it links to other data")
    return group[name]


def _claimed_bytes(dataset: h5py.Dataset) -> int:
    if dataset.is_virtual or dataset.external:
        raise SuspiciousArchive("its data are in another file")
    return int(dataset.size or 0) * int(dataset.dtype.itemsize)
