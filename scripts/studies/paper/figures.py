"""Figures 6 and 8 of the paper, recomputed."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from biaxbayes.fitting.fit import fit
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from studies.common import BLUE, GREEN, ORANGE, PINK, RED, save_figure
from studies.paper.experiments import (
    PRESTRETCHES,
    mae,
    r2_truth,
    theta,
    total_path,
    virtual_specimen,
)
from studies.paper.printed import VIRTUAL
from studies.paper.tables import IGNORING, TOTAL_STRETCH, experiment

COLOUR = {
    "standard": RED, "zeroed": ORANGE, "fip": BLUE, "linden": GREEN, "constrained": PINK,
}  # fmt: skip
STYLE = {"standard": (0, (5, 1.5)), "zeroed": (0, (3, 1, 1, 1)), "fip": (0, (1, 1.2))}
TITLE = {"smoljkic-m55": "Smoljkić M55", "weisbecker-media": "Weisbecker media"}
FORCE = "force / unloaded section, kPa"


def figure6(out: Path) -> None:
    """Stresses of the materials fitted to Smoljkić M55 at the true total stretch."""
    name = "smoljkic-m55"
    truth = MATERIALS[name].material
    drawing, axes = plt.subplots(2, 4, figsize=(6.9, 3.6), sharex=True, sharey="row")
    for column, prestretch in enumerate(PRESTRETCHES):
        lm = float(prestretch)
        path = total_path((lm, lm), total=TOTAL_STRETCH)
        for k in (0, 1):
            ax = axes[k, column]
            ax.plot(path[k], truth.cauchy(*path)[k], color="0.75", lw=4, label="truth")
            for method in (*IGNORING, "fip"):
                look = {"color": COLOUR[method]}
                stress = experiment(name, prestretch, method).material.cauchy(*path)[k]
                ax.plot(path[k], stress, ls=STYLE[method], label=method, **look)
                if method != "fip":
                    printed = GOH(*VIRTUAL[name][method, prestretch].values)
                    at = slice(10, None, 18)
                    stress = np.array(printed.cauchy(*path))[k]
                    label = f"{method}, printed"
                    ax.plot(path[k][at], stress[at], "o", ms=3.5, mfc="none", label=label, **look)
        axes[0, column].set_title(f"prestretch {100 * (lm - 1):.1f} %")
        axes[1, column].set_xlabel("total stretch")
    for k in (0, 1):
        axes[k, 0].set_ylabel(f"Cauchy stress {'xy'[k]}, kPa")
    drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
    save_figure(drawing, out, "paper-figure6")


def figure8(out: Path, *, points: int) -> None:
    """Errors over the prestretch of the methods that ignore it, print beside computation."""
    fine = np.linspace(1.00125, 1.0225, points)
    printed_at = [100 * (float(p) - 1) for p in PRESTRETCHES]
    drawing, axes = plt.subplots(1, 2, figsize=(6.9, 2.9))
    for name, marker, line in (("smoljkic-m55", "o", "-"), ("weisbecker-media", "s", "--")):
        truth = MATERIALS[name].material
        for method in IGNORING:
            errors, scores = [], []
            for lm in fine:
                own = fit(virtual_specimen(truth, (lm, lm), total=TOTAL_STRETCH), method).material
                errors.append(mae(theta(own), theta(truth)))
                scores.append(r2_truth(own, truth, total_path((lm, lm), total=TOTAL_STRETCH)))
            look = {"color": COLOUR[method]}
            rows = [VIRTUAL[name][method, p] for p in PRESTRETCHES]
            for ax, values, key in ((axes[0], errors, "mae"), (axes[1], scores, "r2")):
                label = f"{TITLE[name]}, {method}"
                ax.plot(100 * (fine - 1), values, ls=line, label=label, **look)
                printed = [float(getattr(row, key)) for row in rows]
                ax.plot(printed_at, printed, marker, ms=4, mfc="none", **look)
    axes[0].set(xlabel="prestretch, %", ylabel="MAE (Eq. 8), 1e-3", ylim=(0, 850))
    axes[1].set(xlabel="prestretch, %", ylabel="R2 against the truth")
    axes[1].legend(loc="lower left")
    save_figure(drawing, out, "paper-figure8")
