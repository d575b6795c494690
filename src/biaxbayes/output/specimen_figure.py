"""A specimen as recorded: one panel a protocol, load against stretch in both directions."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.text_file import atomic_write_bytes

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from biaxbayes.specimens.protocol import Protocol

__all__ = ["save_figure", "specimen_figure"]

COLOURS = {"x": "#0072B2", "y": "#D55E00"}  # blue and vermilion of Okabe and Ito
MARKERS = {"x": "o", "y": "s"}
MM = 1.0 / 25.4
POINTS = 300
PANEL_MM = (56.0, 48.0)
MAX_PANELS = 24
LOADS = {
    "force": "force (N)",
    "piola": "first Piola-Kirchhoff stress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
}
STYLE: Any = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "biaxbayes",
    "text.parse_math": False,
}


def specimen_figure(specimen: Specimen) -> Figure:
    """Draw a specimen.

    Parameters
    ----------
    specimen : Specimen

    Returns
    -------
    matplotlib.figure.Figure
        One panel a protocol (the first 24), the same axes in all. Every row up to 300 a
        curve, evenly chosen beyond; the rows at rest are drawn in black.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    protocols = specimen.protocols[:MAX_PANELS]
    columns = min(3, len(protocols)) if len(protocols) != 4 else 2
    rows = math.ceil(len(protocols) / columns)
    width, height = max(columns * PANEL_MM[0], 85.0), rows * PANEL_MM[1] + 14.0
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width * MM, height * MM), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for ax, protocol in zip(grid.flat, protocols, strict=False):
            _panel(ax, protocol)
            if len(specimen.protocols) > 1:
                ax.set_title(_shortened(protocol.name))
        for ax in grid.flat[len(protocols) :]:
            ax.remove()
        for column in range(columns):
            # The lowest panel of each column carries the ticks of the shared axis.
            lowest = grid[(len(protocols) - 1 - column) // columns, column]
            lowest.tick_params(labelbottom=True)
        figure.supxlabel("measured stretch", fontsize=8.0)
        figure.supylabel(LOADS[specimen.stress_pair], fontsize=8.0)
        names = [specimen.axis_x, specimen.axis_y]
        handles, labels = grid[0, 0].get_legend_handles_labels()
        labels = [
            f"{label}: {_shortened(name, 24)}" if name else label
            for label, name in zip(labels, [*names, None], strict=False)
        ]
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def _panel(ax: Axes, protocol: Protocol) -> None:
    index = np.unique(np.linspace(0, protocol.rows - 1, POINTS).round().astype(int))
    if protocol.rows <= POINTS:
        index = np.arange(protocol.rows)
    rest = slice(0, protocol.rest_rows, max(1, protocol.rest_rows // 50))
    for axis in "xy":
        stretch, load = getattr(protocol, f"stretch_{axis}"), getattr(protocol, f"load_{axis}")
        ax.plot(
            stretch[index],
            load[index],
            marker=MARKERS[axis],
            markersize=2.0,
            markeredgewidth=0.0,
            linewidth=0.5,
            color=COLOURS[axis],
            label=axis,
        )
        ax.plot(
            stretch[rest],
            load[rest],
            linestyle="none",
            marker="+",
            markersize=6.0,
            markeredgewidth=0.8,
            color="black",
            zorder=3,
            label="rows at rest" if axis == "y" else None,
        )
    ax.axhline(0.0, color="0.75", linewidth=0.5, zorder=0)
    ax.margins(x=0.04, y=0.06)
    ax.locator_params(axis="x", nbins=5)


def _shortened(text: str, length: int = 34) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the file name ends with, whole or not at all.

    Raises
    ------
    InputError
        If the ending is none of pdf, png, svg, or the file cannot be written.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "png", "svg"):
        raise InputError(
            f"cannot draw a figure as {path.suffix or 'a file without ending'!r}",
            file=path,
            remedy="let the name end with .pdf, .png or .svg",
        )
    import warnings

    import matplotlib as mpl

    out = io.BytesIO()
    stamp = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # Names in scripts that the font lacks are drawn as boxes; that is no error.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(out, format=kind, dpi=200, metadata=stamp)
    atomic_write_bytes(path, out.getvalue())
