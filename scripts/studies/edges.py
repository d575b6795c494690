"""How often intervals hold the truth where it lies on an edge, with and without the edge held.

    OMP_NUM_THREADS=1 python scripts/study.py edges --first 100 --count 50

Virtual specimens of GOH, three protocols, load noise only (0.2 % of the peak or so): kappa = 0, an
edge, and kappa = 0.1, which is none. Nothing was tuned on any of them.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.identifiability.held_edges import held_edges
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.model_error.truths import RATIOS
from studies.page import put, table, write_table

KAPPAS = (0.0, 0.1)
MEDIANS, LOG_SD = (8.0, 15.0, 4.0), 0.3  # C1 and k1 in kPa, k2
MOUNTING = {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02}


def judge(task: tuple[float, int]) -> list[dict[str, object]]:
    """Every parameter of one specimen: whether its intervals hold the truth."""
    kappa, seed = task
    rng = np.random.default_rng([seed, 17])
    C1, k1, k2 = np.exp(rng.normal(np.log(MEDIANS), LOG_SD))
    material = GOH(C1, k1, k2, rng.uniform(25.0, 60.0), kappa)
    specimen, _ = virtual_specimen(
        material,
        name="edge",
        mounting_stretch=(MOUNTING["mounting_stretch_x"], MOUNTING["mounting_stretch_y"]),
        total_stretch=1.2,
        ratios=tuple(RATIOS.values()),
        increments=30,
        machine=Machine(noise_N=0.002),
        seed=seed,
    )
    posterior = prepare(specimen, noise="independent")
    drawn = draw_posterior(posterior, Plan(ess=1000.0, seed=seed))
    draws = pd.DataFrame({name: q.ravel() for name, q in drawn.quantities.items()})
    found = identify_draws(posterior, draws, drawn.convergence.state)
    held = {h.parameter.name: h for h in held_edges(posterior, found.open_edges())}
    truth = dict(zip(GOHLaw().names, material.values, strict=True)) | MOUNTING
    rows: list[dict[str, object]] = []
    for name, true in truth.items():
        e = found[name].evidence
        row: dict[str, object] = {"kappa": kappa, "seed": seed, "parameter": name}
        row["converged"] = drawn.convergence.state
        row["verdict"] = found[name].verdict
        row["told"] = "kappa" in held
        row["free"] = bool(e is not None and e.low <= true <= e.high)
        if "kappa" in held and name in held["kappa"].intervals:
            low, _, high = held["kappa"].intervals[name]
            row["held"] = float(low <= true <= high)
        rows.append(row)
    return rows


def summary(found: pd.DataFrame) -> pd.DataFrame:
    """Of every true kappa and parameter, the share of specimens whose intervals hold the truth."""
    rows = []
    for (kappa, name), part in found.groupby(["kappa", "parameter"], sort=False):
        rows.append(
            {
                "kappa": kappa,
                "parameter": name,
                "specimens": len(part),
                "free_holds": part["free"].mean(),
                "edge_possible": int(part["told"].sum()),
                "held_holds": part["held"].mean(),
            }
        )
    return pd.DataFrame(rows)


def page_table(shares: pd.DataFrame, link: str) -> str:
    """A row a parameter, beside what was counted."""
    wide = shares.pivot(index="parameter", columns="kappa")
    wide = wide.loc[list(dict.fromkeys(shares["parameter"]))]
    edge, inside = KAPPAS
    count, possible = shares["specimens"].iloc[0], shares.groupby("kappa")["edge_possible"].first()
    rows = [
        [name]
        + [f"{row['free_holds', edge]:.2f}"]
        + [f"{row['held_holds', edge]:.2f}" if np.isfinite(row["held_holds", edge]) else "–"]
        + [f"{row['free_holds', inside]:.2f}"]
        for name, row in wide.iterrows()
    ]
    heads = ["parameter", f"kappa {edge:g}: free", "edge held", f"kappa {inside:g}: free"]
    return (
        f"{count} specimens of each kappa; the edge is possible for {possible[edge]} of kappa "
        f"{edge:g} and {possible[inside]} of kappa {inside:g} ([all]({link})).\n\n"
        f"{table(heads, rows)}"
    )


def result(shares: pd.DataFrame) -> str:
    """What holding an open edge is worth where it is true."""
    at_edge = shares[(shares["kappa"] == KAPPAS[0]) & shares["held_holds"].notna()]
    free, held = (100 * at_edge[c] for c in ("free_holds", "held_holds"))
    return (
        f"Where kappa is {KAPPAS[0]:g}, 90 % intervals of the others hold the truth in "
        f"{free.min():.0f} to {free.max():.0f} % of specimens with kappa free, and in "
        f"{held.min():.0f} to {held.max():.0f} % with kappa held at {KAPPAS[0]:g}."
    )


def write_place(page: Path, shares: pd.DataFrame) -> None:
    """Put the short table and what it comes to into a page, all shares beside the page."""
    put(page, "result edges", result(shares))
    link = write_table(page.parent, "held-edges", list(shares.columns), shares)
    put(page, "edges", page_table(shares, link))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    tasks = [(kappa, seed) for kappa in KAPPAS for seed in seeds]
    with ProcessPoolExecutor(options.workers) as pool:
        rows = [row for part in pool.map(judge, tasks) for row in part]
    shares = summary(pd.DataFrame(rows))
    print(shares.to_string(index=False))
    if options.write:
        write_place(options.write, shares)


if __name__ == "__main__":
    main()
