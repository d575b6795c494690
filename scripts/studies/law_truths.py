"""Laws weighed on virtual specimens whose law is known.

    OMP_NUM_THREADS=1 python scripts/study.py law_truths --folder FOLDER --count 20 --workers 2
    python scripts/study.py law_truths --folder FOLDER --page docs/laws-evidence.md

Does the mixture foretell as well as the true law? Truths are drawn from each law's calibration
prior (the one that its simulation-based calibration draws from), on three protocols of 31 rows,
with load noise alone. Every law is fitted and sampled as ``biaxbayes laws`` does it. A law misses
the record where the rms of its fit is more than twice the noise. Every specimen that ends is kept
as a line of JSON, and the same command goes on where it was stopped. No constant was chosen on
these seeds.
"""

from __future__ import annotations

import argparse
import os
import time
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from biaxbayes.calibration.simulated_specimen import (
    Rules,
    draw_truth,
    protocol_prior,
    simulate_specimen,
)
from biaxbayes.comparison.law_weights import STACKED
from biaxbayes.jobs.laws import chosen_laws, compared_laws
from biaxbayes.laws import law_named
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.mounting import load_per_stress
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import LawsPlan
from biaxbayes.parallel import InThisProcess
from biaxbayes.parameters import NOISE_SD, mounting_names
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from studies.page import put, table
from studies.records import kept, run_all

FINAL = "density_final_weights"
TRUE_LAWS = ("goh", "fung", "four-fibre")
FIRST = 300
"""Seeds below it were used while the laws were made."""
SHORT = 2.0
"""Nats by which the mixture may foretell less well than the true law."""
MISSES = 2.0
"""A law misses a record where its rms is more than so many times the noise."""
SMALL = 0.05
"""What laws that miss a record may weigh together."""


def tested() -> Specimen:
    """The specimen whose protocols, dimensions and peak every truth is drawn for."""
    specimen, _ = virtual_specimen(
        GOH(10.0, 40.0, 5.0, 40.0, 0.15),
        name="virtual",
        mounting_stretch=(1.01, 1.02),
        total_stretch=1.25,
        ratios=((1.0, 1.0), (1.0, 0.5), (0.5, 1.0)),
        increments=30,
        machine=Machine(noise_N=0.005),
        seed=0,
    )
    return specimen


def simulated(law: str, seed: int) -> tuple[Specimen, dict[str, float]]:
    """A specimen of a law, and its true values."""
    base = tested()
    posterior = Posterior(
        base, law=law, noise="independent", priors=protocol_prior(base, law_named(law))
    )
    rules = Rules(base, posterior.settings, posterior.priors, posterior.mounts)
    rng = np.random.default_rng([seed, TRUE_LAWS.index(law)])
    truth, _ = draw_truth(rules, rng)
    return simulate_specimen(rules, truth, rng), truth


def noise_kPa(specimen: Specimen, truth: dict[str, float]) -> float:
    """Root mean square over the record of the noise, as a Cauchy stress."""
    mounting = np.array([truth[name] for name in mounting_names("stretch")])
    stretch = np.vstack([np.column_stack([p.stretch_x, p.stretch_y]) for p in specimen.protocols])
    mounted = specimen.geometry == "mounted"
    per_kPa = load_per_stress(specimen.area, stretch, mounting, mounted)
    return float(truth[NOISE_SD.name] * np.sqrt(np.mean(per_kPa**-2.0)))


def weigh(law: str, laws: tuple[str, ...], seed: int) -> dict[str, Any]:
    """One specimen: what every law misses, foretells and weighs."""
    began = time.process_time()
    specimen, truth = simulated(law, seed)
    plan = LawsPlan(seed=seed)
    compared = compared_laws(specimen, {}, laws, plan, InThisProcess())
    rows = compared.table.set_index("law")
    mixture = compared.parts[compared.parts["law"] == STACKED]
    return {
        "seed": seed,
        "law": law,
        "truth": truth,
        "noise_kPa": noise_kPa(specimen, truth),
        "left_out": compared.left_out,
        "states": rows["state"].drop(STACKED).to_dict(),
        **{name: rows[name].drop(STACKED).to_dict() for name in ("rms", "left_out_rms", "weight")},
        "left_out_density": rows["left_out_density"].to_dict(),
        **{name: float(mixture[name].sum()) for name in ("effective_readings", FINAL)},
        "held": float(np.average(mixture["band_coverage"], weights=mixture["readings"])),
        "cpu": round(time.process_time() - began, 1),
    }


def judged(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row a specimen: how far the mixture falls short, and what laws that miss it weigh.

    ``short`` is of the mixture with its final weights, ``unseen`` of the one whose weights have not
    seen the part; records of earlier code have the latter alone.
    """
    rows = []
    for r in records:
        density, law = r["left_out_density"], r["law"]
        bad = [k for k, rms in r["rms"].items() if rms > MISSES * r["noise_kPa"]]
        rows.append(
            {
                "seed": r["seed"],
                "short": density[law] - r[FINAL] if law in density and FINAL in r else np.nan,
                "unseen": density[law] - density[STACKED] if law in density else np.nan,
                "true_weight": r["weight"].get(law, 0.0),
                "missing_weight": sum(w for k in bad if np.isfinite(w := r["weight"][k])),
                "not_converged": sum(s != "converged" for s in r["states"].values()),
                "true_state": r["states"][law],
            }
        )
    return pd.DataFrame(rows)


def _spread(values: pd.Series) -> str:
    return f"{values.median():.2f} ({values.max():.2f})"


def summary(folder: Path) -> str:
    """The table of all laws."""
    rows = []
    for law in TRUE_LAWS:
        found = judged(kept(folder / f"{law}.jsonl"))
        if found.empty:
            continue
        good, unseen = found["short"] <= SHORT, found["unseen"] <= SHORT
        small = found["missing_weight"] < SMALL
        rows.append(
            [
                f"`{law}`",
                len(found),
                f"{good.sum()} of {found['short'].notna().sum()}; {_spread(found['short'])}",
                f"{unseen.sum()} of {len(found)}; {_spread(found['unseen'])}",
                f"{small.sum()} of {len(found)}; {found['missing_weight'].max():.3f}",
                f"{found['true_weight'].median():.2f}",
                int(found["not_converged"].sum()),
            ]
        )
    heads = [
        "true law",
        "specimens",
        f"at most {SHORT:g} nats short; median (largest), weights of all parts",
        "the same, weights of the other parts",
        f"laws that miss the record weigh below {SMALL:g}; most",
        "weight of the true law, median",
        "posteriors not converged",
    ]
    return table(heads, rows)


def main() -> None:
    """Weigh the laws on every specimen that has no record yet, or put the table into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--true-laws", nargs="+", default=list(TRUE_LAWS), choices=TRUE_LAWS)
    parser.add_argument("--laws", help="that are weighed  [all]")
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--page", type=Path, help="put the table into this page")
    asked = parser.parse_args()
    if asked.page is None:
        laws = chosen_laws(asked.laws)
        for law in asked.true_laws:
            run_all(
                partial(weigh, law, laws),
                range(asked.first, asked.first + asked.count),
                asked.folder / f"{law}.jsonl",
                asked.workers,
            )
    text = summary(asked.folder)
    print(text)
    if asked.page is not None:
        put(asked.page, "law-truths", text)


if __name__ == "__main__":
    main()
