"""Model curves of posterior draws at the measured states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from biaxbayes.inference.assemble import mounting_names
from biaxbayes.inference.posterior import Posterior
from biaxbayes.mechanics.goh import cauchy_stress
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
    fibre_switch : bool
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
    fibre_switch: bool
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
            settings.fibre_switch,
            np.concatenate(thinned.scatter),
        )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.measured)

    def mounting_stretch(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Mounting stretch of each draw at each row, shape (draws, rows or 1, 2)."""
        if not self.mounts:
            return np.ones((len(draws["C1"]), 1, 2))
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
        lm = self.mounting_stretch(draws)
        total = self.stretch[None] * lm
        column = {k: np.asarray(draws[k])[:, None] for k in ("C1", "k1", "k2", "alpha", "kappa")}
        stress = cauchy_stress(
            column["C1"],
            column["k1"],
            column["k2"],
            np.deg2rad(column["alpha"]),
            column["kappa"],
            total[..., 0],
            total[..., 1],
            fibre_switch=self.fibre_switch,
        )
        # f_k = A P_k(l lm); dimensions of the mounted state: times lm_k
        mounted = self.specimen.geometry == "mounted"
        load = np.stack(stress, axis=-1) / (self.stretch[None] if mounted else total)
        return load * self._section(draws) + self._offset(draws)

    def _section(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        n = len(draws["C1"])
        one = np.ones(n)
        edge = np.column_stack([draws.get("edge_y", one), draws.get("edge_x", one)])
        thickness = np.asarray(draws.get("thickness", one))[:, None]
        return (self.specimen.area * edge * thickness)[:, None, :]

    def _offset(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        zero = np.zeros(len(draws["C1"]))
        pair = [draws.get(f"load_offset_{axis}", zero) for axis in "xy"]
        return np.column_stack(pair)[:, None, :]

    def noise(self, draws: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray | None]:
        """Noise sd, shape (draws, 1, 1), and its growth with the load or None."""
        growth = draws.get("noise_growth")
        return (
            np.asarray(draws["noise_sd"])[:, None, None],
            None if growth is None else np.asarray(growth)[:, None, None],
        )

    @staticmethod
    def total_sd(model: np.ndarray, noise: tuple[np.ndarray, np.ndarray | None]) -> np.ndarray:
        """Standard deviation of one reading, broadcastable with the model."""
        w, b = noise
        # sd^2 = w^2 + (b f)^2
        return w if b is None else np.sqrt(w**2 + (b * model) ** 2)

    def with_noise(
        self,
        model: np.ndarray,
        noise: tuple[np.ndarray, np.ndarray | None],
        rng: np.random.Generator,
    ) -> np.ndarray:
        """New measurements around the model, same shape."""
        return model + self.total_sd(model, noise) * rng.standard_normal(model.shape)

    def log_likelihood(
        self, model: np.ndarray, noise: tuple[np.ndarray, np.ndarray | None]
    ) -> np.ndarray:
        """Pointwise, untempered log likelihood of one reading a row, shape (draws, rows, 2)."""
        sd = self.total_sd(model, noise)
        square = (self.measured[None] - model) ** 2 + self.scatter
        return -0.5 * square / sd**2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi)
