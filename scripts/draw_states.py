"""Draw the three states of a specimen (``states.png``) and a flowchart (``method.png``).

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
from matplotlib.patches import FancyBboxPatch, Polygon

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


def box(ax: Axes, corners: tuple[float, float, float, float], title: str, text: str) -> None:
    """A step of the method: left, low, right and high edge in millimetres, title and words."""
    left, low, right, high = corners
    shape = FancyBboxPatch(
        (left, low),
        right - left,
        high - low,
        boxstyle="round,pad=0,rounding_size=2",
        facecolor="#eef3f8",
        edgecolor="0.25",
        lw=0.8,
    )
    ax.add_patch(shape)
    middle = 0.5 * (left + right)
    ax.text(middle, high - 2.0, title, ha="center", va="top", fontsize=8, weight="bold")
    ax.text(middle, high - 7.0, text, ha="center", va="top", fontsize=7, linespacing=1.45)


def arrow(ax: Axes, *points: tuple[float, float]) -> None:
    """A line along some points that ends in an arrow."""
    x, y = np.array(points).T
    ax.plot(x, y, color="0.25", lw=0.9, solid_capstyle="butt")
    way = {"arrowstyle": "-|>", "lw": 0.9, "color": "0.25", "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", points[-1], points[-2], arrowprops=way)


def method_figure() -> Figure:
    """What `sample` does with a specimen, step by step, 180 mm wide."""
    with print_style():
        figure = plt.figure(figsize=(PAGE_MM * MM, 84.0 * MM))
        ax = figure.add_axes((0, 0, 1, 1))
        ax.set(xlim=(0, PAGE_MM), ylim=(0, 84.0))
        ax.axis("off")
        box(
            ax,
            (2, 63, 56, 82),
            "Specimen file",
            "stretches $l$ from the mounted state,\nforces or stresses, dimensions,\nload noise",
        )
        box(
            ax,
            (63, 63, 117, 82),
            "Least-squares fit",
            "starting point of the sampler;\nits smooth loads are what the misfit\n"
            "of the law is relative to",
        )
        box(
            ax,
            (124, 63, 178, 82),
            "Material law and priors",
            "GOH, or one of seven other laws;\npriors of the parameters and of the\n"
            "mounting stretch",
        )
        box(
            ax,
            (9, 31, 117, 54),
            "Posterior density at one set of values",
            "propose parameters $\\theta$ and mounting force $p_0$\n"
            "solve the balance $A_0 P(\\theta, \\lambda_\\mathrm{m}) = p_0$ "
            "for the mounting stretch $\\lambda_\\mathrm{m}$\n"
            "compute the forces at the total stretches $l\\,\\lambda_\\mathrm{m}$\n"
            "compare them with the readings: misfit of the law, toe, friction, and noise",
        )
        box(
            ax,
            (124, 31, 178, 54),
            "Sampler",
            "four or more ensembles\nof emcee walkers; repeat until\n"
            "R-hat and effective draws\nmeet their targets",
        )
        box(
            ax,
            (2, 3, 56, 22),
            "Fits of other laws",
            "least squares, for information:\nno verdict depends on them",
        )
        box(
            ax,
            (63, 3, 117, 22),
            "Reported table",
            "per parameter median, interval or\nbound, and verdict: identified, bounded,\n"
            "only in combination, not identified",
        )
        box(
            ax,
            (124, 3, 178, 22),
            "Posterior draws",
            "figures, stress bands,\npredictions, comparison of specimens,\nmaterial cards",
        )
        arrow(ax, (56, 72), (63, 72))
        arrow(ax, (80, 63), (80, 54))
        arrow(ax, (29, 63), (29, 54))
        arrow(ax, (5, 63), (5, 22))
        arrow(ax, (151, 63), (151, 58.5), (104, 58.5), (104, 54))
        arrow(ax, (117, 46), (124, 46))
        arrow(ax, (124, 38), (117, 38))
        ax.text(120.5, 46.7, "value", ha="center", va="bottom", fontsize=5.5)
        ax.text(120.5, 37.3, "step", ha="center", va="top", fontsize=5.5)
        arrow(ax, (151, 31), (151, 22))
        arrow(ax, (124, 12.5), (117, 12.5))
        return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    out = Path(__file__).resolve().parents[1] / "docs" / "figures"
    parser.add_argument("--out", type=Path, default=out)
    folder = parser.parse_args().out
    save_figure(states_figure(), folder / "states.png")
    save_figure(method_figure(), folder / "method.png")


if __name__ == "__main__":
    main()
