"""What one candidate measurement is expected to bring.

Outcomes of the candidate are simulated from some draws of the posterior; for each outcome the other
draws are reweighted by its likelihood, which gives the posterior that the outcome would lead to.
Where the outcomes of a candidate leave too few draws, new ones are drawn for some of them
(:mod:`.outcome_posterior`). The expected information gain is, by nested Monte Carlo over outcomes j
and draws i,

    EIG = mean_j [ log L(y_j | j) - log mean_i L(y_j | i) ].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.findings.candidates import Candidate
from biaxbayes.findings.derived import largest_equibiaxial
from biaxbayes.findings.outcome_posterior import OutcomePosterior, log_mean, weighted_spread
from biaxbayes.inference.posterior import Posterior

__all__ = ["OUTCOMES", "Expected", "expect"]

OUTCOMES, DRAWS, BLOCKS = 200, 12_000, 4
ENOUGH = 20.0
"""Effective draws below which the posterior of an outcome is not trusted."""
FEW_SHARE = 0.1
"""Share of outcomes with fewer from which a candidate's numbers are not trusted."""
SOME_SHARE, SHARPENED, SPARSE = 0.02, 100, 200.0
"""From this share, so many outcomes are gone into, with new draws where they left fewer."""


@dataclass(frozen=True)
class Expected:
    """What a candidate is expected to bring.

    Attributes
    ----------
    name : str
    gain, gain_error : float
        Expected information gain, nats, and its Monte Carlo error.
    reduction, error : ndarray, shape (quantities,)
        Expected share by which the standard deviation shrinks, and its Monte Carlo error.
    at_least : ndarray, shape (quantities,)
        What the best linear estimate from the outcome achieves: a bound from below that needs
        no reweighting.
    effective : float
        Median over the outcomes of the effective number of reweighted draws.
    few : float
        Share of outcomes with fewer than 20 effective draws.
    """

    name: str
    gain: float
    gain_error: float
    reduction: np.ndarray
    error: np.ndarray
    at_least: np.ndarray
    effective: float
    few: float

    @property
    def trusted(self) -> bool:
        """Whether enough draws could be had for the outcomes of this candidate."""
        return self.few <= FEW_SHARE


def expect(
    candidate: Candidate,
    draws: pd.DataFrame,
    quantities: dict[str, np.ndarray],
    rng: np.random.Generator,
    *,
    outcomes: int = OUTCOMES,
    posterior: Posterior | None = None,
) -> Expected | None:
    """What one candidate is expected to bring; None where its loads overflow for some draws.

    Parameters
    ----------
    candidate : Candidate
    draws : DataFrame
    quantities : dict of ndarray, shape (draws,)
    rng : numpy.random.Generator
    outcomes : int
    posterior : Posterior, optional
        Of the draws, with its chart in use. Draws new ones for outcomes that leave too few, where
        these are many.
    """
    order = rng.permutation(len(draws))
    outer, inner = order[:outcomes], np.sort(order[outcomes : outcomes + DRAWS])
    if len(inner) < 4 * BLOCKS:
        raise InputError(f"{len(draws)} draws are too few to plan with", remedy="sample longer")
    values = np.column_stack(list(quantities.values()))
    response = candidate.response(draws.iloc[inner])
    if not all(np.isfinite(part).all() for part in response):
        return None
    simulated = candidate.outcomes(draws.iloc[outer], rng)
    log_weight = candidate.log_likelihood(simulated, draws.iloc[inner])
    own = np.diag(candidate.log_likelihood(simulated, draws.iloc[outer]))
    told = _reweighted(log_weight, own, values[inner])
    if posterior is not None and told.few > SOME_SHARE and len(posterior.mounts) <= 1:
        # That of all draws, as in the names of the quantities.
        stretch = largest_equibiaxial(draws, posterior.specimen)
        names = tuple(quantities)
        after = OutcomePosterior(posterior, candidate, draws.iloc[inner], names, stretch)
        told = _sharpened(told, after, simulated, log_weight, own, values[inner].std(axis=0), rng)
    return told.summed_up(candidate.name, _linear_reduction(*response, values[inner]))


