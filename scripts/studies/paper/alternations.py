"""How many alternations the paper's method takes, and what it does when the record is noisy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from biaxbayes.fitting.fit import FitResult, alternate, fit
from biaxbayes.fitting.residuals import readings
from biaxbayes.laws.published import MATERIALS
from studies.figure import figure
from studies.page import image, table
from studies.paper.experiments import PRESTRETCHES, noisy, table6_specimen, theta, virtual_specimen
from studies.paper.figure_style import COLOUR
from studies.paper.printed import TABLE6, VIRTUAL

__all__ = ["REPLICATES", "alternations", "section"]

TOLERANCES = (1e-3, 1e-4, 1e-6, 1e-10)
REPLICATES = 40
INFERRING = ("fip", "linden", "constrained")


def alternations(material: str, prestretch: str, tolerance: float) -> int:
    """Alternations from the standard fit until stretches and parameters change by less."""
    lm = float(prestretch)
    specimen = virtual_specimen(MATERIALS[material].material, (lm, lm), total=1.2)
    material_found = fit(specimen, "standard").material
    law = material_found.law
    start = law.point(material_found.values)
    data = readings(specimen, shared=True)
    found = alternate(data, start, np.arange(start.size), 100.0, law, tolerance=tolerance)
    return found.alternations


def _replicates(name: str) -> dict[str, list[FitResult]]:
    rng = np.random.default_rng(60)
    specimens = [noisy(table6_specimen(name), rng) for _ in range(REPLICATES)]
    return {method: [fit(s, method, starts=4) for s in specimens] for method in INFERRING}


def section(folder: Path) -> tuple[str, list[str]]:
    """Markdown with the figure drawn, and the disagreements for the summary."""
    counts = [
        [name, p, *(str(alternations(name, p, tolerance)) for tolerance in TOLERANCES)]
        for name in VIRTUAL
        for p in PRESTRETCHES
    ]
    header = ["material", "prestretch", *(f"to {tolerance:.0e}" for tolerance in TOLERANCES)]
    found = {name: _replicates(name) for name in TABLE6}
    rows = [row for name in TABLE6 for row in _spread(name, found[name])]
    failed = {n: sum(not r.converged for r in methods["fip"]) for n, methods in found.items()}
    assert sum(failed.values()) == failed["donor2-intima"], "the text says: the intima alone"
    failures = {"failed": failed["donor2-intima"], "count": REPLICATES}
    text = [
        COUNTS,
        table(header, counts, left=2),
        COUNTED,
        NOISE,
        table(["specimen", "method", "converged", *QUANTITIES], rows, left=2),
        _figure(folder, found),
        CONCLUSION.format(**failures),
    ]
    return "\n".join(text), [DIVERGENCE.format(**failures)]


WINDOW = {"donor2-intima": {"xlim": (-1.0, 8.0), "ylim": (-1.6, 2.2)}}
QUANTITIES = ("C1 kPa", "k2", "kappa", "mounting stretch x", "mounting stretch y")


def _values(result: FitResult) -> list[float]:
    C1, _, k2, _, kappa = theta(result.material)
    return [C1, k2, kappa, *result.mounting_stretch[0]]


def _spread(name: str, found: dict[str, list[FitResult]]) -> list[list[str]]:
    published = MATERIALS[name]
    C1, _, k2, _, kappa = theta(published.material)
    truth = [C1, k2, kappa, *published.mounting_stretch]
    digits = (2, 1, 3, 3, 3)
    rows = [[name, "truth", "", *(f"{v:.{n}f}" for v, n in zip(truth, digits, strict=True))]]
    for method, results in found.items():
        settled = [r for r in results if r.converged]
        cells = ["-"] * len(QUANTITIES)
        if len(settled) >= 5:
            low, high = np.quantile([_values(r) for r in settled], [0.05, 0.95], axis=0)
            cells = [f"{a:.{n}f} to {b:.{n}f}" for a, b, n in zip(low, high, digits, strict=True)]
        rows.append(["", method, f"{len(settled)}/{len(results)}", *cells])
    return rows


def _figure(folder: Path, found: dict[str, dict[str, list[FitResult]]]) -> str:
    file = "paper-noise.png"
    with figure(folder / file, 1, 5, height=2.5) as (drawing, axes):
        for ax, (name, methods) in zip(axes[0], found.items(), strict=True):
            true_x, true_y = MATERIALS[name].mounting_stretch
            for method, marker in zip(INFERRING, "osD", strict=True):
                settled = [r.mounting_stretch[0] for r in methods[method] if r.converged]
                if settled:
                    x, y = 100.0 * (np.array(settled).T - 1.0)
                    ax.plot(
                        x, y, marker, ms=3, mfc="none", mew=0.7, color=COLOUR[method]
                    )  # fmt: skip
            ax.plot(100 * (true_x - 1), 100 * (true_y - 1), "k+", ms=9, mew=1.3)
            # A runaway intima would hide the others
            ax.set(**WINDOW.get(name, {}))
            ax.set(title=name.replace("-", "\n"), xlabel="prestretch x, %")
            ax.locator_params(nbins=4)
        axes[0, 0].set_ylabel("prestretch y, %")
        handles = [
            axes[0, 0].plot([], [], m, ms=4, mfc="none", color=COLOUR[k], label=k)[0]
            for k, m in zip(INFERRING, "osD", strict=True)
        ]
        handles += axes[0, 0].plot([], [], "k+", ms=8, label="truth")
        drawing.legend(handles=handles, loc="outside upper center", ncols=4)
    return image(
        file,
        f"Inferred mounting stretches of {REPLICATES} noisy records of each Table 6 row; fits "
        f"that converged. Scales differ; {_outside(found)} fits of the intima lie outside.",
    )


def _outside(found: dict[str, dict[str, list[FitResult]]]) -> int:
    """Converged fits that the figure's window leaves out."""
    count = 0
    for name, window in WINDOW.items():
        for results in found[name].values():
            for result in (r for r in results if r.converged):
                x, y = 100.0 * (result.mounting_stretch[0] - 1.0)
                inside_x = window["xlim"][0] <= x <= window["xlim"][1]
                count += not (inside_x and window["ylim"][0] <= y <= window["ylim"][1])
    return count


