"""Warm-up: from a first proposal to ensembles with a frozen one that fits.

An independence sampler holds a walker for as long as its importance weight w = density / proposal
exceeds the typical one. Two things are done about that, beside fitting the proposal to the
walkers' own history.

Incremental mixture importance sampling (Raftery and Bao, Biometrics 66 (2010) 1162): components
are added one after the other around the point of the largest weight, shaped like its
neighbourhood, until no weight stands out (:func:`add_components`).

Mixture-weight optimisation: with both densities normalised, the autocorrelation time of the
sampler is about 2 E[w] - 1, the mean taken over the density (Liu, Statistics and Computing 6 (1996)
113). E[w] is a convex function of the weights of a mixture's components. Components that were
added for the tails take more than they need; what they need is found by
:func:`optimise_weights`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.sampling.population_monte_carlo import LEAST_POINTS
from biaxbayes.sampling.proposal import Located, MixtureProposal, TransportedMixture
from biaxbayes.sampling.student_mixture import StudentMixture

if TYPE_CHECKING:
    from biaxbayes.sampling.ensembles import Ensembles

__all__ = ["WarmUp", "add_components", "optimise_weights", "warm_up"]

POOR_ACCEPTANCE = 0.03
"""Below this the independence move is not worth its density evaluations."""


# --- incremental mixture importance sampling ------------------------------------------------------


MAX_COMPONENTS = 12
STANDS_OUT = np.log(6.0)
"""A weight this many e-folds above the mean one stands out."""
NEIGHBOURS = 0.04
SHARE = 0.02
"""Neighbourhood of a new component, as a share of the points; and its mixture weight."""


def add_components(
    proposal: MixtureProposal, located: Located, log_prob: np.ndarray, log_mean_weight: float
) -> MixtureProposal:
    """Add components to a proposal where points of the density stand out.

    Parameters
    ----------
    proposal : MixtureProposal
        The part that comes nearest at the point takes the component.
    located : list of (ndarray, shape (n, d); ndarray, shape (n,))
        From :meth:`.MixtureProposal.located` of points of positive density: history of walkers,
        draws of the proposal.
    log_prob : ndarray, shape (n,)
    log_mean_weight : float
        Log of the mean importance weight (an estimate of the evidence).

    Returns
    -------
    MixtureProposal
        ``proposal`` itself where nothing stands out.
    """
    parts, weights = list(proposal.parts), proposal.weights
    by_part = proposal.log_densities_at(located)
    nearest = by_part.argmax(axis=0)
    log_density = np.logaddexp.reduce(by_part, axis=0)
    by_map: dict[int, _Neighbourhoods] = {}
    for _ in range(MAX_COMPONENTS):
        log_weight = log_prob - log_density
        top = int(np.argmax(log_weight))
        if log_weight[top] - log_mean_weight < STANDS_OUT:
            break
        k = int(nearest[top])
        if k not in by_map:
            by_map[k] = _Neighbourhoods.of(*located[k], nearest == k)
        factor = by_map[k].shape_at(top, log_weight)
        if factor is None:
            break
        mean = by_map[k].r[top]
        share = (1.0 - SHARE) * weights[k] + SHARE
        parts[k] = _with_component(parts[k], mean, factor, SHARE / share)
        weights = (1.0 - SHARE) * weights
        weights[k] = share
        alone = StudentMixture.single(mean, factor)
        new = alone.log_density(by_map[k].r, parts[k].mirrors) + by_map[k].log_jacobian
        # q' = (1 - share) q + share t
        log_density = np.logaddexp(np.log1p(-SHARE) + log_density, np.log(SHARE) + new)
    return MixtureProposal(weights, tuple(parts)) if by_map else proposal


@dataclass(frozen=True)
class _Neighbourhoods:
    """Points in the reference coordinates of one part, and where they lie densely."""

    r: np.ndarray
    log_jacobian: np.ndarray
    white: np.ndarray
    own: np.ndarray

    @classmethod
    def of(cls, r: np.ndarray, log_jacobian: np.ndarray, own: np.ndarray) -> _Neighbourhoods:
        """``own``: the points at which the part comes nearest."""
        d = r.shape[1]
        known = r[own] if own.sum() > 6 * d else r
        scale = np.linalg.inv(np.linalg.cholesky(np.cov(known.T) + 1e-9 * np.eye(d)))
        return cls(r, log_jacobian, r @ scale.T, np.flatnonzero(own))

    def shape_at(self, top: int, log_weight: np.ndarray) -> np.ndarray | None:
        """Cholesky factor of the scatter around a point; None where it has too few neighbours."""
        n, d = len(self.own), self.r.shape[1]
        near = max(int(NEIGHBOURS * len(self.r)), 6 * d)
        if n < 2 * near:
            return None
        distance = ((self.white[self.own] - self.white[top]) ** 2).sum(axis=1)
        chosen = self.own[np.argpartition(distance, near)[:near]]
        # Neighbours that are themselves short of proposal shape the component.
        excess = np.exp(np.clip(log_weight[chosen] - log_weight[top], -20.0, 0.0)) + 1.0 / near
        share = excess / excess.sum()
        offset = self.r[chosen] - self.r[top]
        covariance = (offset * share[:, None]).T @ offset
        covariance += 1e-3 * np.diag(np.diag(covariance)) + 1e-12 * np.eye(d)
        return np.asarray(np.linalg.cholesky(covariance))


def _with_component(
    proposal: TransportedMixture, mean: np.ndarray, factor: np.ndarray, share: float
) -> TransportedMixture:
    old = proposal.mixture
    mixture = StudentMixture.from_factors(
        np.append(old.weights * (1.0 - share), share),
        np.vstack([old.means, mean]),
        np.concatenate([old.factors, factor[None]]),
    )
    return replace(proposal, mixture=mixture)


# --- mixture-weight optimisation ------------------------------------------------------------------


POINTS = 8000
ROUNDS = 20
KEPT = 0.5
"""Part of the proposal that stays as it is: the points may not have been where it reaches."""


def optimise_weights(
    proposal: MixtureProposal, points: np.ndarray, log_prob: np.ndarray, rng: np.random.Generator
) -> MixtureProposal:
    """Set the weights of all components so that E[w] is least.

    Parameters
    ----------
    proposal : MixtureProposal
    points : ndarray, shape (n, d)
        Draws of the density.
    log_prob : ndarray, shape (n,)
    rng : numpy.random.Generator
    """
    if len(points) > POINTS:
        few = rng.choice(len(points), POINTS, replace=False)
        points, log_prob = points[few], log_prob[few]
    share, log_density = _components(proposal, points)
    # q_k / pi, up to a constant that the weights do not depend on
    ratio = log_density - log_prob
    ratio = np.exp(ratio - np.median(ratio.max(axis=0)))
    kept, free = KEPT * (share @ ratio), share
    for _ in range(ROUNDS):
        # E[w] = E[1 / sum_k a_k q_k / pi];  a_k <- a_k sqrt(E[w^2 q_k / pi]), summing to one
        w = 1.0 / (kept + (1.0 - KEPT) * (free @ ratio))
        free = free * np.sqrt(ratio @ (w * w))
        free /= free.sum()
    return _with_weights(proposal, KEPT * share + (1.0 - KEPT) * free)


def _components(proposal: MixtureProposal, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (k,) and log densities (k, n) of the components of all parts."""
    shares, columns = [], []
    for weight, part in zip(proposal.weights, proposal.parts, strict=True):
        r, log_jacobian = part.transport.to_reference(points)
        mixture = part.mixture
        shares.append(weight * mixture.weights)
        for mean, factor in zip(mixture.means, mixture.factors, strict=True):
            alone = StudentMixture.single(mean, factor)
            columns.append(alone.log_density(r, part.mirrors) + log_jacobian)
    return np.concatenate(shares), np.array(columns)


