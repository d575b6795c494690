"""Hold the predictions of ``biaxbayes design`` against sampling again.

For the best candidates, outcomes are simulated, added to the specimen and sampled; the mean
reduction of every spread stands beside the predicted one. A candidate that ranks higher but whose
numbers the design itself does not trust (a reweighting with few effective draws, marked in its
table) is sampled too, and held against the bound from below that the design states for it. Prints
a short table; --write puts it into a page between its marks, and every quantity into a CSV file
beside the page.

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
from studies.page import put, table, write_table

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
    found_anew = []
    for expected, candidate in pairs[: trusted[options.best - 1] + 1]:
        again = resample(
            posterior, draws, candidate, outcomes=options.outcomes, plan=plan, seed=options.seed
        )
        found_anew.append(compared(expected, planned.quantities, again))
        print(found_anew[-1].to_string(index=False), flush=True)
    beside = pd.concat(found_anew, ignore_index=True)
    print(summary(beside))
    if options.write:
        write_place(options.write, options.specimen.stem, beside)


def compared(expected: Expected, quantities: tuple[str, ...], again: Resampled) -> pd.DataFrame:
    """Predicted and sampled reduction of each spread, in per cent with their standard errors."""
    rows: list[dict[str, object]] = []
    for name, value, error in zip(again.quantities, again.reduction, again.error, strict=True):
        i = quantities.index(name)
        row: dict[str, object] = {"candidate": expected.name, "outcomes": again.outcomes}
        row |= {"quantity": name, "sampled_percent": 100 * value, "sampled_se": 100 * error}
        if expected.trusted:
            total = float(np.hypot(error, expected.error[i]))
            row["predicted_percent"] = 100 * expected.reduction[i]
            row["predicted_se"] = 100 * expected.error[i]
            row["difference_in_se"] = (value - expected.reduction[i]) / total
        else:
            row["predicted_at_least_percent"] = 100 * expected.at_least[i]
        rows.append(row)
    return pd.DataFrame(rows).reindex(columns=list(COLUMNS))


COLUMNS = (
    *("candidate", "outcomes", "quantity", "predicted_percent", "predicted_se"),
    *("sampled_percent", "sampled_se", "difference_in_se", "predicted_at_least_percent"),
)
SHOWN = ("k1", "alpha", "kappa", "mounting_stretch_x")
"""Quantities on the page: what equibiaxial tests leave open, and what they tell least of."""


def summary(beside: pd.DataFrame) -> str:
    """A row a candidate: how far predictions and sampling are apart."""
    rows = []
    for (name, outcomes), part in beside.groupby(["candidate", "outcomes"], sort=False):
        of = part.set_index("quantity")
        if part["difference_in_se"].notna().all():
            gap = part["difference_in_se"]
            apart = f"{np.abs(gap).max():.1f}, {np.sqrt((gap**2).mean()):.1f}"
        else:
            apart = "not trusted: at least"
        predicted = of["predicted_percent"].fillna(of["predicted_at_least_percent"])
        each = [f"{predicted[q]:.1f}, {of['sampled_percent'][q]:.1f}" for q in SHOWN]
        rows.append([name, outcomes, *each, apart])
    header = ["candidate", "outcomes", *(f"{q}, %" for q in SHOWN), "difference in se: most, rms"]
    return table(header, rows)


def result(folder: Path) -> str:
    """How far predictions and sampling are apart at most, of all specimens kept beside a page."""
    kept = pd.concat([pd.read_csv(path) for path in sorted(folder.glob("tables/design-*.csv"))])
    gaps = kept["difference_in_se"].dropna()
    return (
        f"The reductions of {len(gaps)} spreads that `design` predicts agree with those of "
        f"sampling again within {gaps.abs().max():.1f} standard errors."
    )


def write_place(page: Path, specimen: str, beside: pd.DataFrame) -> None:
    """Put a specimen's short table and the result of all into a page, all quantities beside it."""
    link = write_table(page.parent, f"design-{specimen}", COLUMNS, beside)
    count = beside["quantity"].nunique()
    told = f"{specimen}; [all {count} quantities with their errors]({link}).\n\n{summary(beside)}"
    put(page, f"design {specimen}", told)
    put(page, "result design", result(page.parent))


if __name__ == "__main__":
    main()
