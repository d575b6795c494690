"""A piece of the tissue as a likelihood sees it: its rows, readings, forward model and errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.forward import ForwardModel
from biaxbayes.model.misfit import CurvePoints, SmoothMisfit
from biaxbayes.model.readings import LEAST_NOISE, SHARED_NOISE, ReadingVector, TestedPaths
from biaxbayes.normal_errors import HALF_LOG_2PI
from biaxbayes.options import Settings
from biaxbayes.parameters import PieceLabels
from biaxbayes.specimens.rows import MeasuredRows
from biaxbayes.specimens.specimen import Specimen


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece of a tissue; n readings, m mounted states."""

    specimen: Specimen
    settings: Settings
    labels: PieceLabels

    @classmethod
    def of_tissue(cls, specimen: Specimen, settings: Settings) -> tuple[Piece, ...]:
        """All pieces of a specimen."""
        quantities = specimen.quantities(settings.material_law.parameters, shared=settings.shared)
        pairs = zip(specimen.pieces, quantities.pieces, strict=True)
        return tuple(cls(piece, settings, labels) for piece, labels in pairs)

    def title(self, protocol: str) -> str:
        """What a protocol is called among those of all pieces."""
        label = self.labels.label
        if not label or len(self.specimen.protocols) == 1:
            return label or protocol
        return f"{label}: {protocol}"

    @cached_property
    def rows(self) -> MeasuredRows:
        """The rows after the mounted state: zeroed and averaged according to the settings."""
        how = self.settings
        return MeasuredRows.from_specimen(
            self.specimen, shared=how.shared, mounting=how.mounting, max_rows=how.max_rows
        ).loaded()

    @cached_property
    def forward(self) -> ForwardModel:
        """From quantities of draws to loads."""
        return ForwardModel.from_specimen(self.specimen, self.settings, self.labels.label)

    @property
    def reads_force(self) -> bool:
        """Whether mounting forces are among the readings."""
        return self.settings.reads_force and self.specimen.experiment.is_mounted

    @cached_property
    def readings(self) -> ReadingVector:
        """How the rows make up the vector of readings."""
        return ReadingVector.from_rows(
            self.rows,
            states=len(self.rows.mounting_load) if self.reads_force else 0,
            average=self.settings.has_misfit,
        )

    def readings_of(self, protocol: int) -> int:
        """Number of readings of each curve of a protocol."""
        index = self.readings.index[self.rows.protocol == protocol]
        return len(np.unique(index[index >= 0])) // len(self.specimen.experiment.axes)

    @cached_property
    def mounting_sd(self) -> np.ndarray:
        """Noise of the mounting readings; empty where there are none."""
        sd = self.rows.mounting_sd[:, list(self.specimen.experiment.axes)]
        return sd.ravel() if self.reads_force else np.empty(0)

    @cached_property
    def measured(self) -> np.ndarray:
        """All readings, (n,)."""
        out = self.readings.means(self.rows.load)
        states = self.readings.mounting_index
        out[states[states >= 0]] = self.rows.mounting_load[: len(states)][states >= 0]
        return out

    def residuals(self, values: Any) -> np.ndarray:
        """Readings less model loads of draws, (draws, n), from natural values by name."""
        forward, rows, readings = self.forward, self.rows, self.readings
        offset = forward.offset(values)
        parts = [
            forward.load(values, rows.stretch[rows.protocol == i], name) + offset
            for i, name in enumerate(rows.names)
        ]
        model = np.array([readings.means(draw) for draw in np.concatenate(parts, axis=1)])
        for state, index in zip(self.labels.states, readings.mounting_index, strict=False):
            load = forward.mounting_load(values, state) + offset[:, 0]
            read = index >= 0
            model[:, index[read]] = load[:, read]
        return np.asarray(self.measured - model)

    def independent_log_likelihood(self, residual: np.ndarray, noise_sd: np.ndarray) -> np.ndarray:
        """Log likelihood of residuals (draws, n) with independent errors of sds w (draws,).

        The errors of a tube's axial force are in proportion to those of the pressure, as the
        largest readings are. The mounting readings have the load cell's own sd.
        """
        readings, count = self.readings, self.readings.mounting_count
        w = noise_sd[:, None] * readings.scale[count:]
        # k readings of mean square scatter about their mean: k [ln N(mean) - scatter / (2 w^2)]
        square = residual[:, count:] ** 2 + readings.scatter[count:]
        curves = -0.5 * square / w**2 - np.log(w) - HALF_LOG_2PI
        z = residual[:, :count] / self.mounting_sd
        mounting = -0.5 * z**2 - np.log(self.mounting_sd) - HALF_LOG_2PI
        # a sum row by row, which does not depend on the number of draws as a product does
        return np.asarray((curves * readings.weight[count:]).sum(axis=1) + mounting.sum(axis=1))

    def smooth_misfit(self, paths: TestedPaths, chosen: np.ndarray | None) -> SmoothMisfit:
        """The smooth misfit of the law, of the ``chosen`` terms or of all."""
        rows, readings, axes = self.rows, self.readings, self.specimen.experiment.axes
        n, count = len(readings.weight), readings.mounting_count
        parts, observed, first = [], [], count
        for i, state in enumerate(rows.state_of_protocol):
            at = rows.protocol == i
            index = readings.index[at][:, axes]
            own = np.unique(index)
            curve, start = (
                points.take(np.flatnonzero(np.isin(points.axis, axes)))
                for points in (paths.tested(i, rows.stretch[at]), paths.start(i))
            )
            share = np.repeat(readings.share[at], len(axes))
            parts += [start, curve.averaged(index.ravel() - first, share)]
            of_start = np.zeros((n, len(axes)))
            if count:
                pooled = int((rows.state_of_protocol == state).sum())
                of_start[readings.mounting_index[state, axes], range(len(axes))] = 1.0 / pooled
            observed += [of_start, np.eye(n)[:, own]]
            first += len(own)
        least = LEAST_NOISE * self.specimen.peak_loads
        noise = np.maximum(self.specimen.noise_sds, least)
        sd = noise[readings.axis] * np.maximum(1.0 / np.sqrt(readings.weight), SHARED_NOISE)
        floor = np.maximum(SHARED_NOISE * noise, least)
        sd[:count] = np.maximum(self.mounting_sd, floor[readings.axis[:count]])
        points = CurvePoints.joined(parts)
        toe, protocols = self.settings.toe, len(rows.names)
        return SmoothMisfit(points, np.hstack(observed), sd, toe, protocols, chosen)
