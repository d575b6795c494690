"""A sampled population: its draws, and predictions for specimens and donors not tested."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr, ndtri

from biaxbayes.errors import printable
from biaxbayes.evenly import evenly_chosen
from biaxbayes.laws.law import Law
from biaxbayes.model.priors import Tie
from biaxbayes.populations.hierarchy import (
    MIN_INSIDE_PROBABILITY,
    Layout,
    correlation_factors,
    inside_probability,
)
from biaxbayes.populations.model import Grouping, PooledValue
from biaxbayes.populations.reweighting import RunDraws
from biaxbayes.populations.sampler import History, PopulationDraws, PopulationPlan, draw_population
from biaxbayes.populations.specimens import Source, is_cut_short, run_draws, sample_again
from biaxbayes.sampling.sampler import Plan

MAX_REJECTIONS, MAX_PRIOR_BATCHES = 1000, 50
NATURAL_DRAWS, PRIOR_DRAWS = 2000, 2**14


def truncated_median(location: np.ndarray, sd: np.ndarray, low: Any, high: Any) -> np.ndarray:
    """Median of a normal truncated to a range."""
    below, above = ndtr((low - location) / sd), ndtr((high - location) / sd)
    return np.clip(location + sd * ndtri(0.5 * (below + above)), low, high)


@dataclass(frozen=True, eq=False)
class Hyper:
    """Draws of means and spreads, on the model's scale; first axis the draw."""

    values: tuple[PooledValue, ...]
    covariance_index: np.ndarray  # (groups,)
    mu: np.ndarray  # (M, groups, p)
    sd_donors: np.ndarray  # (M, p)
    sd: np.ndarray  # (M, sets, p)
    factor_donors: np.ndarray  # (M, p, p), Cholesky factor of the correlations
    factor: np.ndarray  # (M, p, p)

    @classmethod
    def from_prior(
        cls, values: Sequence[PooledValue], layout: Layout, draws: int, rng: np.random.Generator
    ) -> tuple[Hyper, np.ndarray]:
        """Draws of the prior without correlations, and specimens' locations (draws, groups, p)."""
        parts = [_prior_draws(v, layout, draws, rng) for v in values]
        mu, sd_donors, sd, location = (np.stack(part, axis=-1) for part in zip(*parts, strict=True))
        eye = np.broadcast_to(np.eye(len(values)), (draws, len(values), len(values)))
        hyper = cls(tuple(values), layout.covariance_index, mu, sd_donors, sd, eye, eye)
        return hyper, location

    @property
    def limits(self) -> np.ndarray:
        """Lower and upper ends of the values, shape (2, p)."""
        return np.array([v.limits for v in self.values]).T

    def at(self, rows: np.ndarray) -> Hyper:
        """Some of the draws."""
        parts = (self.mu, self.sd_donors, self.sd, self.factor_donors, self.factor)
        return Hyper(self.values, self.covariance_index, *(a[rows] for a in parts))

    def repeat(self, times: int) -> Hyper:
        """Each draw repeated, one copy after the other."""
        return self.at(np.repeat(np.arange(len(self.mu)), times))

    def log_prior(self) -> np.ndarray:
        """Log prior density of means and spreads, up to a constant, shape (M,)."""
        numbers = [(v.mean, v.mean_sd, v.donor_scale, v.specimen_scale) for v in self.values]
        mean, mean_sd, donors, specimens = np.array(numbers).T
        parts = (self.mu - mean) / mean_sd, (self.sd_donors / donors)[:, None], self.sd / specimens
        return np.asarray(-0.5 * np.square(np.concatenate(parts, axis=1)).sum(axis=(1, 2)))

    def specimen_sd(self, group: int) -> np.ndarray:
        """Sds between specimens of a donor, shape (M, p)."""
        return self.sd[:, self.covariance_index[group]]

    def total_sd(self, group: int) -> np.ndarray:
        """Sds between specimens of different donors, shape (M, p)."""
        return np.hypot(self.sd_donors, self.specimen_sd(group))

    def median(self, location: np.ndarray, group: int) -> np.ndarray:
        """Medians of the specimens at a location, shape (M, p)."""
        return truncated_median(location, self.specimen_sd(group), *self.limits)

    def typical_median(self, group: int) -> np.ndarray:
        """Median of the typical donor's specimens, shape (M, p)."""
        return self.median(self.mu[:, group], group)

    def donors(self, group: int, rng: np.random.Generator) -> np.ndarray:
        """Locations of new donors, one per draw, shape (M, p)."""
        sd = self.specimen_sd(group)

        def allowed(new: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return inside_probability(new, sd[rows], *self.limits) >= MIN_INSIDE_PROBABILITY

        return self._around(self.mu[:, group], self.factor_donors, self.sd_donors, allowed, rng)

    def specimens(self, location: np.ndarray, group: int, rng: np.random.Generator) -> np.ndarray:
        """Specimens at locations, one per draw, shape (M, p)."""
        low, high = self.limits

        def inside(new: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return (new >= low) & (new <= high)

        return self._around(location, self.factor, self.specimen_sd(group), inside, rng)

    def _around(
        self, location: np.ndarray, factor: np.ndarray, sd: np.ndarray, allowed: Any, rng: Any
    ) -> np.ndarray:
        """One normal draw around each location, shape (M, p), the first with allowed values."""
        out, left = np.clip(location, *self.limits), np.arange(len(self.mu))
        for _ in range(MAX_REJECTIONS):
            z = rng.standard_normal((len(left), len(self.values)))
            new = location[left] + np.einsum("mij,mj->mi", factor[left], z) * sd[left]
            ok = allowed(new, left).all(axis=1)
            out[left[ok]] = new[ok]
            left = left[~ok]
            if not len(left):
                break
        return out

    def new_specimens(self, group: int, rng: np.random.Generator) -> np.ndarray:
        """Specimens of new donors, one per draw, shape (M, p)."""
        return self.specimens(self.donors(group, rng), group, rng)

    def predictive_p(
        self, theta: np.ndarray, group: int, rng: np.random.Generator
    ) -> tuple[float, np.ndarray]:
        """Posterior predictive p of a specimen (M, p) in its group: jointly, and value by value.

        The squared distance from the group's mean in units of the sds (donors included), compared
        with that of a new specimen of the same draw (Gelman, Meng and Stern 1996). A specimen
        pulls its own group, so that p is rather too large.
        """
        donors = self.sd_donors[:, :, None] * self.factor_donors
        within = self.specimen_sd(group)[:, :, None] * self.factor
        inverse = np.linalg.inv(sum(root @ root.transpose(0, 2, 1) for root in (donors, within)))
        new = self.new_specimens(group, rng)
        off = [x - self.mu[:, group] for x in (theta, new)]
        own, other = (np.einsum("mi,mij,mj->m", x, inverse, x) for x in off)
        each = (np.abs(off[1]) >= np.abs(off[0])).mean(axis=0)
        return float((other >= own).mean()), each


def _prior_draws(
    v: PooledValue, layout: Layout, draws: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means (M, groups), sds of donors (M,) and specimens (M, sets), locations (M, groups)."""
    first = [int(np.flatnonzero(layout.group == g)[0]) for g in range(layout.covariance_index.size)]
    accepted: list[tuple[np.ndarray, ...]] = []
    for _ in range(MAX_PRIOR_BATCHES):
        sd_donors = np.abs(rng.standard_normal(draws)) * v.donor_scale
        sd = np.abs(rng.standard_normal((draws, layout.sets))) * v.specimen_scale
        mu = v.mean + v.mean_sd * rng.standard_normal((draws, layout.covariance_index.size))
        effect = sd_donors[:, None] * rng.standard_normal((draws, layout.donors))
        location = mu[:, layout.group] + effect[:, layout.donor]
        own = sd[:, layout.covariance_index[layout.group]]
        inside = inside_probability(location, own, *v.limits)
        ok = (inside >= MIN_INSIDE_PROBABILITY).all(axis=1)
        accepted.append(tuple(a[ok] for a in (mu, sd_donors, sd, location[:, first])))
        if sum(len(part[1]) for part in accepted) >= draws:
            break
    # priors with hardly a location inside: some draws are repeated
    at = np.arange(draws) % max(sum(len(part[1]) for part in accepted), 1)
    mu, sd_donors, sd, location = (np.concatenate(p)[at] for p in zip(*accepted, strict=True))
    return mu, sd_donors, sd, location


def assessed_quantities(
    grouping: Grouping, values: Sequence[PooledValue], history: History, theta: np.ndarray
) -> dict[str, np.ndarray]:
    """Arrays (ensembles, sweeps, chains): means, spreads, correlations, specimens."""
    names = [v.name for v in values]
    out: dict[str, np.ndarray] = {}
    for g, group in enumerate(grouping.groups):
        for k, name in enumerate(names):
            out[f"mean {name}, {group}"] = history.mu[..., g, k]
    for k, name in enumerate(names):
        out[f"sd_donors {name}"] = history.sd[..., 0, k]
        for s in range(history.sd.shape[-2] - 1):
            group = f", {grouping.groups[s]}" if history.sd.shape[-2] > 2 else ""
            out[f"sd_specimens {name}{group}"] = history.sd[..., 1 + s, k]
    for side, what in enumerate(("donors", "specimens")):
        for k in range(history.partial.shape[-1]):
            out[f"correlation {k + 1} of {what}"] = history.partial[..., side, k]
    for i, label in enumerate(grouping.labels):
        for k, name in enumerate(names):
            out[f"{name} of {label}"] = theta[..., i, k]
    return out


def draw_sources(
    sources: Sequence[Source],
    grouping: Grouping,
    values: Sequence[PooledValue],
    layout: Layout,
    plan: PopulationPlan,
    *,
    stop: Callable[[], int] = lambda: False,
    **work: Any,
) -> PopulationDraws | None:
    """Draw from the population of these runs; None if stopped. See :func:`draw_population`."""

    def again(i: int, mean: np.ndarray, sd: np.ndarray, seed: int) -> RunDraws | None:
        run = Plan(ess=plan.run_ess, ensembles=plan.ensembles, seed=seed, workers=plan.workers)
        return sample_again(sources[i], values, mean, sd, run, stop)

    return draw_population(
        layout,
        [run_draws(s, s.chains, s.posterior.priors, values, plan.ensembles) for s in sources],
        plan,
        partial(assessed_quantities, grouping, values),
        again,
        labels=[printable(s.label) for s in sources],
        cut_short=[i for i, s in enumerate(sources) if is_cut_short(s, values)],
        stop=stop,
        **work,
    )


def _flat(values: np.ndarray, most: int | None) -> np.ndarray:
    """Ensembles, sweeps and chains as one axis, at most so many of it, thinned evenly."""
    rows = values.reshape(math.prod(values.shape[:3]), *values.shape[3:])
    return rows[evenly_chosen(len(rows), most)]


@dataclass(frozen=True, eq=False)
class Population:
    """A sampled population."""

    name: str
    sources: tuple[Source, ...]
    grouping: Grouping
    values: tuple[PooledValue, ...]
    layout: Layout = field(repr=False)
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

    @property
    def centre(self) -> np.ndarray:
        """Prior means of the groups, (p,), from which the stored values are measured."""
        return np.array([v.mean for v in self.values])

    def rng(self, table: int, *index: int) -> np.random.Generator:
        """Random numbers of one table, or one row of it, whichever else were made."""
        key = (1000 + table, *index)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def hyper(self, most: int | None = None) -> Hyper:
        """At most so many draws of means and spreads, in the order ensembles, sweeps, chains."""
        history = self.sampled.history
        mu, sd, pairs = (_flat(v, most) for v in (history.mu, history.sd, history.partial))
        factors = (correlation_factors(pairs[:, side], len(self.values)) for side in range(2))
        index = self.layout.covariance_index
        return Hyper(self.values, index, mu + self.centre, sd[:, 0], sd[:, 1:], *factors)

    def specimen_values(self, most: int) -> np.ndarray:
        """Values of the specimens (M, n, p) on the scale, thinned evenly as :meth:`hyper`."""
        return _flat(self.sampled.theta, most) + self.centre

    def natural(self, i: int, most: int = NATURAL_DRAWS) -> dict[str, np.ndarray]:
        """Natural quantities of a specimen after pooling, by the names of ``summary.csv``."""
        index = self.sampled.history.index[..., i]
        return {
            name: _flat(np.stack([v[at] for v, at in zip(draws, index, strict=True)]), most)
            for name, draws in self.sampled.specimens[i].natural.items()
        }

    def materials(self, theta: np.ndarray) -> pd.DataFrame:
        """Parameters of the law at values on the scale (M, p); fixed ones as in the runs."""
        priors = {name: self.sources[0].posterior.priors[name] for name in self.law.names}
        fixed = {name: p for name, p in priors.items() if isinstance(p, int | float)}
        pooled = {v.name: v.from_scale(theta[:, k]) for k, v in enumerate(self.values)}
        known = pd.DataFrame(pooled).assign(**fixed)
        ties = {name: p for name, p in priors.items() if isinstance(p, Tie)}
        known = known.assign(**{name: tie.factor * known[tie.other] for name, tie in ties.items()})
        return known[list(self.law.names)].astype(float)

    @cached_property
    def prior(self) -> tuple[Hyper, np.ndarray]:
        """Draws of the prior, and locations of each group's specimens."""
        return Hyper.from_prior(self.values, self.layout, PRIOR_DRAWS, self.rng(600))

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


@dataclass(frozen=True)
class PopulationResult:
    """Result of a population: state with reason, tables, and reasons by specimen left out."""

    name: str
    folder: Path
    state: str
    reason: str
    groups: pd.DataFrame = field(repr=False)
    specimens: pd.DataFrame = field(repr=False)
    contrasts: pd.DataFrame = field(repr=False)
    notes: list[str] = field(repr=False)
    left_out: dict[str, str] = field(repr=False)

    def __repr__(self) -> str:
        return f"PopulationResult({self.name!r}, {self.state}, {len(self.groups)} rows of groups)"

    def _repr_html_(self) -> str:
        """State and groups, for notebooks."""
        shown = self.groups[[c for c in self.groups if not str(c).startswith("new_")]]
        table = shown.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")
        return f"<p>{escape(self.name)}: {escape(self.state)}</p>{table}"
