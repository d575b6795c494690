"""The posterior that one outcome of a candidate would lead to, where a run's draws are too few.

A precise measurement leaves hardly any of the draws of a run with weight. Its posterior,

    p(x | data, y) = p(x | data) L(y | x) / Z(y),

is found from them all the same: the reweighted draws, tempered so that enough of them count, give a
first proposal, and population Monte Carlo (:mod:`biaxbayes.inference.population`) carries it to the
density. The last population gives the spread of every quantity and, by its mean weight, Z(y).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.errors import NotConverged
from biaxbayes.findings.candidates import Candidate
from biaxbayes.findings.targets import targets
from biaxbayes.inference.population import explore, resample, tempering
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.proposal import Proposal, edge_array, fit_proposal

__all__ = ["OutcomePosterior", "Sharpened", "log_mean", "weighted_spread"]

POPULATION = 2048
COMPONENTS = 3
"""What a precise measurement leaves is narrow, and narrow posteriors are nearly Gaussian."""


@dataclass(frozen=True)
class Sharpened:
    """What is known after an outcome.

    Attributes
    ----------
    sd : ndarray, shape (quantities,)
    log_evidence : float
        log Z(y), the log of the mean of L over the run's posterior.
    effective : float
        Effective number of the points behind it.
    """

    sd: np.ndarray
    log_evidence: float
    effective: float


@dataclass
class OutcomePosterior:
    """Draws from the posteriors that outcomes of a candidate would lead to.

    Parameters
    ----------
    posterior : Posterior
        With its chart in use; mounted states, if any, shared by all protocols.
    candidate : Candidate
    draws : DataFrame
        Of the run.
    quantities : tuple of str
        Of :func:`.targets.targets`.
    stretch : float
        The total equibiaxial stretch that these refer to.
    """

    posterior: Posterior
    candidate: Candidate
    draws: pd.DataFrame
    quantities: tuple[str, ...]
    stretch: float
    _log_normaliser: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._points = self.posterior.coordinates({k: self.draws[k] for k in self.posterior.free})
        self._regular = np.isfinite(self._points).all(axis=1)
        self._edges = edge_array(self.posterior.edges, self.posterior.dimension)

    def after(
        self, outcome: np.ndarray, log_weight: np.ndarray, rng: np.random.Generator
    ) -> Sharpened | None:
        """What an outcome leads to; None where no proposal comes near it.

        Parameters
        ----------
        outcome : ndarray, shape (readings,)
        log_weight : ndarray, shape (draws,)
            Log likelihood of the outcome for each draw of the run.
        rng : numpy.random.Generator
        """

        def log_density(x: np.ndarray) -> np.ndarray:
            out = self.posterior.log_prob(x)
            inside = np.isfinite(out)
            if inside.any():
                with np.errstate(over="ignore", invalid="ignore"):
                    table = pd.DataFrame(self.posterior.natural(x[inside]))
                    gained = self.candidate.log_likelihood(outcome[None], table)[0]
                out[inside] += np.where(np.isfinite(gained), gained, -np.inf)
            return out

        known = np.where(self._regular, log_weight, -np.inf)
        tempered = np.where(np.isfinite(known), tempering(known) * log_weight, -np.inf)
        try:
            _, x, found = explore(
                log_density, self._fitted(tempered, rng), self._edges, rng, POPULATION, COMPONENTS
            )
        except NotConverged:
            return None
        inside = np.isfinite(found)
        table = pd.DataFrame(self.posterior.natural(x[inside]))
        values = targets(self.posterior, table, self.stretch)
        columns = np.column_stack([values[name] for name in self.quantities])
        sd, effective = weighted_spread(found[None, inside], columns)
        log_evidence = float(log_mean(found)) - self._normaliser(rng)
        return Sharpened(sd[0], log_evidence, float(effective[0]))

    def _fitted(self, log_weight: np.ndarray, rng: np.random.Generator) -> Proposal:
        chosen = resample(log_weight, POPULATION // 2, rng)
        return fit_proposal(
            self._points[chosen], rng, edges=self._edges, components=COMPONENTS, screen=False
        )

    def _normaliser(self, rng: np.random.Generator) -> float:
        """Log integral of the run's own density in the sampling coordinates."""
        if self._log_normaliser is None:
            equal = np.where(self._regular, 0.0, -np.inf)
            first = self._fitted(equal, rng)
            _, _, found = explore(self.posterior.log_prob, first, self._edges, rng, 8 * POPULATION)
            self._log_normaliser = float(log_mean(found))
        return self._log_normaliser


def weighted_spread(log_weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
