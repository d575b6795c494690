r"""The law of May-Newman and Yin for heart valves, with a neo-Hookean matrix.

    W = c0 (I1 - 3) + k1 / (k2 + k3) (exp(Q) - 1),    Q = k2 (I1 - 3)^2 + k3 (sqrt(I4) - 1)^4

    I1 = X + Y + Z,    I4 = X cos^2 alpha + Y sin^2 alpha

with the squared stretches X, Y, Z. Two families of fibres at +alpha and -alpha from x share the one
exponential; an axis-aligned test stretches both equally. Without the matrix (c0 = 0) the stiffness
at the unloaded state is zero, so that c0 is positive.

The sampler works in ln c0, ln S, ln Q*, d and alpha, which is folded at 0 and 90 degrees, with

    Q* = Q at one fixed reference stretch l* per specimen,    d = ln(k3 u^4 / (k2 J^2))
    S = k1 / (k2 + k3) G exp(Q*),    G = k2 J (X + Y - 2 Z) + k3 u^3 sqrt(I4)

    J = I1 - 3,    u = sqrt(I4) - 1

there: 4 S is the sum of both stresses of the exponential. Data determine it and the exponent far
better than k1, k2 and k3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.law import Law, TransformInputs
from biaxbayes.laws.materials import (
    MaterialResponse,
    constants_from_theta,
    derivatives,
    energy,
    to_slots,
)
from biaxbayes.parameters import Parameter, fibre_angle, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class MayNewmanConstants(NamedTuple):
    """c0, k1 (kPa), k2, k3 and cos^2 alpha."""

    c0: Any
    k1: Any
    k2: Any
    k3: Any
    cos2: Any


@inlined
def _strains(constants, X, Y, Z):
    """(I1 - 3, fibre stretch sqrt(I4))."""
    return X + Y + Z - 3.0, np.sqrt(constants.cos2 * X + (1.0 - constants.cos2) * Y)


@inlined
def _exponent(constants, X, Y, Z):
    """Q of the energy."""
    J, stretch = _strains(constants, X, Y, Z)
    u2 = (stretch - 1.0) * (stretch - 1.0)
    return constants.k2 * J * J + constants.k3 * u2 * u2


@derivatives.register(MayNewmanConstants)
def may_newman_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    J, stretch = _strains(constants, X, Y, Z)
    u = stretch - 1.0
    # dQ/dI1 = 2 k2 (I1 - 3),  dQ/dI4 = 2 k3 (sqrt(I4) - 1)^3 / sqrt(I4)
    dQ_dI1 = 2.0 * constants.k2 * J
    dQ_dI4 = 2.0 * constants.k3 * u * u * u / stretch
    growth = constants.k1 / (constants.k2 + constants.k3) * np.exp(_exponent(constants, X, Y, Z))
    # dW/dX = c0 + k1 / (k2 + k3) exp(Q) dQ/dX
    matrix = constants.c0 + growth * dQ_dI1
    fibres = growth * dQ_dI4
    return matrix + constants.cos2 * fibres, matrix + (1.0 - constants.cos2) * fibres, matrix


@energy.register(MayNewmanConstants)
def may_newman_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    growth = constants.k1 / (constants.k2 + constants.k3)
    Q = _exponent(constants, X, Y, Z)
    return constants.c0 * (X + Y + Z - 3.0) + growth * np.expm1(Q)


# --- sampling coordinates ----------------------------------------------------------------------


_C0, _K1, _K2, _K3, _ALPHA = range(5)


class MayNewmanTransform(NamedTuple):
    """Constants of the sampling transform.

    ``k1`` is 1 where ln S is sampled in its place, ``exponents`` where ln Q* and d are sampled in
    those of k2 and k3; (X, Y, Z) is the squared reference stretch.
    """

    k1: float
    exponents: float
    X: float
    Y: float
    Z: float


@inlined
def _reference_state(transform, alpha):
    """(ln J^2, ln u^4, G2 = J (X + Y - 2 Z), G3 = u^3 sqrt(I4)) at the reference stretch."""
    X, Y, Z = transform.X, transform.Y, transform.Z
    cos2 = np.cos(alpha) ** 2
    stretch = np.sqrt(cos2 * X + (1.0 - cos2) * Y)
    J, u = X + Y + Z - 3.0, stretch - 1.0
    return 2.0 * np.log(J), 4.0 * np.log(u), J * (X + Y - 2.0 * Z), u**3 * stretch


@inlined
def _log_stress(reference, log_k2, log_k3):
    """ln(S / k1), with G = k2 G2 + k3 G3."""
    log_J2, log_u4, G2, G3 = reference
    k2, k3 = np.exp(log_k2), np.exp(log_k3)
    # S / k1 = G exp(Q*) / (k2 + k3)
    Q = np.exp(log_k2 + log_J2) + np.exp(log_k3 + log_u4)
    return np.log((k2 * G2 + k3 * G3) / (k2 + k3)) + Q


@to_slots.register(MayNewmanTransform)
def may_newman_to_slots(transform, value):
    """Slots in place of (ln c0, ln S, ln Q*, d, alpha); the log Jacobian."""
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    reference = _reference_state(transform, alpha)
    if transform.exponents > 0.0:
        log_J2, log_u4, _, _ = reference
        log_Q, d = value[_K2], value[_K3]
        # Q* = k2 J^2 (1 + e^d)
        log_part = log_Q - np.log1p(np.exp(d))
        value[_K2], value[_K3] = log_part - log_J2, log_part + d - log_u4
    if transform.k1 > 0.0:
        value[_K1] -= _log_stress(reference, value[_K2], value[_K3])
    return 0.0


@constants_from_theta.register(MayNewmanTransform)
def may_newman_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    cos2 = np.cos(theta[_ALPHA]) ** 2
    return MayNewmanConstants(theta[_C0], theta[_K1], theta[_K2], theta[_K3], cos2)


# --- the law -----------------------------------------------------------------------------------


_ABSENT_EXPONENT_FRACTION = 0.05
_MIN_K3 = 1e-6  # of a fit; it alters no stress where k2 is larger


class MayNewmanLaw(Law):
    """Fibres and an isotropic invariant in one exponential, fibres by their stretch."""

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
        positive_parameter(
            "c0", "c_0", "matrix stiffness", "kPa", 10.0, 2.0, 1e5, "no matrix", positive=True
        ),
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
    joint_parameters = ("k2", "k3")
    condition = "k2 + k3 has to be larger than zero"

    def is_admissible(self, values: Mapping[str, Any]) -> Any:
        """True if there is an exponent."""
        return np.asarray(values["k2"]) + values["k3"] > 0.0

    def constants_from_fit(self, c0, k1, k2, k3, t) -> MayNewmanConstants:
        """Constants at t = cos^2 alpha."""
        return MayNewmanConstants(c0, k1, k2, k3, t)

    def exponents_at(self, constants: MayNewmanConstants, X: Any, Y: Any, Z: Any) -> tuple[Any]:
        """Q."""
        return (_exponent(constants, X, Y, Z),)

    def sampling_transform(self, inputs: TransformInputs) -> MayNewmanTransform:
        """Constants of the sampling transform."""
        k1, k2, k3 = inputs.reparametrised_flags("k1", "k2", "k3")
        return MayNewmanTransform(k1, k2 * k3, *inputs.reference)

    def to_sampling_coordinates(
        self, transform: MayNewmanTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of c0, k1, k2, k3; alpha in radians."""
        out = dict(slots)
        reference = _reference_state(transform, slots["alpha"])
        log_J2, log_u4, _, _ = reference
        if transform.k1 > 0.0:
            out["k1"] = slots["k1"] + _log_stress(reference, slots["k2"], slots["k3"])
        if transform.exponents > 0.0:
            # Q* = Q2 + Q3 with Q2 = k2 J^2, Q3 = k3 u^4;  d = ln(Q3 / Q2)
            log_Q2, log_Q3 = slots["k2"] + log_J2, slots["k3"] + log_u4
            out["k2"], out["k3"] = np.logaddexp(log_Q2, log_Q3), log_Q3 - log_Q2
        return out

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of (c0, k1, k2, k3, t): without any exponent there is no law."""
        return np.array([0.0, 0.0, 0.0, _MIN_K3, 0.0])

    def random_materials(
        self, size: int, max_stretch: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches, the fraction of the fibres, and angles."""
        u = rng.random((size, 3))
        Q = 10.0 ** (-2.0 + 3.2 * u[:, 0])
        fraction = u[:, 1].copy()  # of the fibres
        t = np.cos(0.5 * np.pi * u[:, 2]) ** 2
        fraction[3::5], fraction[4::9] = 1.0, 0.0
        t[1::7], t[2::7] = 0.0, 1.0
        X, Y = np.maximum(max_stretch.T, 1.0 + 1e-3) ** 2
        one = np.ones(size)
        J, stretch = _strains(MayNewmanConstants(one, one, one, one, t), X, Y, 1.0 / (X * Y))
        k2 = np.minimum((1.0 - fraction) * Q / J**2, self.upper[_K2])
        k3 = np.clip(fraction * Q / (stretch - 1.0) ** 4, _MIN_K3, self.upper[_K3])
        return np.column_stack([one, one, k2, k3, t]), np.column_stack(
            [0.3 * np.log(Q), fraction, t]
        )

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """Both parts of the exponent are one half."""
        J, u = 2.0 * stretch**2 + stretch**-4 - 3.0, stretch - 1.0
        return {"k2": 0.5 / J**2, "k3": 0.5 / u**4}

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
