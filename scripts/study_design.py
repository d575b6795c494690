"""Hold the predictions of ``biaxbayes design`` against sampling again.

For the best candidates, outcomes are simulated, added to the specimen and sampled; the mean
reduction of every spread stands beside the predicted one. Prints a table.

    python scripts/study_design.py data/donor2-media.csv --outcomes 20
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.findings.design import Expected, design
from biaxbayes.findings.design_check import Resampled, resample
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, draw
from biaxbayes.specimens.specimen_file import read_specimen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("specimen", type=Path)
    parser.add_argument("--outcomes", type=int, default=20)
    parser.add_argument("--best", type=int, default=2)
    parser.add_argument("--ess", type=float, default=500.0)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    posterior = Posterior(read_specimen(options.specimen))
    plan = Plan(ess=options.ess, workers=options.workers)
    found = draw(posterior, plan)
    draws = pd.DataFrame({name: q.ravel() for name, q in found.quantities.items()})
    planned = design(posterior, draws)
    pairs = list(zip(planned.expected, planned.candidates, strict=True))[: options.best]
    for expected, candidate in pairs:
        again = resample(posterior, draws, candidate, outcomes=options.outcomes, plan=plan)
        show(expected, planned.quantities, again)


def show(expected: Expected, quantities: tuple[str, ...], again: Resampled) -> None:
    print(f"\n{expected.name}, {again.outcomes} outcomes sampled again")
    print(f"{'quantity':<22}{'predicted':>16}{'sampled':>16}{'difference':>12}")
    for name, value, error in zip(again.quantities, again.reduction, again.error, strict=True):
        i = quantities.index(name)
        total = float(np.hypot(error, expected.error[i]))
        told = f"{100 * expected.reduction[i]:.1f} ± {100 * expected.error[i]:.1f}"
        seen = f"{100 * value:.1f} ± {100 * error:.1f}"
        apart = (value - expected.reduction[i]) / total
        print(f"{name:<22}{told + ' %':>16}{seen + ' %':>16}{apart:>+9.1f} se")


if __name__ == "__main__":
    main()
