"""How long a population takes from finished runs, and how that grows with the specimens."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path
from typing import Any

import pandas as pd

import biaxbayes
from biaxbayes.jobs.batch import Batch
from biaxbayes.studies.study_file import read_study
from studies.population.virtual import Plan, made, write
from studies.quick_runs import without_products

__all__ = ["finished_runs", "timed"]

SEED = 7
INCREMENTS = 12


def finished_runs(folder: Path, count: int) -> Path:
    """The finished study of so many specimens, media of two to a donor, or what is missing of it.

    Its runs have draws and no figures, which no population reads.
    """
    plan = Plan(count, increments=INCREMENTS)
    file = write(made(plan, SEED), folder, plan.noise)
    with without_products():
        Batch(read_study(file), folder / "study").execute()
    return folder / "study"


def timed(study: Path, count: int, folder: Path, workers: int) -> dict[str, Any]:
    """The population of so many specimens of a finished study: seconds and effective draws."""
    part = folder / f"first-{count}"
    part.mkdir(parents=True, exist_ok=True)
    _first(study, count).to_csv(part / "study.csv", index=False)
    shutil.copy(study / "study.json", part / "study.json")
    out = folder / f"population-{count}"
    shutil.rmtree(out, ignore_errors=True)
    load = os.getloadavg()[0]
    cpu, wall = time.process_time(), time.perf_counter()
    found = biaxbayes.population(part, out=out, seed=1, workers=workers)
    record = json.loads((out / "population.json").read_text())
    return {
        "seed": count,
        "specimens": len(record["identity"]["runs"]),
        "distinct": len({r["draws"] for r in record["identity"]["runs"].values()}),
        "workers": workers,
        "state": found.state,
        "cpu": round(time.process_time() - cpu, 1),
        "wall": round(time.perf_counter() - wall, 1),
        "load": round(load, 1),
        "processors": os.cpu_count(),
        "convergence": record["convergence"],
    }


def _first(study: Path, count: int) -> pd.DataFrame:
    """Rows of so many specimens; where there are fewer, the same again as of other donors."""
    table = pd.read_csv(study / "study.csv", dtype=str, keep_default_na=False)
    table = table.drop_duplicates("specimen")
    table["folder"] = [str((study / f).resolve()) for f in table["folder"]]
    parts = []
    for turn in range(-(-count // len(table))):
        again = table.copy()
        for column in ("specimen", "donor"):
            again[column] += f"-{turn}" if turn else ""
        parts.append(again)
    return pd.concat(parts).head(count)
