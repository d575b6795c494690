"""Population Monte Carlo: thousands of points that locate a density and its extent.

A population is drawn from a proposal, weighted by density over proposal, and the next proposal is
fitted to it (Cappe et al., J. Comput. Graph. Stat. 13 (2004) 907). A single transport map fitted
to separate clusters of modes tends to lose one: each has its own *part* of the proposal, fitted to
the points at which that part is the densest. All parts get equally many points, so that clusters
of little mass are not fitted from too few points and then underestimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from biaxbayes.errors import NotConverged
from biaxbayes.sampling.modes import Mode, find_modes, mode_clusters
from biaxbayes.sampling.proposal import MixtureProposal, first_proposal, fit_mixture_proposal
from biaxbayes.sampling.target import Target
from biaxbayes.tasks import one_blas_thread

POPULATION = 4096
MAX_GENERATIONS = 24
SEARCH_COMPONENTS = 6
TARGET_FRACTION = 0.4  # effective fraction of a generation at which the proposal fits well enough
TEMPERED_FRACTION = 0.15  # effective fraction that each tempered generation keeps
SEARCH_WIDTHS = (0.3, 1.0, 3.0)
"""Widths, over the scale of a search, of Student t distributions for mass that no mode covers."""
MAX_POPULATIONS = 2
"""Populations that several parts share."""
NEGLIGIBLE_MASS = 1e-3
"""A well-fitted part of the proposal is dropped below this fraction of the mass."""
MIN_POINTS_PER_DIMENSION = 5
"""Points per dimension below which a part is given up: another is denser where it is."""
CLUSTER_POINTS = 600
"""Points of each cluster used in fits during the warm-up, in addition to the walkers' history."""


