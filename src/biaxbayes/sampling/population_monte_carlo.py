"""Population Monte Carlo: thousands of points that find a density and its spread.

A population is drawn from a proposal, weighted by density over proposal, and the next proposal is
fitted to it (Cappe et al., J. Comput. Graph. Stat. 13 (2004) 907). Thousands of points at once
cost a compiled density a few milliseconds; walkers would need hundreds of steps to come as far.
The first proposal has a Student t around every mode (:mod:`.modes`).

A *ridge* is a group of modes with no deep valley between them (:func:`.modes.separate_ridges`). A
single transport map fitted to separated ridges tends to lose one. So each ridge has its own *part*
of the proposal, a mixture of *components*, fitted to the points at which that part is the densest.
All parts get equally many points, so that light ridges are not fitted from too few points and then
underestimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import NotConverged
from biaxbayes.sampling.modes import Mode, find_modes, separate_ridges
from biaxbayes.sampling.proposal import MixtureProposal, first_proposal, fit_mixture_proposal
from biaxbayes.sampling.target import LogDensity, Target
from biaxbayes.tasks import one_blas_thread

POPULATION = 4096
MAX_GENERATIONS = 24
SEARCH_COMPONENTS = 6
TARGET_SHARE = 0.4  # effective share of a generation at which the proposal fits well enough
TEMPERED_SHARE = 0.15  # effective share that each tempered generation keeps
NESTED = (0.3, 1.0, 3.0)
"""Widths, over the scale of a search, of Student t distributions for mass that no mode covers."""
MAX_POPULATIONS = 2
"""Populations that several parts share."""
NEGLIGIBLE_MASS = 1e-3
"""A well-fitted part of the proposal is dropped below this share of the mass."""
MIN_POINTS_PER_DIMENSION = 5
"""Points per dimension below which a part is given up: another is denser where it is."""
RIDGE_POINTS = 600
"""Points of each ridge that fits during the warm-up are made of, beside the walkers' history."""


@dataclass(frozen=True)
class Start:
    """Result of a search, from which walkers start.

    Attributes
    ----------
    proposal : MixtureProposal
        A proposal that fits the density, with a part for each ridge that lies apart.
    points, log_weight : ndarray, shapes (n, d) and (n,)
        A population with log importance weights, -inf where the density is zero.
    rng : numpy.random.Generator
        The generator of the search, which the warm-up continues with.
    """

    proposal: MixtureProposal
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

    The first proposal has a part for each ridge. It has two Student t distributions at each mode,
    one of the local curvature and one of twice its width; three wide ones, around the first mode
    and the first start, guard against modes that were not found.

    Parameters
    ----------
    starts : ndarray, shape (n, d)
        Points to climb from; the first is the best guess.
    scale : ndarray, shape (d,)
        How far from a start to look, in each coordinate.
    rng : numpy.random.Generator
        :meth:`.sampler.Plan.search_rng` makes it from a seed.
    population : int
        Points of a generation; twice as many where there are several ridges.
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
    known = np.zeros(len(scale), dtype=bool) if known is None else known
    wide = [np.diag(scale * np.where(known, 1.0, width)) for width in NESTED]
    ridges = separate_ridges(target.log_prob, modes)
    parts = []
    for ridge in ridges:
        means = [m.location for m in ridge for _ in range(2)] + [ridge[0].location, centre, centre]
        factors = [width * m.factor for m in ridge for width in (1.0, 2.0)] + wide
        shares = [share / len(ridge) for _ in ridge for share in (0.4, 0.3)] + [0.1] * 3
        parts.append(first_proposal(np.array(means), factors, np.array(shares), bounds))
    weights = np.array([len(ridge) for ridge in ridges]) / len(modes)
    first = MixtureProposal(weights, tuple(parts))
    return Start(*explore(target.log_prob, first, bounds, rng, population), rng)


