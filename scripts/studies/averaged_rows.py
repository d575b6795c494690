"""What averaging the rows of a long record changes of the answer, and what it saves.

    biaxbayes convert ... --out aorta.csv
    python scripts/study.py averaged_rows aorta.csv --folder averaged [--page docs/model-error.md]

The command ``sample`` is run with all rows and with averaged ones, in turns. Ratios of its time and
memory are those of this machine as it is now; the quantiles do not depend on it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
import pandas as pd

from biaxbayes import open_run
from biaxbayes.runs.run import Run
from studies.page import number, put, write_table

ALL, AVERAGED = "none", "auto"
TABLE = "model-error-averaged-rows"
QUANTILES = ("q05", "q50", "q95")


def sampled(specimen: Path, folder: Path, thin: str) -> tuple[float, int]:
    """Sample into a folder of this name: wall time (s), and the most that a process held (MB)."""
    command = [sys.executable, "-m", "biaxbayes", "sample", str(specimen), "--thin", thin]
    command += ["--out", str(folder / thin), "--overwrite", "--workers", "2", "--quiet"]
    clock = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - clock
    if code := os.waitstatus_to_exitcode(status):
        raise SystemExit(f"sample ended with {code}")
    return seconds, usage.ru_maxrss >> 10


def side_by_side(whole: Run, averaged: Run) -> pd.DataFrame:
    """One row a parameter: quantiles of both runs."""
    tables = [run.summary.set_index("parameter") for run in (whole, averaged)]
    rows = []
    for name in tables[0].index:
        row: dict[str, object] = {"parameter": name, "unit": tables[0].loc[name, "unit"]}
        for rows_of, table in zip(("all_rows", "averaged"), tables, strict=True):
            row |= {f"{rows_of}_{q}": table.loc[name, q] for q in QUANTILES}
        rows.append(row)
    return pd.DataFrame(rows)


def largest_move(found: pd.DataFrame) -> float:
    """The largest difference of a quantile, as a share of the parameter's 90 % interval."""
    before, after = (found[[f"{r}_{q}" for q in QUANTILES]] for r in ("all_rows", "averaged"))
    width = (found["all_rows_q95"] - found["all_rows_q05"]).to_numpy(dtype=float)
    moved = np.abs(after.to_numpy(dtype=float) - before.to_numpy(dtype=float))
    free = width > 0.0
    return float((moved[free] / width[free, None]).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("specimen", type=Path)
    parser.add_argument("--folder", type=Path, required=True, help="of the runs; overwritten")
    parser.add_argument("--times", type=int, default=3, help="how often each is run")
    parser.add_argument("--page", type=Path, help="Put the result into this page.")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    spent: dict[str, list[float]] = {ALL: [], AVERAGED: []}
    held: dict[str, list[int]] = {ALL: [], AVERAGED: []}
    for _ in range(options.times):
        for thin in spent:
            seconds, MB = sampled(options.specimen, options.folder, thin)
            spent[thin].append(seconds)
            held[thin].append(MB)
            print(f"--thin {thin}: {seconds:.1f} s, {MB} MB", flush=True)
    runs = [open_run(options.folder / thin) for thin in (ALL, AVERAGED)]
    found = side_by_side(*runs)
    rows, kept = (
        sum(p.rows - p.rest_rows for p in run.posterior().thinned.specimen.protocols)
        for run in runs
    )
    times, memory = (median(of[AVERAGED]) / median(of[ALL]) for of in (spent, held))
    text = (
        f"Of the aorta {rows:,} rows become {kept}; [no quantile](tables/{TABLE}.csv) of 5, 50 or "
        f"95 % moves by more than {number(100.0 * largest_move(found), 2)} % of its 90 % interval, "
        f"Monte Carlo error included, and `biaxbayes sample` takes {times:.2f} of the time and "
        f"{memory:.2f} of the memory, "
        f"{median(held[AVERAGED]):.0f} instead of {median(held[ALL]):.0f} MB (medians of "
        f"{options.times} runs in turns, two workers).\n"
    )
    print(found.to_string(index=False))
    print(text)
    if options.page:
        write_table(options.page.parent, TABLE, list(found.columns), found)
        put(options.page, "averaged-rows", text)


if __name__ == "__main__":
    main()
