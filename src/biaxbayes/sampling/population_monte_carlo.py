"""Population Monte Carlo: thousands of points that find a density and its spread.

A population is drawn from a proposal, weighted by density over proposal, and the next proposal is
fitted to it (Cappe et al., J. Comput. Graph. Stat. 13 (2004) 907). Thousands of points at once
cost a compiled density a few milliseconds; walkers would need hundreds of steps to come as far.
The first proposal has a Student t around every mode (:mod:`.modes`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from biaxbayes.errors import NotConverged
from biaxbayes.sampling.modes import Mode, find_modes
from biaxbayes.sampling.proposal import (
    TransportedMixture,
    first_proposal,
    fit_transported_mixture,
)
from biaxbayes.sampling.target import LogDensity, Target

__all__ = [
    "POPULATION",
    "Start",
    "dispersed_starts",
    "effective_share",
    "explore",
    "resample",
    "search",
    "tempered_points",
    "tempering",
]

POPULATION = 4096
MAX_GENERATIONS = 24
SEARCH_COMPONENTS = 6
TARGET_SHARE = 0.4  # effective share of a generation at which the proposal fits well enough
TEMPERED_SHARE = 0.15  # effective share that each tempered generation keeps


NESTED = (0.3, 1.0, 3.0)
"""Widths, over the scale of a search, of Student t distributions for what no mode stands for."""


@dataclass(frozen=True)
class Start:
    """What a search found, from which walkers start.

    Attributes
    ----------
    proposal : TransportedMixture
        A proposal that fits the density.
    points : ndarray, shape (n, d)
        A population spread over the density.
    log_weight : ndarray, shape (n,)
        Log importance weight of each point; -inf where the density is zero.
    rng : numpy.random.Generator
        The random numbers that the search drew from; what follows goes on with them.
    """

    proposal: TransportedMixture
    points: np.ndarray
    log_weight: np.ndarray
    rng: np.random.Generator


def search(
    target: Target,
    starts: np.ndarray,
    scale: np.ndarray,
    rng: np.random.Generator,
    population: int = POPULATION,
    *,
    known: np.ndarray | None = None,
) -> Start:
    """Find all modes of a density that carry mass, and a population spread over them.

    The first proposal has two Student t distributions at each mode, one of the local curvature
    and one of twice its width; three nested and wide ones, around the highest mode and the first
    start, are there in case the modes are not all.

    Parameters
    ----------
    target : Target
    starts : ndarray, shape (n, d)
        Points to climb from; the first is the best guess.
    scale : ndarray, shape (d,)
        How far from a start to look, in each coordinate.
    rng : numpy.random.Generator
        :meth:`.sampler.Plan.search_rng` makes it from a seed.
    population : int
        Points of a generation.
    known : ndarray of bool, shape (d,), optional
        Coordinates whose ``scale`` is their spread already: no distribution is wider there.

    Raises
    ------
    NotConverged
        If no region of positive density is found.
    """
    centre, bounds = starts[0], target.bounds
    modes = find_modes(target.log_prob, starts, scale, bounds) or [
        Mode(centre, np.diag(scale), 0.0)
    ]
    pinned = np.zeros(len(scale), dtype=bool) if known is None else known
    wide = [np.diag(scale * np.where(pinned, 1.0, width)) for width in NESTED]
    means = [m.location for m in modes for _ in range(2)] + [modes[0].location, centre, centre]
    factors = [width * m.factor for m in modes for width in (1.0, 2.0)] + wide
    shares = [share / len(modes) for _ in modes for share in (0.4, 0.3)] + [0.1] * 3
    first = first_proposal(np.array(means), factors, np.array(shares), bounds)
    return Start(*explore(target.log_prob, first, bounds, rng, population), rng)


def explore(
    log_density: LogDensity,
    proposal: TransportedMixture,
    bounds: np.ndarray,
    rng: np.random.Generator,
    population: int = POPULATION,
    components: int = SEARCH_COMPONENTS,
) -> tuple[TransportedMixture, np.ndarray, np.ndarray]:
    """From a first proposal to one that fits a density.

    The first one is much wider than the density, so the weights are tempered: raised to the
    largest power that keeps a share of the population effective. A mode that no point of a
    generation comes near is lost; :mod:`.modes` looks for them beforehand.

    Parameters
    ----------
    log_density : callable
        Vectorised, (n, d) to (n,); -inf where the density is zero.
    proposal : TransportedMixture
    bounds : ndarray, shape (d, 2)
    rng : numpy.random.Generator
    population : int
    components : int
        Largest number of mixture components of each proposal.

    Returns
    -------
    proposal : TransportedMixture
    population : ndarray, shape (n, d)
    log_weight : ndarray, shape (n,)
        Of the last generation.

    Raises
    ------
    NotConverged
        If no point has a positive density.
    """
    best_share, stalled = 0.0, 0
    for _ in range(MAX_GENERATIONS):
        u = proposal.sample(rng, population)
        log_prob = log_density(u)
        inside = np.isfinite(log_prob)
        log_weight = np.full(len(u), -np.inf)
        log_weight[inside] = log_prob[inside] - proposal.log_density(u[inside])
        if not np.isfinite(log_weight).any():
            raise NotConverged("no region of positive density around the starting points")
        power = tempering(log_weight)
        share = effective_share(log_weight)
        if power == 1.0:
            stalled = 0 if share > best_share + 0.02 else stalled + 1
            best_share = max(share, best_share)
            if share > TARGET_SHARE or stalled >= 2:
                break
        tempered = np.where(inside, power * np.where(inside, log_weight, 0.0), -np.inf)
        chosen = resample(tempered, population // 2, rng)
        with threadpool_limits(1, user_api="blas"):
            proposal = fit_transported_mixture(
                u[chosen], rng, bounds=bounds, components=components, screen=False
            )
    return proposal, u, log_weight


def effective_share(log_weight: np.ndarray) -> float:
    """Effective share (sum w)^2 / (n sum w^2) of an importance sample."""
    w = np.exp(log_weight - log_weight.max())
    return float(w.sum() ** 2 / (w.size * (w * w).sum()))


def tempering(log_weight: np.ndarray) -> float:
    """Largest power of the weights, at most one, that keeps a share of them effective."""
    if effective_share(log_weight) >= TEMPERED_SHARE:
        return 1.0
    low, high = 0.0, 1.0
    finite = log_weight[np.isfinite(log_weight)]
    needed = min(TEMPERED_SHARE, 0.5 * finite.size / log_weight.size)
    for _ in range(40):
        power = 0.5 * (low + high)
        share = effective_share(power * finite) * finite.size / log_weight.size
        low, high = (power, high) if share >= needed else (low, power)
    return low


def resample(log_weight: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """Indices drawn in proportion to the weights (systematic resampling)."""
    w = np.exp(log_weight - log_weight.max())
    cumulative = np.cumsum(w) / w.sum()
    return np.minimum(
        np.searchsorted(cumulative, (np.arange(size) + rng.random()) / size), w.size - 1
    )


def tempered_points(
    population: np.ndarray, log_weight: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Points of a population drawn by the square root of their weights, shape (n, d)."""
    return population[resample(0.5 * log_weight, len(population) // 2, rng)]


def dispersed_starts(
    population: np.ndarray,
    log_weight: np.ndarray,
    rng: np.random.Generator,
    *,
    ensembles: int,
    walkers: int,
) -> list[np.ndarray]:
    """Starts of independent ensembles, spread wider than the posterior.

    Drawn from a population by the square root of its weights: about twice the posterior's
    variance.

    Returns
    -------
    list of ndarray, shape (walkers, d)
    """
    starts = []
    for _ in range(ensembles):
        # Without replacement (Gumbel keys), so that the walkers are distinct.
        keys = 0.5 * log_weight + rng.gumbel(size=log_weight.size)
        keys[~np.isfinite(log_weight)] = -np.inf
        starts.append(population[np.argsort(keys)[::-1][:walkers]])
    return starts
