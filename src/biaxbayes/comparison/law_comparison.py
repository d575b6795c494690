"""Laws fitted and sampled on a record without a part of it.

Each protocol is left out in turn; of a single protocol, each quarter of its path. The mounting
constraint and the error model are the same for every law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import NotConverged
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.prediction.bands import evenly_chosen
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen

WHOLE = "whole record"
QUARTERS = 4
MAX_LAW_DRAWS, MAX_PART_DRAWS = 2000, 500
"""Draws used of the posterior of a whole record, and of one with a part left out."""


# --- what is left out ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """A part of a record that is left out."""

    name: str  # of the protocol, with the quarter of a single one
    protocol: int
    rows: slice  # counted with those at rest, which are never left out


def left_out_parts(specimen: Specimen) -> tuple[Part, ...]:
    """Each protocol, or each quarter of the only one."""
    if len(specimen.protocols) > 1:
        return tuple(
            Part(p.name, i, slice(p.rest_rows, p.rows)) for i, p in enumerate(specimen.protocols)
        )
    only = specimen.protocols[0]
    ends = np.linspace(only.rest_rows, only.rows, QUARTERS + 1).round().astype(int)
    return tuple(
        Part(f"{only.name}, quarter {k + 1}", 0, slice(int(a), int(b)))
        for k, (a, b) in enumerate(pairwise(ends))
    )


def without(specimen: Specimen, part: Part) -> Specimen:
    """The specimen without a part of its record."""
    if len(specimen.protocols) > 1:
        rest = tuple(p for i, p in enumerate(specimen.protocols) if i != part.protocol)
        return specimen.with_protocols(rest)
    only = specimen.protocols[0]
    rows = np.ones(only.rows, dtype=bool)
    rows[part.rows] = False
    return replace(specimen, protocols=(only.at_rows(rows),))


def only(specimen: Specimen, part: Part) -> Specimen:
    """The rows at rest and those of a part of the record."""
    whole = specimen.protocols[part.protocol]
    (p,) = specimen.with_protocols([whole]).protocols
    # A protocol that does not start at the mounted state has taken rows at rest from another.
    moved = np.arange(whole.rows)[part.rows] + (p.rows - whole.rows)
    rows = np.r_[np.arange(p.rest_rows), moved]
    return replace(specimen, protocols=(p.at_rows(rows),))


# --- one posterior -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """One law on one record."""

    law: str
    specimen: Specimen  # with the whole record
    part: Part | None  # left out
    options: Mapping[str, Any]  # of `Posterior`, without law, priors of the law and fibre switch
    seed: int
    ess: float  # effective sample size
    max_steps: int

    @property
    def name(self) -> str:
        """Name of the law and of the left-out part."""
        return f"{self.law}, {self.part.name if self.part else WHOLE}"


@dataclass(frozen=True)
class Prediction:
    """Draws of one law on one record."""

    state: str  # of the chains; `failed` if nothing could be drawn
    reason: str
    rmse_kPa: float  # of the deterministic fit
    residuals: tuple[np.ndarray, ...]  # of that fit, (n_p, 2)
    draws: pd.DataFrame  # as in summary.csv


def sample_part(task: Task) -> Prediction:
    """Fit and sample a law on a record without the part; a failure is a state, not an error."""
    shown = task.specimen if task.part is None else without(task.specimen, task.part)
    rmse = float("nan")
    residuals: tuple[np.ndarray, ...] = ()
    try:
        posterior = prepare(shown, law=task.law, seed=task.seed, **task.options)
        rmse, residuals = posterior.fit.rmse_kPa, posterior.fit.residuals
        plan = Plan(ess=task.ess, max_steps=task.max_steps, seed=task.seed, workers=1)
        drawn = draw_posterior(posterior, plan)
    except (NotConverged, np.linalg.LinAlgError) as error:
        return Prediction("failed", str(error), rmse, residuals, pd.DataFrame())
    count = MAX_LAW_DRAWS if task.part is None else MAX_PART_DRAWS
    table = pd.DataFrame({k: v.ravel() for k, v in drawn.quantities.items()})
    table = table.iloc[evenly_chosen(len(table), count)].reset_index(drop=True)
    convergence = drawn.convergence
    return Prediction(convergence.state, convergence.reason, rmse, residuals, table)
