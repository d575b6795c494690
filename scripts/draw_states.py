"""Draw ``docs/figures/states.png``: the unloaded, the mounted and a measured state.

    python scripts/draw_states.py [--out docs/figures]

The stretches are larger than in a test, so that they can be seen.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from biaxbayes.figures.style import MM, PAGE_MM, print_style, save_figure

EDGE = 34.0  # of the unloaded specimen; one unit is one millimetre of the figure
MOUNTING, MEASURED = np.array([1.08, 1.12]), np.array([1.14, 1.06])
ALPHA = np.deg2rad(35.0)
CENTRES = (26.0, 84.0, 147.0)
HEIGHT, MIDDLE = 86.0, 39.0
TISSUE, FIBRE, FORCE = "#f3d9d2", "#b5523b", "#0072B2"


def specimen(ax: Axes, centre: float, stretch: np.ndarray, force: float, symbol: str) -> None:
    """A square with its two fibre families, deformed, and the forces on its edges."""
    half = 0.5 * EDGE * stretch
    here = np.array([centre, MIDDLE])
    corners = here + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    patch = ax.add_patch(Polygon(corners, facecolor=TISSUE, edgecolor="black", lw=0.8))
    for sign in (1.0, -1.0):
        along = np.array([np.cos(ALPHA), sign * np.sin(ALPHA)])
        across = np.array([-along[1], along[0]])
        for offset in np.arange(-36.0, 37.0, 8.0):
            ends = np.array([offset * across - 60.0 * along, offset * across + 60.0 * along])
            # A fibre is a material line: it deforms with the tissue, x = F X
            (line,) = ax.plot(*(here + ends * stretch).T, color=FIBRE, lw=0.5, alpha=0.55)
            line.set_clip_path(patch)
    if not force:
        return
    for k, letter in enumerate("xy"):
        out = np.eye(2)[k]
        for sign in (1.0, -1.0):
            start = here + sign * out * (half + 0.8)
            ax.annotate(
                "",
                start + sign * out * force,
                start,
                arrowprops={"arrowstyle": "-|>", "color": FORCE, "lw": 1.3, "shrinkA": 0},
            )
        tip = here + out * (half + 0.8 + force)
        place = tip + ([0.0, 2.6] if k == 0 else [2.2, -1.6])
        side = "center" if k == 0 else "left"
        ax.text(place[0], place[1], f"${symbol}{letter}}}$", color=FORCE, ha=side)


def lengths(ax: Axes, centre: float, stretch: np.ndarray, texts: tuple[str, str]) -> None:
    """What the edges measure, beside the left half of the lower and the left edge."""
    left, low = np.array([centre, MIDDLE]) - 0.5 * EDGE * stretch
    ax.text(left, low - 1.2, texts[0], ha="left", va="top")
    ax.text(left - 1.2, low, texts[1], ha="right", va="bottom", rotation=90)


def becomes(ax: Axes, start: float, end: float, y: float, height: float, text: str) -> None:
    """A curved arrow from state to state, up or down by so much, and the stretch between them."""
    bend = -2.0 * height / (end - start)
    way = {"arrowstyle": "-|>", "connectionstyle": f"arc3,rad={bend}", "lw": 0.9, "color": "0.25"}
    ax.annotate("", (end, y), (start, y), arrowprops=way)
    up = height > 0.0
    place = y + height + (1.2 if up else -1.2)
    ax.text(0.5 * (start + end), place, text, ha="center", va="bottom" if up else "top")


def angle(ax: Axes, centre: float) -> None:
    """The axes of the test, and the angle of a fibre family from x."""
    here = np.array([centre, MIDDLE])
    way = {"arrowstyle": "-|>", "color": "black", "lw": 0.9, "shrinkA": 0}
    for k, letter in enumerate("xy"):
        tip = here + 12.5 * np.eye(2)[k]
        ax.annotate("", (tip[0], tip[1]), (here[0], here[1]), arrowprops=way)
        x, y = tip + [(0.6, -3.0), (-3.0, -0.6)][k]
        ax.text(x, y, f"${letter}$", fontsize=9)
    along = np.array([np.cos(ALPHA), np.sin(ALPHA)])
    ax.plot(*np.array([here, here + 14.0 * along]).T, color=FIBRE, lw=1.4)
    turn = np.linspace(0.0, ALPHA, 30)
    ax.plot(centre + 8.0 * np.cos(turn), MIDDLE + 8.0 * np.sin(turn), color="black", lw=0.7)
    ax.text(centre + 8.9, MIDDLE + 2.0, r"$\alpha$", fontsize=9)


def states_figure() -> Figure:
    """The three states side by side, 180 mm wide."""
    first, second, third = CENTRES
    with print_style():
        figure = plt.figure(figsize=(PAGE_MM * MM, HEIGHT * MM))
        ax = figure.add_axes((0, 0, 1, 1))
        ax.set(xlim=(0, PAGE_MM), ylim=(0, HEIGHT))
        ax.axis("off")
        one = np.ones(2)
        specimen(ax, first, one, 0.0, "")
        angle(ax, first)
        lengths(ax, first, one, ("$X$", "$Y$"))
        specimen(ax, second, MOUNTING, 4.0, "p_{0,")
        lengths(
            ax, second, MOUNTING, (r"$\lambda_{\mathrm{m},x}\,X$", r"$\lambda_{\mathrm{m},y}\,Y$")
        )
        specimen(ax, third, MOUNTING * MEASURED, 7.0, "f_{")
        edges = (r"$l_x\lambda_{\mathrm{m},x}\,X$", r"$l_y\lambda_{\mathrm{m},y}\,Y$")
        lengths(ax, third, MOUNTING * MEASURED, edges)
        top, low = MIDDLE + 23.0, MIDDLE - 26.0
        becomes(
            ax, first + 4, second - 6, top, 7.0, r"mounting stretch $\lambda_\mathrm{m}$, inferred"
        )
        becomes(ax, second + 8, third - 6, top, 7.0, "measured stretch $l$, in the file")
        becomes(
            ax, first + 4, third - 6, low, -6.0, r"total stretch $\lambda = l\,\lambda_\mathrm{m}$"
        )
        for centre, name, words in (
            (first, "unloaded", "no force"),
            (second, "mounted", "$l = 1$, force $p_0$"),
            (third, "measured", "force $f$"),
        ):
            ax.text(centre, HEIGHT - 2.0, name, ha="center", va="top", fontsize=9, weight="bold")
            ax.text(centre, HEIGHT - 6.5, words, ha="center", va="top")
        return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    out = Path(__file__).resolve().parents[1] / "docs" / "figures"
    parser.add_argument("--out", type=Path, default=out)
    save_figure(states_figure(), parser.parse_args().out / "states.png")


if __name__ == "__main__":
    main()
