"""Figures 3 and 6 to 10 of the paper, recomputed."""

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
from studies.paper.printed import TABLE5, TABLE6, VIRTUAL
from studies.paper.tables import IGNORING, MEASURED_STRETCH, TOTAL_STRETCH, experiment, path_of

COLOUR = {
    "standard": RED, "zeroed": ORANGE, "fip": BLUE, "linden": GREEN, "constrained": PINK,
}  # fmt: skip
STYLE = {"standard": (0, (5, 1.5)), "zeroed": (0, (3, 1, 1, 1)), "fip": (0, (1, 1.2))}
TITLE = {"smoljkic-m55": "Smoljkić M55", "weisbecker-media": "Weisbecker media"}
FORCE = "force / unloaded section, kPa"


def figure3(out: Path) -> None:
    """What happens to the tissue, and what the machine records."""
    drawing, axes = plt.subplots(1, 2, figsize=(6.9, 2.7))
    for ax, name in zip(axes, VIRTUAL, strict=True):
        material = MATERIALS[name].material
        mounting = np.linspace(1.0, 1.02, 11)
        test = total_path((1.02, 1.02), total=TOTAL_STRETCH)[0][::5]
        for k, marker in ((0, "o"), (1, "^")):
            for path, shown, colour, what, fill in (
                (mounting, mounting, RED, "mounting", "none"),
                (test, test, BLUE, "test", "none"),
                (test, test / 1.02, ORANGE, "as recorded", ORANGE),
            ):
                stress = np.array(material.piola(path, path))[k]
                label = f"{what}, {'xy'[k]}"
                ax.plot(shown, stress, marker, color=colour, ms=3, mfc=fill, label=label)
        ax.set(title=TITLE[name], xlabel="stretch", ylabel=FORCE)
    axes[0].legend()
    save_figure(drawing, out, "paper-figure3")


def figures6_and_7(out: Path) -> None:
    """Stresses of the fitted materials at the true total stretch."""
    for number, name in ((6, "smoljkic-m55"), (7, "weisbecker-media")):
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
                        ax.plot(
                            path[k][at], stress[at], "o", ms=3.5, mfc="none", label=label, **look
                        )
            axes[0, column].set_title(f"prestretch {100 * (lm - 1):.1f} %")
            axes[1, column].set_xlabel("total stretch")
        for k in (0, 1):
            axes[k, 0].set_ylabel(f"Cauchy stress {'xy'[k]}, kPa")
        drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
        save_figure(drawing, out, f"paper-figure{number}")


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


def figure9(out: Path) -> None:
    """Printed rows of Table 5, each from its own mounted state."""
    drawing, axes = plt.subplots(1, 5, figsize=(6.9, 2.3), sharey=True)
    for ax, (name, printed) in zip(axes, TABLE5.items(), strict=True):
        for k, colour in ((0, BLUE), (1, RED)):
            for method, row in printed.items():
                path = total_path(row.mounting_stretch, measured=MEASURED_STRETCH)
                stress = np.array(GOH(*row.values).cauchy(*path))[k]
                line = {"ls": "-"} if method == "linden" else {"ls": "", "marker": "o", "ms": 3}
                label = f"{method}, {'xy'[k]}"
                ax.plot(
                    path[k], stress, color=colour, mfc="none", markevery=10, label=label, **line
                )
        ax.set(title=f"specimen {name}", xlabel="total stretch")
    axes[0].set_ylabel("Cauchy stress, kPa")
    drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    save_figure(drawing, out, "paper-figure9")


def figure10(out: Path) -> None:
    """Stresses of the printed rows of Table 6 at the total stretch of the printed fip row."""
    drawing, axes = plt.subplots(2, 5, figsize=(6.9, 3.7))
    for column, (name, rows) in enumerate(TABLE6.items()):
        path = path_of(name)
        for k in (0, 1):
            for method in ("fip", *IGNORING):
                stress = np.array(GOH(*rows[method].values).cauchy(*path))[k]
                line = {"ls": "-" if method == "fip" else STYLE[method], "color": COLOUR[method]}
                axes[k, column].plot(path[k], stress, label=f"printed {method}", **line)
            axes[k, column].set_ylim(0.0, None)
        axes[0, column].set_title(name.replace("-", "\n"))
        axes[1, column].set_xlabel("total stretch")
    for k in (0, 1):
        axes[k, 0].set_ylabel(f"Cauchy stress {'xy'[k]}, kPa")
    drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save_figure(drawing, out, "paper-figure10")
