"""What to measure next: how much a candidate measurement would narrow the posterior.

Outcomes of the candidate are simulated from some draws of the posterior; for each outcome the other
draws are reweighted by its likelihood, which gives the posterior that the outcome would lead to.
The expected information gain is, by nested Monte Carlo over outcomes j and draws i,

    EIG = mean_j [ log L(y_j | j) - log mean_i L(y_j | i) ].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.errors import InputError, RunError
from biaxbayes.executors.executor import Executor, InThisProcess
from biaxbayes.findings.candidates import Candidate, standard_candidates
from biaxbayes.findings.derived import STRESS, derived_quantities, largest_equibiaxial
from biaxbayes.findings.sampling_scale import judged_scales
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior
from biaxbayes.mechanics.goh import PARAMETERS

__all__ = ["Design", "Expected", "design", "expect", "targets"]

OUTCOMES, DRAWS, BLOCKS = 200, 12_000, 4
ENOUGH = 20.0
"""Effective draws below which the reweighted posterior of an outcome is not trusted."""
FEW_SHARE = 0.1
"""Share of outcomes with fewer from which a candidate's numbers are not trusted."""


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
        """Whether the draws of the run suffice for this candidate."""
        return self.few <= FEW_SHARE


@dataclass(frozen=True)
class Design:
    """Candidates in the order of their rank.

    Attributes
    ----------
    quantities : tuple of str
    expected : tuple of Expected
    skipped : tuple of str
        Candidates whose loads overflow for some draws.
    candidates : tuple
        In the order of ``expected``.
    """

    quantities: tuple[str, ...]
    expected: tuple[Expected, ...]
    skipped: tuple[str, ...]
    candidates: tuple[Any, ...]

    def to_frame(self) -> pd.DataFrame:
        """One row a candidate and quantity."""
        rows = []
        for rank, e in enumerate(self.expected, start=1):
            head = {
                "rank": rank,
                "candidate": e.name,
                "information_gain_nats": e.gain,
                "information_gain_error": e.gain_error,
                "effective_draws": e.effective,
                "share_of_outcomes_below_20_draws": e.few,
                "trusted": e.trusted,
            }
            for i, name in enumerate(self.quantities):
                rows.append(
                    head
                    | {
                        "quantity": name,
                        "expected_reduction_of_sd": e.reduction[i],
                        "error": e.error[i],
                        "at_least": e.at_least[i],
                    }
                )
        return pd.DataFrame(rows)

    def _repr_html_(self) -> str:
        """Expected reduction of each standard deviation, for notebooks."""
        wide = pd.DataFrame(
            [dict(zip(self.quantities, e.reduction, strict=True)) for e in self.expected],
            index=[e.name + ("" if e.trusted else " *") for e in self.expected],
        )
        wide.insert(0, "information (nats)", [e.gain for e in self.expected])
        return wide.to_html(float_format=lambda v: f"{v:.2f}")


def targets(
    posterior: Posterior, draws: pd.DataFrame, stretch: float | None = None
) -> dict[str, np.ndarray]:
    """Quantities whose spread is to shrink, on the scales of the verdicts.

    Free material parameters and mounting stretches (C1, k1 and k2 in logs), the in-plane
    structure tensor, and in logs the small-strain stiffness and the stress at a total equibiaxial
    stretch (the largest tested one where none is given).
    """
    out = {}
    for scale in judged_scales(posterior.priors, draws):
        if isinstance(scale.prior, Prior):
            out[scale.name] = scale.of(draws[scale.name].to_numpy(dtype=float))
    top = round(stretch or largest_equibiaxial(draws, posterior.specimen), 3)
    switch = posterior.settings.fibre_switch
    for d in derived_quantities(draws, [top], [1.0], fibre_switch=switch):
        if d.name != "Hz":
            logs = d.kind == STRESS or bool(d.unit)
            out[d.key] = np.log(np.maximum(d.values, 1e-300)) if logs else d.values
    return {name: v for name, v in out.items() if np.ptp(v) > 0.0}


