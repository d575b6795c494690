"""One look for all figures of the page: colour-blind-safe, readable at print width."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["COLOUR", "LABEL", "STYLE", "figure"]

# Okabe and Ito, with black for what is true
COLOUR = {
    "truth": "#000000",
    "standard": "#D55E00",
    "zeroed": "#E69F00",
    "fip": "#0072B2",
    "linden": "#009E73",
    "constrained": "#CC79A7",
}
STYLE = {
    "truth": "-",
    "standard": (0, (5, 1.5)),
    "zeroed": (0, (3, 1, 1, 1)),
    "fip": (0, (1, 1.2)),
    "linden": "-",
    "constrained": "-",
}
LABEL = {
    "truth": "truth",
    "standard": "standard",
    "zeroed": "zeroed",
    "fip": "fip",
    "linden": "linden",
    "constrained": "constrained",
}
RC = {
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
        # No software stamp: the same numbers give the same bytes
        drawing.savefig(path, dpi=200, metadata={"Software": None})
        plt.close(drawing)
