r"""The Lee-Sacks law: an isotropic and a fibre exponential, weighted, in a neo-Hookean matrix.

    W = c0 (I1 - 3) + (c1 / 2) (delta exp(c2 (I1 - 3)^2) + (1 - delta) exp(c3 E^2) - 1)
    I1 = X + Y + Z,    E = I4 - 1 = X cos^2 alpha + Y sin^2 alpha - 1

with the squared stretches X, Y, Z. I4 is shared by two families at +alpha and -alpha from x, which
an axis-aligned test strains equally; fibres carry load in extension and compression. delta is the
isotropic share of the exponentials. Without the matrix (c0 = 0) the unloaded state is singular
under a dead load, so that c0 is positive.

The sampler works in the roots (:mod:`biaxbayes.laws.coordinates`) of S0, S2, q2, S3 and q3, in the
places of c0, c1, c2, delta and c3, and in alpha, which is folded at 0 and 90 degrees, with

    q2 = c2 (I1* - 3)^2          S2 = c1 delta c2 (I1* - 3) exp(q2)
    q3 = c3 E*^2                 S3 = c1 (1 - delta) c3 E* exp(q3)          S0 = c0

at one fixed reference stretch l* per specimen, that of its row of largest I1: the stress of each
term there, which data determine better than c1 and delta.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.coordinates import (
    ROOT_WIDTH,
    from_root_exponent,
    from_root_stress,
    log_fibre_strain,
    log_square,
    log_stress_scale,
    to_root_exponent,
    to_root_stress,
)
from biaxbayes.laws.law import Law, TransformInputs
from biaxbayes.laws.materials import constants_from_theta, derivatives, energy, to_slots
from biaxbayes.parameters import Parameter, fibre_angle, fraction_parameter, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class LeeSacksConstants(NamedTuple):
    """c0 and c1 (kPa), the exponents c2 and c3, delta, and cos^2 alpha."""

    c0: Any
    c1: Any
    c2: Any
    c3: Any
    delta: Any
    cos2: Any


@inlined
def _strains(constants, X, Y, Z):
    """(I1 - 3, E)."""
    return X + Y + Z - 3.0, constants.cos2 * X + (1.0 - constants.cos2) * Y - 1.0


@derivatives.register(LeeSacksConstants)
def lee_sacks_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    t, delta, c2, c3 = constants.cos2, constants.delta, constants.c2, constants.c3
    J, E = _strains(constants, X, Y, Z)
    # dW/dI1 = c0 + c1 delta c2 J exp(c2 J^2),  dW/dE = c1 (1 - delta) c3 E exp(c3 E^2)
    isotropic = constants.c0 + constants.c1 * delta * c2 * J * np.exp(c2 * J * J)
    fibre = constants.c1 * (1.0 - delta) * c3 * E * np.exp(c3 * E * E)
    return isotropic + t * fibre, isotropic + (1.0 - t) * fibre, isotropic + 0.0 * fibre


@energy.register(LeeSacksConstants)
def lee_sacks_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    delta = constants.delta
    J, E = _strains(constants, X, Y, Z)
    # delta + (1 - delta) = 1, which the last term takes away
    growth = delta * np.expm1(constants.c2 * J * J) + (1.0 - delta) * np.expm1(constants.c3 * E * E)
    return constants.c0 * (X + Y + Z - 3.0) + 0.5 * constants.c1 * growth


# --- sampling coordinates ----------------------------------------------------------------------


_C0, _C1, _C2, _C3, _DELTA, _ALPHA = range(6)


class LeeSacksTransform(NamedTuple):
    """Constants of the sampling transform.

    ``c0``, ``c2``, ``c3`` are 1 where roots are sampled in their places, ``stresses`` where those
    of S2 and S3 are in the places of c1 and delta; ``log_scale`` is ln s, s in kPa, ``log_J``
    ln(I1* - 3), (X, Y) the squared reference stretch.
    """

    c0: float
    c2: float
    c3: float
    stresses: float
    log_scale: float
    log_J: float
    X: float
    Y: float


@to_slots.register(LeeSacksTransform)
def lee_sacks_to_slots(transform, value):
    """Slots in place of the roots; the log Jacobian."""
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    log_J, log_E = transform.log_J, log_fibre_strain(alpha, transform.X, transform.Y)
    log_jacobian = from_root_stress(value, _C0, transform.c0, transform.log_scale, 0.0, 0.0)
    log_jacobian += from_root_exponent(value, _C2, transform.c2, 2.0 * log_J)
    log_jacobian += from_root_exponent(value, _C3, transform.c3, 2.0 * log_E)
    if transform.stresses > 0.0:
        log_S2, slope2 = log_square(value[_C1])
        log_S3, slope3 = log_square(value[_DELTA])
        # a = ln(c1 delta) = ln S2 - ln(c2 (I1* - 3)) - q2,  b = ln(c1 (1 - delta)) likewise
        a = transform.log_scale + log_S2 - value[_C2] - log_J
        a -= np.exp(value[_C2] + 2.0 * log_J)
        b = transform.log_scale + log_S3 - value[_C3] - log_E
        b -= np.exp(value[_C3] + 2.0 * log_E)
        log_c1 = max(a, b) + np.log1p(np.exp(-abs(a - b)))
        value[_C1] = log_c1
        value[_DELTA] = np.exp(a - log_c1)
        # |d(ln c1, delta) / d(a, b)| = delta (1 - delta)
        log_jacobian += slope2 + slope3 + (a - log_c1) + (b - log_c1)
    elif not 0.0 <= value[_DELTA] <= 1.0:
        return -np.inf
    return log_jacobian


@constants_from_theta.register(LeeSacksTransform)
def lee_sacks_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    return LeeSacksConstants(
        theta[_C0], theta[_C1], theta[_C2], theta[_C3], theta[_DELTA], np.cos(theta[_ALPHA]) ** 2
    )


# --- the law -----------------------------------------------------------------------------------


class LeeSacksLaw(Law):
    """Lee-Sacks: an isotropic and a fibre exponential, weighted, in a neo-Hookean matrix."""

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
        positive_parameter(
            "c0", "c_0", "matrix stiffness", "kPa", 10.0, 2.0, 1e5, "no matrix", positive=True
        ),
        positive_parameter(
            "c1", "c_1", "stiffness of the exponentials", "kPa", 10.0, 2.5, 1e6, "no exponentials"
        ),
        positive_parameter(
            "c2", "c_2", "isotropic stiffening", "1", 10.0, 2.0, 1e4, "no isotropic stiffening"
        ),
        positive_parameter("c3", "c_3", "fibre stiffening", "1", 10.0, 2.0, 1e4, "no fibres"),
        fraction_parameter(
            "delta", r"\delta", "isotropic share", "no isotropic exponential", "no fibres"
        ),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
    )
    amplitudes = ("c0", "c1")
    exponents: ClassVar = {"c2": "c2 (I1 - 3)^2", "c3": "c3 (I4 - 1)^2"}
    fraction_tolerances: ClassVar = {"delta": 0.02}
    undefined_at: ClassVar = {
        "alpha": (("delta", 1, "delta = 1"), ("c1", 0, "c1 = 0"), ("c3", 0, "c3 = 0"))
    }

    def constants_from_fit(self, *point: Any) -> LeeSacksConstants:
        """Constants at (c0, c1, c2, c3, delta, cos^2 alpha)."""
        return LeeSacksConstants(*point)

    def exponents_at(self, constants: LeeSacksConstants, X: Any, Y: Any, Z: Any) -> tuple[Any, ...]:
        """The exponents of the isotropic term and of the fibres."""
        J, E = _strains(constants, X, Y, Z)
        return constants.c2 * J * J, constants.c3 * E * E

    def sampling_transform(self, inputs: TransformInputs) -> LeeSacksTransform:
        """Constants of the sampling transform."""
        X, Y, Z = inputs.max_I1_state
        c0, c1, c2, c3, delta = inputs.reparametrised_flags("c0", "c1", "c2", "c3", "delta")
        log_J = float(np.log(X + Y + Z - 3.0))
        log_scale = log_stress_scale(inputs.peak_kPa)
        return LeeSacksTransform(c0, c2, c3, c1 * c2 * c3 * delta, log_scale, log_J, X, Y)

    def to_sampling_coordinates(
        self, transform: LeeSacksTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of c0 to c3, delta, radians."""
        out = dict(slots)
        log_J, log_scale = transform.log_J, transform.log_scale
        log_E = log_fibre_strain(slots["alpha"], transform.X, transform.Y)
        to_root_stress(out, "c0", transform.c0, log_scale, 0.0, 0.0)
        to_root_exponent(out, "c2", transform.c2, 2.0 * log_J)
        to_root_exponent(out, "c3", transform.c3, 2.0 * log_E)
        if transform.stresses > 0.0:
            # S2 = c1 delta c2 (I1* - 3) exp(q2),  S3 = c1 (1 - delta) c3 E* exp(q3)
            q2, q3 = np.exp(slots["c2"] + 2.0 * log_J), np.exp(slots["c3"] + 2.0 * log_E)
            with np.errstate(divide="ignore"):
                out["c1"] = slots["c1"] + np.log(slots["delta"]) + slots["c2"]
                out["delta"] = slots["c1"] + np.log(1.0 - slots["delta"]) + slots["c3"]
            to_root_stress(out, "c1", transform.stresses, log_scale, q2, log_J)
            to_root_stress(out, "delta", transform.stresses, log_scale, q3, log_E)
        return out

    def sampling_bounds(self, transform: LeeSacksTransform) -> dict[str, tuple[float, float]]:
        """Bounds of the angle, and of delta where it is a coordinate."""
        bounds = super().sampling_bounds(transform)
        if transform.stresses > 0.0:
            del bounds["delta"]
        return bounds

    def sampling_widths(self, transform: LeeSacksTransform) -> dict[str, float]:
        """Widths of the roots."""
        roots = [name for name in ("c0", "c2", "c3") if getattr(transform, name) > 0.0]
        roots += ["c1", "delta"] if transform.stresses > 0.0 else []
        return dict.fromkeys(roots, ROOT_WIDTH)

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """Exponents of one at delta = 1/2."""
        J = 2.0 * stretch**2 + stretch**-4 - 3.0
        return {"c2": J**-2, "c3": (stretch**2 - 1.0) ** -2, "delta": 0.5}
