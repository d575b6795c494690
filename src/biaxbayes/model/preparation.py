"""Prepare a posterior for sampling: fit, effective readings, sampling coordinates, starting point.

The weight of the curves is read from the residuals of the least-squares fit, which uses no priors.
With priors of the user, and with a noise sd that depends on the load, the residuals of the sampled
model are used, at its mode and over their sd: a prior that pulls the model off the data correlates
neighbouring residuals, and the effective number of readings is smaller.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from biaxbayes.error_model import CONSTANT
from biaxbayes.fitting.effective_readings import EffectiveReadings, effective_readings
from biaxbayes.model.assembly import SamplingConstants
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import DIMENSION, ERROR, FORCE, STRETCH, mounting_names
from biaxbayes.sampling.modes import find_modes
from biaxbayes.specimens.specimen import Specimen


def prepare(
    specimen: Specimen, *, seed: int = 0, beta: float | None = None, **options: Any
) -> Posterior:
    """Fit a specimen, estimate the effective number of readings, and make the posterior.

    Parameters
    ----------
    seed : int
        Seed of the random starts of the least-squares fit.
    beta : float, optional
        Weight n_eff / n of the log likelihood; estimated from the residuals if not given, and one
        for independent noise.
    **options
        Further arguments of :class:`~biaxbayes.model.posterior.Posterior`.

    Returns
    -------
    Posterior
        With its ``fit``, its ``readings`` where they were estimated, and sampling
        coordinates that suit the fit.

    Raises
    ------
    InputError
        If the options do not fit the specimen.
    """
    unweighted = Posterior(specimen, **options, beta=1.0 if beta is None else beta)
    posterior = unweighted.replaced(fit=unweighted.least_squares(seed))
    if beta is None and posterior.settings.noise != "independent":
        readings = sampled_readings(posterior)
        posterior = posterior.replaced(beta=readings.beta, readings=readings)
    return with_sampling_constants(posterior)


def with_sampling_constants(posterior: Posterior, softening: float | None = None) -> Posterior:
    """The same posterior with the sampling coordinates that suit its least-squares fit.

    ``softening`` is that of stored coordinates, which can only be read with the scale that they
    were written with; by default it is that of the fitted material.
    """
    if softening is None:
        law = posterior.law
        fitted = dict(zip(law.names, posterior.fit.material.values, strict=True))
        softening = law.softening(fitted)
    return posterior.replaced(
        sampling_constants=SamplingConstants(softening, _reference_stretch(posterior))
    )


def _reference_stretch(posterior: Posterior) -> tuple[float, float] | None:
    """Largest total stretches of a specimen, at the fitted mounting stretch."""
    if not posterior.settings.infers_mounting:
        return None
    lm = np.clip(np.max(posterior.fit.mounting_stretch, axis=0), 1.0, 1.5)
    tops = [(p.stretch_x.max(), p.stretch_y.max()) for p in posterior.specimen.protocols]
    x, y = np.max(tops, axis=0) * lm
    return x, y


# --- natural parameters to start from ------------------------------------------------------------


def start_parameters(posterior: Posterior) -> dict[str, float]:
    """Natural parameters of the least-squares fit, moved off the bounds of their ranges."""
    fit, specimen = posterior.fit, posterior.specimen
    law = posterior.law
    out: dict[str, float] = {
        **dict(zip(law.names, law.clip_inside(fit.material.values), strict=True)),
        "noise_sd": max(fit.rms, 2.0 * specimen.load_resolution),
    }
    for q in posterior.sampled:
        p = q.parameter
        if p.kind in (STRETCH, FORCE):
            values = fit.mounting_stretch if p.kind == STRETCH else fit.mounting_load
            out[q.name] = float(values[posterior.mounts.index(q.state)][q.axis])
        elif p.kind == DIMENSION:
            out[q.name] = 0.0 if p.unit_symbol("N") else 1.0
        elif p.kind == ERROR and p.prior is not None:
            out[q.name] = float(Prior.from_numbers(*p.prior).ppf(np.array(0.5)))
    return inside_priors(posterior, out)


def inside_priors(posterior: Posterior, parameters: dict[str, float]) -> dict[str, float]:
    """Parameters moved into the ranges of their priors."""
    out = dict(parameters)
    for name, prior in posterior.priors.items():
        if name in out and isinstance(prior, Prior):
            low, high = prior.low, prior.high
            if not low < out[name] < high:
                span = (high - low) if np.isfinite(high - low) else max(abs(low), 1.0)
                out[name] = float(np.clip(out[name], low + 0.01 * span, high - 0.01 * span))
    return out


# --- effective number of readings ----------------------------------------------------------------


def sampled_readings(posterior: Posterior) -> EffectiveReadings:
    """Effective number of readings, from the residuals of the model that is sampled."""
    readings = effective_readings(posterior.fit.residuals)
    if posterior.settings.error_model is CONSTANT and not user_priors(posterior):
        return readings
    constants = SamplingConstants(reference_stretch=_reference_stretch(posterior))
    provisional = posterior.replaced(thin=0, beta=readings.beta, sampling_constants=constants)
    return effective_readings(*modal_residuals(provisional))


def user_priors(posterior: Posterior) -> dict[str, Prior]:
    """Priors given by the user, for the law and the mounting stretches."""
    chosen = posterior.settings.priors
    given = {name: prior for name, prior in chosen.items() if isinstance(prior, Prior)}
    measured = [n for n in mounting_names("stretch") if n in posterior.specimen.metadata]
    defaults = {name: posterior.priors.get(name) for name in measured if name not in chosen}
    return given | {name: p for name, p in defaults.items() if isinstance(p, Prior)}


def modal_residuals(posterior: Posterior) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Measured minus model at the mode of the posterior, and its sd, (rows, 2) per protocol."""
    base = start_parameters(posterior)
    starts = [base]
    others = posterior.settings.error_model.parameters[1:]
    for factor in (1.0, 3.0):  # a small sd at zero load: the rest of the errors is larger
        larger = {p.name: factor * base[p.name] for p in others}
        starts.append(base | larger | {"noise_sd": 0.1 * base["noise_sd"]})
    centres = {name: prior.ppf(np.array(0.5)) for name, prior in user_priors(posterior).items()}
    near = {name: float(value) for name, value in centres.items() if name in base}
    starts += [inside_priors(posterior, base | near)] if near else []
    points = np.vstack([posterior.coordinates(s) for s in starts])
    scale = np.ones(posterior.dimension)
    for i, q in enumerate(posterior.sampled):
        if q.parameter.kind == FORCE:
            scale[i] = max(posterior.specimen.noise_sd, posterior.specimen.load_resolution)
        elif q.parameter.kind == STRETCH:
            scale[i] = 0.02
    modes = find_modes(posterior.log_prob, points, scale, posterior.bounds)
    mode = modes[0].location if modes else points[0]
    rows = posterior.rows
    mean, sd = posterior.forward.predict_rows(posterior.natural(mode), rows)
    parts = [rows.protocol == i for i in range(len(rows.names))]
    return [(rows.load - mean[0])[part] for part in parts], [sd[0][part] for part in parts]
