"""Specimens of a population from their finished runs: their likelihoods, and their draws.

The likelihood is that of the run: same readings, law and errors, its misfit relative to the loads
of the same fit. The run's prior of the pooled parameters is replaced by a flat one inside of their
physical range; everything else of the run's density stays, the priors of its mounting stretches
and errors included.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.compilation import compiled
from biaxbayes.errors import InputError, RunError
from biaxbayes.identifiability.determined import largest_equibiaxial
from biaxbayes.model import density as kernel
from biaxbayes.model.assembly import SamplingConstants
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import FIXED, UNIFORM, Prior
from biaxbayes.parameters import STRETCH
from biaxbayes.populations.ensemble import Individual
from biaxbayes.populations.model import PooledValue
from biaxbayes.runs.run import Run

MAX_DRAWS = 1500
"""Draws of a run for each ensemble."""
MIN_DRAWS = 50


@dataclass(frozen=True, eq=False)
class Source:
    """A specimen's run with sampling coordinates tuned to its draws."""

    label: str
    run: Run
    posterior: Posterior

    @cached_property
    def largest_stretch(self) -> float:
        """Largest equibiaxial total stretch that the test reached."""
        return largest_equibiaxial(self.run.draws, self.run.specimen)

    @classmethod
    def from_run(cls, label: str, run: Run) -> Source:
        """A finished run under its label."""
        posterior = run.posterior()
        law = posterior.law
        medians = {n: float(np.median(run.draws[n])) for n in law.names}
        constants = SamplingConstants(law.softening(medians), None)
        return cls(label, run, posterior.replaced(sampling_constants=constants))


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


@compiled()
def _log_priors(kinds, rows, values):
    """Sum of the log priors of the pooled values, on the scale of the table's units."""
    out = np.zeros(values.shape[0])
    for i in range(values.shape[0]):
        for k in range(kinds.size):
            out[i] += kernel.log_prior(kinds[k], rows[k], values[i, k])
    return out


def make_individual(source: Source, values: Sequence[PooledValue], ensembles: int) -> Individual:
    """A specimen for the sampler; RunError if the draws are not those of the density."""
    posterior = source.posterior
    slots = posterior.assembly.slots
    whole = posterior.assembly.problem
    for v in values:
        if v.parameter.kind == STRETCH and (
            v.name not in slots or not posterior.settings.infers_mounting
        ):
            raise InputError(
                f"{source.label} has no mounting stretch that all of its protocols share",
                remedy="leave out `pool_mounting`",
            )
    at = np.array([slots.index(v.name) for v in values])
    # a flat, unnormalised prior of the pooled values in their physical range
    prior_kind, prior = whole.prior_kind.copy(), whole.prior.copy()
    prior_kind[at] = UNIFORM
    prior[at] = [[0.0, 1.0, *v.edges, 0.0] for v in values]
    problem = whole._replace(prior_kind=prior_kind, prior=prior)
    per_unit = whole.per_unit[at]
    logs = np.array([v.parameter.logarithmic for v in values])
    kinds, rows = np.full(len(values), FIXED), np.zeros((len(values), 5))
    for k, v in enumerate(values):
        own = posterior.priors[v.name]
        if isinstance(own, Prior):
            kinds[k], rows[k] = own.encode(log_scale=v.parameter.logarithmic)

    def density(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        log, _, evaluation = posterior.evaluate(problem, u)
        pooled = evaluation.values[:, at] * per_unit
        with np.errstate(divide="ignore", invalid="ignore"):
            pooled[:, logs] = np.log(pooled[:, logs])
        log[~np.isfinite(pooled).all(axis=1)] = -np.inf
        return log, pooled

    def log_prior(theta: np.ndarray) -> np.ndarray:
        return np.asarray(_log_priors(kinds, rows, np.ascontiguousarray(theta)))

    pool = _pools(source, ensembles, density)
    return Individual(source.label, density, log_prior, posterior.bounds, pool)


def _pools(source: Source, ensembles: int, density: Callable[..., Any]) -> np.ndarray:
    """Coordinates of the run's draws, a share of its ensembles each; (ensembles, N, d)."""
    chains = source.run.chains
    own = len(next(iter(chains.values())))
    out = []
    for k in range(ensembles):
        chosen = [e for e in range(own) if e % ensembles == k] or [k % own]
        flat = {name: v[chosen].reshape(-1) for name, v in chains.items()}
        size = len(next(iter(flat.values())))
        rows = np.linspace(0, size - 1, min(size, MAX_DRAWS)).round().astype(int)
        if own < ensembles:  # another part of the same ensemble for each
            rows = (rows + (k // own) * max(1, size // (MAX_DRAWS * ensembles))) % size
        u = source.posterior.coordinates({name: v[rows] for name, v in flat.items()})
        u = u[np.isfinite(u).all(axis=1)]
        out.append(u[np.isfinite(density(np.ascontiguousarray(u))[0])])
    least = min(len(u) for u in out)
    if least < MIN_DRAWS:
        raise RunError(
            f"{source.run.path}: its draws are not those of its density; sample it again"
        )
    return np.ascontiguousarray([u[:least] for u in out])
