r"""The law of Holzapfel, Sommer, Gasser and Regitnig for coronary arteries.

    W = mu/2 (X + Y + Z - 3) + (k1 / k2) (exp(k2 F) - 1)
    F = (1 - rho) max(I4 - 1, 0)^2 + rho (I1 - 3)^2

    I1 = X + Y + Z,    I4 = X cos^2 alpha + Y sin^2 alpha

with the squared stretches X, Y, Z. Two equal families of fibres lie at +alpha and -alpha from x; an
axis-aligned test stretches both equally. rho = 0 are aligned fibres, rho = 1 is an isotropic law;
the paper's own rho is 1 - rho here. Fibres carry load in extension only, as in the paper.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from biaxbayes.laws.differentiation import exponential
from biaxbayes.laws.law import Law, matrix_stiffness, stiffening
from biaxbayes.parameters import Parameter, fibre_angle, fraction_parameter, positive_parameter


def energy(X, Y, Z, mu, k1, k2, cos2, rho):
    """W in kPa at squared stretches."""
    I1 = X + Y + Z
    E = np.maximum(cos2 * X + (1.0 - cos2) * Y - 1.0, 0.0)
    F = (1.0 - rho) * E * E + rho * (I1 - 3.0) ** 2
    return 0.5 * mu * (I1 - 3.0) + k1 * exponential(k2, F)


class Holzapfel2005Law(Law):
    """Fibres and an isotropic invariant in one exponential, in a neo-Hookean matrix."""

    energy = staticmethod(energy)
    name = "holzapfel-2005"
    title = "Holzapfel 2005"
    source = "Holzapfel, Sommer, Gasser, Regitnig, Am. J. Physiol. Heart 289 (2005) H2048"
    doi = "10.1152/ajpheart.00934.2004"
    description = (
        "the incompressible model of Holzapfel et al. (2005) with two fibre families at ±alpha "
        "from the x axis and equal properties, which share an exponential with I1; fibres "
        "carried load in extension only"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        matrix_stiffness("mu", r"\mu", 20.0),
        positive_parameter(
            "k1", "k_1", "stiffness of the exponential", "kPa", 30.0, 2.5, 1e6, "no exponential"
        ),
        stiffening("k2", "k_2", "stiffening"),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
        fraction_parameter(
            "rho",
            r"\rho",
            "isotropic share of the exponent",
            "aligned fibres",
            "isotropic",
            width=0.15,
        ),
    )
    ties = (("k1", "mu"), ("mu", "k1"))
    amplitudes = ("mu", "k1")
    exponents: ClassVar = {"k2": "k2 F"}
    fraction_tolerances: ClassVar = {"rho": 0.05}
    undefined_at: ClassVar = {"alpha": (("rho", 1, "rho = 1"), ("k1", 0, "k1 = 0"))}
