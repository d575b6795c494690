r"""The Gasser-Ogden-Holzapfel law.

Two symmetric fibre families lie at +alpha and -alpha from x. An axis-aligned test gives both the
same fibre strain, so the strain energy of Eq. 5 of the method paper (Math. Comput. Appl. 2024,
29(4), 55) reads, with the squared stretches X, Y, Z,

    W = C1 (X + Y + Z - 3) + (k1 / k2) (exp(k2 E^2) - 1)
    E = Hx X + Hy Y + Hz Z - 1

and the diagonal (Hx, Hy, Hz) of the generalised structure tensor. With the fibre switch (Abaqus,
FEBio) fibres carry no compression; the paper has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from biaxbayes.laws.differentiation import exponential
from biaxbayes.laws.dispersed_fibres import DispersedFibreLaw, structure_tensor
from biaxbayes.laws.law import matrix_stiffness
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.parameters import Parameter


def energy(X, Y, Z, C1, k1, k2, cos2, kappa, switch):
    """W in kPa at squared stretches; with the switch (1), no fibres where E is negative."""
    Hx, Hy, Hz = structure_tensor(cos2, kappa)
    E = Hx * X + Hy * Y + Hz * Z - 1.0
    fibres = 1.0 - switch * (E < 0.0)
    return C1 * (X + Y + Z - 3.0) + fibres * k1 * exponential(k2, E * E)


class GOHLaw(DispersedFibreLaw):
    """Gasser-Ogden-Holzapfel: dispersed fibres in a neo-Hookean matrix."""

    energy = staticmethod(energy)
    name = "goh"
    title = "Gasser-Ogden-Holzapfel"
    abbreviation = "GOH"
    source = "Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15"
    doi = "10.1098/rsif.2005.0073"
    description = (
        "the incompressible Gasser-Ogden-Holzapfel model with two fibre families at ±alpha from "
        "the x axis and equal properties; fibres carried load {load}"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        matrix_stiffness("C1", "C_1", 10.0),
        *DispersedFibreLaw.fibre_parameters,
    )
    amplitudes = ("C1", "k1")
    exponents: ClassVar = {"k2": "k2 E^2"}
    compares_stiffness = True
    undefined_at: ClassVar = {"alpha": (("kappa", 1, "kappa = 1/3"),)}

    def material_at(self, values: Sequence[float]) -> GOH:
        """One material, checked, at parameters in their own units."""
        C1, k1, k2, alpha, kappa = values
        return GOH(C1, k1, k2, alpha, kappa, self.fibre_switch)

    as_goh = material_at


@dataclass(frozen=True)
class GOH(MaterialResponse):
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
        if not np.all(np.isfinite(self.values)):
            raise ValueError("GOH parameters must be finite")
        if min(self.C1_kPa, self.k1_kPa, self.k2) < 0.0:
            raise ValueError("C1, k1 and k2 must not be negative")
        if not 0.0 <= self.alpha_deg <= 90.0:
            raise ValueError("alpha must lie between 0 and 90 degrees")
        if not 0.0 <= self.kappa <= 1.0 / 3.0 + 1e-12:
            raise ValueError("kappa must lie between 0 and 1/3")

    @property
    def law(self) -> GOHLaw:
        """The law, with this material's fibre switch."""
        return GOHLaw(self.fibre_switch)

    @property
    def values(self) -> tuple[float, float, float, float, float]:
        """(C1, k1, k2, alpha in degrees, kappa), in the order of the law's parameters."""
        return self.C1_kPa, self.k1_kPa, self.k2, self.alpha_deg, self.kappa

    @property
    def theta(self) -> tuple[float, float, float, float, float]:
        """(C1, k1, k2, alpha in radians, kappa)."""
        return *self.values[:3], float(np.deg2rad(self.alpha_deg)), self.kappa

    def structure_tensor(self) -> tuple[float, float, float]:
        """Diagonal (Hx, Hy, Hz) of the generalised structure tensor; sums to one."""
        return structure_tensor(np.cos(self.theta[3]) ** 2, self.kappa)