def _with_weights(proposal: MixtureProposal, share: np.ndarray) -> MixtureProposal:
    counts = [len(part.mixture.weights) for part in proposal.parts]
    by_part = np.split(share, np.cumsum(counts)[:-1])
    parts = []
    for part, own in zip(proposal.parts, by_part, strict=True):
        old = part.mixture
        mixture = StudentMixture.from_factors(own / own.sum(), old.means, old.factors)
        parts.append(replace(part, mixture=mixture))
    return MixtureProposal(np.array([own.sum() for own in by_part]), tuple(parts))


# --- warm-up --------------------------------------------------------------------------------------


ROUND_STEPS = 16
CHECKS = ((16, 3.0), (64, 3.0), (160, 2.5), (160, 2.5), (16, np.inf))
"""Steps on which the final proposal is judged, and the excess below which it passes; else it is
fitted once more. Tuned on processor time to 2,000 effective draws, the warm-up included: shipped
specimens, three seeds, all ways of mounting and six laws. On others (measured tissue, simulated
tests, other seeds) limits of 1.9, 1.9, 1.6 and 2.5 take 11 % longer in the geometric mean."""
COMPONENTS_OF_ROUNDS, COMPONENTS, MORE_COMPONENTS = 8, 12, 20
"""Of the proposal of the rounds, of the final one, and of one that has been fitted again."""
MOST_COMPONENTS = 24
"""Of all parts together, where there are several."""
INCREMENTS = 2
"""Rounds in which components are added."""
LOW_EXCESS, HIGH_EXCESS = 1.6, 4.0
"""Excess, how far the largest log weights (their 0.998 quantile) lie above the median one: up to
the first walkers move freely, from the second they hardly do."""
TWO_MAPS_EXCESS = 2.5
"""Above this excess one transport map is too few, and the next fit has two."""
DE_SHARES = (0.15, 0.25, 0.5)
"""Share of differential evolution, another way to move: at a low excess, between, at a high one."""
MAX_ROUNDS = 8
GOOD = 0.45  # acceptance from which a proposal need not change before its final fit
REMEMBERED = 2  # rounds that the final fit is made from
RISE = 0.02  # smallest rise of acceptance that is worth another round
ENOUGH_ACCEPTANCE, ENOUGH_EXCESS = 0.5, 3.1
"""Acceptance and excess with which the proposal of the rounds is kept as it is: a better one would
cost more time than it saves."""


