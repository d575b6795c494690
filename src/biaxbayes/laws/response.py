r"""The response of a material: what a law states of its energy, and the stress that follows.

Planar biaxial test, incompressible, no shear: F = diag(lx, ly, 1/(lx ly)), plane stress sz = 0. A
law is a strain energy W of the squared stretches X = lx^2, Y = ly^2, Z = 1/(X Y), even in shear.
With A, B, C = dW/dX, dW/dY, dW/dZ the Cauchy stresses are

    s_x = 2 (X A - Z C)        s_y = 2 (Y B - Z C)

and the six second derivatives give the Jacobian of the force balance at the mounted state.

A law states, for a ``NamedTuple`` of its constants, four functions in plain arithmetic, which serve
numbers, arrays, complex numbers (complex-step differentiation) and the compiled density alike:
:func:`exponents`, :func:`derivatives`, :func:`second_derivatives`, :func:`energy`; and for one of
its sampling coordinates :func:`to_natural` and :func:`constants_at`. The functions below are stubs:
:func:`register` says what they are for a type, and compiled code picks the response by the type
that it is given, so that one kernel is compiled for each law. Exponentials are kept apart from the
rest because the kernel evaluates them for whole curves at once: a law states its exponents, and
gets their exponentials back as ``g``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.compilation import inlined, picked, use_own_cache
from biaxbayes.errors import InputError
from biaxbayes.parameters import DEGREE

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law

__all__ = [
    "STEP",
    "Material",
    "MaterialResponse",
    "PointMaterial",
    "StatedMaterial",
    "cauchy_components",
    "column",
    "constants_at",
    "derivatives",
    "energy",
    "exponential_energy",
    "exponentials",
    "exponents",
    "first_derivatives",
    "log_stretch_jacobian",
    "register",
    "second_derivatives",
    "squared_stretches",
    "to_natural",
]


use_own_cache()

# --- what a law states, by the type of its constants or coordinates ----------------------------


_STATED: dict[tuple[str, type], Callable[..., Any]] = {}


def _stated(what: str, kind: type) -> Callable[..., Any]:
    return _STATED[what, kind]


def exponents(constants, X, Y, Z):
    """Exponents of the law's exponentials at squared stretches; a tuple."""
    return _stated("exponents", type(constants))(constants, X, Y, Z)


def derivatives(constants, X, Y, Z, g):
    """(dW/dX, dW/dY, dW/dZ) in kPa, with the exponentials ``g`` of :func:`exponents`."""
    return _stated("derivatives", type(constants))(constants, X, Y, Z, g)


def second_derivatives(constants, X, Y, Z, g):
    """(W_XX, W_XY, W_XZ, W_YY, W_YZ, W_ZZ) in kPa."""
    return _stated("second_derivatives", type(constants))(constants, X, Y, Z, g)


def energy(constants, X, Y, Z):
    """Strain energy per reference volume in kPa (mJ/mm^3), zero where unloaded; not compiled."""
    return _stated("energy", type(constants))(constants, X, Y, Z)


def to_natural(coordinates, value):
    """Turn sampling coordinates, the first entries of ``value``, into natural ones in place.

    Positive scales are logs before and after, angles radians. Returns the log Jacobian of natural
    by sampling coordinates, -inf outside the law's range.
    """
    return _stated("to_natural", type(coordinates))(coordinates, value)


def constants_at(coordinates, value):
    """Constants of the law at natural values (no logs, radians), the first entries of ``value``."""
    return _stated("constants_at", type(coordinates))(coordinates, value)


_COMPILED = {
    f.__name__: f for f in (exponents, derivatives, second_derivatives, to_natural, constants_at)
}


def register(kind: type, **functions: Callable[..., Any]) -> None:
    """Say what the functions above are for a type of constants or coordinates.

    Parameters
    ----------
    kind : type
        A ``NamedTuple`` whose name no other law's has: it is all that the name of a compiled
        function says of the law, and functions that two processes compiled are linked by name.
    **functions
        By the names of the stubs, with the same argument names.
    """
    for name, function in functions.items():
        _STATED[name, kind] = inlined(function)


