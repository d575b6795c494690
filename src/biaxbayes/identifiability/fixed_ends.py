"""An end of a parameter's range as a hypothesis: the others, with the parameter fixed there.

Where the truth lies on an end (aligned fibres: kappa = 0), a prior that is spread over the range
leaves no mass on it, and the ridge leads away from it: no interval of the whole posterior need hold
the truth. Whether the end is true is for the reader to say. Both readings are given: the parameter
free, and fixed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.errors import BiaxbayesError
from biaxbayes.identifiability.marginals import INTERVAL, Edge
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import FORCE, Parameter

if TYPE_CHECKING:
    import pandas as pd

DRAWS = 8192
LEAST_ESS = 1000.0
"""Effective draws from which the ends of an interval are known to a tenth of its sd."""
LARGEST_SHARE = 0.02
"""Most that one draw may weigh: a larger share shows mass that the proposal does not cover."""


@dataclass(frozen=True)
class FixedEnd:
    """Intervals of a posterior with a parameter fixed at an end of its range.

    Attributes
    ----------
    parameter : Parameter
    value : float
    meaning : str
        What a material there is, in words; may be empty.
    intervals : dict of str to (float, float, float)
        5, 50 and 95 % point of every other quantity, by name.
    draws : float
        Effective draws that they were taken from.
    """

    parameter: Parameter
    value: float
    meaning: str
    intervals: dict[str, tuple[float, float, float]]
    draws: float


def fixed_ends(
    posterior: Posterior, edges: Mapping[str, Sequence[Edge]], seed: int = 0
) -> tuple[FixedEnd, ...]:
    """Fix parameters at the ends that the data do not exclude, one at a time.

    Parameters
    ----------
    edges : mapping of str to sequence of Edge
        By parameter: physical ends of its range.

    Returns
    -------
    tuple of FixedEnd
        Without those at which the law has no posterior, or whose draws are too few.
    """
    ends = [fixed_end(posterior, name, edge, seed) for name, own in edges.items() for edge in own]
    return tuple(end for end in ends if end is not None)


def fixed_end(posterior: Posterior, name: str, edge: Edge, seed: int = 0) -> FixedEnd | None:
    """Intervals of the posterior with one parameter fixed at an end of its range.

    Importance sampling with the proposal of the search; the sampler, where that is too poor.

    Parameters
    ----------
    name : str
        A parameter of the law.
    """
    from biaxbayes.model.preparation import charted

    parameter = posterior.quantities[name].parameter
    priors = {**posterior.settings.priors, name: edge.value}
    try:
        at_end = charted(posterior.replaced(priors=priors, fit=None, chart=None))
        quantities, weight, draws = _drawn(at_end, seed)
    except BiaxbayesError:  # no such material, or none that balances the mounting force
        return None
    if draws < LEAST_ESS:
        return None
    lost = {n for n, causes in posterior.law.meaningless.items() if _lost(causes, name, edge)}
    forces = {q.name for q in posterior.sampled if q.parameter.kind == FORCE}
    levels = (INTERVAL[0], 0.5, INTERVAL[1])
    intervals = {}
    for other, values in quantities.items():
        if other == name or other in lost | forces or not np.ptp(values) > 0.0:
            continue
        low, median, high = np.quantile(values, levels, weights=weight, method="inverted_cdf")
        intervals[other] = (float(low), float(median), float(high))
    return FixedEnd(parameter, edge.value, edge.meaning(parameter), intervals, draws)


def _lost(causes: Sequence[tuple[str, int, str]], name: str, edge: Edge) -> bool:
    """Whether a parameter means nothing at an end of another."""
    return any((other, side) == (name, edge.side) for other, side, _ in causes)


def _drawn(posterior: Posterior, seed: int) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
    """Draws of every quantity, their weights, and how many they are worth."""
    from biaxbayes.model.search import search
    from biaxbayes.sampling.sampler import Plan, draw

    plan = Plan(ess=LEAST_ESS, seed=seed)
    target, start = search(posterior, plan.search_rng(), plan.population)
    x = start.proposal.sample(deepcopy(start.rng), DRAWS)  # the sampler goes on with its own
    log_prob = target.log_prob(x)
    x, log_prob = x[np.isfinite(log_prob)], log_prob[np.isfinite(log_prob)]
    log_weight = log_prob - start.proposal.log_density(x)
    weight = np.exp(log_weight - log_weight.max(initial=-np.inf))
    # Kish: (sum w)^2 / sum w^2
    draws = float(weight.sum() ** 2 / (weight**2).sum()) if weight.size else 0.0
    if draws >= LEAST_ESS and weight.max() < LARGEST_SHARE * weight.sum():
        return _judged(target.quantities(x), posterior), weight, draws
    found = draw(target, start, plan)
    ess = found.convergence.worst_ess if found.convergence.state == "converged" else 0.0
    flat = {name: values.ravel() for name, values in found.quantities.items()}
    some = next(iter(flat.values()))
    return _judged(flat, posterior), np.ones(some.size), ess


def _judged(quantities: Mapping[str, Any], posterior: Posterior) -> dict[str, np.ndarray]:
    """The quantities that a summary has, without the densities."""
    return {n: np.asarray(v) for n, v in quantities.items() if n in posterior.parameter_names}


# --- as a table ----------------------------------------------------------------------------------


def fixed_end_table(ends: Sequence[FixedEnd]) -> pd.DataFrame:
    """One row for each hypothesis and quantity."""
    from pandas import DataFrame

    return DataFrame(
        [
            (e.parameter.name, e.value, e.meaning, name, *interval, e.draws)
            for e in ends
            for name, interval in e.intervals.items()
        ],
        columns=["fixed", "at", "meaning", "parameter", "low_90", "median", "high_90", "draws"],
    )
