"""Averaging of every k consecutive rows of a path, with the scatter of their loads about a trend.

    sum_j (f_j - m_j)^2 = k [(mean f - m)^2 + scatter]

for a residual that hardly changes within k rows, so that a Gaussian likelihood loses nothing. Bins
of equal length instead would give less weight to slowly recorded parts of a path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.protocol import CURVES
from biaxbayes.specimens.specimen import Specimen

AUTO_ABOVE = 200  # rows of a protocol, without those at rest, from which ``auto`` averages
AUTO_ROWS = 100  # largest number of rows of a protocol after ``auto``
MIN_ROWS = 10


@dataclass(frozen=True)
class AveragedSpecimen:
    """A specimen with averaged rows, those at rest unchanged."""

    specimen: Specimen
    # mean square about the trend in each averaged row, (n_p, 2), load units squared
    scatter: tuple[np.ndarray, ...]
    weight: tuple[float, ...]  # rows of the record per row left, by protocol


def rows_to_keep(specimen: Specimen, max_rows: int | str, *, automatic: bool) -> int:
    """Maximum number of rows per protocol; 0 keeps all, as ``auto`` does if not `automatic`."""
    if max_rows == "auto":
        longest = max(p.rows - p.rest_rows for p in specimen.protocols)
        return AUTO_ROWS if automatic and longest > AUTO_ABOVE else 0
    if max_rows == "none":
        return 0
    try:
        rows = int(max_rows)
    except (TypeError, ValueError):
        problem, remedy = f"cannot average to {max_rows!r} rows", "a number, none or auto"
        raise InputError(problem, remedy=remedy) from None
    if rows and rows < MIN_ROWS:
        problem, remedy = f"{rows} rows per protocol leave no curve", f"{MIN_ROWS} or more, or none"
        raise InputError(problem, remedy=remedy)
    return rows


def average_rows(specimen: Specimen, rows: int) -> AveragedSpecimen:
    """Average consecutive rows to at most `rows` per protocol after those at rest; 0 keeps all."""
    protocols, scatter, weight = [], [], []
    for protocol in specimen.protocols:
        count = protocol.rows - protocol.rest_rows
        size = -(-count // rows) if rows else 1
        load = specimen.load(protocol)[protocol.rest_rows :]
        # Even groups: a short last one, where residuals are largest, would weigh as a full one.
        groups = -(-count // max(size, 1))
        starts = np.arange(groups) * count // max(groups, 1)
        weight.append(count / max(len(starts), 1))
        if size <= 1:
            protocols.append(protocol)
            scatter.append(np.zeros_like(load))
            continue
        scatter.append(_scatter(load, starts))
        means: dict[str, Any] = {}
        for key in (*CURVES, "time_s"):
            column = getattr(protocol, key)
            if column is not None:
                rest, after = np.split(column, [protocol.rest_rows])
                sums = np.add.reduceat(after, starts)
                means[key] = np.concatenate([rest, sums / np.diff([*starts, count])])
        protocols.append(replace(protocol, **means))
    if any(mean is not p for mean, p in zip(protocols, specimen.protocols, strict=True)):
        specimen = replace(specimen, protocols=tuple(protocols))
    return AveragedSpecimen(specimen, tuple(scatter), tuple(weight))


def averaged_specimen(specimen: Specimen, rows: int) -> Specimen:
    """Average rows, and keep the load noise."""
    averaged = average_rows(specimen, rows).specimen
    further = tuple(averaged_specimen(piece, rows) for piece in specimen.further)
    return replace(averaged.with_noise_of(specimen), further=further)


def _scatter(load: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Mean square about a line in each group of rows, shape (groups, 2)."""
    out = np.full((len(starts), 2), np.nan)
    ends = [*starts[1:], len(load)]
    for i, (first, last) in enumerate(zip(starts, ends, strict=True)):
        k = last - first
        if k == 1:
            out[i] = 0.0
        elif k > 2:
            # k - 2 degrees of freedom about a line, k - 1 about the mean
            t = np.arange(k) - 0.5 * (k - 1)
            y = load[first:last] - load[first:last].mean(axis=0)
            slope = t @ y / (t @ t)
            out[i] = ((y - t[:, None] * slope) ** 2).sum(axis=0) * (k - 1) / (k - 2) / k
    pairs = np.isnan(out[:, 0])
    if pairs.any():
        # var(second difference) = 6 sd^2; the mean square of two about their mean is sd^2 / 2
        bend = np.diff(load, n=2, axis=0)
        out[pairs] = (bend**2).mean(axis=0) / 12.0 if len(bend) else 0.0
    return out
