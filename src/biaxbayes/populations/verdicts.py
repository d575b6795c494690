"""Verdicts on pooled values and on quantities that follow from them.

The rule is that of single runs, with the prior of the same median for a group's mean, and that of a
specimen of its group, both without any data. Spreads are compared on the scale of the model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.identifiability.identify import diagnostics_from_draws, identify_draws
from biaxbayes.identifiability.marginals import INTERVAL, Z90, ComparisonScale
from biaxbayes.identifiability.reported import reported
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NOT_IDENTIFIED,
    ParameterVerdict,
    Thresholds,
    assess_parameters,
)
from biaxbayes.laws.law import Law
from biaxbayes.model.priors import DrawnPrior
from biaxbayes.parameters import STRETCH, Parameter, Quantity
from biaxbayes.populations.model import PooledValue
from biaxbayes.populations.population_result import PRIOR_DRAWS, Hyper
from biaxbayes.populations.specimens import Source
from biaxbayes.report_table import interval_texts

CONSTANT_TOLERANCE = 1e-9


def mean_verdicts(
    hyper: Hyper,
    prior: Hyper,
    group: int,
    law: Law,
    materials: pd.DataFrame,
    top: float,
    state: str,
) -> dict[str, ParameterVerdict]:
    """Verdicts on a group's means by pooled value; ``top`` is the largest stretch."""
    own, before = hyper.typical_median(group), prior.typical_median(group)
    columns = {v.name: v.from_scale(own[:, k]) for k, v in enumerate(hyper.values)}
    scales = [
        ComparisonScale(Quantity(v.parameter), DrawnPrior(v.from_scale(before[:, k])))
        for k, v in enumerate(hyper.values)
    ]
    ends = np.full((len(materials), 2), top)
    distances = law.bound_tolerances(law.material(materials), [ends])
    return _assess(scales, columns, hyper.log_prior(), distances, law, state)


def reported_text(p: ParameterVerdict) -> str:
    """The interval or the bound of a verdict; empty where there is nothing to report."""
    if p.verdict not in (IDENTIFIED, COMBINATION, BOUNDED):
        return ""
    (row,) = reported([p])
    return row.interval


def in_words(p: ParameterVerdict) -> str:
    """Verdict, interval and reason."""
    interval = reported_text(p)
    level = 95 if p.verdict == BOUNDED else 90
    known = f"{p.verdict}, {interval}{p.scale.parameter.unit_words()} ({level} %)"
    reason = p.assessment.reason
    return (known if interval else p.verdict) + (f"; {reason}" if reason else "")


def spread_verdicts(
    hyper: Hyper, group: int, law: Law, state: str
) -> dict[str, dict[str, ParameterVerdict]]:
    """Verdicts on sd_donors, sd_specimens and sd_total of a group, by pooled value."""
    from scipy.stats import halfnorm

    out = {}
    log_prior = hyper.log_prior()
    levels = (np.arange(PRIOR_DRAWS) + 0.5) / PRIOR_DRAWS
    rng = np.random.default_rng(0)
    own = {
        "sd_donors": hyper.sd_donors,
        "sd_specimens": hyper.specimen_sd(group),
        "sd_total": hyper.total_sd(group),
    }
    for k, v in enumerate(hyper.values):
        both = (v.donor_scale, v.specimen_scale)
        priors = [halfnorm.ppf(levels, scale=scale) for scale in both]
        priors.append(np.hypot(*(rng.normal(0.0, scale, PRIOR_DRAWS) for scale in both)))
        log, unit = v.parameter.logarithmic, v.parameter.unit
        # sharp if its uncertainty barely widens a new specimen
        sharp = (math.log(v.parameter.sharp) if log else v.parameter.sharp) / (2.0 * Z90)
        sd = Parameter(
            name=v.name,
            unit="1" if log else unit,
            words=f"sd of {'ln ' if log else ''}{v.name}",
            low=0.0,
            at_low="no spread",
            sharp=sharp,
            digits=".2g",
        )
        names = [f"{side} of {v.name}" for side in own]
        scales = [
            ComparisonScale(Quantity(replace(sd, name=name)), DrawnPrior(prior))
            for name, prior in zip(names, priors, strict=True)
        ]
        columns = dict(zip(names, (values[:, k] for values in own.values()), strict=True))
        distances = dict.fromkeys(names, sharp)
        # the total separately: it is a function of the other two, not a further parameter
        verdicts = _assess(scales[:2], columns, log_prior, distances, law, state)
        verdicts |= _assess(scales[2:], columns, log_prior, distances, law, state)
        out[v.name] = {side: verdicts[name] for side, name in zip(own, names, strict=True)}
    return out


def _assess(
    scales: Sequence[ComparisonScale],
    columns: Mapping[str, np.ndarray],
    log_prior: np.ndarray,
    distances: Mapping[str, float],
    law: Law,
    state: str,
) -> dict[str, ParameterVerdict]:
    thresholds = Thresholds()
    diagnostics = {}
    if state != "unusable":
        draws = pd.DataFrame({s.name: columns[s.name] for s in scales})
        diagnostics = diagnostics_from_draws(
            scales, draws, draws, (log_prior, None), distances, thresholds
        )
    verdicts = assess_parameters(scales, diagnostics, law, state, thresholds=thresholds)
    return {p.name: p for p in verdicts}


def specimen_verdicts(
    source: Source,
    pooled: pd.DataFrame,
    values: Sequence[PooledValue],
    prior: np.ndarray,
    state: str,
) -> dict[str, str]:
    """Verdicts on a specimen after pooling, by name; `prior` (M, p) are specimens on the scale.

    Mounting stretches keep the verdict of the run: pooling shows nothing about differences of laws.
    """
    own = {v.name: DrawnPrior(v.from_scale(prior[:, k])) for k, v in enumerate(values)}
    identification = identify_draws(
        source.posterior, pooled, state, priors={**source.posterior.priors, **own}
    )
    verdicts = {p.name: p.verdict for p in identification.parameters}
    if state != "converged":
        return verdicts
    run_verdicts = {r.name: r.verdict for r in source.run.result.reported}
    stretches = source.posterior.quantities.of_kind(STRETCH)
    return verdicts | {q.name: run_verdicts[q.name] for q in stretches if q.name in run_verdicts}


def derived_verdict(values: np.ndarray, contraction: float, parameter: Parameter) -> dict[str, Any]:
    """Verdict on a quantity that follows from parameters, as columns of population.csv."""
    if np.ptp(values) <= CONSTANT_TOLERANCE * abs(values[0]):
        return {"verdict": FIXED}  # as the parameters are that it follows from
    low, high = (float(v) for v in np.quantile(values, INTERVAL))
    narrow = not parameter.logarithmic or high <= Thresholds().max_ratio * low
    if contraction < Thresholds().contraction or not narrow:
        return {"verdict": NOT_IDENTIFIED, "contraction": contraction}
    text = " to ".join(interval_texts(low, low, high, parameter)[1:])
    return {"verdict": IDENTIFIED, "reported": text, "contraction": contraction}
