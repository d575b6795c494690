"""Specimens sampled and pooled in this process, without folders, figures or reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.options import PopulationOptions
from biaxbayes.populations import sampler
from biaxbayes.populations.model import Grouping, PopulationPriors, make_layout, pooled_values
from biaxbayes.populations.population_result import Population, draw_sources
from biaxbayes.populations.specimens import Source, pooled_names
from biaxbayes.runs.archive import draw_table
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.specimen import Specimen

SINGLE: dict[str, Any] = {
    **{"ess": 1000.0, "max_steps": 3000, "first_block": 64},
    **{"ensembles": 2, "walkers": 32},
}
"""Plan of a single specimen: that of a calibration study, and more draws."""
POPULATION: dict[str, Any] = {
    **{"ess": 400.0, "max_steps": 6000, "first_block": 200},
    **{"ensembles": 2, "chains": 16, "run_ess": 1000.0},
}
"""Plan of a population: fewer and smaller ensembles than ``biaxbayes population`` has."""


@dataclass(frozen=True, eq=False)
class HeldRun:
    """A sampled specimen as a population takes it: a run without a folder."""

    posterior: Posterior
    found: Draws
    path: str = ""

    @property
    def state(self) -> str:
        """Of the draws."""
        return self.found.convergence.state

    @property
    def chains(self) -> Mapping[str, np.ndarray]:
        """Quantities as arrays of shape (ensembles, steps, walkers)."""
        return self.found.quantities

    @cached_property
    def draws(self) -> pd.DataFrame:
        """One row a draw."""
        return draw_table(self.chains)

    @property
    def specimen(self) -> Specimen:
        """What was sampled."""
        return self.posterior.specimen

    def source(self, label: str) -> Source:
        """As ``Source.from_run`` makes it of a run's folder."""
        return Source(label, self, self.posterior)  # type: ignore[arg-type]


def sampled(specimen: Specimen, seed: int, **options: Any) -> HeldRun:
    """A specimen's own posterior, as ``biaxbayes sample`` draws it."""
    posterior = prepare(specimen, seed=seed, **options)
    return HeldRun(posterior, draw_posterior(posterior, Plan(seed=seed, **SINGLE)))


def pool(
    runs: Mapping[str, HeldRun],
    group: Sequence[str],
    donor: Sequence[str],
    seed: int,
    priors: PopulationPriors | None = None,
    **plan: Any,
) -> Population:
    """Sample a population of these, as ``biaxbayes population`` does."""
    sources = [run.source(label) for label, run in runs.items()]
    grouping = Grouping(tuple(runs), tuple(group), tuple(donor))
    stated = priors or PopulationPriors()
    values = stated.apply_to(pooled_values(sources[0].posterior.law, pooled_names(sources)))
    asked = sampler.PopulationPlan(seed=seed, **(POPULATION | plan))
    layout = make_layout(grouping, values, PopulationOptions(), stated)
    found = draw_sources(sources, grouping, values, layout, asked)
    assert found is not None  # nothing stops it
    return Population(
        "virtual", tuple(sources), grouping, tuple(values), layout, found, seed, {}, []
    )
