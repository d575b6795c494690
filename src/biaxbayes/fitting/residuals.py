r"""Rows of a specimen in flat arrays, and the residuals of the deterministic fits on them.

What is compared (``quantity``):

    "cauchy"   s_k(theta, l lm)  with the data updated to the mounting stretch,
               f_k l_k lm_k / A0_k  (unloaded dimensions)  or  f_k l_k / Am_k  (mounted)
    "load"     A0_k P_k(theta, l lm)  or  Am_k lm_k P_k(theta, l lm)  with f_k

Mounting stretch: given (:class:`LoadResiduals`), two more unknowns
(:class:`FreeMounting`), or the root of the force balance at the mounted state, with the
mounting load either given or unknown and measured (:class:`BalancedMounting`).

All residuals are model minus data over one scale, shape (rows,); parameters are the free ones
among the law's coordinates, followed by those of the mounting state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from biaxbayes.forward import ForwardModel
from biaxbayes.laws.law import Law
from biaxbayes.specimens.specimen import Specimen

# --- all rows of a specimen in flat arrays, as a fit needs them ----------------------------------


@dataclass(frozen=True, eq=False)
class Readings:
    """Rows of all protocols, one below the other."""

    stretch: np.ndarray  # (2, n), measured: relative to the mounted state
    # (2, n): force (N) or first Piola-Kirchhoff stress (kPa) in the file's geometry
    load: np.ndarray
    group: np.ndarray  # (n,): index of the mounted state
    at_rest: np.ndarray  # (n,): recorded at the mounted state, before the test starts
    mounting_load: np.ndarray  # (2, m)
    mounting_sd: np.ndarray  # (2, m)
    area: np.ndarray  # (2,): load per kPa
    mounted: bool  # dimensions refer to the mounted state
    rows: tuple[slice, ...]  # of each protocol

    @classmethod
    def from_specimen(cls, specimen: Specimen, *, shared: bool, zeroed: bool = False) -> Readings:
        """Rows of a specimen with one mounted state for all protocols, or one each."""
        source = specimen.zeroed() if zeroed else specimen
        loads = [source.load(p) for p in source.protocols]
        reading, sd = source.mounting_readings(shared=shared)
        sizes = [p.rows for p in source.protocols]
        ends = np.cumsum([0, *sizes])
        return cls(
            stretch=np.concatenate([[p.stretch_x, p.stretch_y] for p in source.protocols], axis=1),
            load=np.concatenate(loads).T.copy(),
            group=np.zeros(ends[-1], dtype=int)
            if shared
            else np.repeat(np.arange(len(sizes)), sizes),
            at_rest=np.concatenate([np.arange(p.rows) < p.rest_rows for p in source.protocols]),
            mounting_load=reading.T.copy(),
            mounting_sd=sd.T.copy(),
            area=specimen.area,
            mounted=specimen.geometry == "mounted",
            rows=tuple(slice(a, b) for a, b in pairwise(ends)),
        )

    def forward(self, law: Law) -> ForwardModel:
        """The forward model of a law on the specimen."""
        return ForwardModel(law, self.area, self.mounted)

    @property
    def peak(self) -> float:
        """Largest absolute load, at least the smallest normal number."""
        return max(float(np.abs(self.load).max()), 1e-300)

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

    def by_protocol(self, residual: np.ndarray) -> list[np.ndarray]:
        """Residuals (2 n,) of the rows as one array (n_p, 2) per protocol."""
        pairs = residual.reshape(2, -1).T
        return [pairs[rows] for rows in self.rows]


MAX_SIGN_CHANGE_Z = 3.0
"""Standard deviations by which the sign changes of independent errors may fall short."""


def has_smooth_misfit(residuals: Sequence[np.ndarray]) -> bool:
    """True if the signs of residuals (n_p, 2) change too seldom for independent errors."""
    changes = steps = 0
    for part in residuals:
        if not part.any():
            continue
        above = part > 0.0
        changes += int(np.count_nonzero(above[1:] != above[:-1]))
        steps += 2 * max(len(part) - 1, 0)
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
    scale: float
    mounting_stretch: np.ndarray
    law: Law

    def residual(self, unknowns: np.ndarray) -> np.ndarray:
        """Residual vector; not finite where the model cannot be evaluated."""
        with np.errstate(all="ignore"):
            return self.evaluate(unknowns)[0]

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative; the caller suppresses NumPy's warnings."""
        r, by_point, _ = self._rows(self.fit_coordinates(unknowns), self.mounting_stretch)
        return r, by_point[self.free].T

    @property
    def forward(self) -> ForwardModel:
        """The forward model of the law."""
        return self.data.forward(self.law)

    def fit_coordinates(self, unknowns: np.ndarray) -> np.ndarray:
        """Fit coordinates of the material, fixed ones filled in."""
        point = self.point.copy()
        point[self.free] = unknowns[: self.free.size]
        return point

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m)."""
        return self.mounting_stretch

    def _rows(self, point: np.ndarray, lm: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (2n,), and their derivatives with respect to fit coordinates and ln lm.

        Shapes (p, 2n) and (2n, 2m).
        """
        data = self.data
        rows = self.forward.response(point, data.stretch, lm[:, data.group])
        residual, by_point, by_lm = (
            rows.load - data.load,
            rows.by_fit_coordinate,
            rows.by_log_mounting,
        )
        if self.quantity == "cauchy":
            # s - f l lm / A0 (unloaded), s - f l / Am (mounted)
            residual, by_point = residual / rows.per_stress, by_point / rows.per_stress[:, None]
            by_lm = by_lm / rows.per_stress[:, None]
            if not data.mounted:
                by_lm[0, 0] += residual[0]
                by_lm[1, 1] += residual[1]
        by_point = by_point.transpose(1, 0, 2).reshape(point.size, -1) / self.scale
        # a row depends on the mounting stretches of its own group, columns ordered (k, group)
        member = data.group[:, None] == np.arange(lm.shape[1])
        by_all = (by_lm / self.scale).transpose(0, 2, 1)[..., None] * member[:, None, :]
        return residual.ravel() / self.scale, by_point, by_all.reshape(-1, lm.size)


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
        r, by_point, by_lm = self._rows(point, lm)
        by_lm = (by_lm / lm.ravel())[:, self.free_mounting]
        if self.reading_sd is None:
            return r, np.hstack([by_point[self.free].T, by_lm])
        sd, groups = self.reading_sd, lm.shape[1]
        state = self.forward.response(point, 1.0, lm)
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
    their readings in units of the sd, which are residuals as well.
    """

    reading_sd: np.ndarray | None = None
    compiled: bool = True

    def mounting_load(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting loads, shape (2, m), in the unit of the readings."""
        reading = self.data.mounting_load
        if self.reading_sd is None:
            return reading
        z = unknowns[self.free.size :].reshape(reading.shape)
        # f0 = reading + z s0
        return reading + z * self.reading_sd

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m); NaN where no root exists."""
        load = self.mounting_load(unknowns)
        return self.forward.solve_mounting(
            self.fit_coordinates(unknowns), load, compiled=self.compiled
        )

    def log_stretch_jacobian(self, unknowns: np.ndarray, lm: np.ndarray) -> np.ndarray:
        """Derivative (2m, unknowns) of all ln lm, at stretches lm, with respect to the unknowns.

        By the implicit function theorem: with the mounting load f0 = q(theta, lm),

            dq/d(ln lm) d(ln lm) = d f0 - dq/d(theta) d(theta)
        """
        state = self.forward.response(self.fit_coordinates(unknowns), 1.0, lm)
        inverse = np.linalg.inv(state.by_log_mounting.transpose(2, 0, 1))
        by_point = -np.einsum("gij,jpg->igp", inverse, state.by_fit_coordinate)
        groups = len(inverse)
        by_point = by_point[..., self.free].reshape(2 * groups, -1)
        if self.reading_sd is None:
            return by_point
        by_z = inverse * self.reading_sd.T[:, None]
        return np.hstack([by_point, _block_diagonal(by_z.transpose(1, 2, 0))])

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative."""
        z = unknowns[self.free.size :]
        lm = self.mounting(unknowns)
        if not np.isfinite(lm).all():
            rows = 2 * self.data.group.size + z.size
            return np.full(rows, np.nan), np.zeros((rows, unknowns.size))
        r, by_point, by_lm = self._rows(self.fit_coordinates(unknowns), lm)
        jacobian = by_lm @ self.log_stretch_jacobian(unknowns, lm)
        jacobian[:, : self.free.size] += by_point[self.free].T
        # the residual of z is z itself
        by_z = np.eye(z.size, unknowns.size, self.free.size)
        return np.concatenate([r, z]), np.vstack([jacobian, by_z])


def _block_diagonal(blocks: np.ndarray) -> np.ndarray:
    """Matrices (2, 2, m) of the mounted states as one (2 m, 2 m), block-diagonal; (k, group)."""
    groups = blocks.shape[2]
    out = np.zeros((2, groups, 2, groups))
    for g in range(groups):
        out[:, g, :, g] = blocks[:, :, g]
    return out.reshape(2 * groups, -1)
