r"""Rows of a specimen in flat arrays, and the residuals of the deterministic fits on them.

What is compared (``quantity``):

    "cauchy"   s_k(theta, l lm)  with the data updated to the mounting stretch,
               f_k l_k lm_k / A0_k  (unloaded dimensions)  or  f_k l_k / Am_k  (mounted)
    "load"     A0_k P_k(theta, l lm)  or  Am_k lm_k P_k(theta, l lm)  with f_k

What is known of the mounting stretch: it is given (:class:`GivenMounting`), two more unknowns
(:class:`FreeMounting`), or the root of the force balance at the mounted state, with the
mounting load given or an unknown with a reading (:class:`BalancedMounting`).

All residuals are model minus data over one scale, shape (rows,); parameters are the free ones
among the law's coordinates, followed by those of the mounting state.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from biaxbayes.laws.law import Law, StressResponse
from biaxbayes.mechanics.mounting import load_per_stress, solve_balance
from biaxbayes.specimens.specimen import Specimen

__all__ = [
    "BalancedMounting",
    "FreeMounting",
    "GivenMounting",
    "Readings",
    "mounting_roots",
    "readings",
]


# --- all rows of a specimen in flat arrays, as a fit needs them ----------------------------------


@dataclass(frozen=True, eq=False)
class Readings:
    """Rows of all protocols, one below the other.

    Attributes
    ----------
    stretch : ndarray, shape (2, n)
        Measured stretches, relative to the mounted state.
    load : ndarray, shape (2, n)
        Force (N) or first Piola-Kirchhoff stress (kPa) in the file's geometry.
    group : ndarray of int, shape (n,)
        Which mounted state a row belongs to.
    at_rest : ndarray of bool, shape (n,)
        Rows recorded at the mounted state, before the test starts.
    mounting_load, mounting_sd : ndarray, shape (2, m)
        Reading of each mounted state and its standard deviation, in the unit of ``load``.
    area : ndarray, shape (2,)
        Load per kPa.
    mounted : bool
        Whether the dimensions refer to the mounted state.
    rows : tuple of slice
        The rows of each protocol.
    """

    stretch: np.ndarray
    load: np.ndarray
    group: np.ndarray
    at_rest: np.ndarray
    mounting_load: np.ndarray
    mounting_sd: np.ndarray
    area: np.ndarray
    mounted: bool
    rows: tuple[slice, ...]

    @property
    def peak(self) -> float:
        """Largest absolute load, at least the smallest normal number."""
        return max(float(np.abs(self.load).max()), 1e-300)

    def thinned(self, per_protocol: int) -> Readings:
        """At most so many stretched rows of each protocol, evenly chosen, the last included."""
        keep = []
        for rows in self.rows:
            index = np.arange(rows.start, rows.stop)
            index = index[~self.at_rest[rows]]
            chosen = np.unique(np.linspace(0, index.size - 1, per_protocol).round().astype(int))
            keep.append(index[chosen] if index.size else index)
        kept = np.concatenate(keep)
        ends = np.cumsum([0, *(k.size for k in keep)])
        return replace(
            self,
            stretch=self.stretch[:, kept],
            load=self.load[:, kept],
            group=self.group[kept],
            at_rest=self.at_rest[kept],
            rows=tuple(slice(a, b) for a, b in pairwise(ends)),
        )

    def stretched(self) -> Readings:
        """Without the rows at rest, which enter a posterior through the mounting reading."""
        return self.thinned(self.at_rest.size)


def readings(specimen: Specimen, *, shared: bool, zeroed: bool = False) -> Readings:
    """Flatten a specimen.

    Parameters
    ----------
    specimen : Specimen
    shared : bool
        One mounted state for all protocols, or one each.
    zeroed : bool
        Subtract each protocol's mounting reading from its loads.
    """
    source = specimen.zeroed() if zeroed else specimen
    loads = [source.load(p) for p in source.protocols]
    reading, sd = source.mounting_readings(shared=shared)
    sizes = [p.rows for p in source.protocols]
    ends = np.cumsum([0, *sizes])
    return Readings(
        stretch=np.concatenate([[p.stretch_x, p.stretch_y] for p in source.protocols], axis=1),
        load=np.concatenate(loads).T.copy(),
        group=np.zeros(ends[-1], dtype=int) if shared else np.repeat(np.arange(len(sizes)), sizes),
        at_rest=np.concatenate([np.arange(p.rows) < p.rest_rows for p in source.protocols]),
        mounting_load=reading.T.copy(),
        mounting_sd=sd.T.copy(),
        area=specimen.area,
        mounted=specimen.geometry == "mounted",
        rows=tuple(slice(a, b) for a, b in pairwise(ends)),
    )


# --- residuals of the deterministic fits and their analytic Jacobians ----------------------------


@dataclass(eq=False)
class GivenMounting:
    """Theta is unknown, the mounting stretch (2, m) is given."""

    data: Readings
    quantity: str
    point: np.ndarray
    free: np.ndarray
    scale: float
    mounting_stretch: np.ndarray
    law: Law
    _last: tuple = field(default=(), repr=False)

    def residual(self, unknowns: np.ndarray) -> np.ndarray:
        """Residual vector; not finite where the model cannot be evaluated."""
        return self._at(unknowns)[0]

    def jacobian(self, unknowns: np.ndarray) -> np.ndarray:
        """Derivative of the residual vector, shape (rows, unknowns)."""
        return self._at(unknowns)[1]

    def evaluate(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual vector and its derivative; a descent silences what NumPy says of them."""
        found = self._compute(unknowns)
        self._last = (unknowns.copy(), found)
        return found

    def theta(self, unknowns: np.ndarray) -> np.ndarray:
        """Coordinates of the fit with the fixed ones filled in."""
        point = self.point.copy()
        point[self.free] = unknowns[: self.free.size]
        return point

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m)."""
        return self.mounting_stretch

    def _at(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The last evaluation, if it was of these unknowns, or a new one."""
        if self._last and np.array_equal(self._last[0], unknowns):
            return self._last[1]
        with np.errstate(all="ignore"):
            return self.evaluate(unknowns)

    def _compute(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r, by_point, _, _ = self._rows(self.theta(unknowns), self.mounting_stretch)
        return r, by_point[self.free].T

    def _rows(
        self, point: np.ndarray, lm: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, StressResponse]:
        """Residuals (2n,), by theta (p, 2n), by all ln lm (2n, 2m), and the mounted states."""
        data = self.data
        lmr = lm if lm.shape[1] == 1 else lm[:, data.group]
        # one call for rows and mounted states: NumPy's calls take longer than the arithmetic
        all_of_it = self.law.response(point, np.hstack([data.stretch * lmr, lm]))
        rows, state = all_of_it.split(data.group.size)
        s, by_lm = rows.stress, rows.by_log_stretch.copy()
        # model: A0 s / (l lm) (unloaded), Am s / l (mounted)
        factor = load_per_stress(data.area[:, None], data.stretch, lmr, data.mounted)
        measured = data.load
        if self.quantity == "cauchy":
            # data: f l lm / A0 (unloaded), f l / Am (mounted)
            measured, factor = measured / factor, np.ones_like(s)
            moves = measured
        else:
            moves = s
        if not data.mounted:
            by_lm[0, 0] -= moves[0]
            by_lm[1, 1] -= moves[1]
        factor = factor / self.scale
        r = factor * s - measured / self.scale
        by_point = (factor * rows.by_coordinate.transpose(1, 0, 2)).reshape(point.size, -1)
        return r.ravel(), by_point, self._spread(factor[:, None, :] * by_lm), state

    def _spread(self, by_lm: np.ndarray) -> np.ndarray:
        """(2, 2, n) by a row's own ln lm to (2n, 2m) by all, columns ordered (k, group)."""
        groups = self.data.mounting_load.shape[1]
        if groups == 1:
            return by_lm.transpose(0, 2, 1).reshape(-1, 2)
        member = self.data.group[:, None] == np.arange(groups)
        return (by_lm.transpose(0, 2, 1)[:, :, :, None] * member[None, :, None, :]).reshape(
            -1, 2 * groups
        )


@dataclass(eq=False)
class FreeMounting(GivenMounting):
    """Theta and the mounting stretches are unknown; rows at rest count like any other."""

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m)."""
        return unknowns[self.free.size :].reshape(2, -1)

    def _compute(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lm = self.mounting(unknowns)
        r, by_point, by_lm, _ = self._rows(self.theta(unknowns), lm)
        return r, np.hstack([by_point[self.free].T, by_lm / lm.ravel()])


@dataclass(eq=False)
class BalancedMounting(GivenMounting):
    """The mounting stretch is the root of the force balance at the mounted state.

    With ``reading_sd`` (2, m) the mounting loads are unknowns too, in units of their sd from
    their readings, and add one residual each. Not ``compiled``, the same code looks for the root in
    Python: for laws that are fitted once, compiling takes longer than that.
    """

    reading_sd: np.ndarray | None = None
    compiled: bool = True

    def mounting_load(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting loads, shape (2, m), in the unit of the readings."""
        reading = self.data.mounting_load
        if self.reading_sd is None:
            return reading
        offset = unknowns[self.free.size :].reshape(reading.shape)
        return reading + offset * self.reading_sd

    def mounting(self, unknowns: np.ndarray) -> np.ndarray:
        """Mounting stretches, shape (2, m); NaN where no root exists."""
        load = self.mounting_load(unknowns)
        return mounting_roots(self.data, self.theta(unknowns), load, self.law, self.compiled)[0]

    def log_stretch_by_unknowns(
        self, unknowns: np.ndarray, lm: np.ndarray, inverse: np.ndarray, state: StressResponse
    ) -> np.ndarray:
        """Derivative of all ln lm by the unknowns, shape (2m, unknowns), by the balance.

        Parameters
        ----------
        unknowns : ndarray
        lm, inverse : ndarray
            From :func:`mounting_roots`.
        state : StressResponse
            Of the mounted states.
        """
        # Implicit function theorem: J d(ln lm) = -ds/dtheta d theta + lm^(unloaded) d p0
        by_theta = -np.einsum("gij,jpg->igp", inverse, state.by_coordinate)
        by_theta = by_theta[..., self.free].reshape(lm.size, -1)
        if self.reading_sd is None:
            return by_theta
        load = self.reading_sd / self.data.area[:, None] * (1.0 if self.data.mounted else lm)
        groups = lm.shape[1]
        by_offset = np.zeros((2, groups, 2, groups))
        for g in range(groups):
            by_offset[:, g, :, g] = inverse[g] * load[:, g]
        return np.hstack([by_theta, by_offset.reshape(2 * groups, -1)])

    def _compute(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        point, data = self.theta(unknowns), self.data
        load = self.mounting_load(unknowns)
        lm, inverse = mounting_roots(data, point, load, self.law, self.compiled)
        offsets = unknowns[self.free.size :]
        if not np.isfinite(lm).all():
            rows = 2 * data.group.size + offsets.size
            return np.full(rows, np.nan), np.zeros((rows, unknowns.size))
        r, by_point, by_lm, state = self._rows(point, lm)
        jacobian = by_lm @ self.log_stretch_by_unknowns(unknowns, lm, inverse, state)
        jacobian[:, : self.free.size] += by_point[self.free].T
        # an offset has itself for a residual
        pin = np.eye(offsets.size, unknowns.size, self.free.size)
        return np.concatenate([r, offsets]), np.vstack([jacobian, pin])


def mounting_roots(
    data: Readings, point: np.ndarray, load: np.ndarray, law: Law, compiled: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Mounting stretches (2, m) and inverse Jacobians of the balance (m, 2, 2); NaN without root.

    Parameters
    ----------
    data : Readings
    point : ndarray, shape (p,)
    load : ndarray, shape (2, m)
        Mounting loads.
    law : Law
    compiled : bool
    """
    solve: Any = solve_balance if compiled else solve_balance.py_func  # type: ignore[attr-defined]
    constants = law.at_point(point).constants
    groups = load.shape[1]
    lm, inverse = np.full((2, groups), np.nan), np.full((groups, 2, 2), np.nan)
    for g in range(groups):
        px, py = load[:, g] / data.area
        ok, x, y, jxx, jxy, jyy = solve(constants, px, py, data.mounted)
        if ok:
            lm[:, g] = np.exp(x), np.exp(y)
            inverse[g] = np.array([[jyy, -jxy], [-jxy, jxx]]) / (jxx * jyy - jxy * jxy)
    return lm, inverse