COUNTS = """### Iteration counts

Alternations (root finding, then refitting) that `fip` takes from the standard fit until neither a
mounting stretch nor, relatively, a parameter changes by more than the tolerance. The paper says
10 to 20 and does not print its tolerance.
"""
COUNTED = """
Convergence is linear: the count grows with the logarithm of the tolerance and with the
prestretch. The printed 10 to 20 fits a tolerance between 1e-3 and 1e-6.
"""
NOISE = f"""### `fip` beside `linden` when the record is noisy

On noise-free records the two and `constrained` agree to ten digits. {REPLICATES} records of each
Table 6 row with 0.6 mN of load-cell noise and a smooth misfit of 2 %, the same records for each
method; 5 to 95 % of the fits that converged.
"""
CONCLUSION = """
`fip` and `constrained` balance the first force as it was read and so carry its noise into
the mounting stretch; `linden` treats it as one row among a hundred and lets the curve decide, so
the model error goes there instead. The paper's suggestion that `linden` leaves more uncertainty
is borne out where the first force is large against the load cell's noise (walls and media), and
reversed for intima and adventitia, whose mounting forces of 2 to 4 mN are three to seven times
that noise. The spread of k2 and kappa is that of the tissue's own record: with a 2 % misfit
one test says little about either, by any method.

`fip` did not converge on {failed} of {count} intima records. Followed step by step, the alternation
runs away: less matrix stiffness needs more prestretch to carry the force, more prestretch refits
to less matrix stiffness, until C1 is zero and no stretch balances the force. On the same records
`constrained`, which shares its equilibrium and not its iteration, converges.
"""
DIVERGENCE = (
    "- Section 2.2.2, **convergence of fip**: the paper does not say that the alternation may "
    "diverge. With load-cell noise of 0.6 mN and a misfit of 2 % it did on {failed} of {count} "
    "virtual intima records, and nowhere else."
)
