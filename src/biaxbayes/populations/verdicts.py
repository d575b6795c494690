"""What is told of a population: verdicts on pooled values, and what follows from them.

The rule is :func:`biaxbayes.identifiability.verdict.decide`. A group's mean is compared with the
prior of the same median, a specimen's pooled value with the prior of a specimen of its group, both
before any record was looked at: what the records of the whole study tell, its own or not. Spreads
are compared on the scale of the model, where their priors are half-normal, and end at zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import contractions
from biaxbayes.identifiability.determined import NORMAL_90, Derived, derived_quantities
from biaxbayes.identifiability.evidence import evidence_of_draws
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.marginals import Scale
from biaxbayes.identifiability.verdict import (
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    ParameterVerdict,
    Thresholds,
    judge_parameters,
)
from biaxbayes.laws.law import Law
from biaxbayes.model.priors import DrawnPrior
from biaxbayes.parameters import STRETCH, Parameter, Quantity
from biaxbayes.populations.model import LINEAR, LOG, PooledValue
from biaxbayes.populations.predictive import Hyper
from biaxbayes.populations.specimens import Source

if TYPE_CHECKING:
    from biaxbayes.populations.result import Population

# --- verdicts: the rule of single runs, with the prior that a value has here ---------------------


def mean_verdicts(
    hyper: Hyper,
    prior: Hyper,
    group: int,
    law: Law,
    materials: pd.DataFrame,
    top: float,
    state: str,
) -> dict[str, ParameterVerdict]:
    """Verdicts on a group's means, by pooled value.

    Parameters
    ----------
    hyper, prior : Hyper
        Draws of the posterior and of the prior.
    group : int
    law : Law
    materials : DataFrame
        The group's means of the same draws, as parameters of the law.
    top : float
        Largest equibiaxial total stretch, at which ends of ranges are near.
    state : str
    """
    own, before = hyper.typical(group), prior.typical(group)
    columns = {v.name: v.from_scale(own[:, k]) for k, v in enumerate(hyper.values)}
    scales = [
        Scale(Quantity(v.parameter), DrawnPrior(v.from_scale(before[:, k])))
        for k, v in enumerate(hyper.values)
    ]
    ends = np.full((len(materials), 2), top)
    distances = law.edge_distances(law.material(materials), [ends])
    return _judged(scales, columns, hyper.log_prior(), distances, law, state)


def spread_parameter(v: PooledValue, side: str) -> Parameter:
    """The sd of a pooled value, on the scale of the model.

    It is sharp where what is left open of it moves the 90 % interval of a new specimen by less than
    a sharp interval of the value is wide.
    """
    p = v.parameter
    width = math.log(p.sharp) if p.logarithmic else p.sharp
    return Parameter(
        f"{side} of {v.name}",
        unit="1" if p.logarithmic else p.unit,
        words=f"sd of {'ln ' if p.logarithmic else ''}{v.name}",
        low=0.0,
        at_low="no spread",
        sharp=width / NORMAL_90,
        digits=".2g",
    )


def spread_verdicts(
    hyper: Hyper, group: int, law: Law, state: str
) -> dict[str, dict[str, ParameterVerdict]]:
    """Verdicts on the sds of donors and of a group's specimens, by pooled value and side.

    Parameters
    ----------
    hyper : Hyper
    group : int
    law : Law
    state : str
    """
    out = {}
    log_prior = hyper.log_prior()
    for k, v in enumerate(hyper.values):
        sides = {
            "sd_donors": (hyper.sd_donors[:, k], v.donor_scale),
            "sd_specimens": (hyper.spread(group)[:, k], v.specimen_scale),
        }
        scales, columns, distances = [], {}, {}
        for side, (values, scale) in sides.items():
            p = spread_parameter(v, side)
            scales.append(Scale(Quantity(p), _half_normal(scale)))
            columns[p.name] = values
            distances[p.name] = p.sharp
        found = _judged(scales, columns, log_prior, distances, law, state)
        out[v.name] = {side: found[f"{side} of {v.name}"] for side in sides}
    return out


def _half_normal(scale: float) -> DrawnPrior:
    from scipy.stats import halfnorm

    levels = (np.arange(2**14) + 0.5) / 2**14
    return DrawnPrior(halfnorm.ppf(levels, scale=scale))


def _judged(
    scales: Sequence[Scale],
    columns: Mapping[str, np.ndarray],
    log_prior: np.ndarray,
    distances: Mapping[str, float],
    law: Law,
    state: str,
) -> dict[str, ParameterVerdict]:
    thresholds = Thresholds()
    evidence = {}
    if state != "unusable":
        draws = pd.DataFrame(dict(columns))
        evidence = evidence_of_draws(scales, draws, draws, (log_prior, None), distances, thresholds)
    found = judge_parameters(scales, evidence, law, state, thresholds=thresholds)
    return {p.name: p for p in found}


def specimen_verdicts(
    source: Source,
    pooled: pd.DataFrame,
    values: Sequence[PooledValue],
    prior: np.ndarray,
    state: str,
) -> dict[str, str]:
    """Verdicts on a specimen's parameters and mounting stretches after pooling, by name.

    Mounting stretches keep the verdict of the run: pooling tells nothing of how laws differ.

    Parameters
    ----------
    source : Source
    pooled : DataFrame
        Natural quantities of the specimen, with ``log_likelihood``.
    values : sequence of PooledValue
    prior : ndarray, shape (M, p)
        Specimens of the group drawn from the prior, on the scale.
    state : str
    """
    own = {v.name: DrawnPrior(v.from_scale(prior[:, k])) for k, v in enumerate(values)}
    found = identify_draws(
        source.posterior,
        pooled,
        state,
        priors={**source.posterior.priors, **own},
    )
    verdicts = {p.name: p.verdict for p in found.parameters}
    if state != "converged":
        return verdicts
    of_run = {r.name: r.verdict for r in source.run.result.reported}
    stretches = source.posterior.quantities.of_kind(STRETCH)
    return verdicts | {q.name: of_run[q.name] for q in stretches if q.name in of_run}


# --- what follows from pooled parameters: structure tensor, stiffness and stress of a group ------

CURVE_DRAWS = 400
CONSTANT = 1e-9
WITHIN, BETWEEN = 60, 30
"""Specimens of the typical donor, and donors, made for each draw of a quantity that follows."""


def stated_stretches(sources: Sequence[Source]) -> list[float]:
    """Equibiaxial total stretches that every specimen reached: half-way and the largest."""
    top = min(s.largest_stretch for s in sources)
    return [round(1.0 + share * (top - 1.0), 3) for share in (0.5, 1.0)]


def derived(found: Population, theta: np.ndarray) -> list[Derived]:
    """Quantities that follow from materials; infinite where they cannot be computed."""
    stretches = stated_stretches(found.sources)
    all_of = derived_quantities(found.materials(theta), found.law, stretches, [1.0, stretches[-1]])
    return [replace(q, values=np.nan_to_num(q.values, nan=np.inf)) for q in all_of]


def _typical(
    found: Population, hyper: Hyper, g: int, rng: np.random.Generator
) -> tuple[list[Derived], list[Derived]]:
    """Quantities of the typical donor's specimens, and their median draw by draw."""
    within = hyper.repeated(WITHIN)
    single = derived(found, within.specimens(within.mu[:, g], g, rng))
    shape = (hyper.draws, WITHIN)
    return single, [replace(q, values=np.median(q.values.reshape(shape), axis=1)) for q in single]


