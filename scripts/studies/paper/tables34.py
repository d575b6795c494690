"""Tables 3 and 4: eight virtual experiments, two methods that ignore the prestretch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from biaxbayes.fitting.fit import FitResult, fit
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from studies.page import table
from studies.paper.experiments import (
    PRESTRETCHES,
    mae,
    r2_truth,
    theta,
    total_path,
    virtual_specimen,
)
from studies.paper.printed import PARAMETERS, VIRTUAL, Row, unit

__all__ = ["REASONS", "TOTAL_STRETCH", "Comparison", "compare", "experiment", "section"]

TOTAL_STRETCH = 1.2
NAMES = {"smoljkic-m55": "Table 3, Smoljkić M55", "weisbecker-media": "Table 4, Weisbecker media"}
REASONS = {
    ("weisbecker-media", "zeroed", "1.010", "C1"): (
        "The optimum is 14.06 kPa and its neighbours print 14.0 and 14.2: 14.6 looks like 14.06 "
        "with a digit lost. The MAE and R2 printed in this row follow from the printed 14.6, so "
        "the slip came before they were computed; with the optimum they are {mae_own:.1f} and "
        "{r2_own:.3f}."
    ),
    ("smoljkic-m55", "standard", "1.015", "R2"): (
        "The printed parameters give {r2_printed:.3f} and so does the optimum ({r2_own:.3f}); "
        "the printed MAE does follow from the printed parameters. The value that is printed is "
        "what the *next* row's parameters (1.020) give on this row's stretches: {r2_next:.3f}."
    ),
}
"""Cells that differ by more than one unit of the last digit (parameters) or 0.001 (R2)."""


@dataclass(frozen=True)
class Comparison:
    """A printed row beside what was recomputed."""

    material: str
    prestretch: str
    printed: Row
    own: FitResult
    mae_printed: float  # of the printed parameters
    mae_own: float
    r2_printed: float  # R2 against the truth, of the printed parameters
    r2_own: float

    def parameter_gap(self, index: int) -> float:
        """Recomputed less printed, in units of the last printed digit."""
        printed = self.printed.theta[index]
        return float(theta(self.own.material)[index] - float(printed)) / unit(printed)

    def differs(self) -> list[str]:
        """Names of the cells that differ by more than rounding or cutting can."""
        cells = [
            name
            for index, name in enumerate(PARAMETERS)
            if abs(self.parameter_gap(index)) > 1.0 + 1e-9
        ]
        if abs(self.mae_printed - float(self.printed.mae)) > 0.1 + 1e-9:
            cells.append("MAE")
        if abs(self.r2_printed - float(self.printed.r2)) > 0.001 + 1e-9:
            cells.append("R2")
        return cells


@cache
def experiment(material: str, prestretch: str, method: str) -> FitResult:
    """Fit of one virtual experiment."""
    lm = float(prestretch)
    specimen = virtual_specimen(MATERIALS[material].material, (lm, lm), total=TOTAL_STRETCH)
    return fit(specimen, method)


def compare(material: str) -> list[Comparison]:
    """All printed rows of a material beside the recomputed ones."""
    truth = MATERIALS[material].material
    found = []
    for (method, prestretch), row in VIRTUAL[material].items():
        lm = float(prestretch)
        path = total_path((lm, lm), total=TOTAL_STRETCH)
        own = experiment(material, prestretch, method)
        found.append(
            Comparison(
                material,
                prestretch,
                row,
                own,
                mae(row.values, theta(truth)),
                mae(theta(own.material), theta(truth)),
                r2_truth(GOH(*row.values), truth, path),
                r2_truth(own.material, truth, path),
            )
        )
    return found


def next_row_r2(material: str, method: str, prestretch: str) -> float:
    """R2 of the next printed row's parameters on this row's stretches."""
    following = PRESTRETCHES[PRESTRETCHES.index(prestretch) + 1]
    lm = float(prestretch)
    return r2_truth(
        GOH(*VIRTUAL[material][method, following].values),
        MATERIALS[material].material,
        total_path((lm, lm), total=TOTAL_STRETCH),
    )


def _lines(c: Comparison) -> list[list[str]]:
    marked = c.differs()
    values = theta(c.own.material)
    digits = [max(len(text.partition(".")[2]) + 1, 2) for text in c.printed.theta]
    own = [
        f"**{value:.{n}f}**" if name in marked else f"{value:.{n}f}"
        for name, value, n in zip(PARAMETERS, values, digits, strict=True)
    ]
    shown_r2 = f"{c.r2_printed:.4f}"
    return [
        [c.printed.method, c.prestretch, "printed", *c.printed.theta, c.printed.mae, c.printed.r2],
        ["", "", "of the printed parameters"]
        + [""] * 5
        + [
            f"**{c.mae_printed:.1f}**" if "MAE" in marked else f"{c.mae_printed:.1f}",
            f"**{shown_r2}**" if "R2" in marked else shown_r2,
        ],
        ["", "", "our optimum", *own, f"{c.mae_own:.1f}", f"{c.r2_own:.4f}"],
    ]


def _reasons(comparisons: list[Comparison]) -> list[str]:
    lines = []
    for c in comparisons:
        for cell in c.differs():
            key = (c.material, c.printed.method, c.prestretch, cell)
            reason = REASONS.get(key, "No reason found.").format(
                mae_own=c.mae_own,
                r2_own=c.r2_own,
                r2_printed=c.r2_printed,
                r2_next=next_row_r2(*key[:3]) if cell == "R2" else float("nan"),
            )
            lines.append(f"- {NAMES[c.material]}, {key[1]}, {key[2]}, **{cell}**: {reason}")
    return lines


def section() -> tuple[str, list[str]]:
    """Markdown of both tables, and the disagreements for the summary."""
    text, disagreements = [INTRODUCTION], []
    header = ("method", "prestretch", "", "C1 kPa", "k1 kPa", "k2", "alpha deg", "kappa")
    for material in VIRTUAL:
        comparisons = compare(material)
        rows = [line for c in comparisons for line in _lines(c)]
        text.append(f"### {NAMES[material]}\n")
        text.append(table((*header, "MAE 1e-3", "R2"), rows, left=3))
        inferred = [
            np.abs(theta(experiment(material, p, m).material) / theta(MATERIALS[material].material))
            for p in PRESTRETCHES
            for m in ("fip", "linden", "constrained")
        ]
        worst = float(np.abs(np.array(inferred) - 1.0).max())
        text.append(
            "`fip`, `linden` and `constrained` return the truth at every prestretch, as the paper "
            f"says of its method: the largest relative error of any parameter is {worst:.0e}.\n"
        )
        reasons = _reasons(comparisons)
        text.extend(reasons)
        text.append("")
        disagreements.extend(reasons)
    text.append(_fit_quality())
    return "\n".join(text), disagreements


def _fit_quality() -> str:
    fits = {
        (m, p): experiment(m, p, method).r2
        for m in VIRTUAL
        for p in PRESTRETCHES
        for method in ("standard",)
    }
    (material, prestretch), least = min(fits.items(), key=lambda item: item[1])
    return (
        "The R2 of these fits to *their own data* is something else and tells nothing: the paper "
        f"says about 0.99, here it is {least:.3f} at worst ({material}, standard, {prestretch}) "
        "and above 0.99999 for every zeroed fit.\n"
    )


INTRODUCTION = """## Tables 3 and 4: the virtual experiments

Equibiaxial, 100 equal increments from the mounted state to a total stretch of 1.2, no noise. MAE
is Eq. 8. The tables' R2 is that of the printed parameters against the true stress at the true
total stretch (both directions pooled with one mean), not that of the fit to its data. Three lines
a row: what is printed; MAE and R2 recomputed from the printed parameters; our own optimum. A
recomputed cell is **bold** where it differs from print by more than one unit of the last digit
(R2: 0.001). Some printed digits are cut rather than rounded (R2 throughout), which that allows.
"""
