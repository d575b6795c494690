r"""Dispersed fibres: the generalised structure tensor, and the chart that it is sampled in.

Two symmetric families lie at +alpha and -alpha from x, dispersed by kappa. An axis-aligned test
sees the diagonal (Hx, Hy, Hz) of their structure tensor alone (Gasser, Ogden, Holzapfel, J. R. Soc.
Interface 3 (2006) 15), in which both families have the strain E = Hx X + Hy Y + Hz Z - 1 at
squared stretches X, Y, Z.

The chart is (d, v). Data determine d = ln(Hx / Hy). v stands for h = (1 - 3 kappa) sin 2 alpha,
twice the in-plane shear component of each family's structure tensor: what an axis-aligned test does
not see. With R = 1 - 3 kappa and D = Hx - Hy = R cos 2 alpha, the pair (D, h) are Cartesian
coordinates of the polar pair (R, 2 alpha). At a given d, h runs from 0, where alpha is 0 or 90
degrees, to h_max = 2 sqrt(t (1 - t)), t = Hx / (Hx + Hy), where kappa is 0;

    v = asinh(h / s) / asinh(h_max / s)

runs from 0 to 1. The density is regular on both edges, and both are straight in v, which the
independence move folds its proposals at. The softening s, a constant of the specimen near its
|D|, makes the density 1/R of the polar coordinates flat in v, however close to isotropy (R = 0) the
tissue is. One chart thus serves every specimen; (alpha, kappa) themselves are used where one of
the two is fixed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse, exponential_energy
from biaxbayes.parameters import Parameter, fibre_angle, positive_parameter

DEFAULT_SOFTENING = 0.3


@inlined
def structure_tensor(alpha, kappa):
    """Diagonal (Hx, Hy, Hz) of the generalised structure tensor; ``alpha`` in radians."""
    return structure_tensor_from_cos2(np.cos(alpha) ** 2, kappa)


@inlined
def structure_tensor_from_cos2(cos2, kappa):
    """Diagonal (Hx, Hy, Hz) from cos^2 of the angle."""
    # Hx = kappa + (1 - 3 kappa) cos^2 alpha,  Hy = kappa + (1 - 3 kappa) sin^2 alpha,  Hz = kappa
    return kappa + (1.0 - 3.0 * kappa) * cos2, kappa + (1.0 - 3.0 * kappa) * (1.0 - cos2), kappa


def dispersion_as_goh(kappa_ip: float, kappa_op: float, alpha_deg: float) -> tuple[float, float]:
    """Angle and dispersion of GOH of the same axis-aligned response as two dispersions.

    With the dispersion in the plane and out of it (Holzapfel et al., J. R. Soc. Interface 12 (2015)
    20150188) and one generalised strain, the structure tensor of two families at +-alpha is
    (A + B cos^2 alpha, A + B sin^2 alpha, 1 - 2 kappa_op). It is that of GOH at another angle
    wherever its last component is the smallest. So histology is given as a prior of GOH.

    Parameters
    ----------
    kappa_ip : float
        In the plane: 0 aligned, 1/2 no preferred direction in the plane, 1 aligned across.
    kappa_op : float
        Out of the plane: 1/2 all fibres in the plane, 1/3 isotropic where kappa_ip is 1/2.
    alpha_deg : float
        Mean angle of a family from the x axis.

    Returns
    -------
    alpha_deg, kappa : float

    Raises
    ------
    InputError
        For dispersions out of range, and where more of the fibres points across than along x or y.
    """
    if not (0.0 <= kappa_ip <= 1.0 and 0.0 <= kappa_op <= 0.5):
        raise InputError(
            f"kappa_ip {kappa_ip:g} and kappa_op {kappa_op:g} are out of range",
            remedy="kappa_ip lies between 0 and 1, kappa_op between 0 and 0.5",
        )
    A, B = 2.0 * kappa_op * kappa_ip, 2.0 * kappa_op * (1.0 - 2.0 * kappa_ip)
    Hx, Hz = A + B * math.cos(math.radians(alpha_deg)) ** 2, 1.0 - 2.0 * kappa_op
    Hy = 1.0 - Hx - Hz
    if Hz > min(Hx, Hy) * (1.0 + 1e-12):
        raise InputError(
            f"GOH has no such dispersion: H is {Hx:.3g}, {Hy:.3g} in the plane and {Hz:.3g} across",
            remedy="a larger kappa_op, or leave alpha and kappa free",
        )
    # Hx = kappa + (1 - 3 kappa) cos^2 alpha,  Hz = kappa
    R = 1.0 - 3.0 * Hz
    cos2 = (Hx - Hz) / R if R > 1e-9 else 0.5
    return math.degrees(math.acos(math.sqrt(min(max(cos2, 0.0), 1.0)))), Hz


@inlined
def fibre_strain(constants, X, Y, Z):
    """Green-like strain E of the dispersed fibre families."""
    # E = Hx X + Hy Y + Hz Z - 1
    return constants.Hx * X + constants.Hy * Y + constants.Hz * Z - 1.0


@inlined
def _active(constants, E):
    """1 where the fibres carry load, 0 in compression with the switch."""
    return 1.0 - constants.switch * (E.real < 0.0)


@inlined
def fibre_slope(constants, E):
    """Give dW/dE of W = (k1 / k2) (exp(k2 E^2) - 1)."""
    # dW/dE = 2 k1 E exp(k2 E^2)
    return 2.0 * constants.k1 * E * np.exp(constants.k2 * E * E) * _active(constants, E)


def fibre_energy(constants, E):
    """W = (k1 / k2) (exp(k2 E^2) - 1); not compiled."""
    return constants.k1 * exponential_energy(constants.k2, E * E) * _active(constants, E)


@inlined
def angles_from_chart(d, v, softening):
    """(alpha, kappa, ln |d(alpha, kappa)/d(d, v)|); ``alpha`` in radians."""
    t = 1.0 / (1.0 + np.exp(-d))
    tt = 1.0 / ((1.0 + np.exp(-d)) * (1.0 + np.exp(d)))  # t (1 - t), without cancellation
    h_max = 2.0 * np.sqrt(tt)
    span = np.arcsinh(h_max / softening)
    h = softening * np.sinh(v * span)
    # D = Hx - Hy = g (2 + R) with g = (2 t - 1) / 3, since Hx + Hy = 1 - kappa = (2 + R) / 3
    g = (2.0 * t - 1.0) / 3.0
    g2 = g * g
    # R^2 = D^2 + h^2:  (1 - g^2) R^2 - 4 g^2 R - 4 g^2 - h^2 = 0
    R = (2.0 * g2 + np.sqrt(4.0 * g2 * g2 + (1.0 - g2) * (4.0 * g2 + h * h))) / (1.0 - g2)
    R = min(R, 1.0)
    D = g * (2.0 + R)
    # d kappa d alpha = dD dh / (6 R);  dD/dd = (2 + R) R / (R - g D) * (2/3) t (1 - t) at fixed h
    # dh/dv = span sqrt(h^2 + s^2) at fixed d
    slope = span * np.sqrt(h * h + softening * softening)
    log_jacobian = np.log((2.0 + R) * tt * slope / (9.0 * (R - g * D)))
    return 0.5 * np.arctan2(h, D), (1.0 - R) / 3.0, log_jacobian


def chart_from_angles(alpha, kappa, softening):
    """(d, v) from the angle (radians) and the dispersion; arrays broadcast."""
    R = 1.0 - 3.0 * kappa
    D = R * np.cos(2.0 * alpha)
    # Hx / Hy = (1 - kappa + D) / (1 - kappa - D)
    d = np.log((1.0 - kappa + D) / (1.0 - kappa - D))
    h = R * np.sin(2.0 * alpha)
    h_max = 1.0 / np.cosh(0.5 * d)  # 2 sqrt(t (1 - t))
    v = np.arcsinh(h / softening) / np.arcsinh(h_max / softening)
    return d, np.clip(v, 0.0, 1.0)


def median_softening(alpha, kappa) -> float:
    """Median |Hx - Hy|, at least 0.02, of tissue around these angles (radians) and dispersions."""
    D = (1.0 - 3.0 * np.asarray(kappa)) * np.cos(2.0 * np.asarray(alpha))
    return float(np.clip(np.median(np.abs(D)), 0.02, 1.0))


@inlined
def reference_state(alpha, kappa, X, Y, Z):
    """(ln E*^2, ln(E* sqrt(gx gy))) at the reference stretch, given squared."""
    Hx, Hy, Hz = structure_tensor(alpha, kappa)
    E = Hx * X + Hy * Y + Hz * Z - 1.0
    gx = Hx * X - Hz * Z
    gy = Hy * Y - Hz * Z
    # S = k1 E* exp(q) sqrt(gx gy),  q = k2 E*^2
    return 2.0 * np.log(E), np.log(E) + 0.5 * np.log(gx * gy)


class DispersedFibreLaw(Law):
    """Shared part of laws with dispersed fibres: parameters of the fibres and their chart."""

    has_switch = True
    fibre_parameters: ClassVar[tuple[Parameter, ...]] = (
        positive_parameter("k1", "k_1", "fibre stiffness", "kPa", 30.0, 2.5, 1e6, "no fibres"),
        positive_parameter(
            "k2", "k_2", "fibre stiffening", "1", 10.0, 2.0, 1e4, "no exponential stiffening"
        ),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
        Parameter(
            "kappa",
            r"\kappa",
            words="fibre dispersion",
            low=0.0,
            high=1.0 / 3.0,
            at_low="aligned fibres",
            at_high="isotropic",
            sharp=0.1,
            digits=".3f",
            prior=("uniform", 0.0, 1.0 / 3.0),
        ),
    )
    ties = (("k1", "C1"), ("C1", "k1"))
    fraction_tolerances: ClassVar = {"kappa": 0.02}

    def sampling_bounds(self, transform: Any) -> dict[str, tuple[float, float]]:
        """Bounds of the sampling coordinates, by parameter."""
        if transform.chart > 0.0:
            return {"kappa": (0.0, 1.0)}
        return super().sampling_bounds(transform)

    def sampling_widths(self, transform: Any) -> dict[str, float]:
        """Width of kappa itself, where the chart is not used."""
        return {} if transform.chart > 0.0 else {"kappa": 0.06}

    def has_isotropy_scale(self, transform: Any) -> bool:
        """True if the chart is used."""
        return bool(transform.chart > 0.0)

    def softening(self, values: Mapping[str, Any]) -> float:
        """Scale of the chart near isotropy for materials by parameter, in their own units."""
        return median_softening(np.deg2rad(values["alpha"]), values["kappa"])

    def derived_quantities(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor: what an axis-aligned test sees of the fibres."""
        c = material.constants
        return {"Hx": c.Hx, "Hy": c.Hy, "Hz": c.Hz}
