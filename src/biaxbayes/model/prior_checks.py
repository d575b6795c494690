"""Warnings about priors that contradict the data and about limits of the solver."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from biaxbayes.fitting.result import root_mean_square
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import modal_residuals, user_priors
from biaxbayes.model.priors import Prior, prior_text
from biaxbayes.parameters import DEGREE, NOISE_PARAMETERS
from biaxbayes.specimens.check import Finding

NEAR_EDGE = 0.05
"""Draws within this fraction of a limit of the mounting stretch count as lying at it."""
FEW_DRAWS = 0.001
FAR = 3.0
"""Standard deviations of a prior beyond which the fit lies far from it."""
TAIL = 0.5 * math.erfc(FAR / math.sqrt(2.0))
LOST = 6.0
"""Log likelihood that a prior costs where it contradicts the data: 3.5 standard deviations."""


def bracket_findings(stretches: Mapping[str, np.ndarray]) -> list[Finding]:
    """Mounting stretches whose draws lie at the limits between which they are searched."""
    low, high = BRACKET
    findings = []
    for name, draws in stretches.items():
        below, above = draws < low * (1.0 + NEAR_EDGE), draws > high * (1.0 - NEAR_EDGE)
        share = float(np.mean(below | above))
        if share <= FEW_DRAWS:
            continue
        limit = low if below.mean() > above.mean() else high
        findings.append(
            Finding(
                "mounting-stretch-limit",
                "warning",
                f"{100 * share:.2g} % of the draws of {name} lie at {limit:g}, the limit of the "
                f"search ({low:g} to {high:g}): its interval is cut there. Check the mounting "
                "force and its unit, or state a narrower --mounting-sd",
            )
        )
    return findings


def radian_findings(posterior: Posterior) -> list[Finding]:
    """Priors of angles that look as if they were given in radians."""
    findings = []
    parameters = {p.name: p for p in posterior.law.parameters}
    for name, prior in user_priors(posterior).items():
        if name not in parameters or parameters[name].unit != DEGREE:
            continue
        uniform = prior.family in ("uniform", "loguniform")
        centre = prior.high if uniform else prior.location
        if not 0.0 < centre <= math.pi / 2.0:
            continue
        first, second = (prior.low, prior.high) if uniform else (prior.location, prior.scale)
        first_deg = math.degrees(first)
        second_deg = second if prior.family == "lognormal" else math.degrees(second)
        findings.append(
            Finding(
                "radians",
                "warning",
                f"the prior of {name}, {prior.family} {first:g}, {second:g}, is in degrees; if "
                f"that is in radians, state {first_deg:.4g}, {second_deg:.4g}",
            )
        )
    return findings


def unused_prior_findings(posterior: Posterior) -> list[Finding]:
    """Priors of parameters that the chosen error model does not have."""
    settings = posterior.settings
    return [
        Finding(
            "unused-prior",
            "warning",
            f"the prior of {p.name} has no effect: the sd of the errors is {settings.error_model}",
        )
        for p in NOISE_PARAMETERS
        if p.name in settings.priors and p not in settings.error_model.parameters
    ]


def prior_findings(posterior: Posterior) -> list[Finding]:
    """Priors of the user that contradict the data."""
    conflicts = prior_conflicts(posterior)
    return [Finding("prior-contradicts-data", "warning", text) for text in conflicts.values()]


def prior_conflicts(posterior: Posterior) -> dict[str, str]:
    """Text on every prior of the user that contradicts the data, by parameter.

    The fit uses no priors. A prior contradicts the data where the fitted value lies beyond three
    of its standard deviations, and the residuals at the mode of the posterior are larger than
    those of the fit by more than their scatter explains:

        n_eff ln(rms at the mode / rms of the fit) > 6
    """
    priors = user_priors(posterior)
    if not priors:
        return {}
    specimen = posterior.specimen
    fit = posterior.fit
    fitted = dict(zip(posterior.law.names, fit.material.values, strict=True))
    for axis in (0, 1):
        fitted[f"mounting_stretch_{'xy'[axis]}"] = float(np.mean(fit.mounting_stretch[:, axis]))
    floor = max(specimen.load_resolution, 1e-300)
    best = max(fit.rms, floor)
    at_mode = max(root_mean_square(modal_residuals(posterior.replaced(thin=0))[0]), floor)
    readings = posterior.beta * 2.0 * sum(p.rows - p.rest_rows for p in specimen.protocols)
    if readings * math.log(at_mode / best) <= LOST:
        return {}
    noise = specimen.noise_sd
    beside = ""
    if noise > 0.0:
        beside = f", {at_mode / noise:.2g} times the load noise of {noise:.2g} {specimen.unit}"
    units = {q.parameter.name: q.unit for q in posterior.quantities.values()}
    return {
        name: f"the prior of {name}, {prior_text(prior, units[name])}, contradicts the data, which "
        f"alone give {fitted[name]:.4g}: under this prior the model misses the loads by "
        f"{at_mode:.2g} {specimen.unit} rms instead of {best:.2g}{beside}"
        for name, prior in priors.items()
        if name in fitted and is_far(prior, fitted[name])
    }


def is_far(prior: Prior, value: float) -> bool:
    """Whether a value lies beyond three standard deviations of a prior."""
    level = float(prior.cdf(np.array(value)))
    return min(level, 1.0 - level) < TAIL
