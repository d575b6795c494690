r"""The Gasser-Ogden-Holzapfel membrane in a planar biaxial test.

Kinematics: incompressible, no shear, F = diag(lx, ly, 1/(lx ly)), plane stress sz = 0.
Two symmetric fibre families lie at +alpha and -alpha from x. An axis-aligned test gives both
the same fibre strain, so the strain energy of Eq. 5 of the method paper (Math. Comput. Appl.
2024, 29(4), 55) reads

    W = C1 (lx^2 + ly^2 + lz^2 - 3) + (k1 / k2) (exp(k2 E^2) - 1)
    E = Hx lx^2 + Hy ly^2 + Hz lz^2 - 1

with the diagonal (Hx, Hy, Hz) of the generalised structure tensor.

The functions of the first block are the only definition of the model. They are written with
plain arithmetic, so that the same text serves NumPy arrays, complex numbers (complex-step
differentiation) and, through ``register_jitable``, the compiled posterior density.
Squared stretches are written ``ax, ay, az``; the exponential enters as ``growth``
= exp(k2 E^2), because the compiled kernel evaluates it for a whole curve at once.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numba.extending import register_jitable

__all__ = [
    "GOH",
    "PARAMETERS",
    "cauchy_stress",
    "cauchy_stress_by_log_stretch",
    "cauchy_stress_by_parameter",
    "piola_stress",
    "strain_energy",
    "structure_tensor",
]

PARAMETERS = ("C1", "k1", "k2", "alpha", "kappa")
"""Order of the material parameters wherever they form an axis of an array."""


# --- the model, once -----------------------------------------------------------------------


@register_jitable
def structure_tensor(alpha, kappa):
    """Diagonal (Hx, Hy, Hz) of the generalised structure tensor; ``alpha`` in radians."""
    cos2 = np.cos(alpha) ** 2
    # Hx = kappa + (1 - 3 kappa) cos^2 alpha,  Hy = kappa + (1 - 3 kappa) sin^2 alpha,  Hz = kappa
    return kappa + (1.0 - 3.0 * kappa) * cos2, kappa + (1.0 - 3.0 * kappa) * (1.0 - cos2), kappa


@register_jitable
def fibre_strain(Hx, Hy, Hz, ax, ay, az):
    """Green-like strain E of the dispersed fibre families."""
    # E = Hx lx^2 + Hy ly^2 + Hz lz^2 - 1
    return Hx * ax + Hy * ay + Hz * az - 1.0


@register_jitable
def fibre_factor(k1, E, growth, fibre_switch):
    """Fibre stress factor e; with the switch (Abaqus, FEBio) fibres carry no compression."""
    # e = 4 k1 E exp(k2 E^2)
    return 4.0 * k1 * E * growth * (1.0 - fibre_switch * (E.real < 0.0))


@register_jitable
def fibre_factor_slope(k1, k2, E, growth, fibre_switch):
    """Derivative of the fibre stress factor by the fibre strain."""
    # de/dE = 4 k1 (1 + 2 k2 E^2) exp(k2 E^2)
    return 4.0 * k1 * (1.0 + 2.0 * k2 * E * E) * growth * (1.0 - fibre_switch * (E.real < 0.0))


@register_jitable
def stress_component(C1, Hk, Hz, e, ak, az):
    """Cauchy stress in one loading direction k."""
    # s_k = (2 C1 + Hk e) lk^2 - (2 C1 + Hz e) lz^2
    return (2.0 * C1 + Hk * e) * ak - (2.0 * C1 + Hz * e) * az


@register_jitable
def stress_jacobian(C1, Hx, Hy, Hz, e, slope, ax, ay, az):
    """Derivatives (xx, xy, yy) of the Cauchy stresses by the log stretches; symmetric.

    With W a function of (ln lx, ln ly), s_k = dW/d ln lk, so this is the Hessian of W.
    """
    gx = Hx * ax - Hz * az
    gy = Hy * ay - Hz * az
    # ds_x/d ln lx = 4 C1 (lx^2 + lz^2) + 2 (de/dE) gx^2 + 2 e (Hx lx^2 + Hz lz^2)
    jxx = 4.0 * C1 * (ax + az) + 2.0 * slope * gx * gx + 2.0 * e * (Hx * ax + Hz * az)
    # ds_x/d ln ly = 4 C1 lz^2 + 2 (de/dE) gx gy + 2 e Hz lz^2
    jxy = 4.0 * C1 * az + 2.0 * slope * gx * gy + 2.0 * e * Hz * az
    jyy = 4.0 * C1 * (ay + az) + 2.0 * slope * gy * gy + 2.0 * e * (Hy * ay + Hz * az)
    return jxx, jxy, jyy


# --- the same, for arrays ------------------------------------------------------------------


def _plain(*values: Any) -> Any:
    """Numbers and arrays as they are, lists and tables' columns as arrays."""
    known = (float, complex, np.ndarray, np.generic)
    return (v if isinstance(v, known) else np.asarray(v) for v in values)


