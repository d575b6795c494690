"""How many alternations the paper's method takes, and what it does when the record is noisy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from biaxbayes.fitting.fit import FitResult, alternate, fit
from biaxbayes.fitting.residuals import readings
from biaxbayes.laws.published import MATERIALS
from studies.figure import figure
from studies.page import image, table, write_table
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
    columns = ["material", "prestretch", *(f"to_{tolerance:.0e}" for tolerance in TOLERANCES)]
    counted = write_table(folder, "paper-alternations", columns, counts)
    ranges = [
        f"{min(of)} to {max(of)}" for of in zip(*(map(int, c[2:]) for c in counts), strict=True)
    ]
    found = {name: _replicates(name) for name in TABLE6}
    columns = [f"{q}_{end}" for q in QUANTITIES for end in ("q05", "q95")]
    rows = [row for name in TABLE6 for row in _spread(name, found[name])]
    spread = write_table(folder, "paper-noise", ["specimen", "method", "converged", *columns], rows)
    failed = {n: sum(not r.converged for r in methods["fip"]) for n, methods in found.items()}
    assert sum(failed.values()) == failed["donor2-intima"], "the text says: the intima alone"
    shown = [_told(row) for row in rows if row[0] in SHOWN]
    failures = {"failed": failed["donor2-intima"], "count": REPLICATES}
    text = [
        COUNTS.format(link=counted, loose=ranges[0], middle=ranges[2], sharp=ranges[3]),
        NOISE.format(link=spread),
        table(["specimen", "method", "converged", *ON_PAGE], shown, left=2),
        _figure(folder, found),
        CONCLUSION.format(**failures),
    ]
    return "\n".join(text), [DIVERGENCE.format(**failures)]


WINDOW = {"donor2-intima": {"xlim": (-1.0, 8.0), "ylim": (-1.6, 2.2)}}
QUANTITIES = ("C1_kPa", "k2", "kappa", "mounting_stretch_x", "mounting_stretch_y")
DIGITS = (2, 1, 3, 3, 3)
ON_PAGE = {"C1 kPa": "C1_kPa", "mounting stretch x": "mounting_stretch_x"}
SHOWN = ("donor2", "donor2-intima")
"""Specimens on the page: a large mounting force, and the smallest."""


def _values(result: FitResult) -> list[float]:
    C1, _, k2, _, kappa = theta(result.material)
    return [C1, k2, kappa, *result.mounting_stretch[0]]


def _spread(name: str, found: dict[str, list[FitResult]]) -> list[list[str]]:
    """The truth and, of each method, the 5 and 95 % points of every quantity."""
    published = MATERIALS[name]
    C1, _, k2, _, kappa = theta(published.material)
    truth = [
        f"{v:.{n}f}"
        for v, n in zip((C1, k2, kappa, *published.mounting_stretch), DIGITS, strict=True)
    ]
    rows = [[name, "truth", "", *(text for text in truth for _ in range(2))]]
    for method, results in found.items():
        settled = [r for r in results if r.converged]
        cells = [""] * 2 * len(QUANTITIES)
        if len(settled) >= 5:
            ends = np.quantile([_values(r) for r in settled], [0.05, 0.95], axis=0)
            cells = [f"{v:.{n}f}" for pair, n in zip(ends.T, DIGITS, strict=True) for v in pair]
        rows.append([name, method, f"{len(settled)} of {len(results)}", *cells])
    return rows


def _told(row: list[str]) -> list[str]:
    """A row of the page: both ends of the shown quantities in one cell each."""
    pairs = dict(zip(QUANTITIES, zip(row[3::2], row[4::2], strict=True), strict=True))
    ends = [pairs[quantity] for quantity in ON_PAGE.values()]
    return [*row[:3], *(low if low == high else f"{low} to {high}" for low, high in ends)]


def _figure(folder: Path, found: dict[str, dict[str, list[FitResult]]]) -> str:
    file = "paper-noise.png"
    with figure(folder / "figures" / file, 1, 5, height=2.5) as (drawing, axes):
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
        "Inferred mounting stretches of noisy records",
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

`fip` takes {loose} alternations from the standard fit until neither a mounting stretch nor,
relatively, a parameter changes by more than 1e-3, {middle} to 1e-6 and {sharp} to 1e-10, more the
larger the prestretch ([all]({link})). The printed 10 to 20, without a tolerance, fits 1e-3 to 1e-6.
"""
NOISE = f"""### `fip` beside `linden` when the record is noisy

{REPLICATES} records of each Table 6 row with 0.6 mN of load-cell noise and a smooth misfit of 2 %,
the same for each method; 5 to 95 % of the fits that converged ([all specimens and
quantities]({{link}})). Without noise the three agree to ten digits.
"""
CONCLUSION = """
`fip` and the `constrained` of this table balance the first force as it was read and carry its noise
into the mounting stretch (`constrained` now weighs it as one reading with the load cell's noise);
`linden` treats it as one row among a hundred, so the model error goes there instead. That
`linden` leaves more uncertainty, as the paper suggests, holds for walls and media, whose first
force is more than twenty times the noise, and is reversed for intima and adventitia, where it is
less than eight times. With a 2 % misfit one test says little about k2 and kappa, by any method.

`fip` runs away on {failed} of {count} intima records: less matrix stiffness needs more prestretch
to carry the force, which refits to less matrix stiffness, until C1 is zero. `constrained`, with the
same equilibrium and another iteration, converges on all, to a C1 that scatters as widely or more.
"""
DIVERGENCE = (
    "- Section 2.2.2, **convergence of fip**: with load-cell noise of 0.6 mN and a misfit of 2 % "
    "the alternation diverged on {failed} of {count} virtual intima records, and nowhere else."
)
