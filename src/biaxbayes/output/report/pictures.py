"""Figures of a run folder as data URIs, so that the page needs nothing beside itself."""

from __future__ import annotations

import base64
import struct
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Picture", "pictures"]

MAGIC = b"\x89PNG\r\n\x1a\n"
TOTAL_BYTES = 3_300_000
"""Of the files; a third more once encoded. The page stays below 5 MB."""


@dataclass(frozen=True)
class Picture:
    """A PNG of the run folder.

    Attributes
    ----------
    uri : str
    width, height : int
        Pixels.
    """

    uri: str
    width: int
    height: int


def pictures(folder: Path, stems: tuple[str, ...]) -> dict[str, Picture]:
    """Figures that are there, by stem; the first ones are kept where all would be too large."""
    left, out = TOTAL_BYTES, {}
    for stem in stems:
        path = folder / f"{stem}.png"
        try:
            if path.is_symlink() or not path.is_file() or path.stat().st_size > left:
                continue
            data = path.read_bytes()
        except OSError:
            continue
        if data[:8] != MAGIC or data[12:16] != b"IHDR" or len(data) > left:
            continue
        left -= len(data)
        width, height = struct.unpack(">II", data[16:24])
        uri = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
        out[stem] = Picture(uri, width, height)
    return out
