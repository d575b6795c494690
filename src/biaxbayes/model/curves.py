"""Model curves of posterior draws at the measured states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from biaxbayes.laws.law import Law
from biaxbayes.mechanics.mounting import load_per_stress, sections
from biaxbayes.model.error_model import ErrorModel, errors_of
from biaxbayes.model.layout import mounting_names
from biaxbayes.model.posterior import Posterior
from biaxbayes.specimens.specimen import Specimen

__all__ = ["Curves"]


@dataclass(frozen=True)
class Curves:
    """The rows that a posterior was conditioned on, and its model of them.

    Attributes
    ----------
    specimen : Specimen
    stretch, measured : ndarray, shape (rows, 2)
        Measured stretches and loads after the mounted state, protocol after protocol.
    protocol : ndarray of int, shape (rows,)
    mounts : tuple of str
        Labels of the mounted states; empty for the classical mistakes, where lm = 1.
    mounting_reading, mounting_reading_sd : ndarray, shape (m, 2)
    law : Law
    errors : ErrorModel
    scatter : ndarray, shape (rows, 2), or 0
        Mean square scatter of the readings that a measured load is the mean of.
    """

    specimen: Specimen
    stretch: np.ndarray
    measured: np.ndarray
    protocol: np.ndarray
    mounts: tuple[str, ...]
    mounting_reading: np.ndarray
    mounting_reading_sd: np.ndarray
    law: Law
    errors: ErrorModel
    scatter: np.ndarray | float = 0.0

    @classmethod
    def of(cls, posterior: Posterior) -> Curves:
        """The curves of a posterior's own specimen."""
        settings = posterior.settings
        specimen = posterior.specimen
        thinned = posterior.thinned
        data = thinned.specimen
        stretch, measured, protocol = [], [], []
        for i, p in enumerate(data.protocols):
            kept = slice(p.rest_rows, None)
            stretch.append(np.column_stack([p.stretch_x, p.stretch_y])[kept])
            measured.append(data.load(p)[kept])
            protocol.append(np.full(p.rows - p.rest_rows, i))
        reading, sd = specimen.mounting_readings(shared=settings.mounting_stretch == "shared")
        return cls(
            specimen,
            np.concatenate(stretch),
            np.concatenate(measured),
            np.concatenate(protocol),
            posterior.mounts if settings.infers_mounting else (),
            reading,
            sd,
            settings.material_law,
            errors_of(settings),
            np.concatenate(thinned.scatter),
        )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.measured)

    def mounting_stretch(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Mounting stretch of each draw at each row, shape (draws, rows or 1, 2)."""
        if not self.mounts:
            return np.ones((len(draws["noise_sd"]), 1, 2))
        per_mount = [
            np.column_stack([draws[n] for n in mounting_names("stretch", label)])
            for label in self.mounts
        ]
        if len(per_mount) == 1:
            return per_mount[0][:, None, :]
        return np.stack(per_mount, axis=1)[:, self.protocol]

    def model(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Model load of each draw, shape (draws, rows, 2), in the specimen's unit.

        Parameters
        ----------
        draws : mapping of str to ndarray, shape (draws,)
            Natural quantities by the names of ``summary.csv``.
        """
        total = self.stretch[None] * self.mounting_stretch(draws)
        stress = self.law.material(draws).cauchy(total[..., 0], total[..., 1])
        return self.load_per_stress(draws) * np.stack(stress, axis=-1) + self.offset(draws)

    def load_per_stress(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Load per Cauchy stress of each draw at each row, shape (draws, rows, 2)."""
        mounted = self.specimen.geometry == "mounted"
        lm = self.mounting_stretch(draws)
        return load_per_stress(self._section(draws), self.stretch[None], lm, mounted)

    def _section(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Load per kPa of each draw, shape (draws, 1, 2)."""
        one = np.ones(len(draws["noise_sd"]))
        factors = (np.asarray(draws.get(name, one)) for name in ("edge_x", "edge_y", "thickness"))
        return np.column_stack(sections(self.specimen.area, *factors))[:, None, :]

    def offset(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Zero of the load cell in each draw, shape (draws, 1, 2)."""
        zero = np.zeros(len(draws["noise_sd"]))
        pair = [draws.get(f"load_offset_{axis}", zero) for axis in "xy"]
        return np.column_stack(pair)[:, None, :]

    def noise(self, draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Parameters of the errors by name, each of shape (draws, 1, 1)."""
        return {p.name: np.asarray(draws[p.name])[:, None, None] for p in self.errors.parameters}

    def total_sd(self, model: np.ndarray, noise: Mapping[str, np.ndarray]) -> np.ndarray:
        """Standard deviation of one reading, broadcastable with the model."""
        return self.errors.sd(noise, model)

    def with_noise(
        self, model: np.ndarray, noise: Mapping[str, np.ndarray], rng: np.random.Generator
    ) -> np.ndarray:
        """New measurements around the model, same shape."""
        return self.errors.simulate(noise, model, rng)

    def log_likelihood(self, model: np.ndarray, noise: Mapping[str, np.ndarray]) -> np.ndarray:
        """Pointwise, unweighted log likelihood of one reading a row, shape (draws, rows, 2)."""
        return self.errors.log_likelihood(noise, model, self.measured[None], self.scatter)
