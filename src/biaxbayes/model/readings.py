"""The readings that a likelihood compares, as one vector, and their places on the paths.

First the mounting readings, x and y of each mounted state; then, protocol by protocol, the rows in
x and those in y. Neighbouring rows may be averaged into one reading: the model's loads are computed
at every row and averaged in the same way, so that nothing is lost of a curve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.error_model import HALF_LOG_2PI
from biaxbayes.forward import ForwardModel, MeasuredRows
from biaxbayes.model.misfit import CurvePoints, SmoothMisfit
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import ThinnedSpecimen

LEAST_NOISE = 1e-4
"""Least noise of a reading under a smooth misfit, as a fraction of the largest load."""
CURVE_READINGS = 64
"""Readings of all curves in one direction, from 20 to 32 a curve: a smooth misfit is resolved."""
FEWEST_READINGS, MOST_READINGS = 20, 32


@dataclass(frozen=True, eq=False)
class ReadingVector:
    """How rows make up the vector of readings; n readings.

    Attributes
    ----------
    index : int64 ndarray, shape (rows, 2)
        The reading that the load of a row belongs to, in x and y.
    share : ndarray, shape (rows,)
        Weight of a row in the mean.
    weight : ndarray, shape (n,)
        Number of recorded loads that a reading is the mean of; one for a mounting reading.
    scatter : ndarray, shape (n,)
        Mean square scatter of those loads about their mean, where the record was averaged.
    mounted : int
        Number of mounting readings, which come first.
    """

    index: np.ndarray
    share: np.ndarray
    weight: np.ndarray
    scatter: np.ndarray
    mounted: int

    @classmethod
    def from_rows(
        cls, rows: MeasuredRows, thinned: ThinnedSpecimen, mounted: int, *, average: bool
    ) -> ReadingVector:
        """Of the rows of a specimen; ``average`` them to what a smooth misfit needs."""
        protocols = len(rows.names)
        most = int(np.clip(CURVE_READINGS // protocols, FEWEST_READINGS, MOST_READINGS))
        index, share = np.zeros(rows.load.shape, dtype=np.int64), np.zeros(len(rows.load))
        weight, scatter = [np.ones(mounted)], [np.zeros(mounted)]
        first = mounted
        for p in range(protocols):
            at = np.flatnonzero(rows.protocol == p)
            groups = min(len(at), most) if average else len(at)
            # as many rows in each group as in every other, to one
            group = np.arange(len(at)) * groups // max(len(at), 1)
            size = np.bincount(group, minlength=groups)
            index[at] = first + group[:, None] + np.array([0, groups])
            share[at] = 1.0 / size[group]
            weight.append(np.tile(thinned.weight[p] * size, 2))
            of_group = np.stack([np.bincount(group, column) for column in rows.scatter[at].T])
            scatter.append((of_group / size).ravel())
            first += 2 * groups
        return cls(index, share, np.concatenate(weight), np.concatenate(scatter), mounted)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Values (rows, 2) averaged to the readings after the mounting ones, (n,); those are 0."""
        out = np.zeros(len(self.weight))
        np.add.at(out, self.index, self.share[:, None] * values)
        return out


# --- independent errors --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class IndependentErrors:
    """Likelihood of readings with independent normal errors of one sd w, which is sampled.

    The mounting readings have the load cell's own sd.
    """

    readings: ReadingVector
    mounting_sd: np.ndarray  # (mounting readings,)

    def log_likelihood(self, residual: np.ndarray, noise_sd: np.ndarray) -> np.ndarray:
        """Log likelihood of residuals (draws, n) at noise sds (draws,)."""
        count = self.readings.mounted
        weight, w = self.readings.weight[count:], noise_sd[:, None]
        # k readings of mean square scatter about their mean: k [ln N(mean) - scatter / (2 w^2)]
        square = residual[:, count:] ** 2 + self.readings.scatter[count:]
        curves = -0.5 * square / w**2 - np.log(w) - HALF_LOG_2PI
        z = residual[:, :count] / self.mounting_sd
        mounting = -0.5 * z**2 - np.log(self.mounting_sd) - HALF_LOG_2PI
        return np.asarray(curves @ weight + mounting.sum(axis=1))


# --- places of readings on the paths of the test -------------------------------------------------

SAME_PATH = 0.03
"""Distance, over the reach of a protocol, within which a path runs along it."""


