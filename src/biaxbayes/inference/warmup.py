"""Warm-up: from a search to ensembles with a frozen, well-fitting proposal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from biaxbayes.inference.covering import cover
from biaxbayes.inference.ensembles import POOR_ACCEPTANCE, Ensembles
from biaxbayes.inference.patchwork import Patchwork
from biaxbayes.inference.proposal import Proposal
from biaxbayes.inference.rebalancing import rebalance

__all__ = ["WarmUp", "warm_up"]

ROUND_STEPS = 16
CHECKS = ((16, 1.9, 0.6), (64, 1.9, 0.0), (160, 1.6, 0.0), (160, 2.5, 0.0), (16, np.inf, 0.0))
"""Steps on which the final proposal is judged, the log weight above the median up to which it
passes, and the acceptance from which; where it holds walkers for longer it is fitted once more."""
COMPONENTS, MORE_COMPONENTS = 12, 20
"""Of the final proposal, and of one that has been fitted again."""
COVERING_ROUNDS = 2
LOOSE, TORN, STICKY = 1.6, 2.5, 4.0
"""Log weight above the median: up to the first walkers move freely, from the last they hardly do.
Above the second one trend is too few, and the next fit has two."""
DE_SHARES = (0.15, 0.25, 0.5)
"""Share of differential evolution, another way to move: when loose, between, when sticky."""
MAX_ROUNDS = 8
GOOD = 0.45  # acceptance from which a proposal need not change before its final fit
REMEMBERED = 2  # rounds that the final fit is made from
RISE = 0.02  # smallest rise of acceptance that is worth another round
FITTING, TIGHT = 0.5, 3.1
"""Acceptance and largest log weight above the median with which the proposal of the rounds is kept
as it is: a better one would cost more time than it saves."""


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
    proposal: Proposal,
    spread: np.ndarray,
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
    proposal : Proposal
        A first proposal.
    spread : ndarray, shape (n, d)
        Points spread wider than the posterior (:func:`.population.tempered_points`). A proposal
        too narrow where they are would hold a walker for long: none is kept without a fit, and
        they make up a fifth of what a final one is fitted to.
    progress : callable
        Called with a short text at each round.
    """
    ensembles.proposal = Patchwork(np.ones(1), (proposal,))
    ensembles.set_share(0.7)
    rounds, points, log_prob = _adapted(ensembles, progress)
    acceptance, held = ensembles.acceptance, LOOSE
    if not _fits(ensembles, points, log_prob, spread):
        acceptance, held = _keep(ensembles, points, log_prob, spread, progress)
    message = ""
    share = 1.0 - DE_SHARES[int(np.searchsorted((LOOSE, STICKY), held))]
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
    ensembles: Ensembles, progress: Callable[[str], None]
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
            ensembles.adapt(history, screen=False)
    return rounds, np.concatenate(recent), np.concatenate(recent_log_prob)


def _fits(
    ensembles: Ensembles, points: np.ndarray, log_prob: np.ndarray, spread: np.ndarray
) -> bool:
    """Whether the proposal would hold no walker for long, among them or where ``spread`` is."""
    assert ensembles.proposal is not None
    if ensembles.acceptance < FITTING:
        return False
    log_weight = log_prob - ensembles.proposal.log_density(points)
    in_tails = ensembles.members[0].log_density(spread) - ensembles.proposal.log_density(spread)
    highest = np.max([log_weight.max(), in_tails.max()])  # NaN where there is no telling
    return bool(highest - np.median(log_weight) < TIGHT)


def _keep(
    ensembles: Ensembles,
    points: np.ndarray,
    log_prob: np.ndarray,
    spread: np.ndarray,
    progress: Callable[[str], None],
) -> tuple[float, float]:
    """Fit the proposal that is kept, once more on a longer history as long as it holds walkers.

    Returns its acceptance and the log weight, above the median one, of the points that hold
    walkers longest.
    """
    components, parts = COMPONENTS, 1
    acceptance = held = 0.0
    for steps, limit, least in CHECKS:
        count = min(len(spread), len(points) // 4)
        chosen = ensembles.rng.choice(len(spread), count, replace=False)
        history = np.concatenate([points, spread[chosen]])
        ensembles.adapt(history, components=components, parts=parts, screen=True)
        assert isinstance(ensembles.proposal, Patchwork)
        proposal = _covered(ensembles, ensembles.proposal, points, log_prob, 2 * len(spread))
        proposal = rebalance(proposal, points, log_prob, ensembles.rng)
        ensembles.proposal = proposal
        ensembles.reset_counts()
        chain, chain_log_prob = ensembles.run(steps)
        points, log_prob = chain.reshape(-1, chain.shape[-1]), chain_log_prob.ravel()
        log_weight = log_prob - proposal.log_density(points)
        acceptance = ensembles.acceptance
        held = float(np.quantile(log_weight, 0.998) - np.median(log_weight))
        if held < limit and acceptance > least:
            break
        progress(f"adapting further, acceptance {acceptance:.2f}")
        components, parts = MORE_COMPONENTS, 2 if held > TORN else 1
    return acceptance, held


def _covered(
    ensembles: Ensembles,
    proposal: Patchwork,
    points: np.ndarray,
    log_prob: np.ndarray,
    size: int,
) -> Patchwork:
    """The proposal with components added where walkers or its own draws find it short."""
    log_density = ensembles.members[0].log_density
    for _ in range(COVERING_ROUNDS):
        fresh = proposal.sample(ensembles.rng, size)
        fresh_log_prob = log_density(fresh)
        inside = np.isfinite(fresh_log_prob)
        fresh, fresh_log_prob = fresh[inside], fresh_log_prob[inside]
        log_weight = fresh_log_prob - proposal.log_density(fresh)
        top = log_weight.max()
        log_mean = top + np.log(np.exp(log_weight - top).sum() / size)
        points, first = np.unique(np.concatenate([points, fresh]), axis=0, return_index=True)
        log_prob = np.concatenate([log_prob, fresh_log_prob])[first]
        before = proposal
        proposal = cover(proposal, points, log_prob, float(log_mean))
        if proposal is before:
            break
    return proposal
