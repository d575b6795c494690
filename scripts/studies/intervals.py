"""Do the 90 % intervals contain the truth? The shipped specimens, and seeds that are not shipped.

    python scripts/study.py intervals --workers 2

``data/README.md`` quotes the tables. A truth at the end of its range (kappa 0, alpha 90 degrees)
is judged by the one-sided 90 % interval that starts there. ``drawn`` truths lie inside all ranges,
with the misfit of the shipped specimens; ``exact`` ones without misfit.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import binomtest

from biaxbayes import GOH, read_specimen
from biaxbayes.errors import BiaxbayesError
from biaxbayes.laws.published import MATERIALS, PublishedMaterial
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.truth import Truth
from make_specimens import MISFIT, table6_specimen
from studies.common import (
    COLOURS,
    DATA,
    SPECIMENS,
    options_of,
    parser,
    print_table,
    run_all,
    save_figure,
    write_table,
)

HOOKED = ("hooked-media", "hooked-weisbecker")
NOISES = ("correlated", "independent")
LABELS = {"C1": "C1_kPa", "k1": "k1_kPa", "k2": "k2", "alpha": "alpha_deg", "kappa": "kappa"}
PARAMETERS = (*LABELS, "mounting_stretch_x", "mounting_stretch_y")
FIRST_SEED = 1000  # far from the shipped ones
STUDIES = {
    "printed": (MISFIT, NOISES),
    "drawn": (MISFIT, NOISES),
    "exact": (0.0, ("independent",)),
}
"""Smooth misfit of the records, and the errors that are sampled with."""
CHEAP = Plan(ess=200, max_steps=1500, ensembles=2, walkers=32)
"""For counts over many seeds: enough draws for a 5 % quantile."""


def true_values(truth: Truth) -> dict[str, float]:
    """True values by the names of the summary."""
    material = {name: float(truth.material[label]) for name, label in LABELS.items()}
    pair = (truth.mounting_stretch_x, truth.mounting_stretch_y)
    return material | dict(zip(PARAMETERS[-2:], pair, strict=True))


def drawn_material(name: str, seed: int) -> PublishedMaterial:
    """A material around a printed one, inside all ranges, and a mounting stretch.

    Angle, dispersion and mounting stretches are uniform. C1, and exponent and stress of the fibres
    at the largest stretch, are those of the printed material times lognormal factors (sd of the log
    0.3): drawn independently, k1 and k2 would make stresses of any size.
    """
    rng = np.random.default_rng([seed, SPECIMENS.index(name), 20])
    printed = MATERIALS[name]
    assert printed.measured_stretch is not None
    mounting = (float(rng.uniform(1.005, 1.03)), float(rng.uniform(1.005, 1.03)))
    alpha, kappa = float(rng.uniform(20.0, 70.0)), float(rng.uniform(0.05, 0.28))
    C1, exponent, stress = np.exp(0.3 * rng.standard_normal(3))

    def at_top(material: GOH, stretch: tuple[float, float]) -> tuple[float, float]:
        """(E^2, stress of the fibres in x and y together) at the largest total stretch."""
        top = np.array(stretch) * printed.measured_stretch
        X, Y = top**2
        E = np.array(material.structure_tensor()) @ np.array([X, Y, 1.0 / (X * Y)]) - 1.0
        return float(E) ** 2, float(np.sum(replace(material, C1_kPa=0.0).cauchy(*top)))

    m = printed.material
    strain2, load = at_top(m, printed.mounting_stretch)
    unscaled = GOH(m.C1_kPa * float(C1), 1.0, 0.0, alpha, kappa)
    own_strain2, _ = at_top(unscaled, mounting)
    unscaled = replace(unscaled, k2=m.k2 * strain2 * float(exponent) / own_strain2)
    _, unit_load = at_top(unscaled, mounting)
    drawn = replace(unscaled, k1_kPa=load * float(stress) / unit_load)
    return replace(printed, material=drawn, mounting_stretch=mounting)


def at_end_of_range(name: str, truth: float) -> bool:
    """Whether a one-sided interval starts at the truth, and cannot miss it."""
    return (name, truth) in {("kappa", 0.0), ("alpha", 90.0)}


def interval(name: str, draws: np.ndarray, truth: float) -> tuple[float, float]:
    """The 90 % interval, one-sided where the truth is the end of its range."""
    if at_end_of_range(name, truth):
        if name == "kappa":
            return 0.0, float(np.quantile(draws, 0.9))
        return float(np.quantile(draws, 0.1)), 90.0
    low, high = np.quantile(draws, [0.05, 0.95])
    return float(low), float(high)


def judge(draws: Draws, truth: dict[str, float]) -> list[dict[str, Any]]:
    """Every interval beside its truth."""
    rows = []
    for name, value in truth.items():
        low, high = interval(name, draws.quantities[name], value)
        row = {"parameter": name, "truth": value, "low": low, "high": high}
        rows.append({**row, "contains": bool(low <= value <= high)})
    return rows


def shipped(name: str, noise: str, quick: bool) -> pd.DataFrame:
    """Every interval of a shipped specimen, and how well the chains did."""
    plan = CHEAP if quick else Plan()
    draws = draw_posterior(prepare(read_specimen(DATA / f"{name}.csv"), noise=noise), plan)
    truth = true_values(Truth(**json.loads((DATA / "truth.json").read_text())[name]))
    table = pd.DataFrame(judge(draws, truth)).assign(specimen=name, noise=noise)
    c = draws.convergence
    return table.assign(state=c.state, rhat=c.worst_rhat, ess=round(c.worst_ess))


def one_seed(study: str, name: str, noise: str, seed: int) -> dict[str, Any]:
    """Intervals of one virtual specimen; none where it could not be sampled."""
    drawn = None if study == "printed" else drawn_material(name, seed)
    try:
        specimen, truth = table6_specimen(name, seed, drawn, STUDIES[study][0])
        draws = draw_posterior(prepare(specimen, noise=noise), CHEAP)
    except BiaxbayesError as error:
        return {"state": str(error), "rows": []}
    state = draws.convergence.state
    return {"state": state, "rows": [] if state == "unusable" else judge(draws, true_values(truth))}


def over_seeds(records: list[dict[str, Any]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """How many intervals contain a printed truth; coverage of drawn truths in per cent."""
    rows = [
        {**dict(zip(("study", "specimen", "noise", "seed"), r["case"], strict=True)), **row}
        for r in records
        for row in r["rows"]
    ]
    every = pd.DataFrame(rows)
    printed = every[every["study"] == "printed"]
    counts = printed.pivot_table(
        index=["specimen", "noise"],
        columns="parameter",
        values="contains",
        aggfunc="sum",
        sort=False,
    ).astype(int)
    counts["seeds"] = printed.groupby(["specimen", "noise"], sort=False)["seed"].nunique()
    drawn = []
    for (study, noise, name), part in every[every["study"] != "printed"].groupby(
        ["study", "noise", "parameter"], sort=False
    ):
        test = binomtest(int(part["contains"].sum()), len(part))
        ends = test.proportion_ci(0.95)
        row = {"study": study, "noise": noise, "parameter": name, "specimens": len(part)}
        covered = {"coverage": test.statistic, "low": ends.low, "high": ends.high}
        drawn.append(row | {k: 100 * v for k, v in covered.items()})
    return counts.reset_index(), pd.DataFrame(drawn)


def draw_shares(counts: pd.DataFrame, out: Path) -> None:
    """Draw the share of printed truths that intervals contain, a marker per specimen."""
    drawing, axes = plt.subplots(1, len(NOISES), figsize=(6.9, 2.5), sharey=True)
    for ax, noise in zip(axes, NOISES, strict=True):
        for k, (_, row) in enumerate(counts[counts["noise"] == noise].iterrows()):
            at = np.arange(len(PARAMETERS)) + 0.13 * (k - 2)
            share = [row[p] / row["seeds"] for p in PARAMETERS]
            look = {"color": COLOURS[k], "mfc": "none", "label": row["specimen"]}
            ax.plot(at, share, "osv^D"[k], ms=4, **look)
        ax.axhline(0.9, color="0.6", lw=0.8, zorder=0)
        ax.set_xticks(range(len(PARAMETERS)), [*LABELS, "λ x", "λ y"])
        ax.set(title=f"noise = {noise}", ylim=(0.0, 1.04))
    axes[0].set_ylabel("share of seeds whose\n90 % interval contains the truth")
    drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    save_figure(drawing, out, "seed-intervals")


def main() -> None:
    """Sample the shipped specimens and all seeds."""
    arguments = parser(__doc__)
    arguments.add_argument("--seeds", type=int, default=50)
    options = options_of(arguments)
    names = SPECIMENS[-2:] if options.quick else SPECIMENS
    tables = [
        shipped(name, noise, options.quick)
        for name in (names[:1] if options.quick else (*SPECIMENS, *HOOKED))
        for noise in NOISES
    ]
    write_table(options.out, "shipped-intervals", pd.concat(tables))
    cases = [
        (study, name, noise, FIRST_SEED + k)
        for k in range(1 if options.quick else options.seeds)
        for name in names
        for study, (_, noises) in STUDIES.items()
        for noise in noises
    ]
    records = run_all(one_seed, cases, options.records / "intervals.jsonl", options.workers)
    counts, coverage = over_seeds(records)
    write_table(options.out, "seed-intervals", counts)
    print_table("drawn truths", coverage)
    draw_shares(counts, options.out)


if __name__ == "__main__":
    main()
