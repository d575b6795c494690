"""Laws fitted and sampled on a record without a part of it, and their predictions of that part.

Given a draw, a left-out reading is normal: its mean is the load of the law plus the misfit that the
other readings lead one to expect there, its variance that of the misfit given them plus the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.errors import NotConverged
from biaxbayes.evenly import evenly_chosen
from biaxbayes.model.draw import as_sampled, draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.readings import ReadingVector
from biaxbayes.normal_errors import log_likelihood
from biaxbayes.parameters import FORCE, STRETCH
from biaxbayes.prediction.tissue import Tissue
from biaxbayes.progress_bar import OnProgress, no_progress
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.rows import MeasuredRows
from biaxbayes.specimens.specimen import Specimen

WHOLE = "whole record"
QUARTERS = 4
MAX_LAW_DRAWS, MAX_PART_DRAWS = 2000, 500
"""Draws used of the posterior of a whole record, and of one without a part."""


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


def restricted_to(specimen: Specimen, part: Part) -> Specimen:
    """The rows at rest and those of a part of the record."""
    whole = specimen.protocols[part.protocol]
    (p,) = specimen.with_protocols([whole]).protocols
    # with_protocols put rows at rest before a protocol that does not start at the mounted state
    moved = np.arange(whole.rows)[part.rows] + (p.rows - whole.rows)
    rows = np.r_[np.arange(p.rest_rows), moved]
    return replace(specimen, protocols=(p.at_rows(rows),))


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


@dataclass(frozen=True, eq=False)
class PredictedReadings:
    """Readings as the draws of a law predict them; (draws, m, 2), or broadcast with it."""

    measured: np.ndarray  # (m, 2)
    load_per_stress: np.ndarray  # (m, 2), load per Cauchy stress at the median mounting stretch
    mean: np.ndarray  # of the tissue: the law and its misfit
    sd: np.ndarray  # of the tissue about it
    noise_sd: np.ndarray  # of a reading about the tissue

    @property
    def log_density(self) -> np.ndarray:
        """Log predictive density of each reading, (2 m,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            each = log_likelihood(self.mean, np.hypot(self.sd, self.noise_sd), self.measured)
        each = np.where(np.isfinite(each), each, -np.inf)
        # ln p(y_i | rest) = ln mean_s N(y_i | m_si, sd_si)
        return np.asarray(logsumexp(each, axis=0) - np.log(len(each))).ravel()

    @property
    def expected(self) -> np.ndarray:
        """Mean of each reading over the draws, (2 m,), without draws that overflow."""
        finite = np.isfinite(self.mean).all(axis=(1, 2))
        finite |= not finite.any()  # unless there are no others
        return np.asarray(self.mean[finite].mean(axis=0)).ravel()


@dataclass(frozen=True, eq=False)
class Prediction:
    """Draws of one law on one record, and the readings of the left-out part that they predict."""

    state: str  # of the chains; `failed` if nothing could be drawn
    reason: str
    rmse_kPa: float  # of the least-squares fit
    draws: pd.DataFrame  # as in summary.csv
    readings: PredictedReadings | None = None


def sample_part(task: Task, progress: OnProgress = no_progress) -> Prediction:
    """Fit and sample a law on a record without the part; a failure is a state, not an error."""
    shown = task.specimen if task.part is None else without(task.specimen, task.part)
    rmse = float("nan")
    try:
        posterior = prepare(shown, law=task.law, seed=task.seed, **task.options)
        rmse = posterior.fit.rmse_kPa
        plan = Plan(ess=task.ess, max_steps=task.max_steps, seed=task.seed, workers=1)
        drawn = draw_posterior(posterior, plan, progress=progress)
        posterior = as_sampled(posterior, drawn.target.constants)
    except (NotConverged, np.linalg.LinAlgError) as error:
        return Prediction("failed", str(error), rmse, pd.DataFrame())
    count = MAX_LAW_DRAWS if task.part is None else MAX_PART_DRAWS
    table = pd.DataFrame({k: v.ravel() for k, v in drawn.quantities.items()})
    table = table.iloc[evenly_chosen(len(table), count)].reset_index(drop=True)
    readings = None
    if task.part is not None:
        readings = predicted_readings(posterior, table, task.specimen, task.part)
    return Prediction(drawn.convergence.state, drawn.convergence.reason, rmse, table, readings)


def predicted_readings(
    posterior: Posterior, draws: pd.DataFrame, specimen: Specimen, part: Part
) -> PredictedReadings:
    """Readings of a part that the posterior has not seen, averaged as the likelihood would."""
    tissue = Tissue(posterior, draws)
    settings, single = posterior.settings, len(specimen.protocols) == 1
    left_out = restricted_to(specimen.as_compared(settings.mounting), part)
    rows = MeasuredRows.from_specimen(left_out, shared=True, max_rows=settings.max_rows).loaded()
    readings = ReadingVector.from_rows(rows, states=0, average=settings.has_misfit)
    count = len(readings.weight) // 2
    average = np.zeros((count, len(rows.load)))
    average[readings.index[:, 0] // 2, np.arange(len(rows.load))] = readings.share
    law = tissue.law(rows.stretch) + posterior.forward.offset(tissue.draws)
    # a quarter lies on the path of the protocol that is known
    misfit, sd = tissue.misfit(rows.stretch, 0 if single else None)
    # load per Cauchy stress at the median mounting stretch
    mounting = posterior.quantities.of_kind(STRETCH, FORCE)
    names = [q.name for q in mounting if q.name in tissue.draws]
    medians = {name: tissue.draws[name].median() for name in names}
    load_per_stress = posterior.forward.load_per_stress(medians, rows.stretch, rows.names[0])[0]
    return PredictedReadings(
        average @ rows.load,
        average @ load_per_stress,
        average @ (law + misfit),
        average @ np.broadcast_to(sd, law.shape),
        tissue.noise_sd / np.sqrt(readings.weight[::2, None]),
    )
