"""Laws fitted and sampled on a record without a part of it, and weights by what they foretell.

Each protocol is left out in turn; of a single protocol, each quarter of its path. The mounting
constraint and the error model are the same for every law.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that foretells left-out readings best. With p_ki the density that model k gives
to reading i, b_i what the reading is worth, and a Dirichlet prior (a, ..., a) towards equal
weights,

    maximise  sum_i b_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

Evidences are not used: those of likelihoods with different powers cannot be compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import NotConverged
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.prediction.bands import evenly_chosen, mixture_percentiles
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen

__all__ = [
    "PRIOR_READINGS",
    "WHOLE",
    "Part",
    "Prediction",
    "Task",
    "mixed_percentiles",
    "only",
    "parts_of",
    "sample_part",
    "stacking_weights",
    "weighted_density",
]

WHOLE = "whole record"
QUARTERS = 4
KEPT_DRAWS, KEPT_OF_PART = 2000, 500
"""Draws kept of the posterior of a whole record, and of one with a part left out."""


# --- what is left out ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """A part of a record that is left out.

    Attributes
    ----------
    name : str
        Of the protocol, with the quarter where it has only one.
    protocol : int
    rows : slice
        Of the protocol, those at rest included in the count and never left out.
    """

    name: str
    protocol: int
    rows: slice


def parts_of(specimen: Specimen) -> tuple[Part, ...]:
    """Each protocol, or each quarter of the only one.

    Parameters
    ----------
    specimen : Specimen
    """
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
        kept = tuple(p for i, p in enumerate(specimen.protocols) if i != part.protocol)
        return replace(specimen, protocols=kept)
    only = specimen.protocols[0]
    rows = np.ones(only.rows, dtype=bool)
    rows[part.rows] = False
    columns = {k: getattr(only, k)[rows] for k in ("stretch_x", "stretch_y", "load_x", "load_y")}
    return replace(specimen, protocols=(replace(only, **columns, time_s=None),))


def only(specimen: Specimen, part: Part) -> Specimen:
    """The rows at rest and those of a part of the record."""
    p = specimen.protocols[part.protocol]
    rows = np.r_[np.arange(p.rest_rows), np.arange(p.rows)[part.rows]]
    columns = {k: getattr(p, k)[rows] for k in ("stretch_x", "stretch_y", "load_x", "load_y")}
    return replace(specimen, protocols=(replace(p, **columns, time_s=None),))


# --- one posterior -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """One law on one record.

    Attributes
    ----------
    law : str
    specimen : Specimen
        Of the whole record.
    part : Part or None
        What is left out.
    options : mapping
        Keyword arguments of :class:`~biaxbayes.model.posterior.Posterior` but the law, its priors
        and its switch.
    seed : int
    ess : float
        Effective draws wanted.
    max_steps : int
    """

    law: str
    specimen: Specimen
    part: Part | None
    options: Mapping[str, Any]
    seed: int
    ess: float
    max_steps: int

    @property
    def name(self) -> str:
        """Of the law and of what is left out."""
        return f"{self.law}, {self.part.name if self.part else WHOLE}"


@dataclass(frozen=True)
class Prediction:
    """Draws of one law on one record.

    Attributes
    ----------
    state : str
        Of the chains; ``failed`` where nothing could be drawn.
    reason : str
    rmse_kPa : float
        Of the deterministic fit to the record.
    residuals : tuple of ndarray, shape (n_p, 2)
        Of that fit.
    draws : DataFrame
        Columns as in ``summary.csv``; empty where nothing could be drawn.
    """

    state: str
    reason: str
    rmse_kPa: float
    residuals: tuple[np.ndarray, ...]
    draws: pd.DataFrame


def sample_part(task: Task) -> Prediction:
    """Fit and sample a law on a record without the part.

    Parameters
    ----------
    task : Task

    Returns
    -------
    Prediction
        ``failed`` with its reason where nothing can be drawn; nothing is raised for it.
    """
    shown = task.specimen if task.part is None else without(task.specimen, task.part)
    nothing = pd.DataFrame()
    rmse = float("nan")
    residuals: tuple[np.ndarray, ...] = ()
    try:
        posterior = prepare(shown, law=task.law, seed=task.seed, **task.options)
        assert posterior.fit is not None
        rmse, residuals = posterior.fit.rmse_kPa, posterior.fit.residuals
        plan = Plan(ess=task.ess, max_steps=task.max_steps, seed=task.seed, workers=1)
        drawn = draw_posterior(posterior, plan)
    except (NotConverged, np.linalg.LinAlgError) as error:
        return Prediction("failed", str(error), rmse, residuals, nothing)
    kept = KEPT_DRAWS if task.part is None else KEPT_OF_PART
    table = pd.DataFrame({k: v.ravel() for k, v in drawn.quantities.items()})
    table = table.iloc[evenly_chosen(len(table), kept)].reset_index(drop=True)
    judged = drawn.convergence
    return Prediction(judged.state, judged.reason, rmse, residuals, table)


# --- weights of models by what they predict of records that were left out ------------------------

PRIOR_READINGS = 1.0
"""Readings that the Dirichlet prior is worth in all, a = 1 + 1 / models: further models do not make
it stronger."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray, worth: np.ndarray) -> np.ndarray:
    """Weights of the mixture that foretells left-out readings best.

    Parameters
    ----------
    log_density : ndarray, shape (models, readings)
        Log predictive density of each left-out reading; -inf where a model excludes it.
    worth : ndarray, shape (readings,)
        Independent readings that each is worth.

    Returns
    -------
    ndarray, shape (models,)
        Positive, of sum one.
    """
    models = len(log_density)
    top = log_density.max(axis=0)
    known = np.isfinite(top)  # a reading that all models exclude says nothing of their weights
    density = np.exp(log_density[:, known] - top[known])
    worth = worth[known]
    weight = np.full(models, 1.0 / models)
    prior = PRIOR_READINGS / models  # a - 1
    total = worth.sum() + PRIOR_READINGS
    for _ in range(_STEPS):
        # expectation maximisation: the share of every reading that each model explains
        share = weight[:, None] * density
        mixture = share.sum(axis=0)
        explained = (share / mixture) @ worth + prior
        new = explained / total
        if np.abs(new - weight).max() < _TOLERANCE:
            return new
        weight = new
    return weight


