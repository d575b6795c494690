"""Prepare a posterior for sampling: fit, sampling coordinates, starting point."""

from __future__ import annotations

from typing import Any

import numpy as np

from biaxbayes.fitting.fit_result import FitResult, root_mean_square
from biaxbayes.model.assembly import SamplingConstants
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import (
    DIMENSION,
    FORCE,
    NOISE_SD,
    STIFFNESS,
    STRETCH,
    mounting_names,
    name_of,
)
from biaxbayes.sampling.modes import find_modes
from biaxbayes.specimens.specimen import Specimen


def prepare(specimen: Specimen, *, seed: int = 0, **options: Any) -> Posterior:
    """Fit a specimen and make its posterior, in sampling coordinates that suit the fit.

    Parameters
    ----------
    seed : int
        Seed of the random starts of the least-squares fit.
    **options
        Further arguments of :class:`~biaxbayes.model.posterior.Posterior`.

    Raises
    ------
    InputError
        If the options do not fit the specimen.
    """
    return fitted(Posterior(specimen, **options), seed)


def fitted(posterior: Posterior, seed: int = 0) -> Posterior:
    """The same posterior with its least-squares fit, in sampling coordinates that suit it."""
    return with_sampling_constants(posterior, fit=posterior.least_squares(seed))


def with_sampling_constants(
    posterior: Posterior, isotropy_scale: float | None = None, fit: FitResult | None = None
) -> Posterior:
    """The same posterior with the sampling coordinates that suit a least-squares fit.

    ``isotropy_scale`` is that of stored coordinates, which can only be read with the one that they
    were written with; by default it is that of the fitted material. ``fit`` is by default that of
    the posterior.
    """
    fit = posterior.fit if fit is None else fit
    if isotropy_scale is None:
        law = posterior.law
        isotropy_scale = law.isotropy_scale(dict(zip(law.names, fit.material.values, strict=True)))
    reference: tuple[float, float] | None = None
    if posterior.settings.infers_mounting:  # the largest total stretches
        lm = np.clip(np.max(fit.mounting_stretch, axis=0), 1.0, 1.5)
        pieces = posterior.specimen.pieces
        tops = [p.known_stretch.max(axis=0) for piece in pieces for p in piece.protocols]
        x, y = np.max(tops, axis=0) * lm
        reference = x, y
    constants = SamplingConstants(isotropy_scale, reference)
    return posterior.replaced(sampling_constants=constants, fit=fit)


def with_coarse_terms(posterior: Posterior) -> Posterior:
    """The same posterior with a part of the terms of its misfit, to look where the mass is."""
    if not posterior.settings.has_misfit:
        return posterior
    return posterior.replaced(terms=[misfit.coarse.chosen for misfit in posterior.misfits])


# --- natural parameters to start from ------------------------------------------------------------


def start_parameters(posterior: Posterior) -> dict[str, float]:
    """Natural parameters of the least-squares fit, moved off the bounds of their ranges."""
    fit, law = posterior.fit, posterior.law
    out: dict[str, float] = dict(zip(law.names, law.clip_inside(fit.material.values), strict=True))
    residuals = iter(fit.residuals)  # of all protocols, piece by piece
    for piece in posterior.pieces:
        rms = root_mean_square([next(residuals) for _ in piece.specimen.protocols])
        noise_sd = name_of(NOISE_SD.name, piece.labels.label)
        out[noise_sd] = max(rms, 2.0 * piece.specimen.load_resolution)
    for piece, stiffness in zip(posterior.pieces, fit.stiffness, strict=True):
        out[name_of(STIFFNESS.name, piece.labels.label)] = float(stiffness)
    for q in posterior.sampled:
        p = q.parameter
        if p.kind in (STRETCH, FORCE):
            values = fit.mounting_stretch if p.kind == STRETCH else fit.mounting_load
            out[q.name] = float(values[posterior.mounts.index(q.state)][q.axis])
        elif p.kind == DIMENSION:
            out[q.name] = 0.0 if p.unit_symbol("N") else 1.0
    return inside_priors(posterior, out)


def inside_priors(posterior: Posterior, parameters: dict[str, float]) -> dict[str, float]:
    """Parameters moved into the ranges of their priors."""
    out = dict(parameters)
    for name, prior in posterior.priors.items():
        if name in out and isinstance(prior, Prior) and not prior.low < out[name] < prior.high:
            # the bound that was crossed is finite
            bound = prior.low if out[name] <= prior.low else prior.high
            span = prior.high - prior.low
            margin = 0.01 * (span if np.isfinite(span) else max(abs(bound), 1.0))
            out[name] = float(np.clip(out[name], prior.low + margin, prior.high - margin))
    return out


def user_priors(posterior: Posterior) -> dict[str, Prior]:
    """Priors given by the user, for the law and the mounting stretches."""
    chosen, header = posterior.settings.priors, posterior.specimen.metadata
    measured = [n for n in mounting_names("stretch") if n in header and n not in chosen]
    given = {**chosen, **{name: posterior.priors.get(name) for name in measured}}
    return {name: prior for name, prior in given.items() if isinstance(prior, Prior)}


def mode(posterior: Posterior) -> dict[str, np.ndarray]:
    """Natural values, of shape (1,), at the mode of the posterior near its least-squares fit."""
    base = start_parameters(posterior)
    given = user_priors(posterior)
    near = {n: float(prior.ppf(np.array(0.5))) for n, prior in given.items() if n in base}
    starts = [base, inside_priors(posterior, base | near)] if near else [base]
    points = np.vstack([posterior.coordinates(s) for s in starts])
    known = mounting_force_width(posterior)
    known |= {q.name: 0.02 for q in posterior.sampled if q.parameter.kind == STRETCH}
    scale = np.array([known.get(name, 1.0) for name in posterior.free])
    modes = find_modes(posterior.log_prob, points, scale, posterior.bounds)
    return posterior.natural(modes[0].location if modes else points[0])


def mounting_force_width(posterior: Posterior) -> dict[str, float]:
    """Error (sd) of each mounting force by name, the misfit of the law included."""
    out: dict[str, float] = {}
    for i, piece in enumerate(posterior.pieces):
        sd, readings = piece.rows.mounting_sd.copy(), piece.readings
        if posterior.settings.has_misfit and readings.mounting_count:
            known = readings.mounting_index >= 0
            sd[known] = posterior.misfits[i].toe_and_noise_sd[readings.mounting_index[known]]
        for state, of_state in zip(piece.labels.states, sd, strict=True):
            out |= dict(zip(mounting_names("force", state), of_state.tolist(), strict=True))
    return out
