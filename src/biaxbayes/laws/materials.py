r"""Materials and their stress, from the strain energy of a law.

Planar biaxial test, incompressible, no shear: F = diag(lx, ly, 1/(lx ly)), plane stress sz = 0. A
law is a strain energy W of the squared stretches X = lx^2, Y = ly^2, Z = 1/(X Y), even in shear.
With A, B, C = dW/dX, dW/dY, dW/dZ the Cauchy stresses are

    s_x = 2 (X A - Z C)        s_y = 2 (Y B - Z C)

Four generic functions of the constants of a law, a ``NamedTuple``, are written for each law from
its energy (:func:`constants_type`), as arithmetic of numbers, arrays and complex numbers. The type
of the constants chooses the implementation, also in compiled code, one kernel for each law.
"""

from __future__ import annotations

import hashlib
from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np
from numba.extending import overload

from biaxbayes.compilation import WITHIN, implementation, inlined
from biaxbayes.errors import InputError
from biaxbayes.laws.differentiation import Expression, exponential, exponents_of, gradient, source
from biaxbayes.parameters import DEGREE

STEP = 1e-30
"""Imaginary step of complex-step differentiation: f'(x) = Im f(x + i h) / h, exact to rounding."""


# --- functions of the constants of a law ---------------------------------------------------------


@singledispatch
def energy(constants, X, Y, Z):
    """Strain energy per reference volume in kPa (mJ/mm^3), zero where unloaded; not compiled."""


@singledispatch
def derivatives(constants, X, Y, Z):
    """(dW/dX, dW/dY, dW/dZ) in kPa at squared stretches."""


@singledispatch
def exponents(constants, X, Y, Z):
    """The exponents of the law's exponentials at squared stretches, in their order."""


@singledispatch
def constants_at(like, theta):
    """Constants at theta (parameters without logs, angles in radians), of the type of others."""


@overload(derivatives, jit_options=WITHIN)
def _compiled_derivatives(constants, X, Y, Z):
    return implementation(derivatives, constants)


@overload(exponents, jit_options=WITHIN)
def _compiled_exponents(constants, X, Y, Z):
    return implementation(exponents, constants)


@overload(constants_at, jit_options=WITHIN)
def _compiled_constants_at(like, theta):
    return implementation(constants_at, like)


def constants_type(
    law_energy: Callable[..., Any], names: Sequence[str], angles: Sequence[bool], *, switch: bool
) -> Any:
    """Type of the constants of a law, with its functions, from its energy (see ``Law.energy``)."""
    fields = (*names, "switch") if switch else tuple(names)
    stretches = [Expression(n, varies=True) for n in "XYZ"]
    W = law_energy(*stretches, *map(Expression, fields))
    if not (isinstance(W, Expression) and W.varies):
        raise InputError("the energy does not depend on the stretches")
    given, unpacked = "constants, X, Y, Z", f"{', '.join(fields)}, = constants"
    # cos^2 of angles, the others as they are
    theta = [f"np.cos(theta[{i}]) ** 2" if a else f"theta[{i}]" for i, a in enumerate(angles)]
    theta += ["like.switch"] if switch else []
    text = (
        source("energy", given, unpacked, [W])
        + source("derivatives", given, unpacked, gradient(W, stretches))
        + source("exponents", given, unpacked, exponents_of(W) or [0.0])
        + f"def constants_at(like, theta):\n    return Constants({', '.join(theta)})\n"
    )
    # numba's cache finds a type by its name, in which the digest is that of the compiled code
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    made = __getattr__("__".join((_CONSTANTS, digest, *fields)))
    code: dict[str, Any] = {"np": np, "exponential": exponential, "Constants": made}
    exec(text, code)
    energy.register(made, lambda *given: code["energy"](*given)[0])
    derivatives.register(made, code["derivatives"])
    exponents.register(made, code["exponents"])
    constants_at.register(made, code["constants_at"])
    return made


_CONSTANTS = "Constants"


def __getattr__(name: str) -> Any:
    """The type of the constants of a law by its name, which has their names."""
    if not name.startswith(f"{_CONSTANTS}__"):
        raise AttributeError(name)
    made = namedtuple(name, name.split("__")[2:], module=__name__)  # type: ignore[misc]
    return globals().setdefault(name, made)


# --- the stress ----------------------------------------------------------------------------------


@inlined
def cauchy_stress(constants, X, Y, Z):
    """Cauchy stresses (s_x, s_y) in kPa at squared stretches."""
    A, B, C = derivatives(constants, X, Y, Z)
    # s_x = 2 (X A - Z C),  s_y = 2 (Y B - Z C)
    return 2.0 * (X * A - Z * C), 2.0 * (Y * B - Z * C)


