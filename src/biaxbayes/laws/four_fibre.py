r"""The four-fibre law: fibres along x, along y and along two diagonals in a neo-Hookean matrix.

    W = (c / 2) (X + Y + Z - 3) + sum_f n_f (k1_f / (4 k2_f)) (exp(k2_f E_f^2) - 1)
    E_x = max(X - 1, 0),  E_y = max(Y - 1, 0),  E_d = max(X cos^2 alpha + Y sin^2 alpha - 1, 0)

with the squared stretches X, Y, Z, n_x = n_y = 1 and n_d = 2: the diagonal families at +alpha and
-alpha from x are equal, and an axis-aligned test gives both the same strain. Fibres carry no
compression. Some papers print c and k1 / (2 k2) for the factors c / 2 and k1 / (4 k2): their
numbers are half of those here.

The sampler works in the roots (:mod:`biaxbayes.laws.coordinates`) of S_c, of S_f and q_f of each
family, and in alpha, which is folded at 0 and 90 degrees, with

    q_f = k2_f E_f*^2          S_f = k1_f E_f* exp(q_f)          S_c = c sqrt((X* - Z*)(Y* - Z*))

at one fixed reference stretch l* per specimen, that of its row of largest I1.
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
    log_stress_scale,
    to_root_exponent,
    to_root_stress,
)
from biaxbayes.laws.law import MATRIX_STRESS_FRACTION, Law, TransformInputs
from biaxbayes.laws.materials import (
    constants_from_theta,
    derivatives,
    energy,
    exponential_energy,
    to_slots,
)
from biaxbayes.parameters import Parameter, fibre_angle, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class FourFibreConstants(NamedTuple):
    """c and k1 (kPa), k2 of the families along x, y and the diagonals, and cos^2 alpha."""

    c: Any
    k1_x: Any
    k2_x: Any
    k1_y: Any
    k2_y: Any
    k1_d: Any
    k2_d: Any
    cos2: Any


@inlined
def _extension(E):
    """The strain of a family, zero in compression."""
    return E * (E.real > 0.0)


@inlined
def _strains(constants, X, Y):
    t = constants.cos2
    return _extension(X - 1.0), _extension(Y - 1.0), _extension(t * X + (1.0 - t) * Y - 1.0)


@inlined
def _slope(k1, k2, E):
    """(k1 / 2) E exp(k2 E^2), which is dW/dE of a single family."""
    return 0.5 * k1 * E * np.exp(k2 * E * E)


@derivatives.register(FourFibreConstants)
def four_fibre_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    Ex, Ey, Ed = _strains(constants, X, Y)
    t = constants.cos2
    matrix = 0.5 * constants.c
    diagonal = 2.0 * _slope(constants.k1_d, constants.k2_d, Ed)
    return (
        matrix + _slope(constants.k1_x, constants.k2_x, Ex) + t * diagonal,
        matrix + _slope(constants.k1_y, constants.k2_y, Ey) + (1.0 - t) * diagonal,
        matrix + 0.0 * diagonal,
    )


def _family_energy(k1, k2, E):
    return 0.25 * k1 * exponential_energy(k2, E * E)


@energy.register(FourFibreConstants)
def four_fibre_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    Ex, Ey, Ed = _strains(constants, X, Y)
    return (
        0.5 * constants.c * (X + Y + Z - 3.0)
        + _family_energy(constants.k1_x, constants.k2_x, Ex)
        + _family_energy(constants.k1_y, constants.k2_y, Ey)
        + 2.0 * _family_energy(constants.k1_d, constants.k2_d, Ed)
    )


# --- sampling coordinates ----------------------------------------------------------------------


_C, _K1X, _K2X, _K1Y, _K2Y, _K1D, _K2D, _ALPHA = range(8)
_FAMILIES = (("k1_x", "k2_x"), ("k1_y", "k2_y"), ("k1_d", "k2_d"))


class FourFibreTransform(NamedTuple):
    """Constants of the sampling transform.

    The field of each parameter is 1 where a root is sampled in its place; ``log_scale`` is ln s, s
    in kPa, ``log_matrix`` ln(S_c / c), (X, Y) the squared reference stretch.
    """

    c: float
    k1_x: float
    k2_x: float
    k1_y: float
    k2_y: float
    k1_d: float
    k2_d: float
    log_scale: float
    log_matrix: float
    X: float
    Y: float


@inlined
def _log_strains(transform, alpha):
    """Ln E* of the families."""
    X, Y = transform.X, transform.Y
    return np.log(X - 1.0), np.log(Y - 1.0), log_fibre_strain(alpha, X, Y)


@inlined
def _family_to_slots(value, k1, k2, k1_sampled, k2_sampled, log_scale, log_E):
    """Ln k1 and ln k2 of a family in place of its roots; the log Jacobian."""
    # q = k2 E*^2,  S = k1 E* exp(q)
    log_jacobian = from_root_exponent(value, k2, k2_sampled, 2.0 * log_E)
    q = np.exp(value[k2] + 2.0 * log_E)
    return log_jacobian + from_root_stress(value, k1, k1_sampled, log_scale, q, log_E)


@to_slots.register(FourFibreTransform)
def four_fibre_to_slots(transform, value):
    """Slots in place of the roots; the log Jacobian."""
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    log_x, log_y, log_d = _log_strains(transform, alpha)
    u, s = transform, transform.log_scale
    log_jacobian = _family_to_slots(value, _K1X, _K2X, u.k1_x, u.k2_x, s, log_x)
    log_jacobian += _family_to_slots(value, _K1Y, _K2Y, u.k1_y, u.k2_y, s, log_y)
    log_jacobian += _family_to_slots(value, _K1D, _K2D, u.k1_d, u.k2_d, s, log_d)
    return log_jacobian + from_root_stress(value, _C, u.c, s, 0.0, u.log_matrix)


@constants_from_theta.register(FourFibreTransform)
def four_fibre_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    c, cos2 = theta[_C], np.cos(theta[_ALPHA]) ** 2
    along_x, along_y = (theta[_K1X], theta[_K2X]), (theta[_K1Y], theta[_K2Y])
    return FourFibreConstants(c, *along_x, *along_y, theta[_K1D], theta[_K2D], cos2)


# --- the law -----------------------------------------------------------------------------------


def _family(axis: str, words: str) -> tuple[Parameter, Parameter]:
    """Stiffness and stiffening of a family."""
    stiffness, stiffening = (
        f"{what} of the fibres {words}" for what in ("stiffness", "stiffening")
    )
    ends = f"no fibres {words}", f"no exponential stiffening {words}"
    return (
        positive_parameter(
            f"k1_{axis}", f"k_{{1{axis}}}", stiffness, "kPa", 30.0, 2.5, 1e6, ends[0]
        ),
        positive_parameter(
            f"k2_{axis}", f"k_{{2{axis}}}", stiffening, "1", 10.0, 2.0, 1e4, ends[1]
        ),
    )


class FourFibreLaw(Law):
    """Four fibre families, along x, y and two diagonals, in a neo-Hookean matrix."""

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
        positive_parameter(
            "c", "c", "matrix stiffness", "kPa", 20.0, 2.0, 1e5, "no matrix", positive=True
        ),
        *_family("x", "along x"),
        *_family("y", "along y"),
        *_family("d", "along the diagonals"),
        fibre_angle("alpha", r"\alpha", "angle of the diagonals from x"),
    )
    amplitudes = ("c", "k1_x", "k1_y", "k1_d")
    # the family along an axis, and the diagonals
    exponential_stress_fraction = 0.5 * (1.0 - MATRIX_STRESS_FRACTION)
    exponents: ClassVar = {k2: f"{k2} E^2" for _, k2 in _FAMILIES}
    least_protocols = 2  # one leaves five or six regions along alpha
    undefined_at: ClassVar = {"alpha": (("k1_d", 0, "k1_d = 0"),)}

    def constants_from_fit(self, *point: Any) -> FourFibreConstants:
        """Constants at (c, k1_x, k2_x, k1_y, k2_y, k1_d, k2_d, cos^2 alpha)."""
        return FourFibreConstants(*point)

    def exponents_at(
        self, constants: FourFibreConstants, X: Any, Y: Any, Z: Any
    ) -> tuple[Any, ...]:
        """The exponents of the fibres along x, along y and along the diagonals."""
        k2 = constants.k2_x, constants.k2_y, constants.k2_d
        return tuple(k * E * E for k, E in zip(k2, _strains(constants, X, Y), strict=True))

    def sampling_transform(self, inputs: TransformInputs) -> FourFibreTransform:
        """Constants of the sampling transform."""
        X, Y, Z = inputs.max_I1_state
        log_matrix = 0.5 * float(np.log((X - Z) * (Y - Z)))
        roots = inputs.reparametrised_flags(*self.names[:_ALPHA])
        log_scale = log_stress_scale(inputs.peak_kPa)
        return FourFibreTransform._make((*roots, log_scale, log_matrix, X, Y))

    def to_sampling_coordinates(
        self, transform: FourFibreTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of stiffnesses, exponents; radians."""
        out, u, s = dict(slots), transform, transform.log_scale
        log_strains = _log_strains(u, slots["alpha"])
        for (k1, k2), log_E in zip(_FAMILIES, log_strains, strict=True):
            q = np.exp(slots[k2] + 2.0 * log_E)
            to_root_exponent(out, k2, getattr(u, k2), 2.0 * log_E)
            to_root_stress(out, k1, getattr(u, k1), s, q, log_E)
        to_root_stress(out, "c", u.c, s, 0.0, u.log_matrix)
        return out

    def sampling_widths(self, transform: FourFibreTransform) -> dict[str, float]:
        """Widths of the roots."""
        roots = (name for name in self.names[:_ALPHA] if getattr(transform, name) > 0.0)
        return dict.fromkeys(roots, ROOT_WIDTH)

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """E = l^2 - 1 for every family."""
        return dict.fromkeys(self.exponents, (stretch**2 - 1.0) ** -2)
