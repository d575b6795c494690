"""A prediction of a design held against the real thing: outcomes simulated and sampled again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.errors import NotConverged
from biaxbayes.findings.candidates import Candidate
from biaxbayes.findings.derived import largest_equibiaxial
from biaxbayes.findings.targets import targets
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, draw

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
        again = Posterior(specimen, **options, beta=posterior.beta, seed=plan.seed)
        found = draw(again, plan)
        if found.convergence.state != "reliable":
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