def explore(
    log_density: LogDensity,
    proposal: MixtureProposal,
    bounds: np.ndarray,
    rng: np.random.Generator,
    population: int = POPULATION,
    components: int = SEARCH_COMPONENTS,
) -> tuple[MixtureProposal, np.ndarray, np.ndarray]:
    """Adapt a first proposal to a density; the proposal, its last points and log weights.

    The first one is much wider than the density, so the weights are tempered: raised to the
    largest power that keeps a share of the population effective, separately in each part. All
    parts get equally many points. A mode that no point of a generation comes near is lost;
    :mod:`.modes` looks for them beforehand. A part is dropped when its total weight is negligible
    and no single point dominates. ``components`` is the largest number of components per part.
    Raises NotConverged if no point has a positive density.
    """
    best_share, stalled = 0.0, 0
    for _ in range(MAX_GENERATIONS):
        u = proposal.sample(rng, population * min(len(proposal.parts), MAX_POPULATIONS))
        log_prob = log_density(u)
        inside = np.isfinite(log_prob)
        log_weight = np.full(len(u), -np.inf)
        log_weight[inside] = log_prob[inside] - proposal.log_density(u[inside])
        if not np.isfinite(log_weight).any():
            raise NotConverged("no region of positive density around the starting points")
        label = _ridges(proposal, u, log_weight)
        powers = [tempering(log_weight[label == k]) for k in range(label.max() + 1)]
        if min(powers) == 1.0:
            share = min(effective_share(log_weight[label == k]) for k in range(len(powers)))
            stalled = 0 if share > best_share + 0.02 else stalled + 1
            best_share = max(share, best_share)
            if share > TARGET_SHARE or stalled >= 2:
                break
        tempered = np.where(
            inside, np.array(powers)[label] * np.where(inside, log_weight, 0.0), -np.inf
        )
        chosen = resample_ridges(tempered, label, len(u) // 2, rng)
        most = components * (int(label.max()) + 1)
        with one_blas_thread():
            proposal = fit_mixture_proposal(
                u[chosen], rng, bounds=bounds, components=most, label=label[chosen]
            )
    return proposal, u, log_weight


def _ridges(proposal: MixtureProposal, u: np.ndarray, log_weight: np.ndarray) -> np.ndarray:
    """The ridge of each point, from zero: the densest part of those that stay."""
    by_part = proposal.log_densities(u)
    label = by_part.argmax(axis=0)
    w = np.exp(log_weight - log_weight.max())
    masses, stay = np.bincount(label, w) / w.sum(), []
    for k, mass in enumerate(masses):
        own = log_weight[(label == k) & np.isfinite(log_weight)]
        seen = len(own) >= MIN_POINTS_PER_DIMENSION * u.shape[1]
        if seen and (mass >= NEGLIGIBLE_MASS or tempering(own) < 1.0):
            stay.append(k)
    return np.asarray(by_part[stay or [int(masses.argmax())]].argmax(axis=0))


def resample_ridges(
    log_weight: np.ndarray, label: np.ndarray, size: int, rng: np.random.Generator
) -> np.ndarray:
    """Indices of ``size`` points drawn by their weights, equally many from each ridge."""
    ridges = [np.flatnonzero(label == k) for k in range(int(label.max()) + 1)]
    each = size // len(ridges)
    return np.concatenate([own[resample(log_weight[own], each, rng)] for own in ridges])


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


def tempered_points(start: Start) -> np.ndarray:
    """Points (n, d) drawn by the root of their weights: about twice the variance of each ridge."""
    half = len(start.points) // 2
    return start.points[resample(_tempered_log_weight(start), half, start.rng)]


def ridge_points(start: Start) -> np.ndarray:
    """Points of a population drawn by their weights, as many of each ridge, shape (n, d)."""
    some = np.isfinite(start.log_weight)
    points, log_weight = start.points[some], start.log_weight[some]
    label = np.unique(start.proposal.nearest_part(points), return_inverse=True)[1]
    size = RIDGE_POINTS * (int(label.max()) + 1)
    return points[resample_ridges(log_weight, label, size, start.rng)]


def dispersed_starts(start: Start, *, ensembles: int, walkers: int) -> list[np.ndarray]:
    """Starts (walkers, d) of independent ensembles, spread as :func:`tempered_points`."""
    starts = []
    tempered = _tempered_log_weight(start)
    for _ in range(ensembles):
        # Without replacement (Gumbel keys), so that the walkers are distinct.
        keys = tempered + start.rng.gumbel(size=tempered.size)
        keys[~np.isfinite(tempered)] = -np.inf
        starts.append(start.points[np.argsort(keys)[::-1][:walkers]])
    return starts


def _tempered_log_weight(start: Start) -> np.ndarray:
    """Half the log weights, each ridge as heavy as it is: walkers seldom change between ridges."""
    log_weight = start.log_weight
    tempered = 0.5 * log_weight
    if len(start.proposal.parts) == 1:
        return tempered
    label = start.proposal.nearest_part(start.points)
    for k in range(len(start.proposal.parts)):
        own = (label == k) & np.isfinite(log_weight)
        if own.any():
            tempered[own] += np.logaddexp.reduce(log_weight[own]) - np.logaddexp.reduce(
                tempered[own]
            )
    return tempered
