"""Laws weighed: virtual specimens whose law is known, and tables of measured ones.

    python scripts/study.py laws --workers 2
    python scripts/study.py laws FOLDER...      tables of what ``biaxbayes laws`` wrote

Does the mixture predict as well as the true law? Truths are drawn from each law's calibration
prior, on three protocols of 31 rows, with load noise alone; ``biaxbayes laws`` fits and samples
every law. A law misses the record where the rms of its fit is more than twice the noise. No
constant was chosen on these seeds.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.calibration.simulated_specimen import (
    draw_truth,
    protocol_prior,
    simulate_specimen,
)
from biaxbayes.options import Settings
from studies.common import options_of, parser, print_table, run_all

MIXTURE = "mixture"
TRUE_LAWS = ("goh", "fung", "four-fibre")
FIRST = 300
"""Seeds below it were used while the laws were made."""
SHORT = 2.0
"""Nats by which the mixture may predict less well than the true law."""
MISSES = 2.0
"""A law misses a record where its rms is more than so many times the noise."""
SMALL = 0.05
"""What laws that miss a record may weigh together."""


def simulated(law: str, seed: int) -> tuple[biaxbayes.Specimen, float]:
    """A specimen of a law, and its noise as a Cauchy stress (kPa, root mean square)."""
    tested, _ = biaxbayes.virtual_specimen(
        biaxbayes.GOH(10.0, 40.0, 5.0, 40.0, 0.15),
        name="virtual",
        mounting_stretch=(1.01, 1.02),
        total_stretch=1.25,
        ratios=((1.0, 1.0), (1.0, 0.5), (0.5, 1.0)),
        increments=30,
        machine=biaxbayes.Machine(noise_N=0.005),
        seed=0,
    )
    posterior = biaxbayes.Posterior(
        tested, law=law, noise="independent", priors=protocol_prior(tested, Settings(law=law))
    )
    rng = np.random.default_rng([seed, TRUE_LAWS.index(law)])
    truth, _ = draw_truth(posterior, rng)
    specimen = simulate_specimen(posterior, truth, rng)
    lm = np.array([truth["mounting_stretch_x"], truth["mounting_stretch_y"]])
    stretch = np.vstack([np.column_stack([p.stretch_x, p.stretch_y]) for p in specimen.protocols])
    # force = section of the unloaded state times Cauchy stress over the total stretch
    kPa_per_N = lm * stretch / specimen.area
    return specimen, float(truth["noise_sd"] * np.sqrt(np.mean(kPa_per_N**2)))


def weigh(law: str, seed: int, laws: str | None, ess: float = 1000.0) -> dict[str, Any]:
    """One specimen: by how much the mixture falls short, and what laws that miss it weigh."""
    specimen, noise_kPa = simulated(law, seed)
    with tempfile.TemporaryDirectory() as folder:
        found = biaxbayes.compare_laws(
            specimen, out=folder, laws=laws, seed=seed, ess=ess, workers=1
        )
    rows = found.table.set_index("law")
    density = rows["left_out_density_nats"]
    mixture = found.parts[found.parts["law"] == MIXTURE]
    single = rows.drop(MIXTURE)
    missing = single[single["rms_kPa"] > MISSES * noise_kPa]
    return {
        "short": float(density[law] - mixture["density_final_weights"].sum()),
        "short_unseen": float(density[law] - density[MIXTURE]),
        "true_weight": float(single["weight"][law]),
        "missing_weight": float(missing["weight"].sum()),
        "not_converged": int((single["state"] != "converged").sum()),
    }


def summary(records: list[dict[str, Any]]) -> pd.DataFrame:
    """A row per true law."""
    every = pd.DataFrame(records).assign(law=[record["case"][0] for record in records])
    rows = []
    for law, part in every.groupby("law", sort=False):
        row: dict[str, object] = {"true_law": law, "specimens": len(part)}
        for name in ("short", "short_unseen"):
            row[f"{name}_at_most_{SHORT:g}_nats"] = int((part[name] <= SHORT).sum())
            row |= {f"{name}_median": part[name].median(), f"{name}_largest": part[name].max()}
        row[f"missing_below_{SMALL:g}"] = int((part["missing_weight"] < SMALL).sum())
        row["true_weight_median"] = part["true_weight"].median()
        row["not_converged"] = part["not_converged"].sum()
        rows.append(row)
    return pd.DataFrame(rows)


def measured(folder: Path) -> pd.DataFrame:
    """What ``biaxbayes laws`` found of a specimen: laws by the density of what was left out."""
    columns = ["law", "rms_kPa", "left_out_rms_kPa", "left_out_density_nats", "weight", "state"]
    laws = pd.read_csv(folder / "laws.csv")[columns]
    return laws.sort_values("left_out_density_nats", ascending=False)


def main() -> None:
    """Weigh the laws on virtual specimens, or print the tables of folders."""
    arguments = parser(__doc__)
    arguments.add_argument("folders", type=Path, nargs="*", help="of `biaxbayes laws`")
    arguments.add_argument("--count", type=int, default=20, help="specimens of each law")
    options = options_of(arguments)
    for folder in options.folders:
        print_table(str(folder), measured(folder))
    if options.folders:
        return
    count, true_laws = (1, TRUE_LAWS[1:2]) if options.quick else (options.count, TRUE_LAWS)
    chosen = ("goh,fung", 100.0) if options.quick else (None,)
    cases = [(law, seed, *chosen) for law in true_laws for seed in range(FIRST, FIRST + count)]
    records = run_all(weigh, cases, options.records / "laws.jsonl", options.workers)
    print_table("specimens of a known law", summary(records))


if __name__ == "__main__":
    main()
