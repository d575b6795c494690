"""Tables put between the markers of a page."""

from __future__ import annotations

from pathlib import Path

from biaxbayes.specimens.text_file import atomic_write_text

__all__ = ["put"]


def put(page: Path, marker: str, text: str) -> None:
    """Replace what stands between ``<!-- marker: begin -->`` and ``<!-- marker: end -->``."""
    begin, end = f"<!-- {marker}: begin -->", f"<!-- {marker}: end -->"
    old = page.read_text()
    head, tail = old[: old.index(begin) + len(begin)], old[old.index(end) :]
    atomic_write_text(page, f"{head}\n\n{text}\n\n{tail}")
