"""Find the modes of a posterior, choose its sampling coordinates, and sample."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from biaxbayes.errors import NotConverged
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.model import density
from biaxbayes.model.assembly import SamplingConstants
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import (
    inside_priors,
    mounting_force_width,
    start_parameters,
    with_coarse_terms,
    with_sampling_constants,
)
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import DIMENSION, ERROR, FORCE, PIECE, STRETCH
from biaxbayes.sampling.population_monte_carlo import (
    POPULATION,
    SEARCH_COMPONENTS,
    Start,
    resample,
    resample_clusters,
    search,
)
from biaxbayes.sampling.proposal import fit_mixture_proposal
from biaxbayes.sampling.sampler import Checkpoint, Draws, Plan, Progress, draw
from biaxbayes.sampling.target import Target
from biaxbayes.tasks import one_blas_thread

EXTRA_STARTS = 16
"""Number of materials, far apart, from which the search looks for other modes."""
TYPICAL_POINTS = 400
"""Points of the search by which the terms of a misfit are chosen."""
EXTRA_NOISE = 10.0
"""Initial noise of an extra start relative to that of the fit, since it fits worse."""


def draw_posterior(
    posterior: Posterior,
    plan: Plan,
    *,
    state: Checkpoint | None = None,
    on_block: Callable[[Checkpoint], None] | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
    stop: Callable[[], int] = lambda: False,
) -> Draws:
    """Draw until the plan is met or its steps are spent, from ``state`` if given."""
    if state is not None:
        target = as_sampled(posterior, state.constants).target()
        return draw(target, state, plan, on_block=on_block, progress=progress, stop=stop)
    seconds = {}
    clock = time.perf_counter()
    progress(Progress("fitting"))
    if posterior.sampling_constants == SamplingConstants():  # not prepared
        posterior = with_sampling_constants(posterior)
    seconds["fit"] = time.perf_counter() - clock
    clock = time.perf_counter()
    progress(Progress("compiling (once; cached for later runs)"))
    density.evaluate(posterior.assembly.problem, np.zeros((1, posterior.dimension)))
    seconds["compile"] = time.perf_counter() - clock
    clock = time.perf_counter()
    progress(Progress("searching"))
    target, start = find_start(posterior, plan.search_rng(), plan.population)
    seconds["warm-up"] = time.perf_counter() - clock
    draws = draw(target, start, plan, on_block=on_block, progress=progress, stop=stop)
    seconds["warm-up"] += draws.seconds["warm-up"]
    seconds["sampling"] = draws.seconds["sampling"]
    return replace(draws, seconds=seconds)


def as_sampled(posterior: Posterior, constants: Mapping[str, Any]) -> Posterior:
    """The posterior whose target has these constants: its coordinates, the terms of its misfit."""
    chosen = posterior.replaced(terms=constants["terms"] or None)
    return with_sampling_constants(chosen, constants["isotropy_scale"])


def find_start(
    posterior: Posterior, rng: np.random.Generator, population: int = POPULATION
) -> tuple[Target, Start]:
    """Find all modes of a posterior that carry mass, and the sampling coordinates that suit it.

    The search starts from the least-squares fit and from materials that fit in other ways, in the
    coordinates of the fit (:func:`.preparation.with_sampling_constants`). The target and the start
    are in the coordinates that suit the posterior. Of a smooth misfit the search sums a part of
    the terms, and the target those that have weight at the points it found. Raises
    :class:`NotConverged` if no region of positive density is found.
    """
    posterior = with_coarse_terms(posterior)
    base = start_parameters(posterior)
    starts = np.vstack([posterior.coordinates(base)[0], _extra_starts(posterior, base, rng)])
    # The mounting force is measured, so its spread is not widened.
    scale_is_sd = np.array([q.parameter.kind == FORCE for q in posterior.sampled])
    target, widths = posterior.target(), _start_widths(posterior)
    try:
        start = search(target, starts, widths, rng, population, scale_is_sd=scale_is_sd)
    except NotConverged:
        raise NotConverged("no region of positive density around the deterministic fit") from None
    posterior, start = _rescaled(posterior, start)
    if posterior.settings.has_misfit:
        posterior, start = _with_terms_of_weight(posterior, start)
    return posterior.target(target.counts), start


def _with_terms_of_weight(posterior: Posterior, start: Start) -> tuple[Posterior, Start]:
    """Sum the terms of the misfit that have weight where a search found mass."""
    whole = posterior.replaced(terms=None)
    typical = start.points[resample(start.log_weight, TYPICAL_POINTS, start.rng)]
    residual = density.evaluate(whole.assembly.problem, typical).residual
    terms = [
        misfit.with_weight(residual[:, whole.of_piece(i)]).chosen
        for i, misfit in enumerate(whole.misfits)
    ]
    chosen = posterior.replaced(terms=terms)
    before, after = posterior.log_prob(start.points), chosen.log_prob(start.points)
    inside = np.isfinite(start.log_weight) & np.isfinite(before) & np.isfinite(after)
    log_weight = start.log_weight[inside] + after[inside] - before[inside]
    return chosen, replace(start, points=start.points[inside], log_weight=log_weight)


def _rescaled(posterior: Posterior, start: Start) -> tuple[Posterior, Start]:
    """Change to sampling coordinates scaled for the posterior, where those of the fit differ."""
    if posterior.coordinate_constants.alpha < 0:  # not charted
        return posterior, start
    rng, half = start.rng, len(start.points) // 2
    typical = posterior.natural(start.points[resample(start.log_weight, half, rng)])
    isotropy_scale = posterior.law.isotropy_scale(typical)
    if 0.5 < isotropy_scale / posterior.sampling_constants.isotropy_scale < 2.0:
        return posterior, start
    # Weights are ratios of densities in the same coordinates: they carry over.
    inside = np.isfinite(start.log_weight)
    points, weights = start.points[inside], start.log_weight[inside]
    constants = replace(posterior.sampling_constants, isotropy_scale=isotropy_scale)
    rescaled = posterior.replaced(sampling_constants=constants)
    with np.errstate(divide="ignore"):
        u = rescaled.coordinates(posterior.natural(points))
    regular = np.isfinite(u).all(axis=1)  # kappa = 0 to the last digit lies at infinity
    u, weights = u[regular], weights[regular]
    label = np.unique(start.proposal.nearest_part(points)[regular], return_inverse=True)[1]
    picked = resample_clusters(weights, label, half, rng)
    with one_blas_thread():
        proposal = fit_mixture_proposal(
            u[picked],
            rng,
            bounds=rescaled.bounds,
            components=SEARCH_COMPONENTS * len(start.proposal.parts),
            label=label[picked],
        )
    return rescaled, Start(proposal, u, weights, rng)


def _extra_starts(
    posterior: Posterior, base: dict[str, float], rng: np.random.Generator
) -> np.ndarray:
    """Sampling coordinates of materials that fit in other ways than the best fit, (n, d)."""
    law, starts = posterior.law, []
    setup = FitSetup.from_settings(posterior.specimen, posterior.settings)
    if not setup.free.size:
        return np.empty((0, posterior.dimension))
    for material, lm in zip(*setup.starting_points(EXTRA_STARTS, rng), strict=True):
        inner = law.clip_inside(law.from_fit_coordinates(material))
        start = base | dict(zip(law.names, inner, strict=True))
        for q in posterior.sampled:
            if q.parameter.kind == STRETCH:
                start[q.name] = float(lm[q.axis])
            elif q.parameter.kind == ERROR:
                start[q.name] = EXTRA_NOISE * base[q.name]
        starts.append(posterior.coordinates(inside_priors(posterior, start))[0])
    return np.array(starts)


def _start_widths(posterior: Posterior) -> np.ndarray:
    """How far from a start to look, in each sampling coordinate."""
    mounting = mounting_force_width(posterior)
    widths = posterior.law.sampling_widths(posterior.coordinate_constants)
    out = []
    for q in posterior.sampled:
        p, prior = q.parameter, posterior.priors.get(q.name)
        if p.kind == FORCE:
            out.append(mounting[q.name])
        elif p.kind in (DIMENSION, PIECE) and isinstance(prior, Prior):
            out.append(0.5 * prior.scale)
        else:
            out.append(widths.get(p.name, p.width))
    return np.array(out)
