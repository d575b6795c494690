r"""Fung's exponential of the Green strains in a neo-Hookean matrix.

    W = c0 (X + Y + Z - 3) + (c / 2) (exp(Q) - 1)
    Q = b_x Ex^2 + b_y Ey^2 + 2 b_xy Ex Ey,    Ex = (X - 1) / 2,  Ey = (Y - 1) / 2

with the squared stretches X, Y, Z. The form Q is positive definite: b_x b_y > b_xy^2. A positive c0
keeps the unloaded state stable where the exponential is absent (c = 0, or b_x = b_y = 0).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from biaxbayes.laws.law import Law, matrix_stiffness, stiffening
from biaxbayes.parameters import Parameter, positive_parameter


def energy(X, Y, Z, c0, c, b_x, b_y, b_xy):
    """W in kPa at squared stretches."""
    Ex, Ey = 0.5 * (X - 1.0), 0.5 * (Y - 1.0)
    Q = b_x * Ex * Ex + b_y * Ey * Ey + 2.0 * b_xy * Ex * Ey
    return c0 * (X + Y + Z - 3.0) + 0.5 * c * np.expm1(Q)


_MAX_RHO = 0.98  # largest |b_xy| / sqrt(b_x b_y) that sampling starts from


class FungLaw(Law):
    """Fung's exponential of the Green strains in a neo-Hookean matrix."""

    energy = staticmethod(energy)
    name = "fung"
    title = "Fung"
    source = "Fung, Fronek, Patitucci, Am. J. Physiol. 237 (1979) H620"
    description = (
        "the incompressible Fung model, an exponential of a quadratic form of the Green strains, "
        "in a neo-Hookean matrix"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        matrix_stiffness("c0", "c_0", 10.0),
        positive_parameter(
            "c", "c", "stiffness of the exponential", "kPa", 10.0, 2.5, 1e6, "no exponential"
        ),
        stiffening("b_x", "b_x", "exponent in x", "no stiffening in x"),
        stiffening("b_y", "b_y", "exponent in y", "no stiffening in y"),
        Parameter(
            "b_xy",
            "b_{xy}",
            words="coupling of the exponents",
            sharp=1.0,
            width=0.1,
            largest=1e4,
            prior=("normal", 0.0, 30.0),
        ),
    )
    amplitudes = ("c0", "c")
    exponents: ClassVar = {"b_x": "Q", "b_y": "Q"}
    bound_by = ("b_xy", "b_x", "b_y")
    typical: ClassVar = {"b_xy": 0.0}
    compares_stiffness = True
    joint_parameters = ("b_x", "b_y", "b_xy")
    condition = "b_x b_y has to be larger than b_xy^2"

    def is_admissible(self, values: Mapping[str, Any]) -> Any:
        """True where the form is positive definite."""
        return np.asarray(values["b_xy"]) ** 2 < np.asarray(values["b_x"]) * values["b_y"]

    def constants_from_fit(self, c0, c, b_x, b_y, b_xy) -> Any:
        """Constants; the coupling is clipped to b_x b_y = b_xy^2 where it lies beyond."""
        limit = np.sqrt(b_x * b_y)
        beyond = np.abs(np.real(b_xy)) > np.real(limit)
        clipped = np.where(np.real(b_xy) < 0.0, -limit, limit)
        return self.constants(c0, c, b_x, b_y, np.where(beyond, clipped, b_xy)[()])

    def clip_inside(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its bounds, to where the sampling coordinates are regular."""
        *scales, b_xy = super().clip_inside(values)
        limit = _MAX_RHO * float(np.sqrt(scales[2] * scales[3]))
        return *scales, float(np.clip(b_xy, -limit, limit))

    def from_fit_coordinates(self, point: Any) -> tuple[float, ...]:
        """Parameters at a point of the fits, of a form that is nowhere negative."""
        return tuple(float(v) for v in self.constants_from_fit(*(float(v) for v in point)))

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch."""
        prior = super().scaled_prior(stretch, peak_kPa)
        return prior | {"b_xy": ("normal", 0.0, 0.5 * prior["b_x"][1])}