def weighted_density(log_density: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Log density of a mixture.

    Parameters
    ----------
    log_density : ndarray, shape (models, readings)
    weight : ndarray, shape (models,)

    Returns
    -------
    ndarray, shape (readings,)
    """
    with np.errstate(divide="ignore"):
        mixed: np.ndarray = np.logaddexp.reduce(log_density + np.log(weight)[:, None], axis=0)
    return mixed


def mixed_percentiles(
    model: Sequence[np.ndarray],
    sd: Sequence[np.ndarray],
    weight: np.ndarray,
    levels: tuple[float, ...],
) -> list[np.ndarray]:
    """Percentiles of a mixture: each law gives draws in proportion to its weight.

    Parameters
    ----------
    model, sd : sequence of ndarray, shape (draws, readings)
        Of each law: its curves, and the sds of readings about them.
    weight : ndarray, shape (laws,)
    levels : tuple of float
    """
    size = min(len(m) for m in model)
    counts = np.round(weight * size).astype(int)
    counts[np.argmax(weight)] += size - counts.sum()
    chosen = [evenly_chosen(len(m), max(int(n), 1)) for m, n in zip(model, counts, strict=True)]
    kept = [k for k, n in enumerate(counts) if n > 0]
    return mixture_percentiles(
        np.vstack([model[k][chosen[k]] for k in kept]),
        np.vstack([sd[k][chosen[k]] for k in kept]),
        levels,
    )