def _state(k1, k2, alpha, kappa, lx, ly, fibre_switch):
    """Squared stretches, structure tensor, fibre strain, factor, its slope and the growth."""
    ax, ay = lx * lx, ly * ly
    az = 1.0 / (ax * ay)
    H = Hx, Hy, Hz = structure_tensor(alpha, kappa)
    E = fibre_strain(Hx, Hy, Hz, ax, ay, az)
    growth = np.exp(k2 * E * E)
    e = fibre_factor(k1, E, growth, fibre_switch)
    slope = fibre_factor_slope(k1, k2, E, growth, fibre_switch)
    return (ax, ay, az), H, E, e, slope, growth


def strain_energy(C1, k1, k2, alpha, kappa, stretch_x, stretch_y, *, fibre_switch=False) -> Any:
    """Strain energy density W, Eq. 5 of the paper.

    Parameters
    ----------
    C1, k1 : array_like
        Stiffness of the matrix and of the fibres, kPa.
    k2 : array_like
        Exponent, 1; zero is allowed and gives the limit k1 E^2.
    alpha : array_like
        Mean fibre angle from x, radians.
    kappa : array_like
        Dispersion, 0 to 1/3.
    stretch_x, stretch_y : array_like
        Total stretches. All arguments broadcast; complex values are allowed.
    fibre_switch : bool
        Drop the fibre term where the fibre strain is negative (Abaqus, FEBio).

    Returns
    -------
    ndarray
        Energy per reference volume, kPa.
    """
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y = _plain(
        C1, k1, k2, alpha, kappa, stretch_x, stretch_y
    )
    ax, ay = stretch_x * stretch_x, stretch_y * stretch_y
    az = 1.0 / (ax * ay)
    Hx, Hy, Hz = structure_tensor(alpha, kappa)
    E = fibre_strain(Hx, Hy, Hz, ax, ay, az)
    k2 = np.asarray(k2)
    # (exp(k2 E^2) - 1) / k2 -> E^2 as k2 -> 0
    safe = np.where(k2 == 0.0, 1.0, k2)
    fibre = np.where(k2 == 0.0, E * E, np.expm1(k2 * E * E) / safe)
    active = 1.0 - fibre_switch * (E.real < 0.0)
    return C1 * (ax + ay + az - 3.0) + k1 * fibre * active


def cauchy_stress(C1, k1, k2, alpha, kappa, stretch_x, stretch_y, *, fibre_switch=False) -> Any:
    """Cauchy stresses (s_x, s_y) in kPa; arguments as in :func:`strain_energy`."""
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y = _plain(
        C1, k1, k2, alpha, kappa, stretch_x, stretch_y
    )
    (ax, ay, az), (Hx, Hy, Hz), _, e, _, _ = _state(
        k1, k2, alpha, kappa, stretch_x, stretch_y, fibre_switch
    )
    return stress_component(C1, Hx, Hz, e, ax, az), stress_component(C1, Hy, Hz, e, ay, az)


def piola_stress(C1, k1, k2, alpha, kappa, stretch_x, stretch_y, *, fibre_switch=False) -> Any:
    """First Piola-Kirchhoff stresses (P_x, P_y) in kPa: force over reference area."""
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y = _plain(
        C1, k1, k2, alpha, kappa, stretch_x, stretch_y
    )
    sx, sy = cauchy_stress(
        C1, k1, k2, alpha, kappa, stretch_x, stretch_y, fibre_switch=fibre_switch
    )
    # P_k = s_k / l_k
    return sx / stretch_x, sy / stretch_y


def cauchy_stress_by_log_stretch(
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y, *, fibre_switch=False
) -> Any:
    """Derivatives of (s_x, s_y) by (ln l_x, ln l_y), kPa.

    Returns
    -------
    ndarray, shape (2, 2, ...)
        First axis the stress, second the stretch; symmetric in the two.
    """
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y = _plain(
        C1, k1, k2, alpha, kappa, stretch_x, stretch_y
    )
    (ax, ay, az), (Hx, Hy, Hz), _, e, slope, _ = _state(
        k1, k2, alpha, kappa, stretch_x, stretch_y, fibre_switch
    )
    jxx, jxy, jyy = stress_jacobian(C1, Hx, Hy, Hz, e, slope, ax, ay, az)
    return np.array([[jxx, jxy], [jxy, jyy]])


