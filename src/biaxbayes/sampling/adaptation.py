"""Warm-up: from a first proposal to ensembles with a frozen one that fits.

An independence sampler leaves a walker stuck for as long as its importance weight, density over
proposal, exceeds the median one. So the proposal is fitted to the walkers' own history, again and
on a longer one while the largest weights lie far above the median.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from biaxbayes.sampling.ensembles import Ensembles
from biaxbayes.sampling.population_monte_carlo import MIN_POINTS_PER_DIMENSION
from biaxbayes.sampling.proposal import MixtureProposal

POOR_ACCEPTANCE = 0.03
"""Below this the independence move is not worth its density evaluations."""
ROUND_STEPS = 16
CHECKS = ((16, 3.0), (64, 3.0), (96, np.inf))
"""Steps on which the final proposal is assessed, and the excess below which it passes; else it is
fitted once more. Tuned on processor time to 2,000 effective draws, the warm-up included, on three
shipped specimens and two seeds."""
COMPONENTS_OF_ROUNDS, COMPONENTS, MORE_COMPONENTS = 8, 12, 20
"""Components of the proposal of the rounds, of the final one, of one that is fitted again."""
MAX_COMPONENTS = 24
"""Components of all parts together, where there are several."""
LOW_EXCESS, HIGH_EXCESS = 1.6, 4.0
"""Excess: how far the largest log weights (their 0.998 quantile) lie above the median one. Below
the first, mixing is good; above the second, walkers get stuck."""
DE_SHARES = (0.2, 0.35, 0.5)
"""Fraction of differential-evolution moves: at a low excess, between, at a high one."""
MAX_ROUNDS = 8
GOOD_ACCEPTANCE = 0.45
"""Acceptance from which a proposal need not change before its final fit."""
ROUNDS_OF_FIT = 2
"""Rounds that the final fit is made from."""
MIN_ACCEPTANCE_RISE = 0.02
"""Smallest rise of acceptance that is worth another round."""
ENOUGH_ACCEPTANCE, ENOUGH_EXCESS = 0.5, 3.1
"""Acceptance and excess with which the proposal of the rounds stays as it is: a better one would
cost more time than it saves."""


@dataclass(frozen=True)
class WarmUp:
    """Result of a warm-up."""

    rounds: int
    acceptance: float  # of the independence move in the last round
    message: str  # a warning for the user, or empty


def warm_up(
    ensembles: Ensembles,
    proposal: MixtureProposal,
    overdispersed: np.ndarray,
    cluster_points: np.ndarray,
    *,
    progress: Callable[[str], None] = lambda text: None,
) -> WarmUp:
    """Let the ensembles forget their starts, adapt the proposal to their history and freeze it.

    Rounds of steps alternate with fits of the proposal to the newest pooled history, until the
    acceptance stops rising; if walkers could then be stuck for long, another is fitted with more
    care. Differential evolution stays in the mix throughout. ``overdispersed`` (n, d) are points
    wider than the density (:func:`.draw_tempered_points`), a fifth of the points of a final
    fit: a proposal too narrow there would leave walkers stuck. ``cluster_points`` (m, d) are of
    every cluster of modes; with several of them every fit uses these, too, since a cluster
    may hold few walkers.
    """
    ensembles.proposal = proposal
    ensembles.set_share(0.7)
    best, stalled, rounds = -1.0, 0, 0
    histories: list[tuple[np.ndarray, np.ndarray]] = []  # points, log densities
    for rounds in range(1, MAX_ROUNDS + 1):
        points, log_prob = _steps(ensembles, ROUND_STEPS, ROUND_STEPS // 4)
        histories.append((points, log_prob))
        acceptance, excess = ensembles.acceptance, LOW_EXCESS
        progress(f"adapting, acceptance {acceptance:.2f}")
        stalled = 0 if acceptance > best + MIN_ACCEPTANCE_RISE else stalled + 1
        best = max(best, acceptance)
        if rounds >= ROUNDS_OF_FIT and (acceptance > GOOD_ACCEPTANCE or stalled >= 2):
            break
        if acceptance < GOOD_ACCEPTANCE:
            _adapt(ensembles, points, cluster_points, COMPONENTS_OF_ROUNDS)
    newest = histories[-ROUNDS_OF_FIT:]
    points = np.concatenate([of_round for of_round, _ in newest])
    log_prob = np.concatenate([of_round for _, of_round in newest])
    if acceptance < ENOUGH_ACCEPTANCE or not _fits(ensembles, points, log_prob, overdispersed):
        components = COMPONENTS
        for steps, limit in CHECKS:
            count = min(len(overdispersed), len(points) // 4)
            chosen = ensembles.rng.choice(len(overdispersed), count, replace=False)
            history = np.concatenate([points, overdispersed[chosen]])
            _adapt(ensembles, history, cluster_points, components)
            points, log_prob = _steps(ensembles, steps)
            log_weight = log_prob - ensembles.proposal.log_density(points)
            acceptance = ensembles.acceptance
            excess = float(np.quantile(log_weight, 0.998) - np.median(log_weight))
            if excess < limit:
                break
            progress(f"adapting further, acceptance {acceptance:.2f}")
            components = MORE_COMPONENTS
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


def _steps(ensembles: Ensembles, steps: int, left_out: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, d) of all ensembles in steps whose acceptance is counted, and log densities."""
    ensembles.reset_counts()
    chain, log_prob = ensembles.run(steps)
    return chain[:, left_out:].reshape(-1, chain.shape[-1]), log_prob[:, left_out:].ravel()


def _fits(
    ensembles: Ensembles, points: np.ndarray, log_prob: np.ndarray, overdispersed: np.ndarray
) -> bool:
    """Test that no walker would be stuck for long, at the points or the `overdispersed` ones."""
    proposal = ensembles.proposal
    log_weight = log_prob - proposal.log_density(points)
    in_tails = ensembles.members[0].log_density(overdispersed) - proposal.log_density(overdispersed)
    highest = np.max([log_weight.max(), in_tails.max()])  # NaN if any is: no fit
    return bool(highest - np.median(log_weight) < ENOUGH_EXCESS)


def _adapt(
    ensembles: Ensembles, history: np.ndarray, cluster_points: np.ndarray, components: int
) -> None:
    """Fit the proposal to points; a part to those of each cluster, where there are several."""
    label = None
    if len(ensembles.proposal.parts) > 1:
        history = np.concatenate([history, cluster_points])
        by_part = ensembles.proposal.log_densities(history)
        counts = np.bincount(by_part.argmax(axis=0), minlength=len(by_part))
        large = counts >= MIN_POINTS_PER_DIMENSION * history.shape[1]
        label = by_part[large].argmax(axis=0)
        components = min(components * (int(label.max()) + 1), MAX_COMPONENTS)
    ensembles.adapt(history, components=components, label=label)
