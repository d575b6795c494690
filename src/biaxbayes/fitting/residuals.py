r"""Residuals of the fits, and whether residuals show a smooth misfit.

What is compared (``quantity``), with the readings q of :mod:`biaxbayes.forward`:

    "load"     q_k(theta, l lm)  with f_k
    "cauchy"   the same over the load per Cauchy stress: for a biaxial test s_k(theta, l lm)  with
               the data updated to the mounting stretch, f_k l_k lm_k / A0_k  (unloaded dimensions)
               or  f_k l_k / Am_k  (mounted)

All residuals are model minus data over one scale per piece, those of (n, 2) as one vector. The
unknowns are the free ones among the law's coordinates, followed by those of the mounting state and
the stiffnesses of further pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from biaxbayes.experiments import BIAXIAL
from biaxbayes.forward import ForwardModel, LoadResponse
from biaxbayes.laws.law import Law
from biaxbayes.specimens.rows import MeasuredRows

MAX_SIGN_CHANGE_Z = 3.0
"""Standard deviations by which the sign changes of independent errors may fall short."""


def has_smooth_misfit(residuals: Sequence[np.ndarray]) -> bool:
    """True if the signs of residuals (n_p, 2) change too seldom for independent errors."""
    changes = steps = 0
    for part in residuals:
        read = part[:, part.any(axis=0)]
        above = read > 0.0
        changes += int(np.count_nonzero(above[1:] != above[:-1]))
        steps += read.shape[1] * max(len(read) - 1, 0)
    # Signs of independent errors change at every step with probability 1/2.
    return changes - 0.5 * steps < -MAX_SIGN_CHANGE_Z * 0.5 * np.sqrt(steps)


# --- residuals of the deterministic fits and their analytic Jacobians ----------------------------


@dataclass(eq=False)
class LoadResiduals:
    """Residuals of loads; here the material is unknown and the mounting stretch (m, 2) is given."""

    data: MeasuredRows
    quantity: str
    point: np.ndarray
    free: np.ndarray
    scale: float | np.ndarray  # one, or (pieces,)
    mounting_stretch: np.ndarray
    law: Law

    def residual(self, unknowns: np.ndarray) -> np.ndarray:
        """Residual vector; not finite where the model cannot be evaluated."""
        with np.errstate(all="ignore"):
            return self.evaluate(unknowns)[0]

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative; the caller suppresses NumPy's warnings."""
        r, by_point, _, _ = self._rows(self.fit_coordinates(unknowns), self.mounting_stretch)
        return r, by_point[:, self.free]

    @property
    def forwards(self) -> list[ForwardModel]:
        """The forward model of the law on each piece."""
        return [
            ForwardModel(self.law, p.area, p.geometry == "mounted", p.experiment)
            for p in self.data.pieces
        ]

    def fit_coordinates(self, unknowns: np.ndarray) -> np.ndarray:
        """Fit coordinates of the material, fixed ones filled in."""
        point = self.point.copy()
        point[self.free] = unknowns[: self.free.size]
        return point

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (m, 2)."""
        return self.mounting_stretch

    def stiffness(self, unknowns: np.ndarray) -> np.ndarray:
        """Stiffness of each piece over that of the first, (pieces,)."""
        return np.ones(len(self.data.pieces))

    def response(
        self, point: np.ndarray, lm: np.ndarray, stiffness: np.ndarray | None = None
    ) -> LoadResponse:
        """Readings of all rows at mounting stretches (m, 2) and stiffnesses (pieces,)."""
        data, parts = self.data, []
        for i, forward in enumerate(self.forwards):
            at, c = data.piece == i, 1.0 if stiffness is None else stiffness[i]
            parts.append(forward.response(point, data.stretch[at], lm[data.state[at]], c))
        return LoadResponse.joined(parts)

    def _rows(
        self, point: np.ndarray, lm: np.ndarray, stiffness: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (2n,); derivatives by point (2n, p), ln lm (2n, 2m), ln c (2n, pieces)."""
        data, piece = self.data, self.data.piece
        rows = self.response(point, lm, stiffness)
        residual, by_lm, by_log_stiffness = rows.load - data.load, rows.by_log_mounting, rows.load
        scale = np.broadcast_to(self.scale, len(data.pieces))[piece, None]
        if self.quantity == "cauchy":
            # s - f l lm / A0 (unloaded), s - f l / Am (mounted); stresses have one unit
            scale, by_log_stiffness = scale * rows.load_per_stress, data.load
            by_lm = by_lm + (data.unloaded[:, None] * residual)[..., None] * np.eye(2)
        else:
            scale = scale * data.load_scale
        # a row depends on the mounting stretches of its own state, and the stiffness of its piece
        state = data.state[:, None] == np.arange(len(lm))
        own = piece[:, None] == np.arange(len(data.pieces))
        by_lm = (by_lm / scale[..., None])[:, :, None] * state[:, None, :, None]
        by_log_stiffness = (by_log_stiffness / scale)[..., None] * own[:, None]
        return (
            (residual / scale).ravel(),
            (rows.by_fit_coordinate / scale[..., None]).reshape(-1, point.size),
            by_lm.reshape(-1, lm.size),
            by_log_stiffness.reshape(-1, len(data.pieces)),
        )

    def mounted_response(self, point: np.ndarray, lm: np.ndarray) -> LoadResponse:
        """Loads of the mounted states at stretches (m, 2), in both directions."""
        balanced = [replace(forward, experiment=BIAXIAL) for forward in self.forwards]
        return LoadResponse.joined(
            balanced[i].response(point, 1.0, lm[m : m + 1])
            for m, i in enumerate(self.data.piece_of_state)
        )


