"""Draws of the single runs, reweighted to the population (Hogg, Myers and Bovy 2010).

The draws theta_ij of specimen i's run are from its likelihood times the run's prior pi_i. Given
what the specimens have in common, its likelihood is a sum over them:

    p(data_i | m_i, Sigma)  ~  sum_j w_ij    w_ij = p(theta_ij | m_i, Sigma) / pi_i(theta_ij)

and the specimen is draw j with probability w_ij / sum_j w_ij. This holds where enough draws are
where the population puts the specimen: the Pareto k of the weights says whether (Vehtari, Simpson,
Gelman, Yao and Gabry, JMLR 25 (2024) 72).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.populations.hierarchy import Common, Layout

MAX_K = 0.7
"""Largest Pareto k with which a weighted mean is reliable."""


@dataclass(frozen=True, eq=False)
class RunDraws:
    """Draws of one specimen's run."""

    natural: dict[str, np.ndarray]  # (ensembles, N) each, by the names of ``summary.csv``
    theta: np.ndarray  # (ensembles, N, p): the pooled values, centred
    log_prior: np.ndarray  # (ensembles, N): of these values, in the run

    @cached_property
    def terms(self) -> np.ndarray:
        """Products of two values, and the values, (ensembles, N, p (p + 1) / 2 + p)."""
        i, j = np.triu_indices(self.theta.shape[2])
        return np.concatenate([self.theta[..., i] * self.theta[..., j], self.theta], axis=2)

    def log_weights(self, ensemble: int, m: np.ndarray, P: np.ndarray) -> np.ndarray:
        """Log weights (N, C) up to a constant of each column, of m (C, p) and P (C, p, p).

        ln w_j = -1/2 theta_j' P theta_j + theta_j' P m - ln pi(theta_j)    P = Sigma^-1
        """
        i, j = np.triu_indices(m.shape[1])
        quadratic = np.where(i == j, -0.5, -1.0) * P[:, i, j]
        linear = (P @ m[..., None])[..., 0]
        of_theta = self.terms[ensemble] @ np.hstack([quadratic, linear]).T
        return np.asarray(of_theta - self.log_prior[ensemble][:, None])


class Chains:
    """Chains of one ensemble: what the specimens have in common, and which draw each of them is."""

    def __init__(
        self,
        layout: Layout,
        specimens: list[RunDraws],
        ensemble: int,
        chains: int,
        seed: np.random.SeedSequence,
    ) -> None:
        self.specimens, self.ensemble = specimens, ensemble
        self.rng = np.random.default_rng(seed)
        counts = [s.theta.shape[1] for s in specimens]
        self.index = self.rng.integers(counts, size=(chains, len(specimens)), dtype=np.int32)
        self.common = Common(layout, self.theta, self.rng)

    @property
    def theta(self) -> np.ndarray:
        """Values of the specimens, (C, n, p)."""
        pairs = zip(self.specimens, self.index.T, strict=True)
        return np.stack([s.theta[self.ensemble][at] for s, at in pairs], axis=1)

    def _log_weights(self) -> Iterator[np.ndarray]:
        """Log weights (N, C) of the draws of each specimen, at most zero in every chain."""
        m, P = self.common.m(), self.common.precisions()
        for i, specimen in enumerate(self.specimens):
            log = specimen.log_weights(self.ensemble, m[:, i], P[:, i])
            yield log - log.max(axis=0)

    def sweep(self) -> None:
        """Draw every specimen given the others, then move what they have in common."""
        for i, log in enumerate(self._log_weights()):
            cumulated = np.exp(log).cumsum(axis=0)
            level = self.rng.random(len(self.index)) * cumulated[-1]
            self.index[:, i] = (cumulated < level).sum(axis=0)
        theta = self.theta
        for _ in range(2 if self.common.b == 1 else 1):  # without correlations it costs little
            self.common.update(theta)

    def pareto_k(self) -> np.ndarray:
        """Pareto k of the weights of every chain and specimen, (C, n)."""
        try:
            from arviz import psislw
        except ImportError:  # from ArviZ 1.0
            from arviz_stats.base import array_stats

            psislw = array_stats.psislw

        with np.errstate(over="ignore", invalid="ignore"):
            k = np.stack([psislw(log.T)[1] for log in self._log_weights()], axis=1)
        # not a number where a few draws have all the weight
        return np.nan_to_num(k, nan=np.inf)

    def snapshot(self) -> dict[str, Any]:
        """Copy of all that later sweeps depend on."""
        arrays = {name: getattr(self.common, name).copy() for name in Common.STATE}
        return arrays | {"index": self.index.copy(), "rng": self.rng.bit_generator.state}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        for name in Common.STATE:
            setattr(self.common, name, np.array(snapshot[name]))
        self.index = np.array(snapshot["index"])
        self.rng.bit_generator.state = snapshot["rng"]
