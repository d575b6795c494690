r"""Inflation of a thin-walled tube at a fixed axial stretch.

The wall is a membrane: radial stress neglected, deformation uniform through the wall, no
residual stress (the tube is stress free at its unloaded mid radius R and wall thickness H).
With the circumferential stretch lt and the axial stretch la,

    r = lt R,    h = H / (lt la)                       incompressible wall
    p = s_t h / r = s_t H / (R lt^2 la) = P_t H / (R lt la)

which is the derivative of the stored energy by the volume inside the mid surface. The force
that a transducer reads on the closed tube (the reduced axial force) is

    f = 2 pi r h s_a - pi r^2 p
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.laws.response import MaterialResponse
from biaxbayes.mechanics.mounting import BRACKET

__all__ = [
    "MMHG_PER_KPA",
    "Tube",
    "inflation_axial_force",
    "inflation_pressure",
    "inflation_stretch",
]

MMHG_PER_KPA = 7.500616827
"""Millimetres of mercury per kPa (1 mmHg = 133.322 Pa)."""

GRID = 400  # states at which a crossing is looked for, equally spaced in log stretch
MAX_STEPS = 80
TOLERANCE = 1e-13  # of the stretch


@dataclass(frozen=True)
class Tube:
    """An unloaded thin-walled tube held at an axial stretch.

    Parameters
    ----------
    mid_radius_mm, thickness_mm : float
        Unloaded radius of the middle of the wall, and unloaded wall thickness.
    axial_stretch : float
        Total axial stretch, relative to the unloaded state.
    circumferential : {"x", "y"}
        The axis of the test that runs around the tube; the other runs along it.

    Raises
    ------
    ValueError
        If a dimension is not positive, the wall is thicker than the mid radius, or
        ``circumferential`` is not an axis.
    """

    mid_radius_mm: float
    thickness_mm: float
    axial_stretch: float = 1.0
    circumferential: str = "x"

    def __post_init__(self) -> None:
        values = (self.mid_radius_mm, self.thickness_mm, self.axial_stretch)
        if not all(np.isfinite(v) and v > 0.0 for v in values):
            raise ValueError("mid radius, wall thickness and axial stretch must be positive")
        if self.thickness_mm > self.mid_radius_mm:
            raise ValueError("the wall is thicker than the mid radius: not a thin-walled tube")
        if self.circumferential not in ("x", "y"):
            raise ValueError("circumferential must be 'x' or 'y'")

    def stretches(self, circumferential_stretch) -> tuple[Any, Any]:
        """(stretch_x, stretch_y) of the wall at a circumferential stretch of the mid surface."""
        axial = np.full_like(np.asarray(circumferential_stretch, dtype=float), self.axial_stretch)
        if self.circumferential == "x":
            return circumferential_stretch, axial
        return axial, circumferential_stretch

    def mid_diameter_mm(self, circumferential_stretch) -> Any:
        """Current diameter of the middle of the wall."""
        # d = 2 lt R
        return 2.0 * circumferential_stretch * self.mid_radius_mm

    def outer_diameter_mm(self, circumferential_stretch) -> Any:
        """Current outer diameter."""
        # d_o = 2 r + h
        wall = self.thickness_mm / (circumferential_stretch * self.axial_stretch)
        return self.mid_diameter_mm(circumferential_stretch) + wall


def inflation_pressure(
    material: MaterialResponse, tube: Tube, circumferential_stretch, *, piola_offset_kPa=0.0
) -> Any:
    """Pressure that holds the tube at a circumferential stretch.

    Parameters
    ----------
    material : Material
        One, or one a draw.
    tube : Tube
    circumferential_stretch : array_like
        Total stretch of the mid surface; broadcasts with the material.
    piola_offset_kPa : array_like
        Added to the circumferential first Piola-Kirchhoff stress: the misfit of a new specimen.

    Returns
    -------
    ndarray
        Pressure in kPa.
    """
    stretch_x, stretch_y = tube.stretches(circumferential_stretch)
    Px, Py = material.piola(stretch_x, stretch_y)
    hoop = Px if tube.circumferential == "x" else Py
    # p = P_t H / (R lt la)
    return (
        (hoop + piola_offset_kPa)
        * tube.thickness_mm
        / (tube.mid_radius_mm * circumferential_stretch * tube.axial_stretch)
    )


def inflation_axial_force(material: MaterialResponse, tube: Tube, circumferential_stretch) -> Any:
    """Reduced axial force of the closed tube in mN (kPa mm^2); arguments as for the pressure."""
    stretch_x, stretch_y = tube.stretches(circumferential_stretch)
    s = material.cauchy(stretch_x, stretch_y)
    axial = s[1] if tube.circumferential == "x" else s[0]
    p = inflation_pressure(material, tube, circumferential_stretch)
    R, H = tube.mid_radius_mm, tube.thickness_mm
    # f = 2 pi r h s_a - pi r^2 p,  r h = R H / la
    return (
        2.0 * np.pi * R * H / tube.axial_stretch * axial
        - np.pi * (circumferential_stretch * R) ** 2 * p
    )


def inflation_stretch(
    material: MaterialResponse, tube: Tube, pressure_kPa, *, piola_offset_kPa=0.0
) -> np.ndarray:
    """Circumferential stretch at a pressure: the first state met from the unpressurised one.

    Parameters
    ----------
    material : Material
        One, or one a draw: its values have shape (n, 1).
    tube : Tube
    pressure_kPa : array_like, shape (m,)
    piola_offset_kPa : array_like, shape (n,) or scalar

    Returns
    -------
    ndarray, shape (n, m)
        NaN where no equilibrium lies inside the bracket of stretches 0.5 to 2.
    """
    offset = np.atleast_1d(np.asarray(piola_offset_kPa, dtype=float))[:, None]
    target = np.atleast_1d(np.asarray(pressure_kPa, dtype=float))

    def pressure(stretch: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            p = inflation_pressure(material, tube, stretch, piola_offset_kPa=offset)
        # Beyond the range of the exponential the wall is rigid, inwards as outwards.
        return np.where(np.isfinite(p), p, np.where(stretch > 1.0, np.inf, -np.inf))

    grid = np.geomspace(*BRACKET, GRID)
    coarse = pressure(grid[None, :])
    first, found = _branch(grid, coarse, target, tube.axial_stretch)
    low, high = grid[first], grid[first + 1]
    for _ in range(MAX_STEPS):
        middle = 0.5 * (low + high)
        below = pressure(middle) < target
        low, high = np.where(below, middle, low), np.where(below, high, middle)
        if np.max(high - low) <= TOLERANCE:
            break
    return np.where(found, 0.5 * (low + high), np.nan)


def _branch(
    grid: np.ndarray, coarse: np.ndarray, target: np.ndarray, axial_stretch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of the grid, shape (n, m), over which the pressure first rises through a target.

    Fibres that carry compression can hold a pressure in states of strong contraction as well;
    the branch that counts passes through the unpressurised state.
    """
    interval = np.arange(grid.size - 1)

    def rises(value: float) -> np.ndarray:
        return (coarse[:, :-1] < value) & (coarse[:, 1:] >= value)

    def nearest(candidates: np.ndarray, centre: np.ndarray) -> np.ndarray:
        distance = np.abs(interval - centre[:, None])
        return np.where(candidates, distance, grid.size).argmin(axis=1)

    # Unpressurised, an isotropic wall would rest at lt = la^(-1/2).
    free = np.full(len(coarse), np.searchsorted(grid, axial_stretch**-0.5))
    start, at_rest = nearest(rises(0.0), free), rises(0.0).any(axis=1)
    first = np.empty((len(coarse), target.size), dtype=int)
    found = np.empty(first.shape, dtype=bool)
    for j, value in enumerate(target):
        side = interval >= start[:, None] if value >= 0.0 else interval <= start[:, None]
        candidates = rises(value) & side
        first[:, j] = nearest(candidates, start)
        found[:, j] = candidates.any(axis=1) & at_rest
    return first, found
