"""Find the modes of a posterior, choose its sampling coordinates, and sample."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from biaxbayes.errors import NotConverged
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.model.assembly import SamplingConstants
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import (
    inside_priors,
    mounting_force_width,
    start_parameters,
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
    """Draw from a posterior until the plan is met or its steps are spent.

    Continues from ``state`` if given; the other arguments are those of
    :func:`~biaxbayes.sampling.sampler.draw`. The draws' ``target`` has the sampling coordinates
    that were used. Raises :class:`NotConverged` if no region of positive density is found.
    """
    if state is not None:
        target = with_sampling_constants(posterior, state.constants["isotropy_scale"]).target()
        return draw(target, state, plan, on_block=on_block, progress=progress, stop=stop)
    seconds = {}
    clock = time.perf_counter()
    progress(Progress("fitting"))
    if posterior.sampling_constants == SamplingConstants():  # not prepared
        posterior = with_sampling_constants(posterior)
    seconds["fit"] = time.perf_counter() - clock
    clock = time.perf_counter()
    progress(Progress("compiling (once; cached for later runs)"))
    posterior.log_prob(np.zeros((1, posterior.dimension)))
    seconds["compile"] = time.perf_counter() - clock
    clock = time.perf_counter()
    progress(Progress("searching"))
    target, start = find_start(posterior, plan.search_rng(), plan.population)
    seconds["warm-up"] = time.perf_counter() - clock
    draws = draw(target, start, plan, on_block=on_block, progress=progress, stop=stop)
    seconds["warm-up"] += draws.seconds["warm-up"]
    seconds["sampling"] = draws.seconds["sampling"]
    return replace(draws, seconds=seconds)


def find_start(
    posterior: Posterior, rng: np.random.Generator, population: int = POPULATION
) -> tuple[Target, Start]:
    """Find all modes of a posterior that carry mass, and the sampling coordinates that suit it.

    The search starts from the least-squares fit and from materials that fit in other ways, in the
    coordinates of the fit (:func:`.preparation.with_sampling_constants`). The target and the start
    are in the coordinates that suit the posterior. Raises :class:`NotConverged` if no region of
    positive density is found.
    """
    base = start_parameters(posterior)
    starts = np.vstack([posterior.coordinates(base)[0], _extra_starts(posterior, base, rng)])
    # The mounting force is measured, so its spread is not widened.
    scale_is_sd = np.array([q.parameter.kind == FORCE for q in posterior.sampled])
    target = posterior.target()
    try:
        widths = _start_widths(posterior)
        start = search(target, starts, widths, rng, population, scale_is_sd=scale_is_sd)
    except NotConverged:
        raise NotConverged("no region of positive density around the deterministic fit") from None
    return _rescaled(posterior, target, start)


def _rescaled(posterior: Posterior, target: Target, start: Start) -> tuple[Target, Start]:
    """Change to sampling coordinates scaled for the posterior, where those of the fit differ."""
    if not posterior.law.has_isotropy_scale(posterior.coordinate_constants):
        return target, start
    rng, half = start.rng, len(start.points) // 2
    typical = posterior.natural(start.points[resample(start.log_weight, half, rng)])
    isotropy_scale = posterior.law.isotropy_scale(typical)
    if 0.5 < isotropy_scale / posterior.sampling_constants.isotropy_scale < 2.0:
        return target, start
    # Weights are ratios of densities in the same coordinates: they carry over.
    inside = np.isfinite(start.log_weight)
    points, weights = start.points[inside], start.log_weight[inside]
    label = start.proposal.nearest_part(points)
    rescaled = posterior.replaced(
        sampling_constants=replace(posterior.sampling_constants, isotropy_scale=isotropy_scale)
    )
    with np.errstate(divide="ignore"):
        u = rescaled.coordinates(posterior.natural(points))
    regular = np.isfinite(u).all(axis=1)  # kappa = 0 to the last digit lies at infinity
    u, weights, label = u[regular], weights[regular], label[regular]
    label = np.unique(label, return_inverse=True)[1]
    picked = resample_clusters(weights, label, half, rng)
    with one_blas_thread():
        proposal = fit_mixture_proposal(
            u[picked],
            rng,
            bounds=rescaled.bounds,
            components=SEARCH_COMPONENTS * len(start.proposal.parts),
            label=label[picked],
        )
    return rescaled.target(target.counts), Start(proposal, u, weights, rng)


def _extra_starts(
    posterior: Posterior, base: dict[str, float], rng: np.random.Generator
) -> np.ndarray:
    """Sampling coordinates of materials that fit in other ways than the best fit, (n, d)."""
    law = posterior.law
    setup = FitSetup.from_settings(posterior.specimen, posterior.settings)
    if not setup.free.size:
        return np.empty((0, posterior.dimension))
    materials, stretches = setup.starting_points(EXTRA_STARTS, rng)
    starts = []
    for material, lm in zip(materials, stretches, strict=True):
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
        p = q.parameter
        if p.kind == FORCE:
            out.append(mounting[q.name])
        elif p.kind in (DIMENSION, PIECE):
            prior = posterior.priors[q.name]
            assert isinstance(prior, Prior)
            out.append(0.5 * prior.scale)
        else:
            out.append(widths.get(p.name, p.width))
    return np.array(out)
