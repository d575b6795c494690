"""Whether the draws can be trusted.

Ensembles, not walkers, are independent: R-hat compares ensembles (each cut into an early and a
late half). The autocorrelation is averaged over the walkers of an ensemble around the mean of
all ensembles, so that ensembles that disagree lower the effective sample size.
Rank normalisation and tail indicators follow Vehtari et al., Bayesian Analysis 16 (2021) 667;
R-hat is ArviZ's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtri

__all__ = ["Convergence", "assess", "effective_sample_size", "rank_normalised", "split_rhat"]

RHAT_LIMIT = 1.01
TENTATIVE_RHAT = 1.05
"""Above this the ensembles tell different stories and no interval is shown."""
MIN_STEPS_PER_TAU = 25.0
"""A chain shorter than this many autocorrelation times cannot measure the time itself."""
TENTATIVE_ESS = 100.0
LONGEST_HOLD = 1.0 / 3.0
"""Share of the run that no walker may stand still for: one that does never left its start."""


def rank_normalised(draws: np.ndarray) -> np.ndarray:
    """Normal scores of the pooled ranks, same shape."""
    ranks = pd.Series(draws.ravel()).rank().to_numpy()
    return ndtri((ranks - 0.375) / (ranks.size + 0.25)).reshape(draws.shape)


def split_rhat(draws: np.ndarray) -> float:
    """Split R-hat of draws of shape (ensembles, steps, walkers).

    The larger of the rank-normalised one and that of the folded draws, which sees scale. ArviZ's
    own ranks would import all of SciPy's statistics.
    Infinite when the ensembles do not move, or have no two halves.
    """
    from biaxbayes.lean_imports import array_stats  # imports ArviZ: a tenth of a second

    ensembles, steps, _ = draws.shape
    if steps < 2:
        return float("inf")
    # An ensemble is a chain, its early steps first, so that its halves are early and late steps.
    chains = draws.reshape(ensembles, -1)
    half = chains.shape[1] // 2
    chains = np.hstack([chains[:, :half], chains[:, -half:]])
    both = chains, np.abs(chains - np.median(chains))
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(max(array_stats.rhat(rank_normalised(z), method="split") for z in both))


def autocorrelation_time(draws: np.ndarray) -> float:
    """Integrated autocorrelation time in steps of draws of shape (ensembles, steps, walkers).

    Geyer's initial monotone sequence on the autocorrelation averaged over all walkers, around
    the common mean. ArviZ would take walkers for chains, cut them in halves and end the sequence
    early: 10 % above to 20 % below the effective sizes of AR(1) walkers that are known, and
    depending on the length of the chains; with ensembles for chains it sees no correlation at all.
    """
    ensembles, steps, walkers = draws.shape
    z = draws - draws.mean()
    size = 1 << (2 * steps - 1).bit_length()
    power = np.zeros(size // 2 + 1)
    for e in range(ensembles):
        spectrum = np.fft.rfft(z[e], size, axis=0)
        power += (spectrum.real**2 + spectrum.imag**2).sum(axis=1)
    covariance = np.fft.irfft(power, size)[:steps] / (ensembles * walkers)
    # Unbiased in the lag: n - t products make up the covariance at lag t.
    covariance /= steps - np.arange(steps)
    if covariance[0] <= 0.0:
        return float("inf")
    rho = covariance / covariance[0]
    total, last = 0.0, np.inf
    for lag in range(0, steps - 1, 2):
        pair = rho[lag] + rho[lag + 1]
        if pair <= 0.0:
            break
        last = min(last, pair)
        total += last
    return max(2.0 * total - 1.0, 1.0 / (ensembles * steps * walkers))


def effective_sample_size(draws: np.ndarray) -> float:
    """Effective sample size for the mean of draws of shape (ensembles, steps, walkers).

    Never more than the number of draws.
    """
    if draws.shape[1] < 4 or not np.ptp(draws) > 0.0:
        return 0.0
    return float(min(draws.size / autocorrelation_time(draws), draws.size))


def longest_hold(quantities: dict[str, np.ndarray]) -> int:
    """Most steps that any walker stood still for, of draws of shape (ensembles, steps, walkers)."""
    draws = list(quantities.values())
    moved = np.zeros(draws[0][:, 1:].shape, dtype=bool)
    for values in draws:
        moved |= values[:, 1:] != values[:, :-1]
    steps = np.arange(1, draws[0].shape[1])[None, :, None]
    # The step at which the current stand began.
    began = np.maximum.accumulate(np.where(moved, steps, 0), axis=1)
    return int((steps - began).max(initial=0)) + 1


@dataclass(frozen=True)
class Convergence:
    """Diagnostics of every quantity and the state of the run.

    Attributes
    ----------
    names : tuple of str
    ess_bulk, ess_tail, rhat, tau : ndarray, shape (quantities,)
        ``tau`` is the autocorrelation time in kept steps, of the rank-normalised draws.
    steps : int
        Kept steps of each ensemble.
    state : {"converged", "tentative", "unusable"}
    reason : str
        Why the state has not converged; empty when it is.
    """

    names: tuple[str, ...]
    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    rhat: np.ndarray
    tau: np.ndarray
    steps: int
    state: str
    reason: str

    @property
    def worst_ess(self) -> float:
        """Smallest effective sample size, bulk or tail, of any quantity."""
        return float(min(self.ess_bulk.min(), self.ess_tail.min()))

    @property
    def worst_rhat(self) -> float:
        """Largest R-hat of any quantity."""
        return float(self.rhat.max())


def assess(quantities: dict[str, np.ndarray], *, target_ess: float) -> Convergence:
    """Judge the draws.

    Parameters
    ----------
    quantities : dict of ndarray, shape (ensembles, steps, walkers)
        Constant quantities are left out of the judgement.
    target_ess : float
        Effective sample size asked for, for the worst quantity.

    Returns
    -------
    Convergence
        ``converged``: R-hat below 1.01, ESS on target, chains longer than 25 autocorrelation
        times and no walker that stood still for a third of them. ``tentative``: R-hat below 1.05
        and ESS above 100. ``unusable`` otherwise.
    """
    moving = {
        name: draws
        for name, draws in quantities.items()
        if np.ptp(draws) > 1e-12 * max(abs(float(draws.flat[0])), 1e-300)
    }
    bulk, tail, tau = [], [], []
    steps = 0
    for draws in moving.values():
        z = rank_normalised(draws)
        steps = draws.shape[1]
        time = autocorrelation_time(z) if steps >= 4 else float("inf")
        low, high = np.quantile(draws, [0.05, 0.95])
        tau.append(time)
        bulk.append(min(draws.size / time, draws.size))
        tail.append(
            min(
                effective_sample_size((draws <= low).astype(float)),
                effective_sample_size((draws >= high).astype(float)),
            )
        )
    names, rhat = list(moving), np.array([split_rhat(draws) for draws in moving.values()])
    ess_bulk, ess_tail = np.array(bulk), np.array(tail)
    state, reason = _state(names, ess_bulk, ess_tail, rhat, np.array(tau), steps, target_ess)
    held = longest_hold(quantities) if names else 0
    if state == "converged" and held > LONGEST_HOLD * steps:
        state, reason = "tentative", f"a walker stood still for {held} of {steps} kept steps"
    return Convergence(tuple(names), ess_bulk, ess_tail, rhat, np.array(tau), steps, state, reason)


def _state(
    names: list[str],
    bulk: np.ndarray,
    tail: np.ndarray,
    rhat: np.ndarray,
    tau: np.ndarray,
    steps: int,
    target: float,
) -> tuple[str, str]:
    if not names:
        return "unusable", "nothing moved"
    ess = np.minimum(bulk, tail)
    worst, slow, least = int(np.argmax(rhat)), int(np.argmax(tau)), int(np.argmin(ess))
    short = steps < MIN_STEPS_PER_TAU * tau[slow]
    if rhat[worst] < RHAT_LIMIT and ess[least] >= target and not short:
        return "converged", ""
    if not rhat[worst] < RHAT_LIMIT:
        reason = f"R-hat of {names[worst]} is {rhat[worst]:.3f} (limit {RHAT_LIMIT})"
    elif short:
        reason = (
            f"the chains are only {steps / tau[slow]:.0f} autocorrelation times of {names[slow]} "
            f"long (limit {MIN_STEPS_PER_TAU:.0f})"
        )
    else:
        reason = f"the effective sample size of {names[least]} is {ess[least]:.0f} of {target:.0f}"
    good = rhat[worst] < TENTATIVE_RHAT and ess[least] >= TENTATIVE_ESS
    return ("tentative" if good else "unusable"), reason
