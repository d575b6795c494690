"""One look for the figures of the pages: colour-blind-safe, readable at print width."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from biaxbayes.text_files import atomic_write_bytes

__all__ = ["figure", "save"]

RC: dict[Any, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.2,
    "axes.linewidth": 0.6,
    "figure.constrained_layout.use": True,
}


@contextmanager
def figure(
    path: Path, rows: int, columns: int, *, height: float, width: float = 6.9, **options
) -> Iterator[tuple]:
    """Axes to draw on; saved at print size (inches) when the block ends.

    Parameters
    ----------
    path : Path
    rows, columns : int
    height, width : float
        Inches; 6.9 is the text width of A4.
    """
    with plt.rc_context(RC):
        drawing, axes = plt.subplots(
            rows, columns, figsize=(width, height), squeeze=False, **options
        )
        yield drawing, axes
        save(drawing, path)


def save(drawing: plt.Figure, path: Path) -> None:
    """Write a figure, whole or not at all, and close it."""
    buffer = BytesIO()
    # Without the writer's name: the same numbers give the same bytes
    drawing.savefig(buffer, format=path.suffix[1:], dpi=200, metadata={"Software": None})
    plt.close(drawing)
    atomic_write_bytes(path, buffer.getvalue())