@dataclass(frozen=True)
class WarmUp:
    """What the warm-up found.

    Attributes
    ----------
    rounds : int
        Adaptation rounds.
    acceptance : float
        Acceptance of the independence move in the last round.
    message : str
        Empty, or what the user should know.
    """

    rounds: int
    acceptance: float
    message: str


def warm_up(
    ensembles: Ensembles,
    proposal: MixtureProposal,
    spread: np.ndarray,
    known: np.ndarray,
    *,
    progress: Callable[[str], None] = lambda text: None,
) -> WarmUp:
    """Let the ensembles forget their starts, adapt the proposal to their history and freeze it.

    Rounds of steps alternate with fits of the proposal to the newest pooled history, until the
    acceptance stops rising; unless the proposal then holds no walker for long, another is fitted
    with more care. Differential evolution stays in the mix throughout.

    Parameters
    ----------
    ensembles : Ensembles
    proposal : MixtureProposal
        A first proposal.
    spread : ndarray, shape (n, d)
        Points spread wider than the density (:func:`.population_monte_carlo.tempered_points`). A
        proposal too narrow where they are would hold a walker for long: none is kept without a
        fit, and they make up a fifth of what a final one is fitted to.
    known : ndarray, shape (m, d)
        Points of every ridge (:func:`.population_monte_carlo.ridge_points`). Where the first
        proposal has several parts, every later one is fitted to them, too: few walkers may be on a
        ridge.
    progress : callable
        Called with a short text at each round.
    """
    ensembles.proposal = proposal
    ensembles.set_share(0.7)
    rounds, points, log_prob = _adapted(ensembles, known, progress)
    acceptance, excess = ensembles.acceptance, LOW_EXCESS
    if not _fits_enough(ensembles, points, log_prob, spread):
        acceptance, excess = _final_proposal(ensembles, points, log_prob, spread, known, progress)
    message = ""
    share = 1.0 - DE_SHARES[int(np.searchsorted((LOW_EXCESS, HIGH_EXCESS), excess))]
    if acceptance < POOR_ACCEPTANCE:
        share = 0.1
        message = (
            f"the adapted proposal fits poorly (acceptance {acceptance:.3f}); "
            "sampling falls back on differential evolution, which takes longer"
        )
    ensembles.set_share(share)
    ensembles.freeze()
    return WarmUp(rounds, acceptance, message)