def cauchy_stress_by_parameter(
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y, *, fibre_switch=False
) -> Any:
    """Derivatives of (s_x, s_y) by the parameters in the order of :data:`PARAMETERS`.

    The material parameters are scalars here. Units are kPa per unit of the parameter
    (alpha per radian).

    Returns
    -------
    ndarray, shape (2, 5, ...)
    """
    C1, k1, k2, alpha, kappa, stretch_x, stretch_y = _plain(
        C1, k1, k2, alpha, kappa, stretch_x, stretch_y
    )
    (ax, ay, az), (Hx, Hy, Hz), E, e, slope, growth = _state(
        k1, k2, alpha, kappa, stretch_x, stretch_y, fibre_switch
    )
    unit = fibre_factor(1.0, E, growth, fibre_switch)
    cos2 = np.cos(alpha) ** 2
    tilt = (1.0 - 3.0 * kappa) * np.sin(2.0 * alpha)
    out = []
    for Hk, ak, dHk_alpha, dHk_kappa in (
        (Hx, ax, -tilt, 1.0 - 3.0 * cos2),
        (Hy, ay, tilt, 1.0 - 3.0 * (1.0 - cos2)),
    ):
        gk = Hk * ak - Hz * az
        dE_alpha = tilt * (ay - ax)
        dE_kappa = (1.0 - 3.0 * cos2) * ax + (3.0 * cos2 - 2.0) * ay + az
        out.append(
            [
                2.0 * (ak - az),  # ds/dC1 = 2 (lk^2 - lz^2)
                unit * gk,  # ds/dk1 = e gk / k1
                e * E * E * gk,  # ds/dk2 = e E^2 gk
                slope * dE_alpha * gk + e * dHk_alpha * ak,
                slope * dE_kappa * gk + e * (dHk_kappa * ak - az),
            ]
        )
    return np.array(out)


@dataclass(frozen=True)
class GOH:
    """A Gasser-Ogden-Holzapfel material.

    Parameters
    ----------
    C1_kPa, k1_kPa : float
        Stiffness of the matrix and of the fibre families.
    k2 : float
        Exponent of the fibres.
    alpha_deg : float
        Mean fibre angle from the x axis, 0 to 90 degrees.
    kappa : float
        Dispersion, 0 (aligned) to 1/3 (isotropic).
    fibre_switch : bool
        Fibres carry no compression, as in Abaqus and FEBio; the paper has no switch.

    Raises
    ------
    ValueError
        If a parameter lies outside its range.
    """

    C1_kPa: float
    k1_kPa: float
    k2: float
    alpha_deg: float
    kappa: float
    fibre_switch: bool = False

    def __post_init__(self) -> None:
        values = (self.C1_kPa, self.k1_kPa, self.k2, self.alpha_deg, self.kappa)
        if not np.all(np.isfinite(values)):
            raise ValueError("GOH parameters must be finite")
        if min(self.C1_kPa, self.k1_kPa, self.k2) < 0.0:
            raise ValueError("C1, k1 and k2 must not be negative")
        if not 0.0 <= self.alpha_deg <= 90.0:
            raise ValueError("alpha must lie between 0 and 90 degrees")
        if not 0.0 <= self.kappa <= 1.0 / 3.0 + 1e-12:
            raise ValueError("kappa must lie between 0 and 1/3")

    @property
    def theta(self) -> tuple[float, float, float, float, float]:
        """(C1, k1, k2, alpha in radians, kappa): the arguments of the module's functions."""
        C1, k1, k2, alpha_deg, kappa, _ = astuple(self)
        return C1, k1, k2, float(np.deg2rad(alpha_deg)), kappa

    def structure_tensor(self) -> tuple[float, float, float]:
        """Diagonal (Hx, Hy, Hz) of the generalised structure tensor; sums to one."""
        return structure_tensor(self.theta[3], self.kappa)

    def strain_energy(self, stretch_x, stretch_y) -> Any:
        """Strain energy density in kPa at total stretches."""
        return strain_energy(*self.theta, stretch_x, stretch_y, fibre_switch=self.fibre_switch)

    def cauchy(self, stretch_x, stretch_y) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches."""
        return cauchy_stress(*self.theta, stretch_x, stretch_y, fibre_switch=self.fibre_switch)

    def piola(self, stretch_x, stretch_y) -> Any:
        """First Piola-Kirchhoff stresses (P_x, P_y) in kPa at total stretches."""
        return piola_stress(*self.theta, stretch_x, stretch_y, fibre_switch=self.fibre_switch)
