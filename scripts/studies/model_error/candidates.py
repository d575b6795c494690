"""Error models: a specimen to draws, each with its own option."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from biaxbayes import Specimen, prepare
from biaxbayes.model.draw import draw_posterior
from biaxbayes.options import Settings
from biaxbayes.sampling.sampler import Plan

CANDIDATES: dict[str, dict[str, Any]] = {
    "effective": {},
    "growth": {"noise_growth": True},
    "independent": {"noise": "independent"},
}
DRAWS = 600
CHEAP = Plan(ess=200.0, max_steps=3000, ensembles=2, population=1024, walkers=36, first_block=64)


@dataclass(frozen=True)
class Answer:
    """What a candidate says of a specimen."""

    draws: pd.DataFrame
    state: str
    settings: Settings


def sampled(specimen: Specimen, candidate: str) -> Answer:
    """Draws of a specimen with an error model."""
    posterior = prepare(specimen, **CANDIDATES[candidate])
    drawn = draw_posterior(posterior, CHEAP)
    table = pd.DataFrame({name: values.ravel() for name, values in drawn.quantities.items()})
    table = table.iloc[:: max(1, len(table) // DRAWS)]
    return Answer(table, drawn.convergence.state, posterior.settings)
