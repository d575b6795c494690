"""Convergence diagnostics of draws.

R-hat and effective sample sizes are those of ArviZ (Vehtari et al., Bayesian Analysis 16 (2021)
667). Ensembles, not walkers, are independent: for R-hat an ensemble is a chain, its early steps
first, so that early and late halves of ensembles are compared. For effective sizes each walker is
a chain, so that autocorrelation is that of a walker.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

STATES = ("converged", "tentative", "unusable")
RHAT_LIMIT = 1.01
TENTATIVE_RHAT = 1.05
"""Above this the ensembles disagree and no interval is shown."""
MIN_STEPS_PER_TAU = 25.0
"""A chain shorter than this many autocorrelation times cannot measure the time itself."""
TENTATIVE_ESS = 100.0
TENTATIVE_STEPS_PER_TAU = 2.0
"""Below these nothing is shown, since stuck walkers would count as independent draws."""
MAX_STUCK = 1.0 / 3.0
"""Largest fraction of a run for which a walker may be stuck in one place."""


def split_rhat(draws: np.ndarray) -> float:
    """Rank-normalised split R-hat of draws (ensembles, steps, walkers); infinite if not known."""
    import arviz  # takes a second, which the help of a command need not wait for

    ensembles, steps, _ = draws.shape
    if steps < 2:
        return float("inf")
    with np.errstate(divide="ignore", invalid="ignore"):
        rhat = float(arviz.rhat(draws.reshape(ensembles, -1), method="rank"))
    return rhat if np.isfinite(rhat) else float("inf")


def effective_sample_size(draws: np.ndarray, **method: Any) -> float:
    """Effective sample size of draws (ensembles, steps, walkers), at most their number."""
    return min(_effective_sample_size(draws, **method), float(draws.size))


def autocorrelation_time(draws: np.ndarray) -> float:
    """Integrated autocorrelation time of the mean, in steps; below 1 for antithetic draws."""
    size = _effective_sample_size(draws)
    return draws.size / size if size > 0.0 else float("inf")


def _effective_sample_size(draws: np.ndarray, **method: Any) -> float:
    """The value of :func:`arviz.ess`, also above the number of draws; 0 where it is not known."""
    import arviz

    ensembles, steps, walkers = draws.shape
    if steps < 4 or not np.ptp(draws) > 0.0:
        return 0.0
    chains = draws.transpose(0, 2, 1).reshape(ensembles * walkers, steps)
    chains = chains - chains.mean()  # ArviZ loses digits far from zero
    with np.errstate(divide="ignore", invalid="ignore"):
        size = float(arviz.ess(chains, **{"method": "mean"} | method))
    return size if np.isfinite(size) else 0.0


def longest_stuck(chain: np.ndarray) -> int:
    """Most steps that any walker was stuck for; shape (ensembles, steps, walkers, d)."""
    moved = (chain[:, 1:] != chain[:, :-1]).any(axis=-1)
    steps = np.arange(1, chain.shape[1])[None, :, None]
    last_move = np.maximum.accumulate(np.where(moved, steps, 0), axis=1)
    return int(np.max(steps - last_move, initial=0)) + 1


@dataclass(frozen=True)
class Convergence:
    """Diagnostics of every quantity and the state of the run."""

    names: tuple[str, ...]
    ess_bulk: np.ndarray  # (quantities,), as the next three
    ess_tail: np.ndarray
    rhat: np.ndarray
    tau: np.ndarray  # autocorrelation time in stored steps, of the rank-normalised draws
    steps: int  # stored steps of each ensemble
    state: str  # "converged", "tentative" or "unusable"
    reason: str  # why it has not converged; else empty

    @property
    def worst_ess(self) -> float:
        """Smallest effective sample size, bulk or tail, of any quantity."""
        return float(min(self.ess_bulk.min(), self.ess_tail.min()))

    @property
    def worst_rhat(self) -> float:
        """Largest R-hat of any quantity."""
        return float(self.rhat.max())


def unassessed(reason: str) -> Convergence:
    """Draws too few to be assessed."""
    none = np.array([])
    return Convergence((), none, none, none, none, 0, "unusable", reason)


def assess(quantities: dict[str, np.ndarray], *, target_ess: float) -> Convergence:
    """Diagnostics of quantities (ensembles, steps, walkers), without constant ones.

    ``converged``: R-hat below 1.01, ESS on target, chains longer than 25 autocorrelation times
    and no walker that was stuck for a third of them. ``tentative``: R-hat below 1.05, ESS above
    100 and chains longer than two autocorrelation times. ``unusable`` otherwise.
    """
    moving = {
        name: draws
        for name, draws in quantities.items()
        if np.ptp(draws) > 1e-12 * max(abs(float(draws.flat[0])), 1e-300)
    }
    if not moving:
        return unassessed("no walker moved")
    names, draws = tuple(moving), np.stack(list(moving.values()))
    steps = draws.shape[2]
    bulk = np.array([effective_sample_size(d, method="bulk") for d in draws])
    tail = np.array([effective_sample_size(d, method="tail", prob=(0.05, 0.95)) for d in draws])
    with np.errstate(divide="ignore"):
        tau = draws[0].size / bulk
    rhat = np.array([split_rhat(d) for d in draws])
    ess = np.minimum(bulk, tail)
    worst, slow, least = int(np.argmax(rhat)), int(np.argmax(tau)), int(np.argmin(ess))
    stuck = longest_stuck(np.moveaxis(draws, 0, -1))
    reason = ""
    good = rhat[worst] < TENTATIVE_RHAT and ess[least] >= TENTATIVE_ESS
    good = good and steps >= TENTATIVE_STEPS_PER_TAU * tau[slow]
    if not rhat[worst] < RHAT_LIMIT:
        reason = f"R-hat of {names[worst]} is {rhat[worst]:.3f} (limit {RHAT_LIMIT})"
    elif not steps >= MIN_STEPS_PER_TAU * tau[slow]:
        reason = (
            f"the chains are only {steps / tau[slow]:.0f} autocorrelation times of {names[slow]} "
            f"long (limit {MIN_STEPS_PER_TAU:.0f})"
        )
    elif not ess[least] >= target_ess:
        reason = (
            f"the effective sample size of {names[least]} is {ess[least]:.0f} of {target_ess:.0f}"
        )
    elif stuck > MAX_STUCK * steps:
        reason, good = f"a walker was stuck for {stuck} of {steps} steps", True
    state = "converged" if not reason else "tentative" if good else "unusable"
    return Convergence(names, bulk, tail, rhat, tau, steps, state, reason)
