"""Expected benefit of one candidate measurement.

Outcomes y of the candidate are simulated from a subset of the posterior draws; for each outcome
the other draws are reweighted by its likelihood, which gives the posterior after the outcome,

    p(x | data, y) = p(x | data) L(y | x) / Z(y).

A precise measurement leaves few effective draws. For some of the outcomes its posterior is then
sampled (:class:`OutcomePosterior`): the reweighted draws, tempered so that enough of them count,
give a first proposal, which population Monte Carlo
(:mod:`biaxbayes.sampling.population_monte_carlo`) adapts to the density. The last population gives
the sd of every quantity and, by its mean weight, Z(y).

The expected information gain is, by nested Monte Carlo over outcomes j and draws i,

    EIG = mean_j [ log L(y_j | j) - log mean_i L(y_j | i) ].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.errors import InputError, NotConverged
from biaxbayes.identifiability.determined import STRESS, derived_quantities, largest_equibiaxial
from biaxbayes.identifiability.marginals import parameter_scales
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.optimal_design.candidates import Candidate
from biaxbayes.sampling.population_monte_carlo import adapt_proposal, resample, tempering_power
from biaxbayes.sampling.proposal import MixtureProposal, fit_mixture_proposal


def design_quantities(
    posterior: Posterior, draws: pd.DataFrame, stretch: float | None = None
) -> dict[str, np.ndarray]:
    """Quantities whose sd is to be reduced, on the scales of the verdicts.

    Parameters and mounting stretches (C1, k1, k2 as logs), in-plane structure tensor, and the
    logs of small-strain stiffness and of the stress at a total equibiaxial stretch.
    """
    out = {}
    for scale in parameter_scales(posterior.priors, posterior.quantities, draws):
        if isinstance(scale.prior, Prior):
            out[scale.name] = scale.to_scale(draws[scale.name].to_numpy(dtype=float))
    top = round(stretch or largest_equibiaxial(draws, posterior.specimen), 3)
    for d in derived_quantities(draws, posterior.law, [top], [1.0]):
        if d.name != "Hz":
            logs = d.kind == STRESS or bool(d.unit)
            out[d.key] = np.log(np.maximum(d.values, 1e-300)) if logs else d.values
    return out


# --- the posterior after an outcome ---------------------------------------------------------------

OUTCOME_POPULATION = 2048
OUTCOME_COMPONENTS = 3
"""A precise measurement leaves a narrow posterior, which is nearly Gaussian."""


@dataclass(frozen=True)
class OutcomeResult:
    """Posterior after an outcome."""

    sd: np.ndarray
    log_evidence: float  # log of the mean likelihood over the run's posterior
    effective: float  # number of points


@dataclass
class OutcomePosterior:
    """Samples the posteriors after outcomes of a candidate."""

    posterior: Posterior  # in the sampling coordinates of the draws; mounted states are shared
    candidate: Candidate
    draws: pd.DataFrame
    quantities: tuple[str, ...]
    stretch: float  # total equibiaxial
    _log_normaliser: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._points = self.posterior.coordinates({k: self.draws[k] for k in self.posterior.free})
        self._regular = np.isfinite(self._points).all(axis=1)
        self._bounds = self.posterior.bounds

    def after(
        self, outcome: np.ndarray, log_weight: np.ndarray, rng: np.random.Generator
    ) -> OutcomeResult | None:
        """Posterior after an outcome, from its log likelihood by draw; None if no proposal fits."""

        def log_density(x: np.ndarray) -> np.ndarray:
            out = self.posterior.log_prob(x)
            inside = np.isfinite(out)
            if inside.any():
                with np.errstate(over="ignore", invalid="ignore"):
                    table = pd.DataFrame(self.posterior.natural(x[inside]))
                    gained = self.candidate.log_likelihood(outcome[None], table)[0]
                out[inside] += np.where(np.isfinite(gained), gained, -np.inf)
            return out

        valid = np.where(self._regular, log_weight, -np.inf)
        tempered = np.where(np.isfinite(valid), tempering_power(valid) * log_weight, -np.inf)
        try:
            _, x, log_weights = adapt_proposal(
                log_density,
                self._fitted(tempered, rng),
                self._bounds,
                rng,
                OUTCOME_POPULATION,
                OUTCOME_COMPONENTS,
            )
        except NotConverged:
            return None
        inside = np.isfinite(log_weights)
        table = pd.DataFrame(self.posterior.natural(x[inside]))
        values = design_quantities(self.posterior, table, self.stretch)
        columns = np.column_stack([values[name] for name in self.quantities])
        # a material whose stress overflows is far from all readings
        finite = np.isfinite(columns).all(axis=1)
        sd, effective = weighted_sd(log_weights[None, inside][:, finite], columns[finite])
        log_evidence = float(log_mean(log_weights)) - self._normaliser(rng)
        return OutcomeResult(sd[0], log_evidence, float(effective[0]))

    def _fitted(self, log_weight: np.ndarray, rng: np.random.Generator) -> MixtureProposal:
        chosen = resample(log_weight, OUTCOME_POPULATION // 2, rng)
        return fit_mixture_proposal(
            self._points[chosen], rng, bounds=self._bounds, components=OUTCOME_COMPONENTS
        )

    def _normaliser(self, rng: np.random.Generator) -> float:
        """Log integral of the density of the run in the sampling coordinates."""
        if self._log_normaliser is None:
            equal = np.where(self._regular, 0.0, -np.inf)
            first = self._fitted(equal, rng)
            _, _, log_weights = adapt_proposal(
                self.posterior.log_prob, first, self._bounds, rng, 8 * OUTCOME_POPULATION
            )
            self._log_normaliser = float(log_mean(log_weights))
        return self._log_normaliser


def weighted_sd(log_weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def log_mean(log_weight: np.ndarray) -> np.ndarray:
    """Log of the mean weight along the last axis."""
    return np.asarray(logsumexp(log_weight, axis=-1) - np.log(log_weight.shape[-1]))


# --- the expected benefit of a candidate ----------------------------------------------------------

OUTCOMES, INNER_DRAWS, BLOCKS = 200, 12_000, 4
MIN_EFFECTIVE_DRAWS = 20.0
"""Effective draws below which the posterior of an outcome is not trusted."""
MAX_UNTRUSTED_FRACTION = 0.1
"""Fraction of such outcomes above which the numbers of a candidate are not trusted."""
RESAMPLING_FRACTION, MAX_RESAMPLED_OUTCOMES, RESAMPLING_EFFECTIVE_DRAWS = 0.02, 100, 200.0
"""If more than 2 % of the outcomes have too few draws, those of the first 100 outcomes with fewer
than 200 effective draws are resampled."""


@dataclass(frozen=True)
class Expected:
    """Expected benefit of a candidate."""

    name: str
    gain: float  # nats
    gain_error: float  # Monte Carlo
    reduction: np.ndarray  # of the sd of each quantity, relative
    error: np.ndarray  # Monte Carlo
    at_least: np.ndarray  # lower bound by the best linear estimate, without reweighting
    effective: float  # median effective number of reweighted draws
    untrusted: float  # fraction of outcomes with fewer than 20 effective draws

    @property
    def trusted(self) -> bool:
        """True if enough draws are left for the outcomes of this candidate."""
        return self.untrusted <= MAX_UNTRUSTED_FRACTION


def expect(
    candidate: Candidate,
    draws: pd.DataFrame,
    quantities: dict[str, np.ndarray],
    rng: np.random.Generator,
    *,
    outcomes: int = OUTCOMES,
    posterior: Posterior | None = None,
) -> Expected | None:
    """Expected benefit of a candidate; None if its loads overflow. With `posterior`, resample."""
    order = rng.permutation(len(draws))
    outer, inner = order[:outcomes], np.sort(order[outcomes : outcomes + INNER_DRAWS])
    if len(inner) < 4 * BLOCKS:
        raise InputError(f"{len(draws)} draws are too few to rank by", remedy="sample longer")
    values = np.column_stack(list(quantities.values()))
    response = candidate.response(draws.iloc[inner])
    if not all(np.isfinite(part).all() for part in response):
        return None
    simulated = candidate.outcomes(draws.iloc[outer], rng)
    log_weight = candidate.log_likelihood(simulated, draws.iloc[inner])
    at_truth = np.diag(candidate.log_likelihood(simulated, draws.iloc[outer]))
    values = values[inner]
    sd, blocks = values.std(axis=0), [slice(b, None, BLOCKS) for b in range(BLOCKS)]
    sd_after, effective = weighted_sd(log_weight, values)
    by_outcome = _ByOutcome(
        sd_after / sd,
        at_truth - log_mean(log_weight),
        effective,
        np.array([weighted_sd(log_weight[:, b], values[b])[0] / sd for b in blocks]),
        np.array([at_truth - log_mean(log_weight[:, b]) for b in blocks]),
    )
    if (
        posterior is not None
        and by_outcome.untrusted > RESAMPLING_FRACTION
        and len(posterior.mounts) <= 1
    ):
        # the stretch of all draws, as in the names of the quantities
        stretch = largest_equibiaxial(draws, posterior.specimen)
        names = tuple(quantities)
        after = OutcomePosterior(posterior, candidate, draws.iloc[inner], names, stretch)
        by_outcome = _resampled(by_outcome, after, simulated, log_weight, at_truth, sd, rng)
    return by_outcome.averaged(candidate.name, _linear_reduction(*response, values))


@dataclass(frozen=True)
class _ByOutcome:
    """Every outcome, from all draws and from blocks of them."""

    ratio: np.ndarray  # (outcomes, quantities), sd after over sd before
    gain: np.ndarray  # (outcomes,)
    effective: np.ndarray
    block_ratio: np.ndarray  # (BLOCKS, outcomes, quantities)
    block_gain: np.ndarray  # (BLOCKS, outcomes)

    @property
    def untrusted(self) -> float:
        """Fraction of outcomes with too few effective draws."""
        return float((self.effective < MIN_EFFECTIVE_DRAWS).mean())

    def averaged(self, name: str, at_least: np.ndarray) -> Expected:
        """Means over the outcomes, with their errors."""
        # The error has a part from the outcomes and one from the draws, estimated by blocks.
        blocks = self.block_ratio.mean(axis=1)
        from_draws = blocks.std(axis=0, ddof=1) / np.sqrt(BLOCKS)
        # jackknife: a bias that falls as 1 / draws is BLOCKS times as large in a block, so
        # bias = (mean over blocks - value from all draws) / (BLOCKS - 1)
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
            self.untrusted,
        )


def _resampled(
    by_outcome: _ByOutcome,
    after: OutcomePosterior,
    simulated: np.ndarray,
    log_weight: np.ndarray,
    at_truth: np.ndarray,
    sd: np.ndarray,
    rng: np.random.Generator,
) -> _ByOutcome:
    """The first outcomes alone, with new draws for those that left too few."""
    first = _ByOutcome(
        by_outcome.ratio[:MAX_RESAMPLED_OUTCOMES].copy(),
        by_outcome.gain[:MAX_RESAMPLED_OUTCOMES].copy(),
        by_outcome.effective[:MAX_RESAMPLED_OUTCOMES].copy(),
        by_outcome.block_ratio[:, :MAX_RESAMPLED_OUTCOMES].copy(),
        by_outcome.block_gain[:, :MAX_RESAMPLED_OUTCOMES].copy(),
    )
    for j in np.flatnonzero(first.effective < RESAMPLING_EFFECTIVE_DRAWS):
        posterior = after.after(simulated[j], log_weight[j], rng)
        if posterior is None or posterior.effective <= first.effective[j]:
            continue
        first.ratio[j] = first.block_ratio[:, j] = posterior.sd / sd
        first.gain[j] = first.block_gain[:, j] = at_truth[j] - posterior.log_evidence
        first.effective[j] = posterior.effective
    return first


def _error(values: np.ndarray) -> Any:
    """Standard error of the mean over the outcomes."""
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def _linear_reduction(readings: np.ndarray, noise: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Fraction by which the best linear estimate from the outcome reduces each sd."""
    f, q = readings - readings.mean(axis=0), values - values.mean(axis=0)
    scale = 1.0 / np.sqrt(noise)
    f = f * scale
    # var(q | y) = C_qq - C_qf (C_ff + R)^-1 C_fq, readings scaled so that R is one
    C_fq, C_ff = f.T @ q / len(f), f.T @ f / len(f)
    explained = (C_fq * np.linalg.solve(C_ff + np.eye(len(C_ff)), C_fq)).sum(axis=0)
    share = np.clip(1.0 - explained / np.square(q).mean(axis=0), 0.0, 1.0)
    return 1.0 - np.sqrt(share)