def _adapted(
    ensembles: Ensembles, known: np.ndarray, progress: Callable[[str], None]
) -> tuple[int, np.ndarray, np.ndarray]:
    """Rounds of steps and fits; their number, and the newest points with their log densities."""
    best, stalled, rounds = -1.0, 0, 0
    recent: list[np.ndarray] = []
    recent_log_prob: list[np.ndarray] = []
    for rounds in range(1, MAX_ROUNDS + 1):
        ensembles.reset_counts()
        chain, log_prob = ensembles.run(ROUND_STEPS)
        acceptance = ensembles.acceptance
        progress(f"adapting, acceptance {acceptance:.2f}")
        history = chain[:, ROUND_STEPS // 4 :].reshape(-1, chain.shape[-1])
        recent = [*recent, history][-REMEMBERED:]
        recent_log_prob = [*recent_log_prob, log_prob[:, ROUND_STEPS // 4 :].ravel()][-REMEMBERED:]
        stalled = 0 if acceptance > best + RISE else stalled + 1
        best = max(best, acceptance)
        if rounds >= REMEMBERED and (acceptance > GOOD or stalled >= 2):
            break
        if acceptance < GOOD:
            _adapt(ensembles, history, known, COMPONENTS_OF_ROUNDS, screen=False)
    return rounds, np.concatenate(recent), np.concatenate(recent_log_prob)


def _fits_enough(
    ensembles: Ensembles, points: np.ndarray, log_prob: np.ndarray, spread: np.ndarray
) -> bool:
    """Whether no walker would stand for long, among the points or where ``spread`` is."""
    assert ensembles.proposal is not None
    if ensembles.acceptance < ENOUGH_ACCEPTANCE:
        return False
    log_weight = log_prob - ensembles.proposal.log_density(points)
    in_tails = ensembles.members[0].log_density(spread) - ensembles.proposal.log_density(spread)
    highest = np.max([log_weight.max(), in_tails.max()])  # NaN where there is no telling
    return bool(highest - np.median(log_weight) < ENOUGH_EXCESS)


def _final_proposal(
    ensembles: Ensembles,
    points: np.ndarray,
    log_prob: np.ndarray,
    spread: np.ndarray,
    known: np.ndarray,
    progress: Callable[[str], None],
) -> tuple[float, float]:
    """Fit the proposal that is kept, once more on a longer history while its excess is large.

    Returns its acceptance and its excess.
    """
    components, parts = COMPONENTS, 1
    acceptance = excess = 0.0
    for steps, limit in CHECKS:
        count = min(len(spread), len(points) // 4)
        chosen = ensembles.rng.choice(len(spread), count, replace=False)
        history = np.concatenate([points, spread[chosen]])
        _adapt(ensembles, history, known, components, parts=parts, screen=True)
        assert isinstance(ensembles.proposal, MixtureProposal)
        proposal = _with_components(
            ensembles, ensembles.proposal, points, log_prob, 2 * len(spread)
        )
        proposal = optimise_weights(proposal, points, log_prob, ensembles.rng)
        ensembles.proposal = proposal
        ensembles.reset_counts()
        chain, chain_log_prob = ensembles.run(steps)
        points, log_prob = chain.reshape(-1, chain.shape[-1]), chain_log_prob.ravel()
        log_weight = log_prob - proposal.log_density(points)
        acceptance = ensembles.acceptance
        excess = float(np.quantile(log_weight, 0.998) - np.median(log_weight))
        if excess < limit:
            break
        progress(f"adapting further, acceptance {acceptance:.2f}")
        components, parts = MORE_COMPONENTS, 2 if excess > TWO_MAPS_EXCESS else 1
    return acceptance, excess


def _adapt(
    ensembles: Ensembles,
    history: np.ndarray,
    known: np.ndarray,
    components: int,
    *,
    parts: int = 1,
    screen: bool,
) -> None:
    """Fit the proposal to points; a part to those of each ridge, where there are several."""
    label = None
    assert isinstance(ensembles.proposal, MixtureProposal)
    if len(ensembles.proposal.parts) > 1:
        history = np.concatenate([history, known])
        by_part = ensembles.proposal.log_densities(history)
        points = np.bincount(by_part.argmax(axis=0), minlength=len(by_part))
        label = by_part[points >= LEAST_POINTS * history.shape[1]].argmax(axis=0)
        components = min(components * (int(label.max()) + 1), MOST_COMPONENTS)
    ensembles.adapt(history, components=components, parts=parts, label=label, screen=screen)


def _with_components(
    ensembles: Ensembles,
    proposal: MixtureProposal,
    points: np.ndarray,
    log_prob: np.ndarray,
    size: int,
) -> MixtureProposal:
    """The proposal with components added where walkers or its own draws find it short."""
    log_density = ensembles.members[0].log_density
    located, along = proposal.located(points), points[:, 0]  # a component changes no map
    for _ in range(INCREMENTS):
        fresh = proposal.sample(ensembles.rng, size)
        fresh_log_prob = log_density(fresh)
        inside = np.isfinite(fresh_log_prob)
        fresh, fresh_log_prob = fresh[inside], fresh_log_prob[inside]
        fresh_located = proposal.located(fresh)
        fresh_log_density = np.logaddexp.reduce(proposal.log_densities_at(fresh_located), axis=0)
        log_weight = fresh_log_prob - fresh_log_density
        top = log_weight.max()
        log_mean = top + np.log(np.exp(log_weight - top).sum() / size)
        # A walker that stays is the same point; a move changes the first coordinate, too.
        along, first = np.unique(np.append(along, fresh[:, 0]), return_index=True)
        log_prob = np.append(log_prob, fresh_log_prob)[first]
        located = [
            (np.concatenate([r, new_r])[first], np.append(log_jacobian, new_log_jacobian)[first])
            for (r, log_jacobian), (new_r, new_log_jacobian) in zip(
                located, fresh_located, strict=True
            )
        ]
        before = proposal
        proposal = add_components(proposal, located, log_prob, float(log_mean))
        if proposal is before:
            break
    return proposal
