"""A piece of the tissue as a likelihood sees it: its rows, its readings, its forward model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.forward import ForwardModel
from biaxbayes.model.readings import IndependentErrors, ReadingVector
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
    def independent_errors(self) -> IndependentErrors:
        """Independent errors of the readings."""
        return IndependentErrors(self.readings, self.mounting_sd)

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
