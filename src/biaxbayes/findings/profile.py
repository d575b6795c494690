"""Profile likelihood of one parameter: everything else re-optimised along the way.

The curve is D(value) - min D, with the deviance of :mod:`biaxbayes.findings.held_fit`; values where
it stays below 3.84 (95 % of chi-square with one degree of freedom) make the interval. No prior has
a part in it. In words:

- ``finite``: the curve crosses the threshold on both sides;
- ``practical``: it does not on one side or both, so the data leave the parameter open there;
- ``structural``: it is flat: no amount of this kind of data would tell.

An angle of 0 or 90 degrees is a mirror: the curve goes on as its own image, and counts as closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.executors.executor import executor_for
from biaxbayes.findings.held_fit import THETA, HeldFit, Target
from biaxbayes.findings.profile_axis import axis_of
from biaxbayes.findings.profile_walk import THRESHOLD, Walk
from biaxbayes.inference.assemble import mounting_names
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.stress_response import coordinates_of
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["FLAT", "THRESHOLD", "Profile", "profile_likelihood", "profiles"]

FLAT = 0.1
"""A curve that never rises above this is flat: a likelihood ratio of 0.95."""


@dataclass(frozen=True)
class Profile:
    """A profile likelihood.

    Attributes
    ----------
    parameter : str
    unit : str
    table : DataFrame
        ``value`` (ascending, natural units), ``deviance`` above the minimum, ``error_sd`` and the
        values that all parameters and mounting stretches took.
    estimate : float
    low, high : float
        Ends of the 95 % interval; the end of the range on a side that is open.
    open_low, open_high : bool
        Whether the curve stays below the threshold all the way.
    kind : {"finite", "practical", "structural"}
    beta : float
        Weight n_eff / n of the readings.
    """

    parameter: str
    unit: str
    table: pd.DataFrame
    estimate: float
    low: float
    high: float
    open_low: bool
    open_high: bool
    kind: str
    beta: float

    def in_words(self) -> str:
        """One sentence."""
        unit = {"deg": " degrees", "kPa": " kPa"}.get(self.unit, "")
        low, high, best = (f"{v:.4g}" for v in (self.low, self.high, self.estimate))
        if self.kind == "structural":
            return (
                f"{self.parameter}: structurally not identifiable, the likelihood is flat from "
                f"{low} to {high}{unit}"
            )
        if self.kind == "finite":
            return f"{self.parameter}: {low} to {high}{unit} (95 %), best {best}"
        if self.open_low and self.open_high:
            return f"{self.parameter}: open on both sides, {low} to {high}{unit} all fit"
        if self.open_low:
            return f"{self.parameter}: below {high}{unit} (95 %), open towards {low}; best {best}"
        return f"{self.parameter}: above {low}{unit} (95 %), open towards {high}; best {best}"


def profiles(posterior: Posterior, parameters: Sequence[str], *, workers: int = 1) -> list[Profile]:
    """Profiles of several parameters, in parallel processes where asked for.

    Parameters
    ----------
    posterior : Posterior
        For the specimen, the settings, the weight of the readings and the start.
    parameters : sequence of str
        C1, k1, k2, alpha, kappa, mounting_stretch_x, mounting_stretch_y (with the protocol in
        square brackets where each has its own).
    workers : int
        Processes.

    Raises
    ------
    InputError
        For a parameter that is unknown, fixed, or follows from the others.
    NotConverged
        If the model cannot be fitted to the specimen at all.
    """
    for name in parameters:
        _index(posterior, name)
    executor = executor_for(max(min(workers, len(parameters)), 1))
    _ = posterior.start  # fitted once, not in every process
    found: dict[int, Profile] = {}
    for outcome in executor.run(partial(profile_likelihood, posterior), parameters):
        if outcome.lost:
            raise RunError(f"profile of {parameters[outcome.index]}: {outcome.lost}")
        found[outcome.index] = outcome.value
    return [found[i] for i in range(len(parameters))]


def profile_likelihood(posterior: Posterior, parameter: str) -> Profile:
    """Profile of one parameter; see :func:`profiles`."""
    index = _index(posterior, parameter)
    target = Target(posterior.specimen, posterior.settings, posterior.beta, _fixed(posterior))
    axis = axis_of(parameter, index)
    walk = Walk(target, axis, _optimum(posterior, target))
    walk.run()
    return _profile(walk, posterior, parameter)


def _optimum(posterior: Posterior, target: Target) -> HeldFit:
    """The overall best fit, from the deterministic one."""
    start = posterior.start
    lm = np.clip(start.mounting_stretch, 0.9, 1.2).T
    if not posterior.settings.infers_mounting:
        lm = np.ones((2, target.groups))
    sd = float(np.sqrt(np.mean(np.concatenate(start.residuals) ** 2)))
    theta = coordinates_of(start.material)
    found = target.best({}, np.concatenate([theta, lm.ravel()]), sd)
    # Off the edges too: with a parameter at its bound others may hide a lower point.
    inner = np.maximum(theta, [1e-3, 1e-3, 1e-2, 0.01, 0.01])
    inner[3:] = np.minimum(inner[3:], [0.99, 0.32])
    other = target.best({}, np.concatenate([inner, lm.ravel()]), sd)
    found = other if other.deviance < found.deviance else found
    if not np.isfinite(found.deviance):
        raise NotConverged(f"{posterior.specimen.name}: no material fits this specimen")
    return found


def _index(posterior: Posterior, parameter: str) -> int:
    """Position of a parameter among the unknowns of a target."""
    prior = posterior.priors.get(parameter)
    if isinstance(prior, int | float):
        raise InputError(f"{parameter} is fixed, so it has no profile")
    if parameter in PARAMETERS:
        return PARAMETERS.index(parameter)
    names = [mounting_names("stretch", label) for label in posterior.mounts]
    flat = [pair[k] for k in (0, 1) for pair in names]
    if parameter not in flat or not posterior.settings.infers_mounting:
        known = [*PARAMETERS, *(flat if posterior.settings.infers_mounting else [])]
        raise InputError(
            f"unknown parameter {parameter[:60]!r}", remedy=f"one of {', '.join(known)}"
        )
    if posterior.settings.mounting == "exact":
        raise InputError(
            "with an exact mounting force the mounting stretch follows from the material",
            remedy="use --mounting noisy to profile it",
        )
    return THETA + flat.index(parameter)


def _fixed(posterior: Posterior) -> dict[int, float]:
    out = {}
    for i, name in enumerate(PARAMETERS):
        value = posterior.priors[name]
        if isinstance(value, int | float):
            cos2 = 0.0 if value == 90.0 else float(np.cos(np.radians(value)) ** 2)
            out[i] = cos2 if name == "alpha" else float(value)
    return out


def _profile(walk: Walk, posterior: Posterior, parameter: str) -> Profile:
    rise = np.array([walk.rise(k) for k in range(len(walk.at))])
    value = np.array([walk.axis.natural(at) for at in walk.at])
    ends = []
    for side in (-1, 1):
        pair = walk.crossing(side)
        if pair is None:
            ends.append((value[0 if side < 0 else -1], True))
            continue
        a, b = np.sqrt(np.maximum(rise[list(pair)], 0.0))
        share = (np.sqrt(THRESHOLD) - a) / (b - a)
        at = walk.at[pair[0]] + share * (walk.at[pair[1]] - walk.at[pair[0]])
        ends.append((walk.axis.natural(at), False))
    (low, open_low), (high, open_high) = ends
    if walk.axis.mirrored and open_low != open_high:
        open_low = open_high = False  # the curve goes on as its own image
    flat = open_low and open_high and float(rise.max()) < FLAT
    kind = "structural" if flat else "practical" if open_low or open_high else "finite"
    return Profile(
        parameter=parameter,
        unit=walk.axis.unit,
        table=_table(walk, posterior, value, rise),
        estimate=float(value[walk.lowest]),
        low=float(low),
        high=float(high),
        open_low=bool(open_low),
        open_high=bool(open_high),
        kind=kind,
        beta=posterior.beta,
    )


def _table(walk: Walk, posterior: Posterior, value: np.ndarray, rise: np.ndarray) -> pd.DataFrame:
    unknowns = np.array([f.unknowns for f in walk.fits])
    columns = {"value": value, "deviance": np.maximum(rise, 0.0)}
    for i, name in enumerate(PARAMETERS):
        columns[name] = unknowns[:, i]
    columns["alpha"] = np.rad2deg(np.arccos(np.sqrt(np.clip(unknowns[:, 3], 0.0, 1.0))))
    if posterior.settings.infers_mounting:
        pairs = [mounting_names("stretch", label) for label in posterior.mounts]
        for j, name in enumerate(pair[k] for k in (0, 1) for pair in pairs):
            columns[name] = unknowns[:, THETA + j]
    columns["error_sd"] = np.array([f.error_sd for f in walk.fits])
    return pd.DataFrame(columns)
