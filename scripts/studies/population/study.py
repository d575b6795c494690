"""Populations of virtual specimens whose truth is known.

    python scripts/study.py population --workers 2

``calibration``: studies whose truths are drawn from the model's own priors. ``ridge``: twelve
media, nine with an equibiaxial test only; ``alike``: all twelve so. ``common-misfit`` and
``own-misfit``: media that the law misses smoothly, all in the same way or each in its own;
``no-misfit``: the same media without it. ``docs/population.md`` quotes the tables.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from biaxbayes.calibration.ranks import calibration_table
from studies.common import (
    BLUE,
    RED,
    options_of,
    parser,
    print_table,
    run_all,
    save_figure,
    write_table,
)
from studies.population.calibration import RANKED_DRAWS, calibrate
from studies.population.pooled import pooled_study
from studies.population.virtual import CENTRES, PARAMETERS, SD_SPECIMENS, on_scale

FIRST = 100
"""Seeds below it were used while the studies were made."""
POOLED = ("ridge", "alike", "common-misfit", "own-misfit", "no-misfit")


def calibrated(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Uniformity and coverage of every quantity over the studies."""
    ranks = [
        {"parameter": name, "unit": "", "rank": rank, "below": record["below"][name]}
        for record in records
        for name, rank in record["rank"].items()
    ]
    return calibration_table(pd.DataFrame(ranks), RANKED_DRAWS)


def pooling(records: list[dict[str, Any]]) -> pd.DataFrame:
    """What pooling does to intervals of the specimens with the fewest protocols, and to the mean.

    Widths are medians of pooled over single ones; errors of the mean are root mean squares.
    """
    parts = ("truth", "single", "pooled", "mean", "sd_specimens", "protocols")
    truth, single, pooled, mean, sd, protocols = (
        np.array([record[name] for record in records]) for name in parts
    )
    few = np.broadcast_to(protocols == protocols.min(), truth.shape[:2])
    centre = on_scale(CENTRES["media"])

    def inside(intervals: np.ndarray) -> np.ndarray:
        found = (intervals[:, :, 0] <= truth) & (truth <= intervals[:, :, 2])
        return np.asarray(found[few].mean(axis=0))

    def rms(error: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt((error**2).mean(axis=0)))

    width = (pooled[:, :, 2] - pooled[:, :, 0]) / (single[:, :, 2] - single[:, :, 0])
    columns = {
        "width_pooled_over_single": np.median(width[few], axis=0),
        "single_contains": inside(single),
        "pooled_contains": inside(pooled),
        "error_of_mean": rms(mean[:, 1] - centre),
        "error_of_mean_of_medians": rms(single[:, :, 1].mean(axis=1) - centre),
        "error_of_mean_of_truths": rms(truth.mean(axis=1) - centre),
        "mean_contains": ((mean[:, 0] <= centre) & (centre <= mean[:, 2])).mean(axis=0),
        "sd_specimens_over_true": np.median(sd[:, 1], axis=0) / SD_SPECIMENS,
    }
    return pd.DataFrame({"parameter": PARAMETERS, **columns})


def not_converged(records: list[dict[str, Any]]) -> str:
    """How many populations and single runs did not reach their target."""
    states = [record["state"] for record in records]
    singles = [state for record in records for state in record["singles"]]
    counts = (f"{sum(s != 'converged' for s in x)} of {len(x)}" for x in (states, singles))
    return "{} populations and {} single runs not converged".format(*counts)


def draw(coverage: pd.DataFrame, ridge: pd.DataFrame, out: Path) -> None:
    """Coverage over the calibration, and what pooling does to intervals and to the mean."""
    drawing, (left, right) = plt.subplots(1, 2, figsize=(6.9, 2.9))
    left.plot(coverage["coverage_90"], "o", ms=3, color=BLUE)
    left.axhline(0.9, color="0.6", lw=0.8)
    left.set(xticks=[], ylim=(0.8, 1.0), ylabel="coverage of 90 % intervals", title="Calibration")
    ratio = ridge["error_of_mean"] / ridge["error_of_mean_of_medians"]
    right.axhline(1.0, color="0.6", lw=0.8)
    label = "width of an interval, pooled over single"
    right.plot(ridge["parameter"], ridge["width_pooled_over_single"], "s", color=BLUE, label=label)
    label = "error of the group's mean over that of the mean of medians"
    right.plot(ridge["parameter"], ratio, "o", color=RED, label=label)
    right.set(ylim=(0, 1.4), ylabel="ratio", title="Long ridges")
    right.legend(loc="upper left")
    save_figure(drawing, out, "population-evidence")


def main() -> None:
    """Run all kinds of studies, or one of them."""
    arguments = parser(__doc__)
    arguments.add_argument("--only", choices=["calibration", *POOLED])
    options = options_of(arguments)
    folder = options.records / "population"
    kinds = ("no-misfit",) if options.quick else ("calibration", *POOLED)
    tables = {}
    for kind in kinds:
        if options.only not in (None, kind):
            continue
        study = calibrate if kind == "calibration" else partial(pooled_study, kind)
        count = 1 if options.quick else 200 if kind == "calibration" else 20
        cases = [(seed,) for seed in range(FIRST, FIRST + count)]
        records = run_all(study, cases, folder / f"{kind}.jsonl", options.workers)
        print(f"{kind}: {not_converged(records)}")
        tables[kind] = calibrated(records) if kind == "calibration" else pooling(records)
        if kind == "calibration":
            write_table(options.out, "population-calibration", tables[kind])
        else:
            print_table(kind, tables[kind])
    if {"calibration", "ridge"} <= tables.keys():
        draw(tables["calibration"], tables["ridge"], options.out)


if __name__ == "__main__":
    main()
