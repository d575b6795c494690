"""Hold the predictions of ``biaxbayes design`` against sampling again.

For the best candidates, outcomes are simulated, added to the specimen and sampled; the mean
reduction of every spread stands beside the predicted one. A candidate that ranks higher but whose
numbers the design itself does not trust (a reweighting with few effective draws, marked in its
table) is sampled too, and held against the bound from below that the design states for it. Prints
a table; --write puts it into a page between its marks.

    python scripts/study.py design data/donor2-media.csv --outcomes 20
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.errors import NotConverged
from biaxbayes.identifiability.determined import largest_equibiaxial
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.optimal_design.candidates import Candidate
from biaxbayes.optimal_design.design import design
from biaxbayes.optimal_design.information_gain import Expected, targets
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import read_specimen
from studies.page import put, table

__all__ = ["Resampled", "resample"]


@dataclass(frozen=True)
class Resampled:
    """Reductions of the spread over simulated outcomes that were sampled anew.

    Attributes
    ----------
    quantities : tuple of str
    reduction, error : ndarray, shape (quantities,)
        Mean over the outcomes and its standard error.
    outcomes : int
        Those whose chains converged.
    """

    quantities: tuple[str, ...]
    reduction: np.ndarray
    error: np.ndarray
    outcomes: int


def resample(
    posterior: Posterior,
    draws: pd.DataFrame,
    candidate: Candidate,
    *,
    outcomes: int,
    plan: Plan,
    seed: int = 1,
) -> Resampled:
    """Simulate outcomes of a candidate, add each to the specimen and sample again.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
    candidate : Candidate
    outcomes : int
    plan : Plan
        Of each sampling.
    seed : int

    Returns
    -------
    Resampled

    Raises
    ------
    NotConverged
        If fewer than two outcomes could be sampled.
    """
    rng = np.random.default_rng([seed, 1])
    truths = draws.iloc[rng.choice(len(draws), outcomes, replace=False)]
    simulated = candidate.outcomes(truths, rng)
    # The stress is compared at the stretch of the run, whatever the new protocol reached.
    top = largest_equibiaxial(draws, posterior.specimen)
    before = {name: v.std() for name, v in targets(posterior, draws, top).items()}
    rows = []
    for outcome in simulated:
        specimen, options = candidate.added_to(posterior, outcome)
        again = prepare(specimen, **options, beta=posterior.beta, seed=plan.seed)
        found = draw_posterior(again, plan)
        if found.convergence.state != "converged":
            continue
        table = pd.DataFrame({name: q.ravel() for name, q in found.quantities.items()})
        after = targets(again, table, top)
        rows.append([1.0 - after[name].std() / before[name] for name in before])
    if len(rows) < 2:
        raise NotConverged("fewer than two simulated outcomes led to chains that converged")
    values = np.array(rows)
    names = tuple(before)
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return Resampled(names, values.mean(axis=0), error, len(values))


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
    posterior = prepare(read_specimen(options.specimen))
    plan = Plan(ess=options.ess, workers=options.workers)
    found = draw_posterior(posterior, plan)
    draws = pd.DataFrame({name: q.ravel() for name, q in found.quantities.items()})
    planned = design(posterior, draws)
    pairs = list(zip(planned.expected, planned.candidates, strict=True))
    trusted = [i for i, (expected, _) in enumerate(pairs) if expected.trusted]
    text = ""
    for expected, candidate in pairs[: trusted[options.best - 1] + 1]:
        again = resample(
            posterior, draws, candidate, outcomes=options.outcomes, plan=plan, seed=options.seed
        )
        told = f"\n{options.specimen.stem}: {expected.name}, {again.outcomes} outcomes sampled"
        told += "" if expected.trusted else "; not trusted, judged by its bound"
        beside = compared(expected, planned.quantities, again)
        told += "\n\n" + table(list(beside.columns), beside.to_numpy().tolist())
        print(told, flush=True)
        text += told
    if options.write:
        put(options.write, f"design {options.specimen.stem}", text)


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