def _overload(name: str) -> None:
    """Let compiled code pick a stub's function by the type of its first argument."""

    def first(numba_type: Any) -> Callable[..., Any] | None:
        return _STATED.get((name, getattr(numba_type, "instance_class", type(None))))

    choose: dict[str, Callable[..., Any]] = {
        "exponents": lambda constants, X, Y, Z: first(constants),
        "derivatives": lambda constants, X, Y, Z, g: first(constants),
        "second_derivatives": lambda constants, X, Y, Z, g: first(constants),
        "to_natural": lambda coordinates, value: first(coordinates),
        "constants_at": lambda coordinates, value: first(coordinates),
    }
    picked(_COMPILED[name])(choose[name])


for _name in _COMPILED:
    _overload(_name)


def exponentials(x):
    """Exponentials of a tuple of exponents."""
    return tuple(np.exp(v) for v in x)


def first_derivatives(constants: Any, X: Any, Y: Any, Z: Any) -> tuple[Any, Any]:
    """Exponentials, and with them (dW/dX, dW/dY, dW/dZ) in kPa; not compiled."""
    g = exponentials(exponents(constants, X, Y, Z))
    return g, derivatives(constants, X, Y, Z, g)


def exponential_energy(k: Any, x: Any) -> Any:
    """Give (exp(k x) - 1) / k, which is x where k is zero; numbers and arrays, complex ones too."""
    k = np.asarray(k)
    safe = np.where(k == 0.0, 1.0, k)
    return np.where(k == 0.0, x, np.expm1(k * x) / safe)


def _exponentials_of_tuple(x):
    if x.count == 1:
        return lambda x: (np.exp(x[0]),)
    if x.count == 2:
        return lambda x: (np.exp(x[0]), np.exp(x[1]))
    return lambda x: (np.exp(x[0]), np.exp(x[1]), np.exp(x[2]))


def column(rows, j, like):
    """Column j of an array of rows, as a tuple as long as ``like``."""
    return tuple(rows[i, j] for i in range(len(like)))


def _column_as_tuple(rows, j, like):
    if like.count == 1:
        return lambda rows, j, like: (rows[0, j],)
    if like.count == 2:
        return lambda rows, j, like: (rows[0, j], rows[1, j])
    return lambda rows, j, like: (rows[0, j], rows[1, j], rows[2, j])


picked(exponentials)(_exponentials_of_tuple)
picked(column)(_column_as_tuple)


# --- stress from the derivatives -----------------------------------------------------------------


@inlined
def cauchy_components(X, Y, Z, A, B, C):
    """Cauchy stresses (s_x, s_y) from the derivatives of W."""
    # s_x = 2 (X A - Z C),  s_y = 2 (Y B - Z C)
    return 2.0 * (X * A - Z * C), 2.0 * (Y * B - Z * C)


@inlined
def log_stretch_jacobian(X, Y, Z, A, B, C, second):
    """Derivatives (xx, xy, yy) of the Cauchy stresses by the log stretches; symmetric.

    With W a function of (ln lx, ln ly), s_k = dW/d ln lk, so this is the Hessian of W. From
    dX/d ln lx = 2 X and dZ/d ln lx = -2 Z.
    """
    XX, XY, XZ, YY, YZ, ZZ = second
    # ds_x/d ln lx = 4 (X A + Z C + X^2 W_XX - 2 X Z W_XZ + Z^2 W_ZZ)
    xx = 4.0 * (X * A + Z * C + X * X * XX - 2.0 * X * Z * XZ + Z * Z * ZZ)
    # ds_x/d ln ly = 4 (Z C + X Y W_XY - X Z W_XZ - Y Z W_YZ + Z^2 W_ZZ)
    xy = 4.0 * (Z * C + X * Y * XY - X * Z * XZ - Y * Z * YZ + Z * Z * ZZ)
    yy = 4.0 * (Y * B + Z * C + Y * Y * YY - 2.0 * Y * Z * YZ + Z * Z * ZZ)
    return xx, xy, yy


