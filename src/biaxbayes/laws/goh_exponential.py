r"""GOH fibres in an exponential matrix.

    W = (C1 / b) (exp(b (X + Y + Z - 3)) - 1) + (k1 / k2) (exp(k2 E^2) - 1)
    E = Hx X + Hy Y + Hz Z - 1

with the squared stretches X, Y, Z and the structure tensor of :mod:`biaxbayes.laws.goh`, which is
the case b -> 0. The exponential matrix is that of Demiray (J. Biomech. 5 (1972) 309).

The fibres are sampled in the coordinates of GOH, and the matrix in ln S_m and ln q_m, with

    q_m = b (I1* - 3)          S_m = C1 exp(q_m)

at the reference stretch, because data determine the exponent and the stiffness at the largest
stretch far better than b and C1. Fits move in (C1, b, k1, k2, t, kappa) with t = cos^2 alpha.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.laws.coordinates import from_log_stress, to_log_stress
from biaxbayes.laws.dispersed_fibres import (
    DispersedFibreLaw,
    fibre_energy,
    fibre_slope,
    fibre_strain,
    structure_tensor,
    structure_tensor_from_cos2,
)
from biaxbayes.laws.goh import GOHLaw, GOHTransform
from biaxbayes.laws.law import TransformInputs
from biaxbayes.laws.materials import (
    constants_from_theta,
    derivatives,
    energy,
    exponential_energy,
    to_slots,
)
from biaxbayes.parameters import Parameter, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class GOHExponentialConstants(NamedTuple):
    """C1 (kPa) and b of the matrix; k1 (kPa), k2, structure tensor and switch of the fibres."""

    C1: Any
    b: Any
    k1: Any
    k2: Any
    Hx: Any
    Hy: Any
    Hz: Any
    switch: Any


@derivatives.register(GOHExponentialConstants)
def goh_exponential_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    E = fibre_strain(constants, X, Y, Z)
    # dW/dX = C1 exp(b (I1 - 3)) + Hx dW/dE
    matrix = constants.C1 * np.exp(constants.b * (X + Y + Z - 3.0))
    slope = fibre_slope(constants, E)
    return (
        matrix + constants.Hx * slope,
        matrix + constants.Hy * slope,
        matrix + constants.Hz * slope,
    )


@energy.register(GOHExponentialConstants)
def goh_exponential_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    E = fibre_strain(constants, X, Y, Z)
    matrix = constants.C1 * exponential_energy(constants.b, X + Y + Z - 3.0)
    return matrix + fibre_energy(constants, E)


# --- sampling coordinates ----------------------------------------------------------------------


_C1, _B, _K1, _K2, _ALPHA, _KAPPA = range(6)


class GOHExponentialTransform(NamedTuple):
    """Constants of the sampling transform.

    ``fibres`` are those of GOH; ``C1``, ``b`` are 1 where ln S_m and ln q_m are sampled in their
    places; ``log_I`` is ln(I1 - 3) at the reference stretch.
    """

    fibres: GOHTransform
    C1: float
    b: float
    log_I: float

    @property
    def chart(self) -> float:
        """1 where the fibres are sampled in their chart."""
        return self.fibres.chart


@to_slots.register(GOHExponentialTransform)
def goh_exponential_to_slots(transform, value):
    """Slots in place of (ln S_m, ln q_m, ln S, ln q, d, v); the log Jacobian."""
    # S_m = C1 exp(q_m),  q_m = b (I1* - 3)
    from_log_stress(value, _C1, _B, transform.C1, transform.b, transform.log_I, 0.0)
    # the places of GOH, with b in that of C1, which its fibres do not need
    return to_slots(transform.fibres, value[_B:])


@constants_from_theta.register(GOHExponentialTransform)
def goh_exponential_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    Hx, Hy, Hz = structure_tensor(theta[_ALPHA], theta[_KAPPA])
    return GOHExponentialConstants(
        theta[_C1], theta[_B], theta[_K1], theta[_K2], Hx, Hy, Hz, transform.fibres.switch
    )


# --- the law -----------------------------------------------------------------------------------


class GOHExponentialLaw(DispersedFibreLaw):
    """Gasser-Ogden-Holzapfel fibres in an exponential matrix."""

    name = "goh-exponential"
    title = "GOH with an exponential matrix"
    source = (
        "Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15; "
        "Demiray, J. Biomech. 5 (1972) 309"
    )
    description = f"{GOHLaw.description}, in a matrix that stiffens exponentially with I1"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        GOHLaw.parameters[0],
        positive_parameter(
            "b", "b", "matrix stiffening", "1", 5.0, 2.0, 1e3, "a neo-Hookean matrix"
        ),
        *DispersedFibreLaw.fibre_parameters,
    )
    amplitudes = ("C1", "k1")
    exponents: ClassVar = {"b": "b (I1 - 3)", "k2": "k2 E^2"}
    undefined_at: ClassVar = {"alpha": (("kappa", 1, "kappa = 1/3"), ("k1", 0, "k1 = 0"))}

    def constants_from_fit(self, C1, b, k1, k2, t, kappa) -> GOHExponentialConstants:
        """Constants at t = cos^2 alpha."""
        Hx, Hy, Hz = structure_tensor_from_cos2(t, kappa)
        return GOHExponentialConstants(C1, b, k1, k2, Hx, Hy, Hz, float(self.fibre_switch))

    def exponents_at(
        self, constants: GOHExponentialConstants, X: Any, Y: Any, Z: Any
    ) -> tuple[Any, ...]:
        """The exponents of matrix and fibres."""
        E = fibre_strain(constants, X, Y, Z)
        return constants.b * (X + Y + Z - 3.0), constants.k2 * E * E

    def sampling_transform(self, inputs: TransformInputs) -> GOHExponentialTransform:
        """Constants of the sampling transform."""
        fibres = GOHLaw(self.fibre_switch).sampling_transform(inputs)
        log_I = float(np.log(sum(inputs.reference) - 3.0))
        C1, b = inputs.reparametrised_flags("C1", "b")
        return GOHExponentialTransform(fibres, C1, b, log_I)

    def to_sampling_coordinates(
        self, transform: GOHExponentialTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of C1, b, k1, k2; alpha in radians."""
        out = GOHLaw(self.fibre_switch).to_sampling_coordinates(transform.fibres, slots)
        to_log_stress(out, "C1", "b", transform.C1, transform.b, transform.log_I, 0.0)
        return out

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """The fibres of GOH, and b (I1 - 3) = 1."""
        b = 1.0 / (2.0 * stretch**2 + stretch**-4 - 3.0)
        return {"b": b} | GOHLaw().prior_medians(stretch)
