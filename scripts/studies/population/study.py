"""Populations of virtual specimens whose truth is known, and NUTS on the same hierarchical model.

    python scripts/study.py population agreement --folder FOLDER    (needs the extra bench)
    python scripts/study.py population calibration --folder FOLDER --studies 200 --workers 2
    python scripts/study.py population ridge --folder FOLDER --studies 20
    python scripts/study.py population time --folder FOLDER --specimens 10 20 40 100
    python scripts/study.py population table --folder FOLDER --page docs/population-evidence.md

``agreement``: six specimens of three protocols in two groups, and NUTS on all of it at once.
``calibration``: studies whose truths are drawn from the model's own priors. ``ridge``: twelve
media, nine with an equibiaxial test only; ``alike``: all twelve so. ``common-misfit`` and
``own-misfit``: media that the law misses smoothly, all in the same way or each in its own;
``no-misfit``: the same media without it.
``time``: how long a population takes from finished runs. Every study that ends is kept as a line
of JSON, and the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import os
import sys
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

FIRST = 100
"""Seeds below it were used while the studies were made."""
POOLED = ("ridge", "alike", "common-misfit", "own-misfit", "no-misfit")


def main() -> None:
    """Make one kind of study, or the tables of all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["agreement", "calibration", *POOLED, "time", "table"])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--studies", type=int, default=20)
    parser.add_argument("--first", type=int, default=FIRST, help="first seed")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--specimens", type=int, nargs="+", default=[10, 20, 40, 100])
    parser.add_argument(
        "--runs", type=int, default=20, help="finished runs that time is taken from"
    )
    parser.add_argument("--draws", type=int, default=3000, help="of each chain of NUTS")
    parser.add_argument("--warmup", type=int, default=600)
    parser.add_argument("--packages", help="a folder of further packages, such as jax")
    parser.add_argument("--page", type=Path, help="put the tables into this page")
    asked = parser.parse_args()
    if asked.packages:
        sys.path.append(asked.packages)
    seeds = range(asked.first, asked.first + asked.studies)
    records = asked.folder / f"{asked.what}.jsonl"
    if asked.what == "table":
        from studies.population.tables import write_tables

        write_tables(asked.folder, asked.page)
    elif asked.what == "agreement":
        agree(asked.folder, asked.draws, asked.warmup)
    elif asked.what == "time":
        time_them(asked.folder, asked.specimens, asked.runs, asked.workers)
    elif asked.what == "calibration":
        from studies.population.calibration import calibrate
        from studies.records import run_all

        run_all(calibrate, seeds, records, asked.workers)
    else:
        from studies.population.pooled import pooled_study
        from studies.records import run_all

        run_all(partial(pooled_study, asked.what), seeds, records, asked.workers)


def agree(folder: Path, draws: int, warmup: int) -> None:
    """The six specimens where they are not there yet, and NUTS anew."""
    from studies.population.agreement import SEED, make_six, nuts
    from studies.records import run_all

    if not (folder / "six" / "population" / "population.nc").exists():
        make_six(folder / "six")
    run_all(lambda _: nuts(folder / "six", draws, warmup), [SEED], folder / "agreement.jsonl", 1)


def time_them(folder: Path, counts: list[int], runs: int, workers: int) -> None:
    """Populations of the specimens of one finished study."""
    from studies.population.timing import finished_runs, timed
    from studies.records import run_all

    study = finished_runs(folder / "many", runs)

    def one(count: int) -> dict[str, object]:
        return timed(study, count, folder / "many", workers)

    run_all(one, counts, folder / "time.jsonl", 1)


if __name__ == "__main__":
    main()
