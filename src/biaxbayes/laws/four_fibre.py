r"""The four-fibre law: fibres along x, along y and along two diagonals in a neo-Hookean matrix.

    W = (c / 2) (X + Y + Z - 3) + sum_f n_f (k1_f / (4 k2_f)) (exp(k2_f E_f^2) - 1)
    E_x = max(X - 1, 0),  E_y = max(Y - 1, 0),  E_d = max(X cos^2 alpha + Y sin^2 alpha - 1, 0)

with the squared stretches X, Y, Z, n_x = n_y = 1 and n_d = 2: the diagonal families at +alpha and
-alpha from x are equal, and an axis-aligned test gives both the same strain. Fibres carry no
compression. Some papers print c and k1 / (2 k2) for the factors c / 2 and k1 / (4 k2): their
numbers are half of those here.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from biaxbayes.laws.differentiation import exponential
from biaxbayes.laws.law import MATRIX_STRESS_FRACTION, Law, matrix_stiffness, stiffening
from biaxbayes.parameters import Parameter, fibre_angle, positive_parameter


def energy(X, Y, Z, c, k1_x, k2_x, k1_y, k2_y, k1_d, k2_d, cos2):
    """W in kPa at squared stretches."""
    E_x, E_y = np.maximum(X - 1.0, 0.0), np.maximum(Y - 1.0, 0.0)
    E_d = np.maximum(cos2 * X + (1.0 - cos2) * Y - 1.0, 0.0)
    along_x = 0.25 * k1_x * exponential(k2_x, E_x * E_x)
    along_y = 0.25 * k1_y * exponential(k2_y, E_y * E_y)
    diagonal = 0.5 * k1_d * exponential(k2_d, E_d * E_d)
    return 0.5 * c * (X + Y + Z - 3.0) + along_x + along_y + diagonal


def _family(axis: str, words: str) -> tuple[Parameter, Parameter]:
    """Stiffness and stiffening of a family."""
    of, none = f"of the fibres {words}", f"no fibres {words}"
    k1, k2 = f"k_{{1{axis}}}", f"k_{{2{axis}}}"
    return (
        positive_parameter(f"k1_{axis}", k1, f"stiffness {of}", "kPa", 30.0, 2.5, 1e6, none),
        stiffening(f"k2_{axis}", k2, f"stiffening {of}", f"no exponential stiffening {words}"),
    )


class FourFibreLaw(Law):
    """Four fibre families, along x, y and two diagonals, in a neo-Hookean matrix."""

    energy = staticmethod(energy)
    name = "four-fibre"
    title = "four-fibre"
    source = "Baek, Gleason, Rajagopal, Humphrey, Comput. Methods Appl. Mech. Eng. 196 (2007) 3070"
    description = (
        "the incompressible four-fibre model, with fibre families along x, along y and along two "
        "diagonals of equal properties at ±alpha from the x axis in a neo-Hookean matrix; fibres "
        "carried load in extension only"
    )
    # As those of GOH: c is twice its C1, and fibres of any family are as stiff.
    parameters: ClassVar[tuple[Parameter, ...]] = (
        matrix_stiffness("c", "c", 20.0),
        *_family("x", "along x"),
        *_family("y", "along y"),
        *_family("d", "along the diagonals"),
        fibre_angle("alpha", r"\alpha", "angle of the diagonals from x"),
    )
    amplitudes = ("c", "k1_x", "k1_y", "k1_d")
    # the family along an axis, and the diagonals
    exponential_stress_fraction = 0.5 * (1.0 - MATRIX_STRESS_FRACTION)
    exponents: ClassVar = {k2: f"{k2} E^2" for k2 in ("k2_x", "k2_y", "k2_d")}
    roots = True
    least_protocols = 2  # one leaves five or six regions along alpha
    undefined_at: ClassVar = {"alpha": (("k1_d", 0, "k1_d = 0"),)}
