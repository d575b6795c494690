"""A sampled population: what its draws say of groups, donors and specimens."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from biaxbayes.laws.law import Law
from biaxbayes.populations.ensemble import Design
from biaxbayes.populations.model import Grouping, PooledValue
from biaxbayes.populations.predictive import PRIOR_DRAWS, Hyper, correlation_factors
from biaxbayes.populations.sampler import History, PopulationDraws
from biaxbayes.populations.specimens import Source
from biaxbayes.prediction.bands import evenly_chosen

NATURAL_DRAWS = 2000


def assessed_quantities(
    grouping: Grouping, values: Sequence[PooledValue], history: History
) -> list[dict[str, np.ndarray]]:
    """Arrays (ensembles, sweeps, chains): means, spreads, correlations; then specimens."""
    names = [v.name for v in values]
    out: dict[str, np.ndarray] = {}
    for g, group in enumerate(grouping.groups):
        for k, name in enumerate(names):
            out[f"mean {name}, {group}"] = history.mu[..., g, k]
    for k, name in enumerate(names):
        out[f"sd_donors {name}"] = history.sd_donors[..., k]
        for s in range(history.sd.shape[-2]):
            group = f", {grouping.groups[s]}" if history.sd.shape[-2] > 1 else ""
            out[f"sd_specimens {name}{group}"] = history.sd[..., s, k]
    for side, what in enumerate(("donors", "specimens")):
        for k in range(history.partial.shape[-1]):
            out[f"correlation {k + 1} of {what}"] = history.partial[..., side, k]
    specimens = {
        f"{name} of {label}": history.theta[..., i, k]
        for i, label in enumerate(grouping.labels)
        for k, name in enumerate(names)
    }
    return [out, specimens]


@dataclass(frozen=True, eq=False)
class Population:
    """A sampled population."""

    name: str
    sources: tuple[Source, ...]
    grouping: Grouping
    values: tuple[PooledValue, ...]
    design: Design = field(repr=False)
    sampled: PopulationDraws = field(repr=False)
    seed: int
    left_out: dict[str, str]  # reasons by specimen
    notes: list[str]  # for readers of the numbers

    @property
    def law(self) -> Law:
        """The material law."""
        return self.sources[0].posterior.law

    @property
    def state(self) -> str:
        """``converged``, ``tentative`` or ``unusable``."""
        return self.sampled.convergence.state

    @property
    def reason(self) -> str:
        """Why it has not converged."""
        return self.sampled.convergence.reason

    def rng(self, what: int) -> np.random.Generator:
        """Random numbers of one table, whichever else were made."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(1000 + what,)))

    def hyper(self, most: int | None = None, *, with_specimens: bool = False) -> Hyper:
        """At most so many draws of means and spreads, in the order ensembles, sweeps, chains.

        ``with_specimens`` takes those stored with the specimens' values.
        """
        history = self.sampled.history
        every = history.every if with_specimens else 1

        def flat(values: np.ndarray) -> np.ndarray:
            taken = values[:, ::every]
            rows = taken.reshape(math.prod(taken.shape[:3]), *taken.shape[3:])
            return rows[evenly_chosen(len(rows), most)]

        partial = flat(history.partial)
        factors = (correlation_factors(partial[:, side], len(self.values)) for side in range(2))
        return Hyper(
            self.values,
            self.design.layout.set_of,
            flat(history.mu) + self.design.centre,
            flat(history.sd_donors),
            flat(history.sd),
            *factors,
        )

    def specimen_values(self, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Values (M, n, p) on the scale and coordinates (M, n, dmax), thinned evenly."""
        history = self.sampled.history
        theta, u = (v.reshape(-1, *v.shape[3:]) for v in (history.theta, history.u))
        at = evenly_chosen(len(theta), most)
        return theta[at] + self.design.centre, u[at]

    def natural(self, i: int, most: int = NATURAL_DRAWS) -> dict[str, np.ndarray]:
        """Natural quantities of a specimen after pooling, by the names of ``summary.csv``."""
        _, u = self.specimen_values(most)
        source = self.sources[i]
        own = np.ascontiguousarray(u[:, i, : source.posterior.dimension])
        return source.posterior.natural(own)

    def materials(self, theta: np.ndarray) -> pd.DataFrame:
        """Parameters of the law at values on the scale (M, p); fixed ones as in the runs."""
        columns = {}
        priors = self.sources[0].posterior.priors
        by_name = {v.name: v.from_scale(theta[:, k]) for k, v in enumerate(self.values)}
        for name in self.law.names:
            prior = priors[name]
            if name in by_name:
                columns[name] = by_name[name]
            elif isinstance(prior, int | float):
                columns[name] = np.full(len(theta), float(prior))
        for name in self.law.names:
            tie = priors[name]
            if name not in columns:
                columns[name] = tie.factor * columns[tie.other]  # type: ignore[union-attr]
        return pd.DataFrame(columns)[list(self.law.names)]

    @cached_property
    def prior(self) -> tuple[Hyper, np.ndarray]:
        """Draws of the prior, and locations of each group's specimens."""
        return Hyper.from_prior(self.values, self.design.layout, PRIOR_DRAWS, self.rng(600))

    def new_specimens(self, most: int = NATURAL_DRAWS) -> dict[str, pd.DataFrame]:
        """Materials of new specimens of new donors, by group; one per draw."""
        hyper, rng = self.hyper(most), self.rng(500)
        return {
            group: self.materials(hyper.new_specimens(g, rng))
            for g, group in enumerate(self.grouping.groups)
        }

    @property
    def largest_stretch(self) -> float:
        """Largest equibiaxial total stretch that any specimen reached."""
        return max(s.largest_stretch for s in self.sources)
