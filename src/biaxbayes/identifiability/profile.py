"""Profile likelihood of one parameter: everything else re-optimised along the way.

The curve is D(value) - min D, with the deviance of
:mod:`biaxbayes.identifiability.conditional_fit`; values where it stays below 2.71 (90 % of
chi-square with one degree of freedom) make the interval. No prior has a part in it. In words:

- ``finite``: the curve crosses the threshold on both sides;
- ``practical``: it does not on one side or both, so the data leave the parameter open there;
- ``structural``: it is flat: no amount of this kind of data would determine it.

An angle of 0 or 90 degrees is a mirror: the curve goes on as its own image, and counts as closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from biaxbayes.error_model import CONSTANT
from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.identifiability.conditional_fit import ConditionalLikelihood
from biaxbayes.identifiability.profile_curve import ProfileCurve, profile_axis
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import CONTENT
from biaxbayes.parallel import executor_for
from biaxbayes.parameters import Quantities, Quantity, mounting_names, unit_words

FLAT_DEVIANCE = 0.1
"""A curve that never rises above this is flat: a likelihood ratio of 0.95."""


@dataclass(frozen=True)
class Profile:
    """A profile likelihood.

    Attributes
    ----------
    table : DataFrame
        ``value`` (ascending, natural units), ``deviance`` above the minimum, ``error_sd`` and the
        values that all parameters and mounting stretches took.
    low, high : float
        Ends of the interval; the end of the range on a side that is open.
    open_low, open_high : bool
        Whether the curve stays below the threshold all the way.
    kind : {"finite", "practical", "structural"}
    beta : float
        Weight n_eff / n of the readings.
    note : str
        How the likelihood differs from that of the model; empty where it does not.
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
    beta: float
    note: str = ""

    def __repr__(self) -> str:
        return f"Profile({self.in_words()})"

    @property
    def quantity(self) -> Quantity:
        """The profiled quantity."""
        return self.known[self.parameter]

    @property
    def unit(self) -> str:
        """Unit of the parameter, empty where it has none."""
        return "" if self.quantity.unit == "1" else self.quantity.unit

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
    """Profiles of several parameters, in parallel processes if requested.

    Names are those of the law, and mounting_stretch_x and mounting_stretch_y (with the protocol in
    square brackets where each has its own). Raises :class:`InputError` for a parameter that is
    unknown, fixed, or follows from the others, :class:`NotConverged` if the model cannot be fitted
    to the specimen.
    """
    for name in parameters:
        _index(posterior, name)
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
    index = _index(posterior, parameter)
    law, start = posterior.law, posterior.fit
    priors = {i: posterior.priors[name] for i, name in enumerate(law.names)}
    fixed = {
        i: law.to_fit_coordinate(i, float(p))
        for i, p in priors.items()
        if isinstance(p, int | float)
    }
    likelihood = ConditionalLikelihood(
        posterior.specimen, posterior.settings, posterior.beta, fixed
    )
    # The overall best fit, from the deterministic one. Off the edges too: with a parameter at its
    # bound others may hide a lower point.
    lm = np.clip(start.mounting_stretch, 0.9, 1.2).T
    if not posterior.settings.infers_mounting:
        lm = np.ones((2, likelihood.groups))
    theta = law.to_fit_coordinates(start.material.values)
    best, other = (
        likelihood.best({}, np.concatenate([point, lm.ravel()]), start.rms)
        for point in (theta, law.to_fit_coordinates(law.clip_inside(start.material.values)))
    )
    best = other if other.deviance < best.deviance else best
    if not np.isfinite(best.deviance):
        raise NotConverged(f"{posterior.specimen.name}: no material fits this specimen")
    axis = profile_axis(posterior.quantities[parameter].parameter, index, law)
    curve = ProfileCurve(likelihood, axis, best)
    curve.run()
    return _profile(curve, posterior, parameter)


def _index(posterior: Posterior, parameter: str) -> int:
    """Position of a parameter among the unknowns of a likelihood."""
    prior = posterior.priors.get(parameter)
    if isinstance(prior, int | float):
        raise InputError(f"{parameter} is fixed, so it has no profile")
    of_law = posterior.law.names
    if parameter in of_law:
        return of_law.index(parameter)
    names = [mounting_names("stretch", label) for label in posterior.mounts]
    flat = [pair[k] for k in (0, 1) for pair in names]
    if parameter not in flat or not posterior.settings.infers_mounting:
        known = [*of_law, *(flat if posterior.settings.infers_mounting else [])]
        raise InputError(
            f"unknown parameter {parameter[:60]!r}", remedy=f"one of {', '.join(known)}"
        )
    if posterior.settings.mounting == "exact":
        raise InputError(
            "with an exact mounting force the mounting stretch follows from the material",
            remedy="use `mounting=noisy` to profile it",
        )
    return len(of_law) + flat.index(parameter)


def _profile(curve: ProfileCurve, posterior: Posterior, parameter: str) -> Profile:
    rise = np.array([curve.rise(k) for k in range(len(curve.at))])
    value = np.array([curve.axis.natural(at) for at in curve.at])
    ends = []
    for side in (-1, 1):
        pair = curve.crossing(side)
        if pair is None:
            ends.append((value[0 if side < 0 else -1], True))
        else:
            ends.append((curve.axis.natural(curve.interpolated(*pair)), False))
    (low, open_low), (high, open_high) = ends
    if curve.axis.parameter.mirror and open_low != open_high:
        open_low = open_high = False  # the curve goes on as its own image
    flat = open_low and open_high and float(rise.max()) < FLAT_DEVIANCE
    kind = "structural" if flat else "practical" if open_low or open_high else "finite"
    errors = posterior.settings.error_model
    note = "" if errors is CONSTANT else f"the sd of the errors is constant here, not {errors}"

    law, unknowns = posterior.law, np.array([f.unknowns for f in curve.fits])
    columns = {"value": value, "deviance": np.maximum(rise, 0.0)}
    for i, name in enumerate(law.names):
        columns[name] = np.array([law.from_fit_coordinate(i, v) for v in unknowns[:, i]])
    if posterior.settings.infers_mounting:
        pairs = [mounting_names("stretch", label) for label in posterior.mounts]
        for j, name in enumerate(pair[k] for k in (0, 1) for pair in pairs):
            columns[name] = unknowns[:, len(law.names) + j]
    columns["error_sd"] = np.array([f.error_sd for f in curve.fits])
    return Profile(
        parameter=parameter,
        known=posterior.quantities,
        table=pd.DataFrame(columns),
        estimate=float(value[curve.lowest]),
        low=float(low),
        high=float(high),
        open_low=bool(open_low),
        open_high=bool(open_high),
        kind=kind,
        beta=posterior.beta,
        note=note,
    )