def following(
    found: Population, g: int
) -> Iterator[tuple[str, str, str, dict[str, np.ndarray], dict[str, Any]]]:
    """Structure tensor, stiffness and stress of a group, as its parameters are told.

    They are identified where the records narrow the median, as in a study.
    """
    hyper = found.hyper(CURVE_DRAWS)
    rng = found.rng(1 + g)
    M = hyper.draws
    of_typical, medians = _typical(found, hyper, g, rng)
    between = hyper.repeated(BETWEEN)
    of_donors = derived(found, between.median(between.donors(g, rng), g))
    wide = hyper.repeated(4)
    location = wide.donors(g, rng)
    new = derived(found, wide.specimens(location, g, rng))
    donor = derived(found, wide.median(location, g))
    _, before = _typical(found, found.prior[0].thinned(CURVE_DRAWS), g, found.rng(700 + g))
    shares = contractions(before, medians)
    for q, median, share, *others in zip(
        of_typical, medians, shares, of_donors, new, donor, strict=True
    ):
        typical, (donors, specimen, one) = q.values, (o.values for o in others)
        unit = q.unit or "1"
        told = {"verdict": NO_VERDICT}
        if found.state == "converged":
            known = share >= Thresholds().contraction
            told = {"verdict": IDENTIFIED if known else NOT_IDENTIFIED, "contraction": share}
            if np.ptp(median.values) <= CONSTANT * abs(median.values[0]):
                told = {"verdict": FIXED}  # as the parameters are that it follows from
        scale = LOG if unit != "1" and min(typical.min(), donors.min()) > 0.0 else LINEAR

        def spread(values: np.ndarray, scale: str = scale) -> np.ndarray:
            with np.errstate(over="ignore", invalid="ignore"):
                moved = np.log(values) if scale == LOG else values
                return np.asarray(moved.reshape(M, -1).std(axis=1, ddof=1))

        yield (
            q.key,
            unit,
            scale,
            {
                "mean": median.values,
                "sd_donors": spread(donors),
                "sd_specimens": spread(typical),
                "new_specimen": specimen,
                "new_donor": one,
            },
            told,
        )
