"""Profile likelihood of one parameter: everything else re-optimised along the way.

The curve is D(value) - min D, with the deviance of :mod:`biaxbayes.profiles.conditional_fit`; where
it stays below 2.71 (90 % of chi-square with one degree of freedom) is the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import CONTENT
from biaxbayes.parallel import executor_for
from biaxbayes.parameters import STRETCH, OfQuantity, Quantities, Quantity, unit_words
from biaxbayes.profiles.conditional_fit import ConditionalLikelihood
from biaxbayes.profiles.profile_curve import ProfileCurve, ProfiledParameter

FLAT_DEVIANCE = 0.1
"""A curve that never rises above this is flat: a likelihood ratio of 0.95."""


@dataclass(frozen=True)
class Profile(OfQuantity):
    """A profile likelihood.

    Attributes
    ----------
    table : DataFrame
        ``value`` (ascending, natural units), ``deviance`` above the minimum, and the values that
        all parameters and mounting stretches took, with the sd of independent errors.
    low, high : float
        Ends of the interval; the end of the range on a side that is open.
    open_low, open_high : bool
        Whether the curve stays below the threshold all the way.
    kind : {"finite", "practical", "structural"}
        The curve crosses the threshold on both sides; it does not on one or both, so that the data
        leave the parameter open there; it is flat: no amount of such data would determine it.
    """

    parameter: str
    known: Quantities
    table: pd.DataFrame
    estimate: float
    low: float
    high: float
    open_low: bool
    open_high: bool
    kind: str

    def __repr__(self) -> str:
        return f"Profile({self.in_words()})"

    @property
    def quantity(self) -> Quantity:  # type: ignore[override]
        """The profiled quantity."""
        return self.known[self.parameter]

    def in_words(self) -> str:
        """One sentence."""
        unit = unit_words(self.unit)
        low, high, best = (f"{v:.4g}" for v in (self.low, self.high, self.estimate))
        level = f"{100.0 * CONTENT:g} %"
        if self.kind == "structural":
            return (
                f"{self.parameter}: structurally not identifiable, the likelihood is flat from "
                f"{low} to {high}{unit}"
            )
        if self.kind == "finite":
            return f"{self.parameter}: {low} to {high}{unit} ({level}), best {best}"
        if self.open_low and self.open_high:
            return f"{self.parameter}: open on both sides, {low} to {high}{unit} all fit"
        if self.open_low:
            return (
                f"{self.parameter}: below {high}{unit} ({level}), open towards {low}; best {best}"
            )
        return f"{self.parameter}: above {low}{unit} ({level}), open towards {high}; best {best}"


def profiles(posterior: Posterior, parameters: Sequence[str], *, workers: int = 1) -> list[Profile]:
    """Profiles of parameters of the law and mounting stretches, in processes if requested."""
    for name in parameters:
        _check(posterior, name)
    executor = executor_for(max(min(workers, len(parameters)), 1))
    posterior = posterior.replaced(fit=posterior.fit)  # once, not in every process
    by_index: dict[int, Profile] = {}
    for outcome in executor.run(partial(profile_likelihood, posterior), parameters):
        if outcome.failure:
            raise RunError(f"profile of {parameters[outcome.index]}: {outcome.failure}")
        by_index[outcome.index] = outcome.value
    return [by_index[i] for i in range(len(parameters))]


def profile_likelihood(posterior: Posterior, parameter: str) -> Profile:
    """Profile of one parameter; see :func:`profiles`."""
    _check(posterior, parameter)
    likelihood = ConditionalLikelihood(posterior, parameter)
    curve = ProfileCurve(likelihood, ProfiledParameter(posterior.quantities[parameter].parameter))
    if not np.isfinite(curve.fits[0].deviance):
        raise NotConverged(f"{posterior.specimen.name}: no material fits this specimen")
    curve.run()
    rise = np.array([curve.rise(k) for k in range(len(curve.at))])
    value = np.array([curve.axis.natural(at) for at in curve.at])
    ends = []
    for side in (-1, 1):
        pair = curve.crossing(side)
        if pair is None:
            ends.append((float(value[0 if side < 0 else -1]), True))
        else:
            ends.append((curve.axis.natural(curve.interpolated(*pair)), False))
    (low, open_low), (high, open_high) = ends
    if curve.axis.parameter.mirror and open_low != open_high:
        open_low = open_high = False  # at 0 or 90 degrees the curve goes on as its own image
    flat = open_low and open_high and float(rise.max()) < FLAT_DEVIANCE
    kind = "structural" if flat else "practical" if open_low or open_high else "finite"
    fits = pd.DataFrame([f.values for f in curve.fits])
    names = [n for n in posterior.parameter_names if n in fits]
    columns = {"value": value, "deviance": np.maximum(rise, 0.0)}
    return Profile(
        parameter=parameter,
        known=posterior.quantities,
        table=pd.DataFrame(columns).join(fits[names]),
        estimate=float(value[curve.lowest]),
        low=low,
        high=high,
        open_low=open_low,
        open_high=open_high,
        kind=kind,
    )


def _check(posterior: Posterior, parameter: str) -> None:
    """Refuse what has no profile."""
    if isinstance(posterior.priors.get(parameter), int | float):
        raise InputError(f"{parameter} is fixed, so it has no profile")
    inferred = posterior.settings.infers_mounting
    stretches = [q.name for q in posterior.quantities.of_kind(STRETCH)] if inferred else []
    known = [*posterior.law.names, *stretches]
    if parameter not in known:
        raise InputError(
            f"unknown parameter {parameter[:60]!r}", remedy=f"one of {', '.join(known)}"
        )
    if parameter in stretches and posterior.settings.mounting == "exact":
        raise InputError(
            "with an exact mounting force the mounting stretch follows from the material",
            remedy="use `mounting=noisy` to profile it",
        )
