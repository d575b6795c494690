r"""The law of May-Newman and Yin for heart valves, with a neo-Hookean matrix.

    W = c0 (I1 - 3) + k1 / (k2 + k3) (exp(Q) - 1),    Q = k2 (I1 - 3)^2 + k3 (sqrt(I4) - 1)^4

    I1 = X + Y + Z,    I4 = X cos^2 alpha + Y sin^2 alpha

with the squared stretches X, Y, Z. Two families of fibres at +alpha and -alpha from x share the one
exponential; an axis-aligned test stretches both equally. Without the matrix (c0 = 0) the stiffness
at the unloaded state is zero, so that c0 is positive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from biaxbayes.laws.law import Law, matrix_stiffness
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.parameters import Parameter, fibre_angle, positive_parameter


def energy(X, Y, Z, c0, k1, k2, k3, cos2):
    """W in kPa at squared stretches."""
    I1, I4 = X + Y + Z, cos2 * X + (1.0 - cos2) * Y
    Q = k2 * (I1 - 3.0) ** 2 + k3 * (np.sqrt(I4) - 1.0) ** 4
    return c0 * (I1 - 3.0) + k1 / (k2 + k3) * np.expm1(Q)


_ABSENT_EXPONENT_FRACTION = 0.05


class MayNewmanLaw(Law):
    """Fibres and an isotropic invariant in one exponential, fibres by their stretch."""

    energy = staticmethod(energy)
    name = "may-newman"
    title = "May-Newman"
    source = "May-Newman, Yin, J. Biomech. Eng. 120 (1998) 38"
    doi = "10.1115/1.2834305"
    description = (
        "the incompressible May-Newman model with two fibre families at ±alpha from the x axis "
        "that share an exponential with I1, in a neo-Hookean matrix; fibres carried load in "
        "extension and compression"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        matrix_stiffness("c0", "c_0", 10.0),
        positive_parameter(
            "k1", "k_1", "stiffness of the exponential", "kPa", 30.0, 2.5, 1e7, "no exponential"
        ),
        positive_parameter(
            "k2", "k_2", "isotropic exponent", "1", 5.0, 2.0, 1e4, "fibres alone stiffen"
        ),
        positive_parameter("k3", "k_3", "exponent of the fibres", "1", 50.0, 2.5, 1e6, "isotropic"),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
    )
    ties = (("k1", "c0"), ("c0", "k1"))
    amplitudes = ("c0", "k1")
    exponents: ClassVar = {"k2": "Q", "k3": "Q"}
    undefined_at: ClassVar = {"alpha": (("k3", 0, "k3 = 0"), ("k1", 0, "k1 = 0"))}
    least: ClassVar = {"k3": 1e-6}  # it alters no stress where k2 is larger
    joint_parameters = ("k2", "k3")
    condition = "k2 + k3 has to be larger than zero"

    def is_admissible(self, values: Mapping[str, Any]) -> Any:
        """True if there is an exponent."""
        return np.asarray(values["k2"]) + values["k3"] > 0.0

    def bound_tolerances(
        self, material: MaterialResponse, max_stretches: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """k2 and k3 by their fraction of Q, the others as for any law."""
        c = material.constants
        (Q,) = self.largest_exponents(c, max_stretches)
        distances = super().bound_tolerances(material, max_stretches)
        for name, other in (("k2", "k3"), ("k3", "k2")):
            alone = c._replace(**{name: np.ones_like(c.k1), other: np.zeros_like(c.k1)})
            (per_unit,) = self.largest_exponents(alone, max_stretches)
            distances[name] = _ABSENT_EXPONENT_FRACTION * float(
                np.median(Q / np.maximum(per_unit, 1e-12))
            )
        return distances