@dataclass(eq=False)
class FreeMounting(LoadResiduals):
    """The material and the mounting stretches are unknown."""

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (m, 2)."""
        return unknowns[self.free.size :].reshape(-1, 2)

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative."""
        lm = self.mounting(unknowns)
        r, by_point, by_log_lm, _ = self._rows(self.fit_coordinates(unknowns), lm)
        return r, np.hstack([by_point[:, self.free], by_log_lm / lm.ravel()])


@dataclass(eq=False)
class BalancedMounting(LoadResiduals):
    """The mounting stretch is the root of the force balance at the mounted state.

    Mounting loads with a ``reading_sd`` (m, 2) are unknowns too, as deviations z from
    their readings in units of the sd, which are residuals as well. With ``piece_sd`` so are the
    logs of the stiffnesses of further pieces, in units of that sd. A mounting stretch that the
    header gives is a reading as well.
    """

    reading_sd: np.ndarray = field(default_factory=lambda: np.zeros((1, 2)))
    compiled: bool = True
    piece_sd: float = 0.0

    @property
    def read(self) -> np.ndarray:
        """Mounting loads that are unknown, as indices into the flat (m, 2)."""
        return np.flatnonzero(self.data.is_mounted & (self.reading_sd > 0.0))

    @property
    def known_stretches(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mounting stretches of the headers: indices into the flat (m, 2), means and sds."""
        mean, sd = self.data.measured_mounting.ravel(), self.data.measured_mounting_sd.ravel()
        known = np.flatnonzero(np.isfinite(mean) & self.data.is_mounted.ravel())
        return known, mean[known], sd[known]

    def mounting_load(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting loads, shape (m, 2), in the unit of the readings."""
        load, read = self.data.mounting_load.copy(), self.read
        z = unknowns[self.free.size : self.free.size + read.size]
        # f0 = reading + z s0
        load.flat[read] += z * self.reading_sd.flat[read]
        return load

    def stiffness(self, unknowns: np.ndarray) -> np.ndarray:
        """Stiffness of each piece over that of the first, (pieces,)."""
        out = np.ones(len(self.data.pieces))
        if self.piece_sd:
            out[1:] = np.exp(self.piece_sd * unknowns[self.free.size + self.read.size :])
        return out

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (m, 2); NaN where no root exists."""
        data, point = self.data, self.fit_coordinates(unknowns)
        load = self.mounting_load(unknowns) / self.stiffness(unknowns)[data.piece_of_state, None]
        lm = np.empty_like(load)
        for i, forward in enumerate(self.forwards):
            own = data.piece_of_state == i
            lm[own] = forward.solve_mounting(point, load[own], compiled=self.compiled)
        return lm

    def log_stretch_jacobian(self, unknowns: np.ndarray, lm: np.ndarray) -> np.ndarray:
        """Derivative (2m, unknowns) of all ln lm, at stretches lm, with respect to the unknowns.

        By the implicit function theorem: with the mounting load f0 = c q(theta, lm),

            c dq/d(ln lm) d(ln lm) = d f0 - c dq/d(theta) d(theta) - f0 d(ln c)
        """
        data = self.data
        at = self.mounted_response(self.fit_coordinates(unknowns), lm)
        is_mounted = data.is_mounted.any(axis=1)
        inverse = np.zeros_like(at.by_log_mounting)
        inverse[is_mounted] = np.linalg.inv(at.by_log_mounting[is_mounted])
        parts = [-(inverse @ at.by_fit_coordinate[..., self.free]).reshape(lm.size, -1)]
        inverse = inverse / self.stiffness(unknowns)[data.piece_of_state, None, None]
        if self.read.size:
            parts.append(block_diag(*inverse * self.reading_sd[:, None])[:, self.read])
        if self.piece_sd:
            # d(ln lm) / d(ln c) = -inverse f0, each state by its own piece
            by_c = -inverse @ self.mounting_load(unknowns)[..., None]
            own = data.piece_of_state[:, None] == np.arange(1, len(data.pieces))
            parts.append(self.piece_sd * (by_c * own[:, None]).reshape(lm.size, -1))
        return np.hstack(parts)

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative."""
        z = unknowns[self.free.size :]
        lm = self.mounting(unknowns)
        if not np.isfinite(lm).all():
            rows = self.data.load.size + z.size + self.known_stretches[0].size
            return np.full(rows, np.nan), np.zeros((rows, unknowns.size))
        stiffness = self.stiffness(unknowns)
        r, by_point, by_lm, by_c = self._rows(self.fit_coordinates(unknowns), lm, stiffness)
        by_log_lm = self.log_stretch_jacobian(unknowns, lm)
        jacobian = by_lm @ by_log_lm
        jacobian[:, : self.free.size] += by_point[:, self.free]
        if self.piece_sd:
            jacobian[:, self.free.size + self.read.size :] += self.piece_sd * by_c[:, 1:]
        # the residual of z, or of ln c, is z itself
        by_z = np.eye(z.size, unknowns.size, self.free.size)
        # that of a mounting stretch m +- v from the header is (lm - m) / v
        known, mean, sd = self.known_stretches
        stretch = lm.ravel()[known]
        by_stretch = by_log_lm[known] * (stretch / sd)[:, None]
        return (
            np.concatenate([r, z, (stretch - mean) / sd]),
            np.vstack([jacobian, by_z, by_stretch]),
        )
