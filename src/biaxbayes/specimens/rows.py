"""Rows of a tissue in flat arrays, as fits and likelihoods take them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from biaxbayes.specimens.averaging import average_rows
from biaxbayes.specimens.specimen import Specimen


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Rows of all protocols of all pieces, one below the other; n rows, m mounted states."""

    pieces: tuple[Specimen, ...]
    stretch: np.ndarray  # (n, 2), measured: relative to the mounted state
    # (n, 2): force (N) or first Piola-Kirchhoff stress (kPa) in the file's geometry
    load: np.ndarray
    at_rest: np.ndarray  # (n,): recorded at the mounted state, before the test starts
    protocol: np.ndarray  # (n,): index among the protocols of all pieces
    weight: np.ndarray  # (n,): number of recorded rows that a row is the mean of
    scatter: np.ndarray  # (n, 2): mean square scatter of their loads
    state_of_protocol: np.ndarray  # index of the mounted state of each protocol
    piece_of_state: np.ndarray  # (m,)
    mounting_load: np.ndarray  # (m, 2)
    mounting_sd: np.ndarray  # (m, 2)
    # (m, 2), mean and sd of the mounting stretches that the headers give; NaN for the others
    measured_mounting: np.ndarray
    measured_mounting_sd: np.ndarray

    @classmethod
    def from_specimen(
        cls, specimen: Specimen, *, shared: bool, mounting: str = "", max_rows: int = 0
    ) -> MeasuredRows:
        """Rows as a mounting mode compares them; shared: one mounted state for each piece."""
        recorded = [piece.as_compared(mounting) for piece in specimen.pieces]
        loads, sds = zip(*(p.mounting_readings(shared=shared) for p in recorded), strict=True)
        averaged = [average_rows(piece, max_rows) for piece in recorded]
        of_rows: list[tuple[Any, ...]] = []
        states: list[int] = []
        for i, part in enumerate(averaged):
            pairs = zip(part.weight, part.scatter, strict=True)
            for p, (weight, scatter) in zip(part.specimen.protocols, pairs, strict=True):
                at_rest = np.arange(p.rows) < p.rest_rows
                protocol = np.full(p.rows, len(states))
                weights = np.where(at_rest, 1.0, weight)
                scatters = np.vstack([np.zeros((p.rest_rows, 2)), scatter])
                load = part.specimen.load(p)
                of_rows.append((p.stretch, load, at_rest, protocol, weights, scatters))
                states.append(i if shared else len(states))
        counts = [len(load) for load in loads]
        known = np.repeat([p.measured_mounting for p in specimen.pieces], counts, axis=0)
        return cls(
            tuple(part.specimen for part in averaged),
            **dict(zip(OF_ROWS, map(np.concatenate, zip(*of_rows, strict=True)), strict=True)),
            state_of_protocol=np.array(states),
            piece_of_state=np.repeat(np.arange(len(loads)), counts),
            mounting_load=np.concatenate(loads),
            mounting_sd=np.concatenate(sds),
            measured_mounting=known[:, 0],
            measured_mounting_sd=known[:, 1],
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the protocols."""
        return tuple(p.name for piece in self.pieces for p in piece.protocols)

    @property
    def state(self) -> np.ndarray:
        """Index of the mounted state of each row, (n,)."""
        return np.asarray(self.state_of_protocol[self.protocol])

    @property
    def piece(self) -> np.ndarray:
        """Index of the piece of each row, (n,)."""
        return np.asarray(self.piece_of_state[self.state])

    @property
    def is_read(self) -> np.ndarray:
        """Whether a direction has readings, (n, 2)."""
        return np.array([np.isin([0, 1], p.experiment.axes) for p in self.pieces])[self.piece]

    @property
    def load_scale(self) -> np.ndarray:
        """Unit of the readings for sums over both directions, (n, 2)."""
        return np.array([p.load_scale for p in self.pieces])[self.piece]

    @property
    def is_mounted(self) -> np.ndarray:
        """Whether a mounted state has a mounting load in a direction, (m, 2)."""
        axes = [np.isin([0, 1], p.experiment.axes) & p.experiment.is_mounted for p in self.pieces]
        return np.asarray(np.array(axes)[self.piece_of_state])

    @property
    def unloaded(self) -> np.ndarray:
        """Whether the dimensions of the piece of a row are those of the unloaded state, (n,)."""
        return np.array([p.geometry != "mounted" for p in self.pieces])[self.piece]

    @property
    def peaks(self) -> np.ndarray:
        """Largest absolute load of each piece over its scale, at least the smallest number."""
        largest = np.full(len(self.pieces), 1e-300)
        np.maximum.at(largest, self.piece, np.abs(self.load / self.load_scale).max(axis=1))
        return largest

    def at(self, rows: np.ndarray) -> MeasuredRows:
        """Some of the rows, in their order."""
        return replace(self, **{name: getattr(self, name)[rows] for name in OF_ROWS})

    def loaded(self) -> MeasuredRows:
        """The rows after those at rest, which enter a posterior as the mounting reading instead."""
        return self.at(~self.at_rest)

    def chosen(self, per_protocol: int) -> MeasuredRows:
        """Evenly chosen rows of each protocol after those at rest, with the last one."""
        rows = self.loaded()
        out = []
        for p in range(len(self.names)):
            own = np.flatnonzero(rows.protocol == p)
            place = np.linspace(0, own.size - 1, min(per_protocol, own.size))
            out.append(own[place.round().astype(int)])
        return rows.at(np.concatenate(out))


OF_ROWS = ("stretch", "load", "at_rest", "protocol", "weight", "scatter")
"""Fields with one entry a row."""
