r"""The Lee-Sacks law: an isotropic and a fibre exponential, weighted, in a neo-Hookean matrix.

    W = c0 (I1 - 3) + (c1 / 2) (delta exp(c2 (I1 - 3)^2) + (1 - delta) exp(c3 E^2) - 1)
    I1 = X + Y + Z,    E = I4 - 1 = X cos^2 alpha + Y sin^2 alpha - 1

with the squared stretches X, Y, Z. I4 is shared by two families at +alpha and -alpha from x, which
an axis-aligned test strains equally; fibres carry load in extension and compression. delta is the
isotropic share of the exponentials. Without the matrix (c0 = 0) the unloaded state is singular
under a dead load, so that c0 is positive.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from biaxbayes.laws.law import Law, matrix_stiffness, stiffening
from biaxbayes.parameters import Parameter, fibre_angle, fraction_parameter, positive_parameter


def energy(X, Y, Z, c0, c1, c2, c3, delta, cos2):
    """W in kPa at squared stretches."""
    I1, E = X + Y + Z, cos2 * X + (1.0 - cos2) * Y - 1.0
    isotropic, fibres = np.expm1(c2 * (I1 - 3.0) ** 2), np.expm1(c3 * E * E)
    return c0 * (I1 - 3.0) + 0.5 * c1 * (delta * isotropic + (1.0 - delta) * fibres)


class LeeSacksLaw(Law):
    """Lee-Sacks: an isotropic and a fibre exponential, weighted, in a neo-Hookean matrix."""

    energy = staticmethod(energy)
    name = "lee-sacks"
    title = "Lee-Sacks"
    source = "Lee, Amini, Gorman, Gorman, Sacks, J. Biomech. 47 (2014) 2055"
    description = (
        "the incompressible Lee-Sacks model, a weighted sum of an isotropic exponential and one "
        "of two fibre families at ±alpha from the x axis, in a neo-Hookean matrix; fibres carried "
        "load in extension and compression"
    )
    # Stiffnesses and exponents of soft tissue lie within two decades of these medians either way;
    # the prior of the isotropic fraction is uniform.
    parameters: ClassVar[tuple[Parameter, ...]] = (
        matrix_stiffness("c0", "c_0", 10.0),
        positive_parameter(
            "c1", "c_1", "stiffness of the exponentials", "kPa", 10.0, 2.5, 1e6, "no exponentials"
        ),
        stiffening("c2", "c_2", "isotropic stiffening", "no isotropic stiffening"),
        stiffening("c3", "c_3", "fibre stiffening", "no fibres"),
        fraction_parameter(
            "delta", r"\delta", "isotropic share", "no isotropic exponential", "no fibres"
        ),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
    )
    amplitudes = ("c0", "c1")
    exponents: ClassVar = {"c2": "c2 (I1 - 3)^2", "c3": "c3 (I4 - 1)^2"}
    roots = True
    fraction_tolerances: ClassVar = {"delta": 0.02}
    undefined_at: ClassVar = {
        "alpha": (("delta", 1, "delta = 1"), ("c1", 0, "c1 = 0"), ("c3", 0, "c3 = 0"))
    }
