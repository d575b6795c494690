"""Errors over prestretch and maximal stretch, for the methods that ignore the prestretch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm

from biaxbayes.fitting.fit import fit
from biaxbayes.laws.published import MATERIALS
from studies.figure import figure
from studies.page import image, table, write_table
from studies.paper.experiments import mae, theta, total_path, virtual_specimen
from studies.paper.figures34 import TITLE
from studies.paper.printed import VIRTUAL

__all__ = ["error_maps", "section"]

PRESTRETCHES = np.linspace(1.0025, 1.03, 12)
TOTALS = np.linspace(1.06, 1.30, 13)
METHODS = ("standard", "zeroed")


def error_maps(material: str, method: str) -> dict[str, np.ndarray]:
    """Errors on the grid, shape (total, prestretch).

    ``mae`` in per cent; ``stress``: root-mean-square error of the Cauchy stress at the true
    stretch over the root-mean-square stress, in per cent.
    """
    truth = MATERIALS[material].material
    shape = (TOTALS.size, PRESTRETCHES.size)
    maps = {"mae": np.empty(shape), "stress": np.empty(shape)}
    for i, total in enumerate(TOTALS):
        for j, lm in enumerate(PRESTRETCHES):
            own = fit(virtual_specimen(truth, (lm, lm), total=total), method).material
            path = total_path((lm, lm), total=total)
            true = np.array(truth.cauchy(*path))
            miss = np.array(own.cauchy(*path)) - true
            maps["mae"][i, j] = 0.1 * mae(theta(own), theta(truth))
            maps["stress"][i, j] = 100.0 * np.sqrt((miss**2).sum() / (true**2).sum())
    return maps


def _share(differences: np.ndarray) -> str:
    return f"{100 * np.mean(differences > 0):.0f}"


def section(folder: Path) -> tuple[str, list[str]]:
    """Markdown with the figure drawn, and the disagreements for the summary."""
    maps = {(m, k): error_maps(m, k) for m in VIRTUAL for k in METHODS}
    rows = []
    for (material, method), found in maps.items():
        for key, label in (("mae", "parameters (MAE)"), ("stress", "stress at the true stretch")):
            grid = found[key]
            rows.append(
                [material, method, label, _share(np.diff(grid, axis=1))]
                + [_share(-np.diff(grid, axis=0)), f"{grid.min():.1f}", f"{grid.max():.0f}"]
            )
    columns = ["material", "method", "error", "grows_with_prestretch_percent"]
    columns += ["shrinks_with_maximal_stretch_percent", "least_percent", "largest_percent"]
    link = write_table(folder, "paper-error-map", columns, rows)
    introduced = INTRODUCTION.format(link=link)
    text = [introduced, _figure(folder, maps), _shrinks(rows), CONCLUSION]
    return "\n".join(text), [SUMMARY]


def _shrinks(rows: list[list[str]]) -> str:
    """The share of the map where the second half of the claim holds."""
    cells: dict[str, list[str]] = {}
    for _, method, error, _, shrinks, *_ in rows:
        cells.setdefault(f"{method}, {error}", []).append(f"{shrinks} %")
    return table(
        ["share where it shrinks with the maximal stretch", *VIRTUAL],
        [[name, *shares] for name, shares in cells.items()],
    )


def _figure(folder: Path, maps: dict[tuple[str, str], dict[str, np.ndarray]]) -> str:
    limits = {"mae": (1.0, 150.0), "stress": (0.5, 150.0)}
    labels = {"mae": "parameter error (MAE), %", "stress": "stress error, %"}
    with figure(
        folder / "figures" / "paper-error-map.png", 2, 4, height=4.0, sharex=True, sharey=True
    ) as (
        drawing,
        axes,
    ):
        for row, key in enumerate(("mae", "stress")):
            norm = LogNorm(*limits[key])
            for column, (material, method) in enumerate(maps):
                ax = axes[row, column]
                mesh = ax.pcolormesh(
                    100 * (PRESTRETCHES - 1), TOTALS, maps[material, method][key],
                    norm=norm, cmap="cividis", shading="nearest", rasterized=True,
                )  # fmt: skip
                if row == 0:
                    ax.set_title(f"{TITLE[material]},\n{method}")
                else:
                    ax.set_xlabel("prestretch, %")
            axes[row, 0].set_ylabel("largest total stretch")
            drawing.colorbar(mesh, ax=axes[row, :], label=labels[key], extend="both", pad=0.01)
    return image(
        "paper-error-map.png",
        "Errors of the two methods that ignore the prestretch. Above: mean absolute error of the "
        "parameters. Below: error of the stress at the true stretch.",
        "Map of the errors",
    )


INTRODUCTION = f"""### Errors grow with prestretch and shrink with maximal stretch

Noise-free virtual experiments over prestretches of 0.25 to 3 % and largest total stretches of
{TOTALS[0]:.2f} to {TOTALS[-1]:.2f}. The table counts neighbouring points of the map between which
the error shrinks with the maximal stretch ([all counts]({{link}})).
"""
CONCLUSION = """
The first half holds: the stress error of both methods grows with prestretch everywhere, and so does
the parameter error of `zeroed`; that of `standard` jumps where another bound takes hold.

The second half is not a rule. An ignored prestretch shifts the curve along the stretch axis, so the
relative stress error is about the shift times d ln(stress) / d(stretch). While the response is
nearly linear that slope falls with stretch (Smoljkić M55 up to 1.2); where it stiffens
exponentially it grows, and so does the error (Weisbecker's media `zeroed` everywhere, Smoljkić M55
beyond 1.25).
"""
SUMMARY = (
    "- Abstract and Discussion, **errors decrease with maximal stretch**: only while the "
    "response is nearly linear; where the tissue stiffens exponentially the error of the stress "
    "grows (map below)."
)
