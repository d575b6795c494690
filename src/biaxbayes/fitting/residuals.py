r"""Rows of all pieces of a tissue in flat arrays, and the residuals of the fits on them.

What is compared (``quantity``), with the readings q of :mod:`biaxbayes.forward`:

    "load"     q_k(theta, l lm)  with f_k
    "cauchy"   the same over the load per Cauchy stress: for a biaxial test s_k(theta, l lm)  with
               the data updated to the mounting stretch, f_k l_k lm_k / A0_k  (unloaded dimensions)
               or  f_k l_k / Am_k  (mounted)

Mounting stretch: given (:class:`LoadResiduals`), two more unknowns
(:class:`FreeMounting`), or the root of the force balance at the mounted state, with the
mounting load either given or unknown and measured (:class:`BalancedMounting`).

All residuals are model minus data over one scale per piece, shape (2 n,); parameters are the free
ones among the law's coordinates, followed by those of the mounting state and the stiffnesses of
further pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from biaxbayes.forward import ForwardModel, LoadResponse
from biaxbayes.laws.law import Law
from biaxbayes.mechanics.experiments import BIAXIAL
from biaxbayes.specimens.specimen import Specimen

# --- all rows of a tissue in flat arrays, as a fit needs them ------------------------------------


@dataclass(frozen=True, eq=False)
class Readings:
    """Rows of all protocols of all pieces, one below the other; m mounted states."""

    pieces: tuple[Specimen, ...]
    stretch: np.ndarray  # (2, n), measured: relative to the mounted state
    # (2, n): force (N) or first Piola-Kirchhoff stress (kPa) in the file's geometry
    load: np.ndarray
    group: np.ndarray  # (n,): index of the mounted state
    at_rest: np.ndarray  # (n,): recorded at the mounted state, before the test starts
    mounting_load: np.ndarray  # (2, m)
    mounting_sd: np.ndarray  # (2, m)
    piece_of_state: np.ndarray  # (m,)
    rows: tuple[slice, ...]  # of each protocol

    @classmethod
    def from_specimen(cls, specimen: Specimen, *, shared: bool, mounting: str = "") -> Readings:
        """Rows of a tissue with one mounted state for all protocols of a piece, or one each."""
        pieces = tuple(piece.as_compared(mounting) for piece in specimen.pieces)
        loads, stretches, at_rest, group, readings, sds = ([] for _ in range(6))
        of_state: list[int] = []
        for i, piece in enumerate(pieces):
            reading, sd = piece.mounting_readings(shared=shared)
            for j, p in enumerate(piece.protocols):
                loads.append(piece.load(p))
                stretches.append(p.stretch)
                at_rest.append(np.arange(p.rows) < p.rest_rows)
                group.append(np.full(p.rows, len(of_state) + (0 if shared else j)))
            readings.append(reading)
            sds.append(sd)
            of_state += [i] * len(reading)
        ends = np.cumsum([0, *(len(part) for part in loads)])
        return cls(
            pieces,
            stretch=np.concatenate(stretches).T.copy(),
            load=np.concatenate(loads).T.copy(),
            group=np.concatenate(group),
            at_rest=np.concatenate(at_rest),
            mounting_load=np.concatenate(readings).T.copy(),
            mounting_sd=np.concatenate(sds).T.copy(),
            piece_of_state=np.array(of_state),
            rows=tuple(slice(a, b) for a, b in pairwise(ends)),
        )

    def forwards(self, law: Law) -> list[ForwardModel]:
        """The forward model of a law on each piece."""
        return [
            ForwardModel(law, p.area, p.geometry == "mounted", p.experiment) for p in self.pieces
        ]

    @property
    def piece(self) -> np.ndarray:
        """Index of the piece of each row, (n,)."""
        return np.asarray(self.piece_of_state[self.group])

    @property
    def is_read(self) -> np.ndarray:
        """Whether a direction has readings, (2, n)."""
        axes = np.array([np.isin([0, 1], p.experiment.axes) for p in self.pieces])
        return np.asarray(axes[self.piece].T)

    @property
    def load_scale(self) -> np.ndarray:
        """Unit of the readings for sums over both directions, (2, n)."""
        return np.array([p.load_scale for p in self.pieces])[self.piece].T

    @property
    def is_mounted(self) -> np.ndarray:
        """Whether a mounted state has a mounting load in a direction, (2, m)."""
        axes = [np.isin([0, 1], p.experiment.axes) & p.experiment.is_mounted for p in self.pieces]
        return np.asarray(np.array(axes)[self.piece_of_state].T)

    @property
    def peaks(self) -> np.ndarray:
        """Largest absolute load of each piece over its scale, at least the smallest number."""
        largest = np.abs(self.load / self.load_scale).max(axis=0)
        return np.maximum(
            [largest[self.piece == i].max(initial=0.0) for i in range(len(self.pieces))], 1e-300
        )

    @property
    def peak(self) -> float:
        """Largest absolute load of the first piece."""
        return float(self.peaks[0])

    def thinned(self, per_protocol: int) -> Readings:
        """Evenly chosen rows of each protocol after those at rest, with the last one."""
        chosen_rows = []
        for rows in self.rows:
            index = np.arange(rows.start, rows.stop)
            index = index[~self.at_rest[rows]]
            chosen = np.unique(np.linspace(0, index.size - 1, per_protocol).round().astype(int))
            chosen_rows.append(index[chosen] if index.size else index)
        all_rows = np.concatenate(chosen_rows)
        ends = np.cumsum([0, *(k.size for k in chosen_rows)])
        return replace(
            self,
            stretch=self.stretch[:, all_rows],
            load=self.load[:, all_rows],
            group=self.group[all_rows],
            at_rest=self.at_rest[all_rows],
            rows=tuple(slice(a, b) for a, b in pairwise(ends)),
        )

    def loaded_rows(self) -> Readings:
        """The rows after those at rest, which enter a posterior as the mounting reading instead."""
        return self.thinned(self.at_rest.size)


MAX_SIGN_CHANGE_Z = 3.0
"""Standard deviations by which the sign changes of independent errors may fall short."""


def has_smooth_misfit(residuals: Sequence[np.ndarray]) -> bool:
    """True if the signs of residuals (n_p, 2) change too seldom for independent errors."""
    changes = steps = 0
    for part in residuals:
        if not part.any():
            continue
        read = part[:, part.any(axis=0)]
        above = read > 0.0
        changes += int(np.count_nonzero(above[1:] != above[:-1]))
        steps += read.shape[1] * max(len(read) - 1, 0)
    # Signs of independent errors change at every step with probability 1/2.
    return changes - 0.5 * steps < -MAX_SIGN_CHANGE_Z * 0.5 * np.sqrt(steps)


# --- residuals of the deterministic fits and their analytic Jacobians ----------------------------


@dataclass(eq=False)
class LoadResiduals:
    """Residuals of loads; here the material is unknown and the mounting stretch (2, m) is given."""

    data: Readings
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
        return r, by_point[self.free].T

    @property
    def forwards(self) -> list[ForwardModel]:
        """The forward model of the law on each piece."""
        return self.data.forwards(self.law)

    def fit_coordinates(self, unknowns: np.ndarray) -> np.ndarray:
        """Fit coordinates of the material, fixed ones filled in."""
        point = self.point.copy()
        point[self.free] = unknowns[: self.free.size]
        return point

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m)."""
        return self.mounting_stretch

    def stiffness(self, unknowns: np.ndarray) -> np.ndarray:
        """Stiffness of each piece over that of the first, (pieces,)."""
        return np.ones(len(self.data.pieces))

    def response(
        self, point: np.ndarray, lm: np.ndarray, stiffness: np.ndarray | None = None
    ) -> LoadResponse:
        """Readings of all rows at mounting stretches (2, m) and stiffnesses (pieces,)."""
        data, parts = self.data, []
        for i, forward in enumerate(self.forwards):
            at = data.piece == i
            part = forward.response(point, data.stretch[:, at], lm[:, data.group[at]])
            factor = 1.0 if stiffness is None else stiffness[i]
            parts.append([factor * v for v in (vars(part)[name] for name in RESPONSE)])
        return LoadResponse(*(np.concatenate(v, axis=-1) for v in zip(*parts, strict=True)))

    def _rows(
        self, point: np.ndarray, lm: np.ndarray, stiffness: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (2n,), and their derivatives with respect to fit coordinates, ln lm and ln c.

        Shapes (p, 2n), (2n, 2m) and (2n, pieces).
        """
        data, piece = self.data, self.data.piece
        rows = self.response(point, lm, stiffness)
        # (2, n); stresses have one unit
        scale = np.broadcast_to(self.scale, len(data.pieces))[piece]
        scale = scale * (1.0 if self.quantity == "cauchy" else data.load_scale)
        residual, by_point = rows.load - data.load, rows.by_fit_coordinate
        by_lm, by_log_stiffness = rows.by_log_mounting, rows.load
        if self.quantity == "cauchy":
            # s - f l lm / A0 (unloaded), s - f l / Am (mounted)
            residual, by_point = residual / rows.per_stress, by_point / rows.per_stress[:, None]
            by_lm = by_lm / rows.per_stress[:, None]
            by_log_stiffness = data.load / rows.per_stress
            unloaded = np.array([p.geometry != "mounted" for p in data.pieces])[piece]
            by_lm[0, 0] += unloaded * residual[0]
            by_lm[1, 1] += unloaded * residual[1]
        scale = np.broadcast_to(scale, residual.shape)
        by_point = (by_point / scale[:, None]).transpose(1, 0, 2).reshape(point.size, -1)
        # a row depends on the mounting stretches of its own group, columns ordered (k, group)
        member = data.group[:, None] == np.arange(lm.shape[1])
        by_all = (by_lm / scale[:, None]).transpose(0, 2, 1)[..., None] * member[:, None, :]
        own = piece[:, None] == np.arange(len(data.pieces))
        by_stiffness = (by_log_stiffness / scale)[..., None] * own
        return (
            (residual / scale).ravel(),
            by_point,
            by_all.reshape(-1, lm.size),
            by_stiffness.reshape(-1, len(data.pieces)),
        )

    def mounted(self, point: np.ndarray, lm: np.ndarray) -> LoadResponse:
        """Loads of the mounted states at stretches (2, m), in both directions."""
        parts = []
        for m, i in enumerate(self.data.piece_of_state):
            balanced = replace(self.forwards[i], experiment=BIAXIAL)
            parts.append(balanced.response(point, 1.0, lm[:, m : m + 1]))
        return LoadResponse(
            *(np.concatenate([vars(p)[name] for p in parts], axis=-1) for name in RESPONSE)
        )


RESPONSE = ("load", "by_fit_coordinate", "by_log_mounting", "per_stress")


@dataclass(eq=False)
class FreeMounting(LoadResiduals):
    """The material and the mounting stretches are unknown.

    With ``reading_sd`` (2, m) the mounting loads have readings, which add one residual each.
    """

    # indices of the unknown ones among lm_x of all groups, then lm_y
    free_mounting: np.ndarray | slice = field(default_factory=lambda: slice(None))
    reading_sd: np.ndarray | None = None

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m)."""
        lm = self.mounting_stretch.copy()
        lm.flat[self.free_mounting] = unknowns[self.free.size :]
        return lm

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative."""
        point, lm = self.fit_coordinates(unknowns), self.mounting(unknowns)
        r, by_point, by_lm, _ = self._rows(point, lm)
        by_lm = (by_lm / lm.ravel())[:, self.free_mounting]
        if self.reading_sd is None:
            return r, np.hstack([by_point[self.free].T, by_lm])
        sd, groups = self.reading_sd, lm.shape[1]
        state = self.mounted(point, lm)
        z = (state.load - self.data.mounting_load) / sd
        z_by_point = (
            (state.by_fit_coordinate / sd[:, None]).transpose(0, 2, 1).reshape(2 * groups, -1)
        )
        slope = state.by_log_mounting / sd[:, None] / lm
        z_by_lm = _block_diagonal(slope)[:, self.free_mounting]
        jacobian = [[by_point[self.free].T, by_lm], [z_by_point[:, self.free], z_by_lm]]
        return np.concatenate([r, z.ravel()]), np.block(jacobian)


@dataclass(eq=False)
class BalancedMounting(LoadResiduals):
    """The mounting stretch is the root of the force balance at the mounted state.

    With ``reading_sd`` (2, m) the mounting loads are unknowns too, as deviations z from
    their readings in units of the sd, which are residuals as well. With ``piece_sd`` so are the
    logs of the stiffnesses of further pieces, in units of that sd.
    """

    reading_sd: np.ndarray | None = None
    compiled: bool = True
    piece_sd: float = 0.0

    @property
    def read(self) -> np.ndarray:
        """Mounting loads that are unknown, as indices into the flat (2, m)."""
        if self.reading_sd is None:
            return np.empty(0, dtype=int)
        return np.flatnonzero(self.data.is_mounted & (self.reading_sd > 0.0))

    def mounting_load(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting loads, shape (2, m), in the unit of the readings."""
        load, read = self.data.mounting_load.copy(), self.read
        if read.size:
            assert self.reading_sd is not None
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
        """Mounting stretches, shape (2, m); NaN where no root exists."""
        data, point = self.data, self.fit_coordinates(unknowns)
        load = self.mounting_load(unknowns) / self.stiffness(unknowns)[data.piece_of_state]
        lm = np.empty_like(load)
        for i, forward in enumerate(self.forwards):
            own = data.piece_of_state == i
            lm[:, own] = forward.solve_mounting(point, load[:, own], compiled=self.compiled)
        return lm

    def log_stretch_jacobian(self, unknowns: np.ndarray, lm: np.ndarray) -> np.ndarray:
        """Derivative (2m, unknowns) of all ln lm, at stretches lm, with respect to the unknowns.

        By the implicit function theorem: with the mounting load f0 = c q(theta, lm),

            c dq/d(ln lm) d(ln lm) = d f0 - c dq/d(theta) d(theta) - f0 d(ln c)
        """
        data, groups = self.data, lm.shape[1]
        state = self.mounted(self.fit_coordinates(unknowns), lm)
        is_mounted = np.array([p.experiment.is_mounted for p in data.pieces])[data.piece_of_state]
        slopes = state.by_log_mounting.transpose(2, 0, 1)
        inverse = np.zeros_like(slopes)
        inverse[is_mounted] = np.linalg.inv(slopes[is_mounted])
        by_point = -np.einsum("gij,jpg->igp", inverse, state.by_fit_coordinate)
        parts = [by_point[..., self.free].reshape(2 * groups, -1)]
        inverse = inverse / self.stiffness(unknowns)[data.piece_of_state, None, None]
        if self.read.size:
            assert self.reading_sd is not None
            by_z = inverse * self.reading_sd.T[:, None]
            parts.append(_block_diagonal(by_z.transpose(1, 2, 0))[:, self.read])
        if self.piece_sd:
            # d(ln lm) / d(ln c) = -inverse f0, each state by its own piece
            by_c = -np.einsum("gij,jg->ig", inverse, self.mounting_load(unknowns))
            own = data.piece_of_state[:, None] == np.arange(1, len(data.pieces))
            parts.append(self.piece_sd * (by_c[..., None] * own).reshape(2 * groups, -1))
        return np.hstack(parts)

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative."""
        z = unknowns[self.free.size :]
        lm = self.mounting(unknowns)
        if not np.isfinite(lm).all():
            rows = 2 * self.data.group.size + z.size
            return np.full(rows, np.nan), np.zeros((rows, unknowns.size))
        stiffness = self.stiffness(unknowns)
        r, by_point, by_lm, by_c = self._rows(self.fit_coordinates(unknowns), lm, stiffness)
        jacobian = by_lm @ self.log_stretch_jacobian(unknowns, lm)
        jacobian[:, : self.free.size] += by_point[self.free].T
        if self.piece_sd:
            jacobian[:, self.free.size + self.read.size :] += self.piece_sd * by_c[:, 1:]
        # the residual of z, or of ln c, is z itself
        by_z = np.eye(z.size, unknowns.size, self.free.size)
        return np.concatenate([r, z]), np.vstack([jacobian, by_z])


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """Matrices (2, 2, m) of the mounted states as one (2 m, 2 m), block-diagonal; (k, group)."""
    groups = blocks.shape[2]
    out = np.zeros((2, groups, 2, groups))
    for g in range(groups):
        out[:, g, :, g] = blocks[:, :, g]
    return out.reshape(2 * groups, -1)
