"""What the studies share: where things are, and pieces of a Markdown page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from biaxbayes.text_files import atomic_write_text, write_csv

__all__ = [
    "DATA",
    "DOCS",
    "ROOT",
    "SPECIMENS",
    "image",
    "number",
    "put",
    "table",
    "write_table",
]

ROOT = Path(__file__).resolve().parents[2]
DATA, DOCS = ROOT / "data", ROOT / "docs"
SPECIMENS = ("donor1", "donor2", "donor2-intima", "donor2-media", "donor2-adventitia")
"""The shipped specimens without hooks."""


def table(header: Sequence[str], rows: Sequence[Sequence[object]], *, left: int = 1) -> str:
    """A pipe table; the first ``left`` columns are text, the others numbers."""
    rule = "|" + "---|" * left + "---:|" * (len(header) - left)
    head, *lines = ("| " + " | ".join(str(c) for c in line) + " |" for line in (header, *rows))
    return "\n".join([head, rule, *lines]) + "\n"


def write_table(folder: Path, name: str, header: Sequence[str], rows: Any) -> str:
    """Write every row of a long table to ``tables/name.csv`` of a folder of pages; its link."""
    import pandas as pd

    write_csv(folder / "tables" / f"{name}.csv", pd.DataFrame(rows, columns=list(header)), digits=4)
    return f"tables/{name}.csv"


def image(name: str, text: str, alt: str = "") -> str:
    """An image of the page's own figures, with its caption; ``alt`` where that is long."""
    return f"![{alt or text}](figures/{name})\n\n*{text}*\n"


def number(value: float, digits: int = 4) -> str:
    """A number with so many significant digits, never in powers of ten."""
    if value == 0.0:
        return "0"
    text = f"{value:.{digits}g}"
    if "e" in text:
        text = f"{value:.0f}" if abs(value) >= 1 else f"{value:.6f}".rstrip("0")
    return text


def put(page: Path, name: str, text: str) -> None:
    """Replace what stands between ``<!-- name -->`` and ``<!-- /name -->`` on a page.

    Raises
    ------
    ValueError
        If the page has no such place; it stays as it is.
    """
    old = page.read_text(encoding="utf-8")
    head, begin, rest = old.partition(f"<!-- {name} -->")
    _, end, tail = rest.partition(f"<!-- /{name} -->")
    if not end:
        raise ValueError(f"{page} has no <!-- {name} --> ... <!-- /{name} -->")
    atomic_write_text(page, f"{head}{begin}\n\n{text.strip()}\n\n{end}{tail}")
