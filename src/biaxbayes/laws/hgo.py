"""The Holzapfel-Gasser-Ogden law: GOH with aligned fibres.

    W = C1 (X + Y + Z - 3) + (k1 / k2) (exp(k2 E^2) - 1),    E = X cos^2 alpha + Y sin^2 alpha - 1

with the squared stretches X, Y, Z. It is the case kappa = 0 of :mod:`biaxbayes.laws.goh`, and a law
of its own because most printed materials have aligned fibres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from biaxbayes.laws.differentiation import exponential
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.parameters import Parameter


def energy(X, Y, Z, C1, k1, k2, cos2):
    """W in kPa at squared stretches."""
    E = cos2 * X + (1.0 - cos2) * Y - 1.0
    return C1 * (X + Y + Z - 3.0) + k1 * exponential(k2, E * E)


class HGOLaw(Law):
    """Holzapfel-Gasser-Ogden: aligned fibres in a neo-Hookean matrix."""

    energy = staticmethod(energy)
    name = "hgo"
    title = "Holzapfel-Gasser-Ogden"
    abbreviation = "HGO"
    source = "Holzapfel, Gasser, Ogden, J. Elast. 61 (2000) 1"
    doi = "10.1023/A:1010835316564"
    description = (
        "the incompressible Holzapfel-Gasser-Ogden model with two aligned fibre families at "
        "±alpha from the x axis and equal properties; fibres carried load in extension and "
        "compression"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = GOHLaw.parameters[:4]
    ties = GOHLaw.ties
    amplitudes = ("C1", "k1")
    exponents: ClassVar = {"k2": "k2 E^2"}
    undefined_at: ClassVar = {"alpha": (("k1", 0, "k1 = 0"),)}

    def as_goh(self, values: Sequence[float]) -> GOH:
        """The equivalent GOH material, without dispersion."""
        C1, k1, k2, alpha = (float(v) for v in values)
        return GOH(C1, k1, k2, alpha, 0.0)

    def derived_quantities(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor in the plane."""
        cos2 = material.constants.alpha
        return {"Hx": cos2, "Hy": 1.0 - cos2}