@dataclass(frozen=True)
class Start:
    """Result of a search, from which walkers start.

    Attributes
    ----------
    proposal : MixtureProposal
        A proposal that fits the density, with a part for each cluster of modes.
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
    scale_is_sd: np.ndarray | None = None,
) -> Start:
    """Locate all modes of a density that carry mass, and draw a population over them.

    The first proposal has a part for each cluster of modes. It has two Student t
    distributions at each mode, one of the local curvature and one of twice its width; three wide
    ones, around the first mode and the first start, guard against undetected modes.

    Parameters
    ----------
    starts : ndarray, shape (n, d)
        Points to climb from; the first is the best guess.
    scale : ndarray, shape (d,)
        How far from a start to look, in each coordinate.
    rng : numpy.random.Generator
        :meth:`.sampler.Plan.search_rng` makes it from a seed.
    population : int
        Points of a generation; twice as many where there are several clusters.
    scale_is_sd : ndarray of bool, shape (d,), optional
        Coordinates whose ``scale`` is their posterior sd: no distribution is wider there.

    Raises
    ------
    NotConverged
        If no point of positive density is drawn.
    """
    centre, bounds = starts[0], target.bounds
    modes = find_modes(target.log_prob, starts, scale, bounds)
    modes = modes or [Mode(centre, np.diag(scale), 0.0)]
    if scale_is_sd is None:
        scale_is_sd = np.zeros(len(scale), dtype=bool)
    wide = [np.diag(scale * np.where(scale_is_sd, 1.0, width)) for width in SEARCH_WIDTHS]
    clusters = mode_clusters(target.log_prob, modes)
    parts = []
    for cluster in clusters:
        means = [m.location for m in cluster for _ in range(2)]
        means += [cluster[0].location, centre, centre]
        factors = [width * m.factor for m in cluster for width in (1.0, 2.0)] + wide
        mix = [weight / len(cluster) for _ in cluster for weight in (0.4, 0.3)] + [0.1] * 3
        parts.append(first_proposal(np.array(means), factors, np.array(mix), bounds))
    weights = np.array([len(cluster) for cluster in clusters]) / len(modes)
    return _adapted(target, MixtureProposal(weights, tuple(parts)), rng, population)


def _adapted(
    target: Target, proposal: MixtureProposal, rng: np.random.Generator, population: int
) -> Start:
    """Adapt a first proposal to a density; NotConverged if no point has a positive density.

    The first one is much wider than the density, so the weights are tempered: raised to the
    largest power that keeps a fraction of the population effective, separately in each part. All
    parts get equally many points. A mode that no point of a generation comes near is lost;
    :mod:`.modes` looks for them beforehand. A part is dropped when its total weight is negligible
    and no single point dominates.
    """
    best_fraction, stalled = 0.0, 0
    for _ in range(MAX_GENERATIONS):
        u = proposal.sample(rng, population * min(len(proposal.parts), MAX_POPULATIONS))
        log_prob = target.log_prob(u)
        inside = np.isfinite(log_prob)
        log_weight = np.full(len(u), -np.inf)
        log_weight[inside] = log_prob[inside] - proposal.log_density(u[inside])
        if not np.isfinite(log_weight).any():
            raise NotConverged("no region of positive density around the starting points")
        label = _cluster_labels(proposal, u, log_weight)
        powers = [tempering_power(log_weight[label == k]) for k in range(label.max() + 1)]
        if min(powers) == 1.0:
            fraction = min(effective_fraction(log_weight[label == k]) for k in range(len(powers)))
            stalled = 0 if fraction > best_fraction + 0.02 else stalled + 1
            best_fraction = max(fraction, best_fraction)
            if fraction > TARGET_FRACTION or stalled >= 2:
                break
        tempered = np.full(len(u), -np.inf)
        tempered[inside] = np.array(powers)[label[inside]] * log_weight[inside]
        chosen = resample_clusters(tempered, label, len(u) // 2, rng)
        components = SEARCH_COMPONENTS * len(powers)
        with one_blas_thread():
            proposal = fit_mixture_proposal(
                u[chosen], rng, bounds=target.bounds, components=components, label=label[chosen]
            )
    return Start(proposal, u, log_weight, rng)


def _cluster_labels(proposal: MixtureProposal, u: np.ndarray, log_weight: np.ndarray) -> np.ndarray:
    """The cluster of each point, from zero: the densest of the parts that are not dropped."""
    by_part = proposal.log_densities(u)
    label = by_part.argmax(axis=0)
    w = np.exp(log_weight - log_weight.max())
    masses, retained = np.bincount(label, w) / w.sum(), []
    for k, mass in enumerate(masses):
        weights_of_part = log_weight[(label == k) & np.isfinite(log_weight)]
        enough = len(weights_of_part) >= MIN_POINTS_PER_DIMENSION * u.shape[1]
        if enough and (mass >= NEGLIGIBLE_MASS or tempering_power(weights_of_part) < 1.0):
            retained.append(k)
    return np.asarray(by_part[retained or [int(masses.argmax())]].argmax(axis=0))


def resample_clusters(
    log_weight: np.ndarray, label: np.ndarray, size: int, rng: np.random.Generator
) -> np.ndarray:
    """Indices of ``size`` points drawn by their weights, equally many from each cluster."""
    clusters = [np.flatnonzero(label == k) for k in range(int(np.max(label)) + 1)]
    count = size // len(clusters)
    return np.concatenate([own[resample(log_weight[own], count, rng)] for own in clusters])


def effective_fraction(log_weight: np.ndarray) -> float:
    """Effective fraction (sum w)^2 / (n sum w^2) of an importance sample."""
    w = np.exp(log_weight - log_weight.max())
    return float(w.sum() ** 2 / (w.size * (w * w).sum()))


def tempering_power(log_weight: np.ndarray) -> float:
    """Largest power of the weights, at most one, that keeps a fraction of them effective."""
    if effective_fraction(log_weight) >= TEMPERED_FRACTION:
        return 1.0
    low, high = 0.0, 1.0
    finite = log_weight[np.isfinite(log_weight)]
    needed = min(TEMPERED_FRACTION, 0.5 * finite.size / log_weight.size)
    for _ in range(40):
        power = 0.5 * (low + high)
        fraction = effective_fraction(power * finite) * finite.size / log_weight.size
        low, high = (power, high) if fraction >= needed else (low, power)
    return low


def resample(log_weight: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """Indices drawn in proportion to the weights (systematic resampling)."""
    w = np.exp(log_weight - log_weight.max())
    cumulative = np.cumsum(w) / w.sum()
    return np.minimum(
        np.searchsorted(cumulative, (np.arange(size) + rng.random()) / size), w.size - 1
    )


def draw_tempered_points(start: Start) -> np.ndarray:
    """Points (n, d) drawn by the root of their weights: about twice each cluster's variance."""
    half = len(start.points) // 2
    return start.points[resample(_tempered_log_weight(start), half, start.rng)]


def draw_cluster_points(start: Start) -> np.ndarray:
    """Points of a population drawn by their weights, equally many of each cluster, shape (n, d)."""
    inside = np.isfinite(start.log_weight)
    points, log_weight = start.points[inside], start.log_weight[inside]
    label = np.unique(start.proposal.nearest_part(points), return_inverse=True)[1]
    size = CLUSTER_POINTS * (int(np.max(label)) + 1)
    return points[resample_clusters(log_weight, label, size, start.rng)]


def dispersed_starts(start: Start, *, ensembles: int, walkers: int) -> list[np.ndarray]:
    """Starts (walkers, d) of independent ensembles, spread as :func:`draw_tempered_points`."""
    starts, tempered = [], _tempered_log_weight(start)
    for _ in range(ensembles):
        # Without replacement (Gumbel keys), so that the walkers are distinct.
        keys = tempered + start.rng.gumbel(size=tempered.size)
        keys[~np.isfinite(tempered)] = -np.inf
        starts.append(start.points[np.argsort(keys)[::-1][:walkers]])
    return starts


def _tempered_log_weight(start: Start) -> np.ndarray:
    """Half the log weights, the mass of each cluster unchanged: walkers seldom change clusters."""
    log_weight = start.log_weight
    tempered = 0.5 * log_weight
    if len(start.proposal.parts) == 1:
        return tempered
    label = start.proposal.nearest_part(start.points)
    for k in range(len(start.proposal.parts)):
        cluster = (label == k) & np.isfinite(log_weight)
        if cluster.any():
            log_mass = logsumexp(log_weight[cluster])
            tempered[cluster] += log_mass - logsumexp(tempered[cluster])
    return tempered
