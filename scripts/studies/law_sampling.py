"""How well each law is sampled: state, time, effective draws an evaluation, two seeds compared.

    python scripts/study.py law_sampling aorta.csv valve.csv:ignored virtual --folder FOLDER
    python scripts/study.py law_sampling --folder FOLDER --page docs/laws-evidence.md

A record is a specimen file, with ``:ignored`` where it was tared (`--mounting ignored`), or
``virtual``, three protocols of a known GOH with load noise. Each law is fitted and sampled with two
seeds at default options, to 2,000 effective draws or 20,000 steps. Effective draws, the fewest of
any quantity, are counted per evaluation of the density after the warm-up. Two runs of one posterior
differ by Monte Carlo error alone: of the draws of one a share F lies below the q-quantile of the
other,

    z = (F - q) / sqrt(q (1 - q) (1 / ess_1 + 1 / ess_2)),

for q of 0.05, 0.5 and 0.95 of every parameter and mounting stretch.
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

from biaxbayes.laws import LAWS
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.parameters import mounting_names
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from studies.law_truths import tested
from studies.page import put, table, write_table
from studies.records import kept, run_all

VIRTUAL, IGNORED = "virtual", ":ignored"
LEVELS = (0.05, 0.5, 0.95)
SEEDS = (1, 2)


def record(named: str) -> tuple[Specimen, dict[str, Any]]:
    """A specimen and the options of its posterior."""
    if named == VIRTUAL:
        return tested(), {}
    path = Path(named.removesuffix(IGNORED))
    return read_specimen(path), {"mounting": "ignored"} if named.endswith(IGNORED) else {}


def stem(named: str) -> str:
    """Name of a record in the table."""
    return Path(named.removesuffix(IGNORED)).stem


def sampled(named: str, law: str) -> dict[str, Any]:
    """One law on one record, with two seeds."""
    specimen, options = record(named)
    began = time.process_time()
    posterior = prepare(specimen, law=law, **options)
    posterior.log_prob(np.zeros((1, posterior.dimension)))
    fit = time.process_time() - began
    drawn, seconds = [], []
    for seed in SEEDS:
        began = time.process_time()
        drawn.append(draw_posterior(posterior, Plan(seed=seed)))
        seconds.append(fit + time.process_time() - began)
    return {
        "record": stem(named),
        "law": law,
        "cpu": round(max(seconds), 1),
        "state": [d.convergence.state for d in drawn],
        "ess": [d.convergence.worst_ess for d in drawn],
        "per_evaluation": [d.convergence.worst_ess / kept_evaluations(d) for d in drawn],
        "rhat": [d.convergence.worst_rhat for d in drawn],
        "differences": differences(posterior, drawn),
    }


def kept_evaluations(drawn: Draws) -> int:
    """Evaluations of the density after the warm-up: one a step of each walker."""
    ensembles, steps, walkers, _ = drawn.chain.shape
    return ensembles * steps * drawn.thin * walkers


def differences(posterior: Posterior, drawn: list[Draws]) -> dict[str, list[float]]:
    """Of two runs, in Monte Carlo errors, by quantity."""
    found = {}
    for name in (*posterior.law.names, *mounting_names("stretch")):
        if any(name not in d.convergence.names for d in drawn):
            continue
        ess = []
        for d in drawn:
            k = d.convergence.names.index(name)
            ess.append(min(d.convergence.ess_bulk[k], d.convergence.ess_tail[k]))
        one, other = (d.quantities[name].ravel() for d in drawn)
        z = []
        for q in LEVELS:
            # z = (F - q) / sqrt(q (1 - q) (1 / ess_1 + 1 / ess_2))
            below = float(np.mean(other <= np.quantile(one, q)))
            z.append((below - q) / np.sqrt(q * (1 - q) * (1 / ess[0] + 1 / ess[1])))
        found[name] = [float(v) for v in z]
    return found


def numbered(named: str, number: int) -> dict[str, Any]:
    """The study of the law of this number, with it as its seed: a record has one line a law."""
    return {"seed": number, **sampled(named, tuple(LAWS)[number])}


def judged(folder: Path) -> pd.DataFrame:
    """One row a record and law."""
    rows = []
    for path in sorted(folder.glob("*.jsonl")):
        for r in kept(path):
            z = np.abs([v for values in r["differences"].values() for v in values])
            rows.append(
                {
                    "record": r["record"],
                    "law": r["law"],
                    "state": ", ".join(dict.fromkeys(r["state"])),
                    "processor_s": r["cpu"],
                    "draws_per_evaluation": min(r["per_evaluation"]),
                    "rhat": max(r["rhat"]),
                    "compared": z.size,
                    "beyond_2": int((z > 2.0).sum()),
                    "largest_difference": z.max(),
                }
            )
    return pd.DataFrame(rows)


def summary(found: pd.DataFrame) -> str:
    """One row a law: time, effective draws an evaluation and difference, record by record."""
    records = list(dict.fromkeys(found["record"]))
    rows = []
    for law in LAWS:
        of = found[found["law"] == law].set_index("record").reindex(records)
        cells = (
            [f"{v:.0f}" for v in of["processor_s"]],
            [f"{v:.2f}" for v in of["draws_per_evaluation"]],
            [f"{v:.1f}" for v in of["largest_difference"]],
        )
        rows.append([f"`{law}`", *(", ".join(c) for c in cells)])
    heads = ["law", f"seconds: {', '.join(records)}", "draws", "seeds"]
    beyond = int(found["beyond_2"].sum())
    return table(heads, rows) + (
        f"\nOf {found['compared'].sum()} quantiles {beyond} differ by more than 2 Monte Carlo "
        f"errors between the seeds, the most by {found['largest_difference'].max():.1f}; R-hat is "
        f"at most {found['rhat'].max():.3f}. Chains: "
        + ", ".join(f"{n} {state}" for state, n in found["state"].value_counts().items())
        + ".\n"
    )


def main() -> None:
    """Sample every law on every record that has no line yet, or put the table into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("records", nargs="*", help="specimen files, or `virtual`")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--page", type=Path, help="put the table into this page")
    asked = parser.parse_args()
    for named in asked.records:
        path = asked.folder / f"{stem(named)}.jsonl"
        run_all(partial(numbered, named), range(len(LAWS)), path, asked.workers)
    found = judged(asked.folder)
    text = summary(found)
    print(text)
    if asked.page is not None:
        link = write_table(asked.page.parent, "law-sampling", [str(c) for c in found], found)
        put(asked.page, "law-sampling", f"{text}\n([Every record and law]({link}).)")


if __name__ == "__main__":
    main()
