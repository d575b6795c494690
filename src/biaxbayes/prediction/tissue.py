"""Loads of the tissue, draw by draw: those of the law, and its misfit given the readings.

With independent errors the tissue follows the law exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from biaxbayes.model.misfit import CurvePoints, SmoothMisfit
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import NOISE_SD, name_of
from biaxbayes.prediction.percentiles import percentiles


@dataclass(frozen=True, eq=False)
class TissueLoads:
    """Loads at m states of stretch, in the unit of the specimen; shapes (draws, m, 2) or broadcast.

    For each draw the tissue's load is normal about ``mean`` with ``sd``, and a reading of it about
    ``reading`` with ``reading_sd``: with friction and the noise of the load cell.
    """

    law: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    reading: np.ndarray
    reading_sd: np.ndarray

    def percentiles(self, levels: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Percentiles (levels, m, 2) of the tissue's load, and of a new reading of it."""
        shape = self.mean.shape

        def over_draws(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
            flat, spread = (np.broadcast_to(v, shape).reshape(shape[0], -1) for v in (mean, sd))
            return percentiles(flat, spread, levels).reshape(-1, *shape[1:])

        return over_draws(self.mean, self.sd), over_draws(self.reading, self.reading_sd)


class Tissue:
    """A piece of the tissue by the draws of its posterior (natural values by name)."""

    def __init__(
        self, posterior: Posterior, draws: pd.DataFrame, seed: int = 0, piece: int = 0
    ) -> None:
        self.posterior = posterior
        self.draws = draws
        self.seed = seed
        self.piece = piece  # the first, or which of the others
        self._model = posterior.pieces[piece]

    @property
    def _smooth(self) -> SmoothMisfit:
        return self.posterior.misfits[self.piece]  # made on first use, from a fit

    @cached_property
    def _residual(self) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            return np.nan_to_num(self.posterior.residuals(self.draws, self.piece))

    @cached_property
    def _terms(self) -> np.ndarray:
        """The term of the misfit of each draw."""
        return self._smooth.choose(self._residual, np.random.default_rng(self.seed))

    @property
    def noise_sd(self) -> np.ndarray:
        """Noise of a reading, (draws, 1, 2)."""
        if self.posterior.settings.has_misfit:
            factors = self._smooth.terms.noise[self._terms]
            return self._model.specimen.noise_sds * factors[:, None, None]
        name = name_of(NOISE_SD.name, self._model.labels.label)
        noise = self.draws[name].to_numpy(dtype=float)[:, None, None]
        return noise * self._model.specimen.load_scale

    def tested(self, protocol: int, stretch: np.ndarray, rows: np.ndarray) -> TissueLoads:
        """Loads at ``rows`` of a protocol's stretches (m, 2), the cell's offset included."""
        name = self._model.specimen.protocols[protocol].name
        law = self.law(stretch[rows], name) + self._model.forward.offset(self.draws)
        if not self.posterior.settings.has_misfit:
            return TissueLoads(law, law, np.zeros((1, 1, 1)), law, self.noise_sd)
        points = self.posterior.paths_of_pieces[self.piece].tested(protocol, stretch)
        points = points.take((2 * rows[:, None] + [0, 1]).ravel())
        mean, sd = self._misfit(points)
        read, read_sd = self._misfit(points, friction=True)
        return TissueLoads(law, law + mean, sd, law + read, np.hypot(read_sd, self.noise_sd))

    def law(self, stretch: np.ndarray, protocol: str = "") -> np.ndarray:
        """Loads of the law at measured stretches (m, 2), without the offset of the cell."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._model.forward.load(self.draws, stretch, protocol)

    def misfit(
        self, stretch: np.ndarray, protocol: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and sd (draws, m, 2) of the misfit on a path; ``protocol``: that it runs along.

        On another path the readings inform only the structures that depend on both stretches.
        """
        if not self.posterior.settings.has_misfit:
            nothing = np.zeros((len(self.draws), len(stretch), 2))
            return nothing, nothing
        return self._misfit(self.posterior.paths_of_pieces[self.piece].path(stretch, protocol))

    def nominal_misfit(
        self, stretch: np.ndarray, section: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same as a nominal stress: mean, sd, and sd of the noise; kPa, (draws, m, 2).

        ``section`` is the load per nominal stress. Readings of a tube are taken as mean stresses
        of its wall.
        """
        mean, sd = self.misfit(stretch)
        test = self._model.specimen.experiment
        units = [test.stresses(stretch, np.broadcast_to(e, stretch.shape)) for e in np.eye(2)]
        if units[0] is None:
            return mean / section, sd / section, self.noise_sd / section
        # P_k = sum_i (dP_k / dq_i) q_i,  P = s / l, of the mounted section
        by_reading = np.array(units, dtype=float) / stretch
        sds, noise = (
            np.sqrt(np.einsum("imk,dmi->dmk", by_reading**2, np.broadcast_to(v, mean.shape) ** 2))
            for v in (sd, self.noise_sd)
        )
        return np.einsum("imk,dmi->dmk", by_reading, mean), sds, noise

    def _misfit(
        self, points: CurvePoints, *, friction: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        mean, sd = self._smooth.given(self._residual, self._terms, points, friction=friction)
        return mean.reshape(len(mean), -1, 2), sd.reshape(len(sd), -1, 2)