@dataclass(frozen=True, eq=False)
class TestedPaths:
    """Paths of a specimen's protocols, and the smooth loads of its least-squares fit along them."""

    specimen: Specimen
    forward: ForwardModel
    fitted: Mapping[str, Any]  # material and mounting stretches of the fit, by name

    @cached_property
    def span(self) -> np.ndarray:
        """Largest log stretch in x and y."""
        logs = [np.abs(np.log(p.stretch)).max(axis=0) for p in self.specimen.protocols]
        return np.maximum(np.max(logs, axis=0), 1e-6)

    @cached_property
    def reach(self) -> np.ndarray:
        """Largest distance from the mounted state of each protocol, (protocols,)."""
        far = [np.linalg.norm(p.stretch - 1.0, axis=1).max() for p in self.specimen.protocols]
        return np.maximum(far, 1e-6)

    def load(self, stretch: np.ndarray, protocol: int | None) -> np.ndarray:
        """Loads of the fit at measured stretches, (m, 2)."""
        names = [p.name for p in self.specimen.protocols]
        name = names[0 if protocol is None else protocol]
        return np.asarray(self.forward.load(self.fitted, stretch, name)[0])

    def start(self, protocol: int) -> CurvePoints:
        """The mounted state, as the first point of the curves of a protocol."""
        return self._points(np.ones((1, 2)), np.zeros(1), protocol)

    def tested(self, protocol: int, stretch: np.ndarray) -> CurvePoints:
        """Points of a protocol at its measured stretches (m, 2), all in the order of the test."""
        steps = np.diff(np.vstack([np.ones(2), stretch]), axis=0)
        along = np.cumsum(np.linalg.norm(steps, axis=1))
        return self._points(stretch, along / max(float(along[-1]), 1e-12), protocol)

    def path(self, stretch: np.ndarray, protocol: int | None = None) -> CurvePoints:
        """Points of any path of measured stretches (m, 2), which may run along a protocol."""
        protocol = self._protocol_along(stretch) if protocol is None else protocol
        reach = self.reach.mean() if protocol is None else self.reach[protocol]
        position = np.linalg.norm(stretch - 1.0, axis=1) / reach
        return self._points(stretch, position, protocol)

    def _points(
        self, stretch: np.ndarray, position: np.ndarray, protocol: int | None
    ) -> CurvePoints:
        load, m = self.load(stretch, protocol), len(stretch)
        peak = self.peaks[protocol] if protocol is not None else np.abs(load).max(axis=0)
        return CurvePoints(
            protocol=np.full(2 * m, -1 if protocol is None else protocol),
            axis=np.repeat([0, 1], m),
            path=np.tile(position, 2),
            plane=np.tile(np.log(stretch) / self.span, (2, 1)),
            load=load.T.ravel(),
            peak=np.repeat(peak, m),
        )

    @cached_property
    def peaks(self) -> np.ndarray:
        """Largest load of the fit in x and y of each protocol, (protocols, 2)."""
        out = []
        for i, p in enumerate(self.specimen.protocols):
            out.append(np.abs(self.load(p.stretch, i)).max(axis=0))
        return np.array(out)

    def _protocol_along(self, stretch: np.ndarray) -> int | None:
        """The protocol that a path of measured stretches runs along; None if there is none."""
        far = np.linalg.norm(stretch - 1.0, axis=1)
        best, least = None, SAME_PATH
        for i, p in enumerate(self.specimen.protocols):
            inside = far <= (1.0 + SAME_PATH) * self.reach[i]
            if not inside.any() or far[inside].max() < 0.5 * min(self.reach[i], far.max()):
                continue
            apart = np.linalg.norm(stretch[inside, None] - p.stretch[None], axis=2).min(axis=1)
            if apart.max() / self.reach[i] < least:
                best, least = i, float(apart.max() / self.reach[i])
        return best


def smooth_misfit(
    paths: TestedPaths,
    rows: MeasuredRows,
    readings: ReadingVector,
    mount: np.ndarray,
    mounting_sd: np.ndarray,
    toe: float,
) -> SmoothMisfit:
    """The smooth misfit of a specimen's readings.

    Parameters
    ----------
    mount : int ndarray, shape (protocols,)
        Index of the mounted state of each protocol.
    mounting_sd : ndarray, shape (mounting readings,)
        Noise of the mounting readings.
    """
    n, specimen = len(readings.weight), paths.specimen
    parts, observed, first = [], np.zeros((n, 0)), readings.mounted
    for i in range(len(rows.names)):
        at = rows.protocol == i
        index = readings.index[at]
        own = np.unique(index)  # readings of x, then of y
        curve = paths.tested(i, rows.stretch[at])
        averaged = _averaged(curve, index.T.ravel() - first, np.tile(readings.share[at], 2))
        parts += [paths.start(i), averaged]
        of_start = np.zeros((n, 2))
        if readings.mounted:
            state = mount[i]
            pooled = int((mount == state).sum())
            of_start[[2 * state, 2 * state + 1], [0, 1]] = 1.0 / pooled
        of_rows = np.zeros((n, len(own)))
        of_rows[own, np.arange(len(own))] = 1.0
        observed = np.hstack([observed, of_start, of_rows])
        first += len(own)
    noise = max(specimen.noise_sd, LEAST_NOISE * specimen.peak_load)
    sd = noise / np.sqrt(readings.weight)
    sd[: readings.mounted] = np.maximum(mounting_sd, LEAST_NOISE * specimen.peak_load)
    return SmoothMisfit(CurvePoints.joined(parts), observed, sd, toe, len(rows.names))


def _averaged(points: CurvePoints, group: np.ndarray, share: np.ndarray) -> CurvePoints:
    """Points averaged in groups."""
    size = int(group.max()) + 1

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(group, share * values, minlength=size)

    return CurvePoints(
        np.rint(mean(points.protocol)).astype(int),
        np.rint(mean(points.axis)).astype(int),
        mean(points.path),
        np.stack([mean(column) for column in points.plane.T], axis=1),
        mean(points.load),
        mean(points.peak),
    )
