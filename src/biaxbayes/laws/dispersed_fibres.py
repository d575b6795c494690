"""Dispersed fibres: the generalised structure tensor, and what laws with such fibres share.

Two symmetric families lie at +alpha and -alpha from x, dispersed by kappa. An axis-aligned test
sees the diagonal (Hx, Hy, Hz) of their structure tensor alone (Gasser, Ogden, Holzapfel, J. R. Soc.
Interface 3 (2006) 15). Angle and dispersion are sampled in :mod:`biaxbayes.laws.chart`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.coordinates import Transform
from biaxbayes.laws.law import Law, stiffening
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.parameters import Parameter, fibre_angle, positive_parameter


def structure_tensor(cos2: Any, kappa: Any) -> tuple[Any, Any, Any]:
    """Diagonal (Hx, Hy, Hz) of the generalised structure tensor, from cos^2 of the angle."""
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


class DispersedFibreLaw(Law):
    """Shared part of laws with dispersed fibres: parameters of the fibres and their chart."""

    has_switch = True
    fibre_parameters: ClassVar[tuple[Parameter, ...]] = (
        positive_parameter("k1", "k_1", "fibre stiffness", "kPa", 30.0, 2.5, 1e6, "no fibres"),
        stiffening("k2", "k_2", "fibre stiffening"),
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
    typical: ClassVar = {"kappa": 0.0}
    charted = ("alpha", "kappa")

    def sampling_widths(self, transform: Transform) -> dict[str, float]:
        """Width of kappa itself, where the chart is not used."""
        return {} if transform.alpha >= 0 else {"kappa": 0.06}

    def isotropy_scale(self, values: Mapping[str, Any]) -> float:
        """Median |Hx - Hy|, at least 0.02, of materials by parameter, in their own units."""
        cos_2_alpha = np.cos(2.0 * np.asarray(np.deg2rad(values["alpha"])))
        D = (1.0 - 3.0 * np.asarray(values["kappa"])) * cos_2_alpha
        return float(np.clip(np.median(np.abs(D)), 0.02, 1.0))

    def derived_quantities(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor: what an axis-aligned test sees of the fibres."""
        c = material.constants
        return dict(zip(("Hx", "Hy", "Hz"), structure_tensor(c.alpha, c.kappa), strict=True))
