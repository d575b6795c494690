"""Specimens of a population from their finished runs: their draws, and further ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from biaxbayes.derived.determined import largest_equibiaxial
from biaxbayes.errors import InputError, RunError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.model.density import log_prior
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import with_sampling_constants
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import STRETCH
from biaxbayes.populations.model import PooledValue
from biaxbayes.populations.reweighting import RunDraws
from biaxbayes.runs.run import Run
from biaxbayes.sampling.sampler import Plan

MAX_DRAWS = 1500
"""Draws of a run for each ensemble."""
MIN_DRAWS = 50


@dataclass(frozen=True, eq=False)
class Source:
    """A specimen's run."""

    label: str
    run: Run
    posterior: Posterior

    @cached_property
    def largest_stretch(self) -> float:
        """Largest equibiaxial total stretch that the test reached."""
        return largest_equibiaxial(self.run.draws, self.run.specimen)

    @property
    def chains(self) -> dict[str, np.ndarray]:
        """Quantities (ensembles, steps, walkers) of the run's draws, with ``log_likelihood``."""
        chains = self.run.chains
        ensembles, steps, walkers = next(iter(chains.values())).shape
        # one row per draw is walker after walker
        log_likelihood = self.run.draws["log_likelihood"].to_numpy()
        by_walker = log_likelihood.reshape(ensembles, walkers, steps)
        return {**chains, "log_likelihood": by_walker.swapaxes(1, 2)}

    @classmethod
    def from_run(cls, label: str, run: Run) -> Source:
        """A finished run under its label."""
        return cls(label, run, run.posterior())


def pooled_names(sources: Sequence[Source]) -> tuple[str, ...]:
    """Parameters that all runs sampled; InputError if laws or sampled parameters differ."""
    first = sources[0]
    names = {s.label: [n for n in s.posterior.law.names if n in s.posterior.free] for s in sources}
    common = names[first.label]
    for source in sources[1:]:
        law, other = source.posterior.law, first.posterior.law
        if (law.key, law.fibre_switch) != (other.key, other.fibre_switch):
            raise InputError(
                f"{first.label} and {source.label} were sampled with other laws",
                remedy="sample all specimens of a population with the same law and fibre switch",
            )
        different = sorted({*names[source.label]} ^ {*common})
        if different:
            there, here = first.label, source.label
            if different[0] not in common:
                there, here = here, there
            raise InputError(
                f"{different[0]} was sampled in {there} and fixed or tied in {here}",
                remedy="fix the same parameters in all specimens",
            )
    if not common:
        raise InputError("no parameter was sampled: all are fixed or tied")
    return tuple(common)


def check_stretches(source: Source, values: Sequence[PooledValue]) -> None:
    """InputError if a mounting stretch is pooled that the run has none of."""
    shared = source.posterior.settings.infers_mounting and source.posterior.settings.shared
    if any(v.parameter.kind == STRETCH for v in values) and not shared:
        raise InputError(
            f"{source.label} has no mounting stretch that all of its protocols share",
            remedy="leave out `pool_mounting`",
        )


def run_draws(
    source: Source,
    chains: Mapping[str, np.ndarray],
    priors: Mapping[str, object],
    values: Sequence[PooledValue],
    ensembles: int,
) -> RunDraws:
    """Draws of quantities (ensembles, steps, walkers) under priors, a share for each of ours."""
    own = len(next(iter(chains.values())))
    parts = []
    for k in range(ensembles):
        chosen = [e for e in range(own) if e % ensembles == k] or [k % own]
        flat = {name: v[chosen].reshape(-1) for name, v in chains.items()}
        size = len(next(iter(flat.values())))
        rows = evenly_chosen(size, MAX_DRAWS)
        if own < ensembles:  # another part of the same ensemble for each
            rows = (rows + (k // own) * max(1, size // (MAX_DRAWS * ensembles))) % size
        finite = np.all([np.isfinite(v.to_scale(flat[v.name][rows])) for v in values], axis=0)
        parts.append({name: v[rows[finite]] for name, v in flat.items()})
    least = min(len(next(iter(part.values()))) for part in parts)
    if least < MIN_DRAWS:
        raise RunError(f"{source.run.path}: has too few draws; sample it again")
    natural = {name: np.stack([part[name][:least] for part in parts]) for name in parts[0]}
    theta = np.stack([v.to_scale(natural[v.name]) for v in values], axis=-1)
    density = np.zeros(theta.shape[:2])
    for k, v in enumerate(values):
        prior = priors[v.name]
        if isinstance(prior, Prior):
            kind, row = prior.encode(log_scale=v.parameter.logarithmic)
            logs = [log_prior(kind, row, x) for x in theta[..., k].ravel()]
            density += np.reshape(logs, density.shape)
    return RunDraws(natural, theta - [v.mean for v in values], density)


def is_cut_short(source: Source, values: Sequence[PooledValue]) -> bool:
    """True if the run's prior excludes a part of the physical range, where it has no draws."""
    materials = [v for v in values if v.parameter.kind != STRETCH]
    priors = [(source.posterior.priors[v.name], v.parameter.range) for v in materials]
    return any(
        isinstance(prior, Prior) and (prior.low > max(low, 0.0) or prior.high < high)
        for prior, (low, high) in priors
    )


def sample_again(
    source: Source,
    values: Sequence[PooledValue],
    mean: np.ndarray,
    sd: np.ndarray,
    plan: Plan,
    stop: Callable[[], int],
) -> RunDraws | None:
    """Sample a specimen under normal priors (p,) of its centred values; None if it was stopped."""
    priors = {}
    for v, offset, width in zip(values, mean, sd, strict=True):
        centre = v.mean + offset
        if v.parameter.logarithmic:
            priors[v.name] = Prior("lognormal", float(np.exp(centre)), float(width))
        else:
            priors[v.name] = Prior("normal", float(centre), float(width)).within(*v.parameter.range)
    chosen = {**source.posterior.settings.priors, **priors}
    posterior = with_sampling_constants(source.posterior.replaced(priors=chosen))
    found = draw_posterior(posterior, plan, stop=stop)
    if found.interrupted:
        return None
    return run_draws(source, found.quantities, posterior.priors, values, plan.ensembles)