def design(
    posterior: Posterior,
    draws: pd.DataFrame,
    candidates: Sequence[Candidate] | None = None,
    *,
    rank_by: str = "parameters",
    seed: int = 1,
    outcomes: int = OUTCOMES,
    executor: Executor | None = None,
) -> Design:
    """Rank candidate measurements by what they are expected to bring.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        Its draws, as in ``run.draws``.
    candidates : sequence of Candidate, optional
        Default :func:`~biaxbayes.findings.candidates.standard_candidates`.
    rank_by : str
        ``parameters`` (mean reduction over the free material parameters), ``information``, or
        the name of a quantity whose spread is to shrink most.
    seed : int
    outcomes : int
        Simulated outcomes of each candidate.
    executor : Executor, optional
        Works off the candidates; default this process. The result does not depend on it.

    Raises
    ------
    InputError
        If ``rank_by`` names no quantity.
    """
    chosen = list(standard_candidates(posterior) if candidates is None else candidates)
    quantities = targets(posterior, draws)
    if rank_by not in ("parameters", "information", *quantities):
        raise InputError(
            f"--rank-by {rank_by[:60]!r} is no quantity of this run",
            remedy=f"choose parameters, information, {', '.join(quantities)}",
        )
    told = _each(chosen, draws, quantities, seed, outcomes, executor or InThisProcess())
    found = [(e, c) for e, c in zip(told, chosen, strict=True) if e is not None]
    skipped = [c.name for e, c in zip(told, chosen, strict=True) if e is None]
    names = tuple(quantities)

    wanted = [n in PARAMETERS if rank_by == "parameters" else n == rank_by for n in names]

    def rank(pair: tuple[Expected, Any]) -> float:
        expected = pair[0]
        # Where all material parameters are fixed there is the information alone.
        return -float(expected.reduction[wanted].mean() if any(wanted) else expected.gain)

    found.sort(key=rank)
    return Design(names, tuple(e for e, _ in found), tuple(skipped), tuple(c for _, c in found))


def _each(
    candidates: Sequence[Candidate],
    draws: pd.DataFrame,
    quantities: dict[str, np.ndarray],
    seed: int,
    outcomes: int,
    executor: Executor,
) -> list[Expected | None]:
    """What each candidate is expected to bring, in their order."""
    tasks = [(candidate, [seed, number]) for number, candidate in enumerate(candidates)]
    told: list[Expected | None] = [None] * len(tasks)
    work = partial(_expect_one, draws=draws, quantities=quantities, outcomes=outcomes)
    for outcome in executor.run(work, tasks):
        if outcome.lost:
            raise RunError(f"candidate {candidates[outcome.index].name}: {outcome.lost}")
        told[outcome.index] = outcome.value
    return told


def _expect_one(
    task: tuple[Candidate, list[int]],
    *,
    draws: pd.DataFrame,
    quantities: dict[str, np.ndarray],
    outcomes: int,
) -> Expected | None:
    candidate, seed = task
    return expect(candidate, draws, quantities, np.random.default_rng(seed), outcomes=outcomes)


def expect(
    candidate: Candidate,
    draws: pd.DataFrame,
    quantities: dict[str, np.ndarray],
    rng: np.random.Generator,
    *,
    outcomes: int = OUTCOMES,
) -> Expected | None:
    """What one candidate is expected to bring; None where its loads overflow for some draws.

    Parameters
    ----------
    candidate : Candidate
    draws : DataFrame
    quantities : dict of ndarray, shape (draws,)
    rng : numpy.random.Generator
    outcomes : int
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
    sd = values[inner].std(axis=0)
    ratio, effective = _posterior_spread(log_weight, values[inner])
    ratio = ratio / sd
    # The error has a part from the outcomes and one from the draws, told by blocks of them.
    blocks = [slice(b, None, BLOCKS) for b in range(BLOCKS)]
    per_block = [_posterior_spread(log_weight[:, b], values[inner][b])[0] / sd for b in blocks]
    block_means = np.array([r.mean(axis=0) for r in per_block])
    from_draws = block_means.std(axis=0, ddof=1) / np.sqrt(BLOCKS)
    # A bias that falls with the number of draws is BLOCKS times as large in a block (jackknife).
    bias = (block_means.mean(axis=0) - ratio.mean(axis=0)) / (BLOCKS - 1)
    gains = own - _log_mean(log_weight)
    gain_blocks = [float((own - _log_mean(log_weight[:, b])).mean()) for b in blocks]
    return Expected(
        candidate.name,
        float(gains.mean()),
        float(np.hypot(_error(gains), np.std(gain_blocks, ddof=1) / np.sqrt(BLOCKS))),
        1.0 - ratio.mean(axis=0),
        np.sqrt(_error(ratio) ** 2 + from_draws**2 + bias**2),
        _linear_reduction(*response, values[inner]),
        float(np.median(effective)),
        float((effective < ENOUGH).mean()),
    )


def _posterior_spread(log_weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sd of every quantity for every outcome, and effective draws of every outcome."""
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    concentration = np.square(weight).sum(axis=1)
    centred = values - values.mean(axis=0)
    mean = weight @ centred
    variance = weight @ np.square(centred) - np.square(mean)
    # Unbiased for weighted draws, as n - 1 is for equal ones.
    variance = np.maximum(variance, 0.0) / np.maximum(1.0 - concentration, 1e-9)[:, None]
    return np.sqrt(variance), 1.0 / concentration


def _log_mean(log_weight: np.ndarray) -> np.ndarray:
    return np.asarray(logsumexp(log_weight, axis=1) - np.log(log_weight.shape[1]))


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
