"""Do the 90 % intervals hold the truth? The shipped specimens, and seeds that are not shipped.

    python scripts/study.py intervals --seeds 50 --workers 2

Writes the tables between the markers of data/README.md. A truth on a physical edge (kappa 0,
alpha 90 degrees) is judged by the one-sided 90 % interval that starts at that edge.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from biaxbayes import read_specimen
from biaxbayes.errors import BiaxbayesError
from biaxbayes.laws.goh import GOHLaw
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.parameters import mounting_names
from biaxbayes.sampling.sampler import Draws, Plan
from make_specimens import table6_specimen
from studies.page import DATA, SPECIMENS, put, table

HOOKED = ("hooked-media", "hooked-weisbecker")
NOISES = ("effective", "independent")
PARAMETERS = (*GOHLaw().names, *mounting_names("stretch"))
FIRST_SEED = 1000  # far from the shipped ones


def truth_of(name: str) -> dict[str, float]:
    truth = json.loads((DATA / "truth.json").read_text())
    entry = truth[name]
    material = entry["material"]
    return {
        "C1": material["C1_kPa"],
        "k1": material["k1_kPa"],
        "k2": material["k2"],
        "alpha": material["alpha_deg"],
        "kappa": material["kappa"],
        "mounting_stretch_x": entry["mounting_stretch_x"],
        "mounting_stretch_y": entry["mounting_stretch_y"],
    }


def interval(name: str, draws: np.ndarray, truth: float) -> tuple[float, float]:
    """The 90 % interval, one-sided from the edge that the truth lies on."""
    if name == "kappa" and truth == 0.0:
        return 0.0, float(np.quantile(draws, 0.9))
    if name == "alpha" and truth == 90.0:
        return float(np.quantile(draws, 0.1)), 90.0
    low, high = np.quantile(draws, [0.05, 0.95])
    return float(low), float(high)


CHEAP = Plan(ess=200, max_steps=1500, ensembles=2, walkers=32)
"""For counts over many seeds: enough draws for a 5 % quantile."""


def sampled(specimen, noise: str, plan: Plan) -> Draws:
    return draw_posterior(prepare(specimen, noise=noise), plan)


Task = tuple[str, str, int]


def one_seed(task: Task) -> tuple[Task, dict[str, bool] | None]:
    name, noise, seed = task
    truth = truth_of(name)
    try:
        result = sampled(table6_specimen(name, seed)[0], noise, CHEAP)
    except BiaxbayesError:
        return task, None
    if result.convergence.state == "unusable":
        return task, None
    hits = {}
    for parameter in PARAMETERS:
        low, high = interval(parameter, result.quantities[parameter], truth[parameter])
        hits[parameter] = low <= truth[parameter] <= high
    return task, hits


def shipped_table() -> str:
    rows: list[list[str]] = []
    for name in (*SPECIMENS, *HOOKED):
        truth = truth_of(name)
        results = {
            n: sampled(read_specimen(DATA / f"{name}.csv"), n, Plan(workers=2)) for n in NOISES
        }
        for parameter in PARAMETERS:
            cells: list[str] = []
            for noise in NOISES:
                draws = results[noise].quantities[parameter]
                low, high = interval(parameter, draws, truth[parameter])
                inside = "yes" if low <= truth[parameter] <= high else "**no**"
                cells += [f"{low:.4g} to {high:.4g}", inside]
            rows.append([name, parameter, f"{truth[parameter]:g}", *cells])
        states = [_state(noise, found) for noise, found in results.items()]
        print(f"{name}: {', '.join(states)}", flush=True)
        rows.append([name, "*convergence*", "", states[0], "", states[1], ""])
    header = ["specimen", "parameter", "truth", NOISES[0], "", NOISES[1], ""]
    return table(header, rows, left=len(header))


def _state(noise: str, found: Draws) -> str:
    """How well the chains converged, in words."""
    judged = found.convergence
    return f"{noise}: {judged.state}, R-hat {judged.worst_rhat:.4f}, ESS {judged.worst_ess:.0f}"


def _finished(record: Path) -> dict[tuple[str, str, int], dict[str, bool] | None]:
    """Runs of an interrupted study, from its record."""
    if not record.exists():
        return {}
    rows = [json.loads(line) for line in record.read_text().splitlines()]
    return {(name, noise, seed): hits for name, noise, seed, hits in rows}


def seeds_table(seeds: int, workers: int, record: Path) -> str:
    tasks = [
        (name, noise, FIRST_SEED + s)
        for s in range(seeds)
        for name in SPECIMENS
        for noise in NOISES
    ]
    counts = {(n, e): dict.fromkeys(PARAMETERS, 0) for n in SPECIMENS for e in NOISES}
    done = dict.fromkeys(counts, 0)
    lost = dict.fromkeys(counts, 0)
    known = _finished(record)
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        left = [task for task in tasks if task not in known]
        for task, hits in pool.imap_unordered(one_seed, left):
            known[task] = hits
            with record.open("a") as file:
                file.write(json.dumps([*task, hits]) + "\n")
    for name, noise, seed in tasks:
        found = known[name, noise, seed]
        if found is None:
            lost[name, noise] += 1
            continue
        done[name, noise] += 1
        for parameter, hit in found.items():
            counts[name, noise][parameter] += hit
    rows = []
    for (name, noise), held in counts.items():
        n = max(done[name, noise], 1)
        shares = [f"{held[p]}/{n}" for p in PARAMETERS]
        rows.append([name, noise, *shares, lost[name, noise]])
    return table(["specimen", "noise", *PARAMETERS, "not converged"], rows, left=2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--record", type=Path, default=Path("intervals.jsonl"))
    parser.add_argument("--page", type=Path, default=DATA / "README.md")
    options = parser.parse_args()
    middle = [
        "90 % intervals of the shipped specimens beside the truth (one-sided where the truth is a",
        f"physical edge), made by `python scripts/study.py intervals --seeds {options.seeds}`:",
        "",
        shipped_table(),
        f"The same intervals over {options.seeds} seeds that are not shipped: how many hold the",
        "truth.",
        "With a smooth misfit of 2 % that GOH cannot represent, `effective` comes nearer to 90 %",
        "than `independent`, and both stay short of it. Two things add up: the misfit pulls the",
        "parameters further than the residuals show, and a truth of kappa = 0 lies at the end of",
        "a ridge, where k1, k2 and alpha sit at the end of their intervals too. Take an interval",
        "as what this model and this record allow, not as a promise about tissue that is not GOH.",
        "",
        seeds_table(options.seeds, options.workers, options.record),
    ]
    put(options.page, "intervals", "\n".join(middle))


if __name__ == "__main__":
    main()