@inlined
def stress_and_slope(constants, x, y):
    """(s_x, s_y) and (ds_x/dx, ds_x/dy, ds_y/dy) at the log stretches x, y: numbers only."""
    # s_k = dW/d ln lk, so the slope is the Hessian of W in ln l, which is symmetric
    X, Y = np.exp(2.0 * (x + 1j * STEP)), np.exp(2.0 * (y + 0j))
    sx, sy = cauchy_stress(constants, X, Y, 1.0 / (X * Y))
    X, Y = np.exp(2.0 * (x + 0j)), np.exp(2.0 * (y + 1j * STEP))
    _, ty = cauchy_stress(constants, X, Y, 1.0 / (X * Y))
    return sx.real, sy.real, sx.imag / STEP, sy.imag / STEP, ty.imag / STEP


def squared_stretches(stretch_x: Any, stretch_y: Any) -> tuple[Any, Any, Any]:
    """Squared stretches (X, Y, Z); lists and columns of tables become arrays."""
    lx, ly = plain(stretch_x), plain(stretch_y)
    X, Y = lx * lx, ly * ly
    return X, Y, 1.0 / (X * Y)


def plain(stretch: Any) -> Any:
    """Numbers and arrays as they are, lists and columns of tables as arrays."""
    if isinstance(stretch, (float, complex, np.ndarray, np.generic)):
        return stretch
    return np.asarray(stretch)


# --- materials -----------------------------------------------------------------------------------


class MaterialResponse:
    """Stress and energy of what has a ``law`` and its parameters ``theta``, angles in radians."""

    law: Any
    theta: Any

    @property
    def constants(self) -> Any:
        """Constants of the law, a ``NamedTuple``."""
        return self.law.constants_from_theta(*self.theta)

    @property
    def values(self) -> tuple[Any, ...]:
        """Values in the parameters' own units and order."""
        return tuple(
            np.rad2deg(v) if p.unit == DEGREE else v
            for p, v in zip(self.law.parameters, self.theta, strict=True)
        )

    def strain_energy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Strain energy per reference volume in kPa at total stretches."""
        return energy(self.constants, *squared_stretches(stretch_x, stretch_y))

    def cauchy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches."""
        return cauchy_stress(self.constants, *squared_stretches(stretch_x, stretch_y))

    def piola(self, stretch_x: Any, stretch_y: Any) -> Any:
        """First Piola-Kirchhoff stresses (P_x, P_y) in kPa at total stretches."""
        sx, sy = self.cauchy(stretch_x, stretch_y)
        # P_k = s_k / l_k
        return sx / np.asarray(stretch_x), sy / np.asarray(stretch_y)

    def cauchy_by_log_stretch(self, stretch_x: Any, stretch_y: Any) -> Any:
        """D (s_x, s_y) / d (ln l_x, ln l_y) in kPa, shape (2, 2, ...), by complex step."""
        lx, ly = plain(stretch_x), plain(stretch_y)
        # d l / d ln l = l
        by_x = MaterialResponse.cauchy(self, lx * (1.0 + 1j * STEP), ly)
        by_y = MaterialResponse.cauchy(self, lx, ly * (1.0 + 1j * STEP))
        xx, yx, xy, yy = np.broadcast_arrays(*by_x, *by_y)
        return np.imag(np.array([[xx, xy], [yx, yy]])) / STEP


@dataclass(frozen=True)
class Material(MaterialResponse):
    """A law with values of its parameters, numbers or arrays: one material, or one per draw."""

    law: Any
    # parameters in their order, angles in radians; broadcast against the stretches
    theta: tuple[Any, ...]


class CheckedMaterial(Material):
    """A material that a user has given: a stress that cannot be computed is an error."""

    def cauchy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches; InputError if not finite."""
        with np.errstate(all="ignore"):
            stress = super().cauchy(stretch_x, stretch_y)
        bad = ~np.isfinite(np.sum(np.broadcast_arrays(*stress), axis=0))
        if bad.any():
            i = int(np.argmax(bad))
            at = [np.ravel(np.broadcast_to(v, bad.shape))[i] for v in (stretch_x, stretch_y)]
            raise InputError(
                f"the law {self.law.name} has no finite stress at stretches {at[0]:g}, {at[1]:g}",
                remedy="stretches are positive numbers, 1 where unloaded",
            )
        return stress