def squared_stretches(stretch_x: Any, stretch_y: Any) -> tuple[Any, Any, Any]:
    """Squared stretches (X, Y, Z); lists and columns of tables become arrays."""
    plain = (float, complex, np.ndarray, np.generic)
    lx: Any = stretch_x if isinstance(stretch_x, plain) else np.asarray(stretch_x)
    ly: Any = stretch_y if isinstance(stretch_y, plain) else np.asarray(stretch_y)
    X, Y = lx * lx, ly * ly
    return X, Y, 1.0 / (X * Y)


STEP = 1e-30
"""Of complex-step differentiation: exact to rounding."""


class MaterialResponse:
    """Stress and energy of what has a ``law`` and natural values ``theta`` of its parameters."""

    law: Any
    theta: Any

    @property
    def constants(self) -> Any:
        """Constants of the law, a ``NamedTuple``."""
        return self.law.constants(*self.theta)

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

    def _first(self, stretch_x: Any, stretch_y: Any) -> tuple[Any, ...]:
        squared = squared_stretches(stretch_x, stretch_y)
        return squared, *first_derivatives(self.constants, *squared)

    def cauchy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches."""
        squared, _, first = self._first(stretch_x, stretch_y)
        return cauchy_components(*squared, *first)

    def piola(self, stretch_x: Any, stretch_y: Any) -> Any:
        """First Piola-Kirchhoff stresses (P_x, P_y) in kPa at total stretches."""
        sx, sy = self.cauchy(stretch_x, stretch_y)
        # P_k = s_k / l_k
        return sx / np.asarray(stretch_x), sy / np.asarray(stretch_y)

    def cauchy_by_log_stretch(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Derivatives of (s_x, s_y) by (ln l_x, ln l_y), kPa.

        Returns
        -------
        ndarray, shape (2, 2, ...)
            First axis the stress, second the stretch; symmetric in the two.
        """
        (X, Y, Z), g, (A, B, C) = self._first(stretch_x, stretch_y)
        second = second_derivatives(self.constants, X, Y, Z, g)
        xx, xy, yy = np.broadcast_arrays(*log_stretch_jacobian(X, Y, Z, A, B, C, second))
        return np.array([[xx, xy], [xy, yy]])

    def cauchy_by_parameter(self, stretch_x: Any, stretch_y: Any) -> np.ndarray:
        """Derivatives of (s_x, s_y) by the parameters, by complex step; shape (2, p, ...).

        The parameters are numbers here. Units are kPa per unit of the parameter, or radian.
        """
        columns = []
        for i in range(len(self.theta)):
            moved = [complex(v) for v in self.theta]
            moved[i] += 1j * STEP
            stepped = Material(self.law, tuple(moved)).cauchy(stretch_x, stretch_y)
            columns.append(np.imag(np.array(stepped)) / STEP)
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class Material(MaterialResponse):
    """A law with values of its parameters, numbers or arrays: one material, or one a draw.

    Attributes
    ----------
    law : Law
    theta : tuple
        Natural values of the law's parameters in their order, angles in radians; arrays
        broadcast against the stretches.
    """

    law: Law
    theta: tuple[Any, ...]


class StatedMaterial(Material):
    """A material that a user has stated: a stress that cannot be computed is an error."""

    def cauchy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches.

        Raises
        ------
        InputError
            Where the stress is too large for a number, or a stretch is none.
        """
        with np.errstate(all="ignore"):
            found = super().cauchy(stretch_x, stretch_y)
        bad = ~np.isfinite(np.sum(np.broadcast_arrays(*found), axis=0))
        if bad.any():
            i = int(np.argmax(bad))
            at = [np.ravel(np.broadcast_to(v, bad.shape))[i] for v in (stretch_x, stretch_y)]
            raise InputError(
                f"the law {self.law.name} has no finite stress at stretches {at[0]:g}, {at[1]:g}",
                remedy="stretches are positive numbers, 1 where unloaded",
            )
        return found


@dataclass(frozen=True)
class PointMaterial(MaterialResponse):
    """A material at coordinates that fits move in.

    Attributes
    ----------
    law : Law
    point : tuple
        One coordinate a parameter, complex ones for derivatives.
    """

    law: Law
    point: tuple[Any, ...]

    @property
    def constants(self) -> Any:
        """Constants of the law."""
        return self.law.constants_at_point(*self.point)
