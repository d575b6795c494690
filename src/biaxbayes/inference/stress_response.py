r"""Cauchy stress and its derivatives in the coordinates that the deterministic fits move in.

The coordinates are (C1, k1, k2, t, kappa) with t = cos^2 alpha. In t the structure tensor is
linear and an angle of 0 or 90 degrees is an ordinary bound; in alpha the stress is stationary
there whatever the data say, and a descent method would stop at either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.mechanics.goh import (
    GOH,
    fibre_factor,
    fibre_factor_slope,
    fibre_strain,
    stress_component,
    stress_jacobian,
    structure_tensor,
)

__all__ = ["StressResponse", "coordinates_of", "material_at", "stress_response"]


@dataclass(frozen=True, eq=False)
class StressResponse:
    """Stresses (kPa) at n states and their derivatives.

    Attributes
    ----------
    stress : ndarray, shape (2, n)
    by_coordinate : ndarray, shape (2, 5, n)
        By (C1, k1, k2, t, kappa).
    by_log_stretch : ndarray, shape (2, 2, n)
        First axis the stress, second the total stretch; symmetric.
    """

    stress: np.ndarray
    by_coordinate: np.ndarray
    by_log_stretch: np.ndarray


def stress_response(
    point: np.ndarray, stretch: np.ndarray, *, fibre_switch: bool = False
) -> StressResponse:
    """Evaluate stresses and derivatives at total stretches.

    Parameters
    ----------
    point : ndarray, shape (5,)
        (C1 kPa, k1 kPa, k2, t, kappa).
    stretch : ndarray, shape (2, n)
        Total stretches.
    fibre_switch : bool
    """
    C1, k1, k2, t, kappa = point
    Hx, Hy, Hz = structure_tensor(np.arccos(np.sqrt(t)), kappa)
    ax, ay = stretch * stretch
    az = 1.0 / (ax * ay)
    E = fibre_strain(Hx, Hy, Hz, ax, ay, az)
    growth = np.exp(k2 * E * E)
    unit = fibre_factor(1.0, E, growth, fibre_switch)
    slope = fibre_factor_slope(k1, k2, E, growth, fibre_switch)
    e = k1 * unit
    jxx, jxy, jyy = stress_jacobian(C1, Hx, Hy, Hz, e, slope, ax, ay, az)
    spread = 1.0 - 3.0 * kappa
    # dE/dt and dE/dkappa, from dHx/dt = 1 - 3 kappa, dHx/dkappa = 1 - 3 t and Hx + Hy + Hz = 1
    E_t = spread * (ax - ay)
    E_kappa = (1.0 - 3.0 * t) * ax + (3.0 * t - 2.0) * ay + az
    by_coordinate = np.empty((2, 5, ax.size), dtype=np.result_type(point, stretch))
    stress = np.empty((2, ax.size), dtype=by_coordinate.dtype)
    for k, (H, a, H_t, H_kappa) in enumerate(
        ((Hx, ax, spread, 1.0 - 3.0 * t), (Hy, ay, -spread, 3.0 * t - 2.0))
    ):
        g = H * a - Hz * az
        stress[k] = stress_component(C1, H, Hz, e, a, az)
        by_coordinate[k, 0] = 2.0 * (a - az)  # ds/dC1 = 2 (lk^2 - lz^2)
        by_coordinate[k, 1] = unit * g  # ds/dk1 = e gk / k1
        by_coordinate[k, 2] = e * E * E * g  # ds/dk2 = e E^2 gk
        by_coordinate[k, 3] = slope * E_t * g + e * H_t * a
        by_coordinate[k, 4] = slope * E_kappa * g + e * (H_kappa * a - az)
    return StressResponse(stress, by_coordinate, np.array([[jxx, jxy], [jxy, jyy]]))


def coordinates_of(material: GOH) -> np.ndarray:
    """(C1, k1, k2, t, kappa) of a material."""
    C1, k1, k2, alpha, kappa = material.theta
    # cos^2 of 90 degrees is 4e-33 in floating point, not the bound it stands for
    t = 0.0 if material.alpha_deg == 90.0 else float(np.cos(alpha) ** 2)
    return np.array([C1, k1, k2, t, kappa])


def material_at(point: np.ndarray, *, fibre_switch: bool = False) -> GOH:
    """The material at (C1, k1, k2, t, kappa)."""
    C1, k1, k2, t, kappa = (float(v) for v in point)
    alpha = float(np.rad2deg(np.arccos(np.sqrt(min(max(t, 0.0), 1.0)))))
    return GOH(C1, k1, k2, min(alpha, 90.0), min(max(kappa, 0.0), 1.0 / 3.0), fibre_switch)
