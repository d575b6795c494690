"""Hold the predictions of ``biaxbayes design`` against sampling again.

For the best candidates, outcomes are simulated, added to the specimen and sampled; the mean
reduction of every spread stands beside the predicted one. A candidate that ranks higher but whose
numbers the design itself does not trust (a reweighting with few effective draws, marked in its
table) is sampled too, and held against the bound from below that the design states for it. Prints
a table; --write puts it into a page between its marks.

    python scripts/study_design.py data/donor2-media.csv --outcomes 20
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.findings.design import design
from biaxbayes.findings.design_check import Resampled, resample
from biaxbayes.findings.expected import Expected
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, draw
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.specimens.text_file import atomic_write_text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("specimen", type=Path)
    parser.add_argument("--outcomes", type=int, default=20)
    parser.add_argument("--best", type=int, default=2)
    parser.add_argument("--ess", type=float, default=500.0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1, help="of the simulated outcomes")
    parser.add_argument("--write", type=Path, help="Markdown page whose table is replaced")
    options = parser.parse_args()
    posterior = Posterior(read_specimen(options.specimen))
    plan = Plan(ess=options.ess, workers=options.workers)
    found = draw(posterior, plan)
    draws = pd.DataFrame({name: q.ravel() for name, q in found.quantities.items()})
    planned = design(posterior, draws)
    pairs = list(zip(planned.expected, planned.candidates, strict=True))
    trusted = [i for i, (expected, _) in enumerate(pairs) if expected.trusted]
    text = ""
    for expected, candidate in pairs[: trusted[options.best - 1] + 1]:
        again = resample(
            posterior, draws, candidate, outcomes=options.outcomes, plan=plan, seed=options.seed
        )
        table = compared(expected, planned.quantities, again)
        told = f"\n{options.specimen.stem}: {expected.name}, {again.outcomes} outcomes sampled"
        told += "" if expected.trusted else "; not trusted, judged by its bound"
        rows = [list(table.columns), ["---"] * len(table.columns), *table.to_numpy().tolist()]
        told += "\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)
        print(told, flush=True)
        text += told
    if options.write:
        mark = f"design {options.specimen.stem}"
        page = options.write.read_text()
        parts = re.split(rf"(<!-- {mark} -->\n|<!-- /{mark} -->)", page)
        atomic_write_text(options.write, "".join([*parts[:2], text + "\n", *parts[3:]]))


def compared(expected: Expected, quantities: tuple[str, ...], again: Resampled) -> pd.DataFrame:
    """Predicted and sampled reduction of each spread."""
    rows = []
    for name, value, error in zip(again.quantities, again.reduction, again.error, strict=True):
        i = quantities.index(name)
        row = {"quantity": name}
        seen = f"{100 * value:.1f} ± {100 * error:.1f} %"
        if expected.trusted:
            total = float(np.hypot(error, expected.error[i]))
            row["predicted"] = (
                f"{100 * expected.reduction[i]:.1f} ± {100 * expected.error[i]:.1f} %"
            )
            row["sampled"] = seen
            row["difference, se"] = f"{(value - expected.reduction[i]) / total:+.1f}"
        else:
            row["predicted at least"] = f"{100 * expected.at_least[i]:.1f} %"
            row["sampled"] = seen
        rows.append(row)
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
