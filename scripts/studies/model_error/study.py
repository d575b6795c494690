"""Which error model is to be believed? Many specimens that GOH cannot represent.

    python scripts/study.py model_error run --specimens 120 --folder model-error
    python scripts/study.py model_error table --folder model-error [--page docs/model-error.md]

Each specimen has three protocols of 40 rows and one of five truths: four fibre families; two
layers of different GOH tissue in parallel; fibres that are recruited gradually, so that the toe is
not GOH; a stiff, concave start as of tissue that was not preconditioned enough; a GOH tissue with a
smooth relative misfit. A third of them are mounted at stretches of 1.1 to 1.3. Every candidate
samples every specimen; draws are kept, and a study that was stopped goes on. Shares of the work
(--first 0 --step 2 and --first 1 --step 2) run side by side in one folder.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from biaxbayes.errors import BiaxbayesError
from studies.model_error.candidates import CANDIDATES
from studies.model_error.kept_draws import kept, write
from studies.model_error.tables import coverage, draw_coverage, judge_all, page_table, result
from studies.model_error.truths import make_case
from studies.page import put, write_table


def run(folder: Path, seeds: range, candidates: list[str], ess: float) -> None:
    """Sample what is not there yet, one candidate after the other."""
    for candidate in candidates:
        for seed in seeds:
            if kept(folder, seed, candidate):
                continue
            case = make_case(seed)
            clock = time.process_time()
            try:
                answers = CANDIDATES[candidate](case.specimen, ess)
            except (BiaxbayesError, np.linalg.LinAlgError) as error:
                print(f"{seed} {case.kind} {candidate}: {error}", flush=True)
                continue
            cpu = time.process_time() - clock
            # The candidate itself last: where it is kept, its variants are.
            for name, answer in reversed(answers.items()):
                write(folder, seed, name or candidate, answer, cpu)
            print(f"{seed} {case.kind} {candidate}: {cpu:.1f} s", flush=True)


TABLES = {"model-error": "model-error", "candidates": "model-error-candidates"}


def write_place(page: Path, place: str, found: pd.DataFrame, specimens: int, far: int) -> None:
    """Put the short table into a page, all of it beside the page; of one candidate its figure."""
    link = write_table(page.parent, TABLES[place], list(found.columns), found)
    put(page, place, page_table(found, specimens, far, link))
    if place == "model-error":
        put(page, "result", result(found, specimens))
        draw_coverage(found, page.parent / "figures" / "model-error.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("--folder", type=Path, default=Path("model-error"))
    parser.add_argument("--page", type=Path, help="Put the table into this page, all beside it.")
    parser.add_argument("--specimens", type=int, default=120)
    parser.add_argument("--candidates", nargs="+", help="These alone.")
    parser.add_argument("--ess", type=float, default=200.0)
    parser.add_argument("--first", type=int, default=0, help="First seed, for a share of the work.")
    parser.add_argument("--step", type=int, default=1)
    options = parser.parse_args()
    if options.what == "run":
        seeds = range(options.first, options.specimens, options.step)
        run(options.folder, seeds, options.candidates or list(CANDIDATES), options.ess)
        return
    wanted = options.candidates or [*CANDIDATES, "sandwich"]
    data = judge_all(options.folder, range(options.specimens), wanted)
    found = coverage(data)
    print(found.to_string(index=False))
    if options.page:
        place = "model-error" if options.candidates else "candidates"
        each = data.drop_duplicates("seed")["far"]
        write_place(options.page, place, found, len(each), int(each.sum()))


if __name__ == "__main__":
    main()
