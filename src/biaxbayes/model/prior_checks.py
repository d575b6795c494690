"""Warnings about priors that contradict the data and about limits of the solver."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from biaxbayes.errors import two_digits
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import mode, start_parameters, user_priors, with_coarse_terms
from biaxbayes.model.priors import prior_text
from biaxbayes.parameters import DEGREE, NOISE_SD, mounting_names, name_of
from biaxbayes.specimens.check import Finding

NEAR_LIMIT = 0.05
"""Draws within this fraction of a limit of the mounting stretch count as lying at it."""
MAX_SHARE_AT_LIMIT = 0.001
TAIL_PROBABILITY = 0.5 * math.erfc(3.0 / math.sqrt(2.0))
"""Of three standard deviations of a prior, beyond which the fit lies far from it."""
MAX_LOSS = 6.0
"""Loss of log likelihood beyond which a prior contradicts the data: 3.5 standard deviations."""


def bracket_findings(stretches: Mapping[str, np.ndarray]) -> list[Finding]:
    """Mounting stretches whose draws lie at the limits between which they are searched."""
    low, high = BRACKET
    findings = []
    for name, draws in stretches.items():
        below, above = draws < low * (1.0 + NEAR_LIMIT), draws > high * (1.0 - NEAR_LIMIT)
        share = float(np.mean(below | above))
        if share <= MAX_SHARE_AT_LIMIT:
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
    angles = {p.name for p in posterior.law.parameters if p.unit == DEGREE}
    for name, prior in user_priors(posterior).items():
        uniform = prior.family in ("uniform", "loguniform")
        centre = prior.high if uniform else prior.location
        if name not in angles or not 0.0 < centre <= math.pi / 2.0:
            continue
        first, second = (prior.low, prior.high) if uniform else (prior.location, prior.scale)
        first_deg = math.degrees(first)
        second_deg = second if prior.family == "lognormal" else math.degrees(second)
        findings.append(
            Finding(
                "radians",
                "warning",
                f"the prior of {name}, {prior.family} {first:g}, {second:g}, is read in "
                f"degrees; if you mean radians, write {first_deg:.4g}, {second_deg:.4g}",
            )
        )
    return findings


def unused_prior_findings(posterior: Posterior) -> list[Finding]:
    """Priors of parameters that the run does not have."""
    if not posterior.settings.has_misfit or NOISE_SD.name not in posterior.settings.priors:
        return []
    text = (
        f"the prior of {NOISE_SD.name} has no effect: the noise is that of the load cell, and a "
        "parameter only with --noise independent"
    )
    return [Finding("unused-prior", "warning", text)]


def prior_findings(posterior: Posterior) -> list[Finding]:
    """Priors of the user that contradict the data."""
    conflicts = prior_conflicts(posterior)
    return [Finding("prior-contradicts-data", "warning", text) for text in conflicts.values()]


def prior_conflicts(posterior: Posterior) -> dict[str, str]:
    """Text on every prior of the user that contradicts the data, by parameter.

    The fit uses no priors. A prior contradicts the data where the fitted value lies beyond three
    of its standard deviations, and the log likelihood at the mode of the posterior is more than 6
    below that of the fit.
    """
    priors = user_priors(posterior)
    if not priors:
        return {}
    posterior = with_coarse_terms(posterior)
    specimen = posterior.specimen
    fit = posterior.fit
    fitted = dict(zip(posterior.law.names, fit.material.values, strict=True))
    own = fit.mounting_stretch[: len(posterior.pieces[0].labels.states)]
    for axis, name in enumerate(mounting_names("stretch")):
        fitted[name] = float(np.mean(own[:, axis]))
    residual, at_mode = posterior.residuals(posterior.paths.fitted), mode(posterior)
    start = start_parameters(posterior)
    labels = [piece.labels.label for piece in posterior.pieces]
    noise_sd = np.array([[start[name_of(NOISE_SD.name, label)] for label in labels]])
    at_fit = float(posterior.log_likelihood(residual, noise_sd)[0])
    if not at_fit - float(at_mode["log_likelihood"][0]) > MAX_LOSS:
        return {}
    readings = posterior.readings
    best, missed = (
        float(np.sqrt(np.mean((own[0] / readings.scale)[readings.mounting_count :] ** 2)))
        for own in (residual[:, posterior.of_piece(0)], posterior.residuals(at_mode, 0))
    )
    noise, beside = specimen.noise_sd, ""
    if noise > 0.0:
        beside = (
            f", {two_digits(missed / noise)} times the load noise of {noise:.2g} {specimen.unit}"
        )
    units = {q.parameter.name: q.unit for q in posterior.quantities.values()}
    out = {}
    for name, prior in priors.items():
        level = float(prior.cdf(np.array(fitted[name]))) if name in fitted else 0.5
        if min(level, 1.0 - level) < TAIL_PROBABILITY:
            out[name] = (
                f"the prior of {name}, {prior_text(prior, units[name])}, contradicts the data, "
                f"which alone give {fitted[name]:.4g}: under this prior the model misses the loads "
                f"by {two_digits(missed)} {specimen.unit} rms instead of {two_digits(best)}{beside}"
            )
    return out
