r"""The law of Holzapfel, Sommer, Gasser and Regitnig for coronary arteries.

    W = mu/2 (X + Y + Z - 3) + (k1 / k2) (exp(k2 F) - 1)
    F = (1 - rho) max(I4 - 1, 0)^2 + rho (I1 - 3)^2

    I1 = X + Y + Z,    I4 = X cos^2 alpha + Y sin^2 alpha

with the squared stretches X, Y, Z. Two equal families of fibres lie at +alpha and -alpha from x; an
axis-aligned test stretches both equally. rho = 0 are aligned fibres, rho = 1 is an isotropic law;
the paper's own rho is 1 - rho here. Fibres carry load in extension only, as in the paper.

The sampler works in ln mu, ln S, ln q, alpha, which is folded at 0 and 90 degrees, and rho, with

    q = k2 F*,    S = k1 G* exp(q),    G = (1 - rho) (I4 - 1) I4 + rho (I1 - 3) (X + Y - 2 Z)

at one fixed reference stretch l* per specimen: 4 S is the sum of both stresses of the exponential
there. Data determine it and the exponent far better than k1 and k2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.coordinates import from_log_stress, to_log_stress
from biaxbayes.laws.law import Law, TransformInputs
from biaxbayes.laws.materials import (
    constants_from_theta,
    derivatives,
    energy,
    exponential_energy,
    to_slots,
)
from biaxbayes.parameters import Parameter, fibre_angle, fraction_parameter, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class Holzapfel2005Constants(NamedTuple):
    """mu, k1 (kPa), k2, cos^2 alpha and rho."""

    mu: Any
    k1: Any
    k2: Any
    cos2: Any
    rho: Any


@inlined
def _strains(constants, X, Y, Z):
    """(I1 - 3, max(I4 - 1, 0))."""
    E = constants.cos2 * X + (1.0 - constants.cos2) * Y - 1.0
    return X + Y + Z - 3.0, E * (E.real > 0.0)


@inlined
def _form(constants, X, Y, Z):
    """F, which the exponent is k2 times."""
    J, E = _strains(constants, X, Y, Z)
    return (1.0 - constants.rho) * E * E + constants.rho * J * J


@derivatives.register(Holzapfel2005Constants)
def holzapfel_2005_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    J, E = _strains(constants, X, Y, Z)
    growth = 2.0 * constants.k1 * np.exp(constants.k2 * _form(constants, X, Y, Z))
    # dW/dI1 = mu/2 + 2 k1 exp(k2 F) rho (I1 - 3),  dW/dI4 = 2 k1 exp(k2 F) (1 - rho) (I4 - 1)
    matrix = 0.5 * constants.mu + growth * constants.rho * J
    fibres = growth * (1.0 - constants.rho) * E
    return matrix + constants.cos2 * fibres, matrix + (1.0 - constants.cos2) * fibres, matrix


@energy.register(Holzapfel2005Constants)
def holzapfel_2005_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    matrix = 0.5 * constants.mu * (X + Y + Z - 3.0)
    return matrix + constants.k1 * exponential_energy(constants.k2, _form(constants, X, Y, Z))


# --- sampling coordinates ----------------------------------------------------------------------


_MU, _K1, _K2, _ALPHA, _RHO = range(5)


class Holzapfel2005Transform(NamedTuple):
    """Constants of the sampling transform.

    ``k1``, ``k2`` are 1 where ln S and ln q are sampled in their places; (X, Y, Z) is the squared
    reference stretch.
    """

    k1: float
    k2: float
    X: float
    Y: float
    Z: float


@inlined
def _reference_state(transform, alpha, rho):
    """(ln F*, ln G*) at the reference stretch, where fibres are stretched."""
    X, Y, Z = transform.X, transform.Y, transform.Z
    cos2 = np.cos(alpha) ** 2
    I4 = cos2 * X + (1.0 - cos2) * Y
    E, J = I4 - 1.0, X + Y + Z - 3.0
    F = (1.0 - rho) * E * E + rho * J * J
    G = (1.0 - rho) * E * I4 + rho * J * (X + Y - 2.0 * Z)
    return np.log(F), np.log(G)


@to_slots.register(Holzapfel2005Transform)
def holzapfel_2005_to_slots(transform, value):
    """Slots in place of (ln mu, ln S, ln q, alpha, rho); the log Jacobian."""
    alpha, rho = value[_ALPHA], value[_RHO]
    if not (0.0 <= alpha <= 0.5 * np.pi and 0.0 <= rho <= 1.0):
        return -np.inf
    log_F, log_G = _reference_state(transform, alpha, rho)
    from_log_stress(value, _K1, _K2, transform.k1, transform.k2, log_F, log_G)
    return 0.0


@constants_from_theta.register(Holzapfel2005Transform)
def holzapfel_2005_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    cos2 = np.cos(theta[_ALPHA]) ** 2
    return Holzapfel2005Constants(theta[_MU], theta[_K1], theta[_K2], cos2, theta[_RHO])


# --- the law -----------------------------------------------------------------------------------


class Holzapfel2005Law(Law):
    """Fibres and an isotropic invariant in one exponential, in a neo-Hookean matrix."""

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
        positive_parameter(
            "mu", r"\mu", "matrix stiffness", "kPa", 20.0, 2.0, 1e5, "no matrix", positive=True
        ),
        positive_parameter(
            "k1", "k_1", "stiffness of the exponential", "kPa", 30.0, 2.5, 1e6, "no exponential"
        ),
        positive_parameter(
            "k2", "k_2", "stiffening", "1", 10.0, 2.0, 1e4, "no exponential stiffening"
        ),
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

    def constants_from_fit(self, mu, k1, k2, t, rho) -> Holzapfel2005Constants:
        """Constants at t = cos^2 alpha."""
        return Holzapfel2005Constants(mu, k1, k2, t, rho)

    def exponents_at(
        self, constants: Holzapfel2005Constants, X: Any, Y: Any, Z: Any
    ) -> tuple[Any, ...]:
        """The exponent that fibres and I1 share."""
        return (constants.k2 * _form(constants, X, Y, Z),)

    def sampling_transform(self, inputs: TransformInputs) -> Holzapfel2005Transform:
        """Constants of the sampling transform."""
        k1, k2 = inputs.reparametrised_flags("k1", "k2")
        return Holzapfel2005Transform(k1, k2, *inputs.reference)

    def to_sampling_coordinates(
        self, transform: Holzapfel2005Transform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of mu, k1, k2; alpha in radians."""
        out = dict(slots)
        reference = _reference_state(transform, slots["alpha"], slots["rho"])
        to_log_stress(out, "k1", "k2", transform.k1, transform.k2, *reference)
        return out

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """F = (E^2 + J^2) / 2 at rho = 1/2."""
        E, J = stretch**2 - 1.0, 2.0 * stretch**2 + stretch**-4 - 3.0
        return {"k2": 2.0 / (E * E + J * J), "rho": 0.5}
