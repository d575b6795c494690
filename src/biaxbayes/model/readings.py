"""The readings of a piece that a likelihood compares, as one vector, and their places on the paths.

First the mounting readings, x and y of each mounted state; then x and y of each row; of a strip,
those along it alone. Neighbouring rows may be averaged into one reading: the model's loads are
computed at every row and averaged in the same way, so that nothing is lost of a curve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.forward import ForwardModel
from biaxbayes.model.misfit import CurvePoints
from biaxbayes.specimens.rows import MeasuredRows
from biaxbayes.specimens.specimen import Specimen

LEAST_NOISE = 1e-4
"""Least noise of a reading under a smooth misfit, as a fraction of the largest load."""
SHARED_NOISE = 0.5
"""Least noise of a mean of rows under a smooth misfit, over that of one: friction, drift and the
steps of a converter do not average away with the number of rows."""
CURVE_READINGS = 64
"""Readings of all curves in one direction, from 20 to 32 a curve: a smooth misfit is resolved."""
FEWEST_READINGS, MOST_READINGS = 20, 32


@dataclass(frozen=True, eq=False)
class ReadingVector:
    """How rows make up the vector of n readings."""

    index: np.ndarray  # int64 (rows, 2): the reading that the load of a row belongs to, or -1
    mounting_index: np.ndarray  # int64 (m, 2): the reading of each mounting load, or -1
    share: np.ndarray  # (rows,): weight of a row in the mean
    # (n,): recorded loads that a reading is the mean of; one for a mounting reading
    weight: np.ndarray
    # (n,): their mean square scatter about the mean, where the record was averaged
    scatter: np.ndarray
    axis: np.ndarray  # int64 (n,): direction
    scale: np.ndarray  # (n,): unit for sums over all readings: one, but of a tube's axial force

    @property
    def mounting_count(self) -> int:
        """Number of mounting readings, which come first."""
        return int((self.mounting_index >= 0).sum())

    @classmethod
    def from_rows(cls, rows: MeasuredRows, *, states: int, average: bool) -> ReadingVector:
        """Of rows and ``states`` mounted loads; ``average`` to what a smooth misfit needs."""
        (piece,) = rows.pieces
        axes = piece.experiment.axes
        mounting_count = states * len(axes)
        mounting_index = np.full((states, 2), -1)
        mounting_index[:, axes] = np.arange(mounting_count).reshape(states, len(axes))
        most = int(np.clip(CURVE_READINGS // len(rows.names), FEWEST_READINGS, MOST_READINGS))
        of_protocols, groups = [], 0
        for count in np.bincount(rows.protocol, minlength=len(rows.names)).tolist():
            own = min(count, most) if average else count
            # as many rows in each group as in every other, to one
            of_protocols.append(groups + np.arange(count) * own // max(count, 1))
            groups += own
        group = np.concatenate(of_protocols)
        share = 1.0 / np.bincount(group)[group]
        index = np.full(rows.load.shape, -1)
        index[:, axes] = mounting_count + len(axes) * group[:, None] + np.arange(len(axes))
        weight = np.repeat(np.bincount(group, rows.weight), len(axes))
        scatter = np.column_stack([np.bincount(group, share * rows.scatter[:, a]) for a in axes])
        axis = np.tile(axes, states + groups)
        return cls(
            index,
            mounting_index,
            share,
            np.concatenate([np.ones(mounting_count), weight]),
            np.concatenate([np.zeros(mounting_count), scatter.ravel()]),
            axis,
            piece.load_scale[axis],
        )

    def means(self, values: np.ndarray) -> np.ndarray:
        """Values (rows, 2) averaged to the readings after the mounting ones, (n,); those are 0."""
        out = np.zeros(len(self.weight))
        read = self.index >= 0
        np.add.at(out, self.index[read], (self.share[:, None] * values)[read])
        return out


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
        logs = [np.abs(np.log(p.known_stretch)).max(axis=0) for p in self.specimen.protocols]
        return np.maximum(np.max(logs, axis=0), 1e-6)

    @cached_property
    def reach(self) -> np.ndarray:
        """Largest distance from the mounted state of each protocol, (protocols,)."""
        stretches = [p.known_stretch for p in self.specimen.protocols]
        return np.maximum([np.linalg.norm(s - 1.0, axis=1).max() for s in stretches], 1e-6)

    def load(self, stretch: np.ndarray, protocol: int | None) -> np.ndarray:
        """Loads of the fit at measured stretches, (m, 2)."""
        name = self.specimen.protocols[protocol or 0].name
        return np.asarray(self.forward.load(self.fitted, stretch, name)[0])

    def start(self, protocol: int) -> CurvePoints:
        """The mounted state, as the first point of the curves of a protocol."""
        return self._points(np.ones((1, 2)), np.zeros(1), protocol)

    def tested(self, protocol: int, stretch: np.ndarray) -> CurvePoints:
        """Points of a protocol at its measured stretches (m, 2), all in the order of the test."""
        steps = np.diff(np.vstack([np.ones(2), known(stretch)]), axis=0)
        along = np.cumsum(np.linalg.norm(steps, axis=1))
        return self._points(stretch, along / max(float(along[-1]), 1e-12), protocol)

    def path(self, stretch: np.ndarray, protocol: int | None = None) -> CurvePoints:
        """Points of any path of measured stretches (m, 2), which may run along a protocol."""
        protocol = self._protocol_along(stretch) if protocol is None else protocol
        reach = self.reach.mean() if protocol is None else self.reach[protocol]
        position = np.linalg.norm(known(stretch) - 1.0, axis=1) / reach
        return self._points(stretch, position, protocol)

    def _points(
        self, stretch: np.ndarray, position: np.ndarray, protocol: int | None
    ) -> CurvePoints:
        load, m = self.load(stretch, protocol), len(stretch)
        peak = self.peaks[protocol] if protocol is not None else np.abs(load).max(axis=0)
        return CurvePoints(
            protocol=np.full(2 * m, -1 if protocol is None else protocol),
            axis=np.tile([0, 1], m),
            path=np.repeat(position, 2),
            plane=np.repeat(np.log(known(stretch)) / self.span, 2, axis=0),
            load=load.ravel(),
            peak=np.tile(peak, m),
        )

    @cached_property
    def peaks(self) -> np.ndarray:
        """Largest load of the fit in x and y of each protocol, (protocols, 2)."""
        tested = [p.stretch for p in self.specimen.protocols]
        return np.array([np.abs(self.load(s, i)).max(axis=0) for i, s in enumerate(tested)])

    def _protocol_along(self, stretch: np.ndarray) -> int | None:
        """The protocol that a path of measured stretches runs along; None if there is none."""
        far = np.linalg.norm(stretch - 1.0, axis=1)
        best, least = None, SAME_PATH
        for i, p in enumerate(self.specimen.protocols):
            inside = far <= (1.0 + SAME_PATH) * self.reach[i]
            if not inside.any() or np.max(far[inside]) < 0.5 * min(self.reach[i], np.max(far)):
                continue
            apart = np.linalg.norm(stretch[inside, None] - p.stretch[None], axis=2).min(axis=1)
            if apart.max() / self.reach[i] < least:
                best, least = i, float(apart.max() / self.reach[i])
        return best


def known(stretch: np.ndarray) -> np.ndarray:
    """Stretches with 1 in place of those across a strip that were not measured."""
    return np.nan_to_num(stretch, nan=1.0)
