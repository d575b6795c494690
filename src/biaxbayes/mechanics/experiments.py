r"""Kinds of test: what a test reads of the stresses of the tissue.

Every reading is a weighted sum of Cauchy stresses at states of stretch that are known but for the
mounting stretch,

    q_i = sum_p sum_k  w_pik g_k s_k(l_p lm),    i = 1, 2 readings of a row,  k = x, y

with the stress s of the membrane (radial stress zero) at points p of the row, and the section g of
the mounted piece (:func:`.mounting.mounted_section`). A kind of test gives the points and weights
of its rows:

- planar biaxial: one point a row, w_ii = 1 / l_i
- strip along k: one point, w_kk = 1 / l_k; nothing pulls at its long sides, so that their stretch
  is the root of s = 0 where it was not measured
- tube: points through the wall, see :class:`Tube`

A new kind of test is a class here with its columns in :mod:`biaxbayes.specimens.keys`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from biaxbayes.laws.materials import STEP

N_PER_KPA_MM2 = 1e-3


def newtons_per_kPa(edge_x_mm: float, edge_y_mm: float, thickness_mm: float) -> np.ndarray:
    """Force per nominal stress in x and y: the section, edge of the other direction x thickness."""
    return np.array([edge_y_mm, edge_x_mm]) * thickness_mm * N_PER_KPA_MM2


@dataclass(frozen=True, eq=False)
class Points:
    """States at which the material answers, and what the readings of their rows are of it."""

    stretch: np.ndarray  # (n, 2), measured; NaN in the direction whose sides are free
    weight: np.ndarray  # (n, 2, 2), of stress k in reading i
    row: np.ndarray  # (n,), ascending

    def sums(self, stress: np.ndarray) -> np.ndarray:
        """Readings (..., rows, 2) of stresses times sections (..., n, 2)."""
        # q_i = sum_p sum_k w_pik g_k s_k
        return self.of_rows(np.einsum("nik,...nk->...ni", self.weight, stress), axis=-2)

    def of_rows(self, values: np.ndarray, axis: int = 0) -> np.ndarray:
        """Sums of values over the points of each row."""
        if self.row.size == self.row[-1] + 1:
            return values
        first = np.flatnonzero(np.diff(self.row, prepend=-1))
        return np.add.reduceat(values, first, axis=axis)


class Experiment(ABC):
    """A kind of test.

    The rows of every kind are two stretches and two readings, in the directions of the tissue.
    """

    name: ClassVar[str]
    axes: tuple[int, ...] = (0, 1)
    """Directions with a reading."""
    free_side: int | None = None
    """The direction whose sides carry no load."""
    is_mounted: bool = True
    """Whether stretches are relative to a mounted state, whose stretch is unknown."""
    curves: tuple[str, ...] = ("x", "y")
    """What a reading is called, in the directions of the tissue."""
    stretches: tuple[str, str] = ("stretch in x", "stretch in y")
    force_unit: str | None = None
    """Unit of the reading in y where it is not that of the reading in x."""

    @abstractmethod
    def points(self, stretch: np.ndarray) -> Points:
        """Points of rows at measured stretches (rows, 2)."""

    def stresses(self, stretch: np.ndarray, load: np.ndarray) -> np.ndarray | None:
        """Mean Cauchy stresses of readings, both (rows, 2), or None where sections give them."""
        return None

    def unit(self, axis: int, unit: str) -> str:
        """Unit of a reading; ``unit`` is that of the loads of the file."""
        return self.force_unit if axis == 1 and self.force_unit else unit

    def same_unit(self, axis: int) -> list[int]:
        """Directions whose readings have the unit of one of them."""
        return [k for k in self.axes if k == axis or not self.force_unit] or [axis]


class Biaxial(Experiment):
    """A square pulled along x and y."""

    name = "biaxial"

    def points(self, stretch: np.ndarray) -> Points:
        """One point a row."""
        weight = np.zeros((len(stretch), 2, 2))
        # q_k = g_k s_k / l_k
        weight[:, [0, 1], [0, 1]] = 1.0 / stretch
        return Points(stretch, weight, np.arange(len(stretch)))


@dataclass(frozen=True)
class Strip(Experiment):
    """A strip pulled along one direction, with free long sides."""

    axis: int

    name = "strip"

    @property
    def axes(self) -> tuple[int, ...]:  # type: ignore[override]
        """The direction of the strip."""
        return (self.axis,)

    @property
    def free_side(self) -> int:  # type: ignore[override]
        """The direction across it."""
        return 1 - self.axis

    def points(self, stretch: np.ndarray) -> Points:
        """One point a row."""
        k = self.axis
        weight = np.zeros((len(stretch), 2, 2))
        # q_k = g_k s_k / l_k
        weight[:, k, k] = 1.0 / stretch[:, k]
        return Points(stretch, weight, np.arange(len(stretch)))


MMHG_PER_KPA = 1.0 / 0.133322387415
"""Millimetres of mercury per kPa, as in the table of units."""
GAUSS_POINTS = 5
"""Points through the wall of a tube: for a wall as thick as its inner radius, pressures of GOH
materials differ by less than 1e-4 from those of 40 points."""


@dataclass(frozen=True)
class Tube(Experiment):
    r"""A pressurised tube: x runs around it, y along it; the radial stress is zero outside.

    Stretches are total: those of the outer surface around, relative to the unloaded tube, and along
    it. With the stress-free sector of radii A < B that lacks the angle phi of a circle,
    c = pi / (pi - phi / 2), as long as the unloaded tube, incompressibility gives the inner radius

        (ro^2 - r^2) lz c = B^2 - R^2         stretch around lt = c r / R

    and with the stresses of a membrane, s_t - s_r and s_z - s_r,

        p = \int s_t / r dr          pressure, kPa
        f = pi \int (2 s_z - s_t) r dr      force on the closed tube beside that of the pressure, mN

    by Gauss points in r. A thin wall is the limit of one point.
    """

    outer_radius_mm: float
    thickness_mm: float
    missing_sector_deg: float = 0.0
    reads_force: bool = True
    points_through_wall: int = GAUSS_POINTS

    name = "tube"
    is_mounted = False
    curves = ("pressure", "axial force")
    stretches = ("circumferential stretch", "axial stretch")
    force_unit = "N"

    @property
    def axes(self) -> tuple[int, ...]:  # type: ignore[override]
        """Pressure, and the axial force where it was read."""
        return (0, 1) if self.reads_force else (0,)

    @property
    def sector(self) -> tuple[float, float, float]:
        """(A, B, c) of the stress-free sector; the thickness is that of the closed, unloaded tube.

        The sector has the wall's thickness and its section.
        """
        c = np.pi / (np.pi - 0.5 * np.deg2rad(self.missing_sector_deg))
        mid = self.outer_radius_mm - 0.5 * self.thickness_mm
        # equal sections: (pi / c) (B^2 - A^2) = pi (b^2 - a^2), B - A = b - a
        mid_sector = c * mid
        half = 0.5 * self.thickness_mm
        return mid_sector - half, mid_sector + half, float(c)

    def radii(self, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inner and outer radius (rows,) of the deformed tube, mm; NaN where there is no lumen."""
        inside, outside, c = self.sector
        outer = stretch[:, 0] * self.outer_radius_mm
        # (ro^2 - ri^2) lz c = B^2 - A^2
        square = outer**2 - (outside**2 - inside**2) / (stretch[:, 1] * c)
        return np.sqrt(np.where(square > 0.0, square, np.nan)), outer

    def points(self, stretch: np.ndarray) -> Points:
        """Gauss points through the wall of each row."""
        _, outside, c = self.sector
        inner, outer = self.radii(stretch)
        place, share = np.polynomial.legendre.leggauss(self.points_through_wall)
        half = 0.5 * (outer - inner)[:, None]
        r, dr = 0.5 * (outer + inner)[:, None] + half * place, half * share
        axial = stretch[:, 1][:, None]
        # R^2 = B^2 - (ro^2 - r^2) lz c
        sector = np.sqrt(outside**2 - (outer[:, None] ** 2 - r**2) * axial * c)
        around = c * r / sector
        weight = np.zeros((*r.shape, 2, 2))
        weight[..., 0, 0] = dr / r
        if self.reads_force:
            weight[..., 1, 0] = -N_PER_KPA_MM2 * np.pi * r * dr
            weight[..., 1, 1] = 2.0 * N_PER_KPA_MM2 * np.pi * r * dr
        count = self.points_through_wall
        state = np.stack([around, np.broadcast_to(axial, r.shape)], axis=-1).reshape(-1, 2)
        return Points(state, weight.reshape(-1, 2, 2), np.repeat(np.arange(len(stretch)), count))

    def stresses(self, stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Mean stresses of the wall from pressure and force."""
        inner, outer = self.radii(stretch)
        mid, wall = 0.5 * (inner + outer), outer - inner
        # s_t = p r / h,   s_z = f / (2 pi r h) + s_t / 2
        around = load[:, 0] * mid / wall
        along = load[:, 1] / (2.0 * np.pi * mid * wall * N_PER_KPA_MM2) + 0.5 * around
        if not self.reads_force:
            along = 0.5 * around
        return np.column_stack([around, along])


BIAXIAL = Biaxial()
TESTS = ("biaxial", "strip x", "strip y", "tube")
"""Kinds of test as a specimen file names them."""


def experiment_of(test: str) -> Experiment:
    """The kind of test of a name in :data:`TESTS`."""
    kind, _, axis = test.partition(" ")
    return Strip("xy".index(axis)) if kind == "strip" else BIAXIAL


# --- free sides ----------------------------------------------------------------------------------

FREE_SIDE_STEPS, FREE_SIDE_TOLERANCE, LARGEST_STEP = 60, 1e-9, 0.1


def with_free_side(cauchy: Any, total: np.ndarray, side: int) -> np.ndarray:
    """Total stretches (..., 2) with the stretch of a free side where it is NaN, the root of s = 0.

    ``cauchy`` gives the stresses (s_x, s_y) at stretches x and y, complex ones too. NaN where
    Newton's method from an isotropic solid's stretch finds no stable root.
    """
    loaded = total[..., 1 - side]
    unknown = np.isnan(total[..., side])
    if not unknown.any():
        return total
    y = -0.5 * np.log(loaded)
    done = np.zeros(y.shape, dtype=bool)
    with np.errstate(all="ignore"):
        for _ in range(FREE_SIDE_STEPS):
            across = np.exp(y) * (1.0 + 1j * STEP)
            s = cauchy(*((loaded, across) if side == 1 else (across, loaded)))[side]
            s, slope = np.real(s), np.imag(s) / STEP
            # downhill where the energy is not convex
            step = np.where(slope > 0.0, -s / slope, -np.sign(s) * LARGEST_STEP)
            y = y + np.clip(step, -LARGEST_STEP, LARGEST_STEP)
            done = (np.abs(step) < FREE_SIDE_TOLERANCE) & (slope > 0.0)
            if done.all():
                break
    # one state for many materials becomes one of each
    out = np.broadcast_to(total, (*y.shape, 2)).copy()
    out[..., side] = np.where(unknown, np.where(done, np.exp(y), np.nan), total[..., side])
    return out