@dataclass(frozen=True)
class _ByOutcome:
    """Every outcome of a candidate, from all draws and from each of several blocks of them.

    Attributes
    ----------
    ratio : ndarray, shape (outcomes, quantities)
        Standard deviation after the outcome, over that before.
    gain, effective : ndarray, shape (outcomes,)
    block_ratio : ndarray, shape (BLOCKS, outcomes, quantities)
    block_gain : ndarray, shape (BLOCKS, outcomes)
    """

    ratio: np.ndarray
    gain: np.ndarray
    effective: np.ndarray
    block_ratio: np.ndarray
    block_gain: np.ndarray

    @property
    def few(self) -> float:
        """Share of outcomes with too few effective draws."""
        return float((self.effective < ENOUGH).mean())

    def summed_up(self, name: str, at_least: np.ndarray) -> Expected:
        """Means over the outcomes, with their errors."""
        # The error has a part from the outcomes and one from the draws, told by blocks of them.
        blocks = self.block_ratio.mean(axis=1)
        from_draws = blocks.std(axis=0, ddof=1) / np.sqrt(BLOCKS)
        # A bias that falls with the number of draws is BLOCKS times as large in one (jackknife).
        bias = (blocks.mean(axis=0) - self.ratio.mean(axis=0)) / (BLOCKS - 1)
        gains = self.block_gain.mean(axis=1)
        return Expected(
            name,
            float(self.gain.mean()),
            float(np.hypot(_error(self.gain), gains.std(ddof=1) / np.sqrt(BLOCKS))),
            1.0 - self.ratio.mean(axis=0),
            np.sqrt(_error(self.ratio) ** 2 + from_draws**2 + bias**2),
            at_least,
            float(np.median(self.effective)),
            self.few,
        )


def _reweighted(log_weight: np.ndarray, own: np.ndarray, values: np.ndarray) -> _ByOutcome:
    """Outcomes by reweighting draws with the given values, shape (draws, quantities)."""
    sd = values.std(axis=0)
    spread, effective = weighted_spread(log_weight, values)
    blocks = [slice(b, None, BLOCKS) for b in range(BLOCKS)]
    return _ByOutcome(
        spread / sd,
        own - log_mean(log_weight),
        effective,
        np.array([weighted_spread(log_weight[:, b], values[b])[0] / sd for b in blocks]),
        np.array([own - log_mean(log_weight[:, b]) for b in blocks]),
    )


def _sharpened(
    told: _ByOutcome,
    after: OutcomePosterior,
    simulated: np.ndarray,
    log_weight: np.ndarray,
    own: np.ndarray,
    sd: np.ndarray,
    rng: np.random.Generator,
) -> _ByOutcome:
    """The first outcomes alone, with new draws for those that left too few."""
    few = slice(0, SHARPENED)
    kept = _ByOutcome(
        told.ratio[few],
        told.gain[few],
        told.effective[few],
        told.block_ratio[:, few],
        told.block_gain[:, few],
    )
    for j in np.flatnonzero(kept.effective < SPARSE):
        found = after.after(simulated[j], log_weight[j], rng)
        if found is None or found.effective <= kept.effective[j]:
            continue
        kept.ratio[j] = kept.block_ratio[:, j] = found.sd / sd
        kept.gain[j] = kept.block_gain[:, j] = own[j] - found.log_evidence
        kept.effective[j] = found.effective
    return kept


def _error(values: np.ndarray) -> Any:
    """Standard error of the mean over the outcomes."""
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def _linear_reduction(readings: np.ndarray, noise: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Share by which the best linear estimate from the outcome shrinks each sd."""
    f, q = readings - readings.mean(axis=0), values - values.mean(axis=0)
    scale = 1.0 / np.sqrt(noise)
    f = f * scale
    # var(q | y) = C_qq - C_qf (C_ff + R)^-1 C_fq, readings scaled so that R is one
    cross, own = f.T @ q / len(f), f.T @ f / len(f)
    explained = (cross * np.linalg.solve(own + np.eye(len(own)), cross)).sum(axis=0)
    share = np.clip(1.0 - explained / np.square(q).mean(axis=0), 0.0, 1.0)
    return 1.0 - np.sqrt(share)
