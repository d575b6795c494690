"""Draw the first figure of the README: a square alone, and the same square with two strips.

    python scripts/draw_readme.py [--out docs/figures]

Samples ``data/pieces`` twice, as ``docs/pieces.md`` does. Left, the 90 % interval of every
parameter; right, the joint posterior of the three that an equibiaxial test confuses.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from corner import hist2d
from matplotlib.ticker import LogLocator, NullFormatter

import biaxbayes
from biaxbayes.figures.style import MM, PAGE_MM, print_style, save_figure

DATA = Path(__file__).resolve().parents[1] / "data" / "pieces"
PIECES = [DATA / f"{name}.csv" for name in ("square", "strip-x", "strip-y")]
SQUARE, BOTH, TRUTH = "#8c8c8c", "#0072B2", "#D55E00"
ROWS = {
    "C1": "$C_1$ (kPa)",
    "k1": "$k_1$ (kPa)",
    "k2": "$k_2$",
    "alpha": r"$\alpha$ (deg)",
    "kappa": r"$\kappa$",
    "mounting_stretch_x": r"$\lambda_{m,x}$",
    "mounting_stretch_y": r"$\lambda_{m,y}$",
}
LOGARITHMIC = ("C1", "k1", "k2")
PAIRS = (("alpha", "kappa"), ("k1", "kappa"), ("k1", "alpha"))


def truths() -> dict[str, float]:
    """The material and the mounting stretches that the square was simulated with."""
    stored = json.loads((DATA / "square.truth.json").read_text("utf-8"))["square"]
    material = (stored["material"][k] for k in ("C1_kPa", "k1_kPa", "k2", "alpha_deg", "kappa"))
    stretches = (stored[k] for k in ("mounting_stretch_x", "mounting_stretch_y"))
    return dict(zip(ROWS, (*material, *stretches), strict=True))


def draw_interval(ax: plt.Axes, name: str, draws: list[pd.DataFrame], truth: float) -> None:
    """Median and 90 % interval of both posteriors, on an axis that shows the wider one."""
    if name in LOGARITHMIC:
        ax.set_xscale("log")
    for level, (table, colour) in enumerate(zip(draws, (SQUARE, BOTH), strict=True)):
        low, median, high = np.quantile(table[name], [0.05, 0.5, 0.95])
        ax.plot([low, high], [-level, -level], color=colour, lw=2.6, solid_capstyle="butt")
        ax.plot(median, -level, "o", color="white", mec=colour, ms=3.2, zorder=3)
    ax.axvline(truth, color=TRUTH, lw=0.9)
    ax.set(ylim=(-1.7, 0.7), yticks=[])
    if name in LOGARITHMIC:
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_ylabel(ROWS[name], rotation=0, ha="right", va="center")
    ax.tick_params(labelsize=6)
    ax.spines[["left", "right", "top"]].set_visible(False)


def draw_pair(ax: plt.Axes, pair: tuple[str, str], draws: list[pd.DataFrame]) -> None:
    """Regions of 50 and 90 % of the joint posterior of two parameters."""
    x, y = (draws[0][name].to_numpy() for name in pair)
    span = [tuple(np.quantile(v, [0.002, 0.998])) for v in (x, y)]
    for table, colour in zip(draws, (SQUARE, BOTH), strict=True):
        hist2d(
            *(table[name].to_numpy() for name in pair),
            ax=ax, color=colour, levels=(0.5, 0.9), range=span, bins=40, smooth=1.2,
            plot_datapoints=False, plot_density=False, fill_contours=True,
        )  # fmt: skip
    truth = truths()
    ax.plot(truth[pair[0]], truth[pair[1]], "+", color=TRUTH, ms=7, mew=1.3)
    ax.set(xlabel=ROWS[pair[0]], ylabel=ROWS[pair[1]])
    ax.tick_params(labelsize=6)


def main() -> None:
    """Sample, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=DATA.parents[1] / "docs" / "figures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        draws = [
            biaxbayes.sample(pieces, out=Path(place, f"run-{len(pieces)}")).draws
            for pieces in (PIECES[:1], PIECES)
        ]
    with print_style():
        figure = plt.figure(figsize=(PAGE_MM * MM, 82 * MM), layout="constrained")
        parts = figure.subfigures(1, 2, width_ratios=(1.0, 1.25))
        assert isinstance(parts, np.ndarray)
        left, right = parts
        truth = truths()
        for ax, name in zip(left.subplots(len(ROWS), 1), ROWS, strict=True):
            draw_interval(ax, name, draws, truth[name])
        panels = right.subplots(2, 2)
        for ax, pair in zip((panels[0, 0], panels[1, 0], panels[1, 1]), PAIRS, strict=True):
            draw_pair(ax, pair, draws)
        panels[0, 1].axis("off")
        for colour, label in ((SQUARE, "square alone"), (BOTH, "square and two strips")):
            panels[0, 1].plot([], [], color=colour, lw=4, label=label)
        panels[0, 1].plot([], [], "+", color=TRUTH, ms=7, mew=1.3, label="simulated with")
        panels[0, 1].legend(loc="center", frameon=False)
        save_figure(figure, options.out / "readme-square-and-strips.png")


if __name__ == "__main__":
    main()
