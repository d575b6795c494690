r"""The four-fibre law: fibres along x, along y and along two diagonals in a neo-Hookean matrix.

    W = (c / 2) (X + Y + Z - 3) + sum_f n_f (k1_f / (4 k2_f)) (exp(k2_f E_f^2) - 1)
    E_x = max(X - 1, 0),  E_y = max(Y - 1, 0),  E_d = max(X cos^2 alpha + Y sin^2 alpha - 1, 0)

with the squared stretches X, Y, Z, n_x = n_y = 1 and n_d = 2: the diagonal families at +alpha and
-alpha from x are alike, and an axis-aligned test gives both the same strain. Fibres carry no
compression. Some papers print c and k1 / (2 k2) for the factors c / 2 and k1 / (4 k2): their
numbers are half of those here.

The sampler works in the roots (:mod:`biaxbayes.laws.amplitudes`) of S_c, of S_f and q_f of each
family, and in alpha, which is folded at 0 and 90 degrees, with

    q_f = k2_f E_f*^2          S_f = k1_f E_f* exp(q_f)          S_c = c sqrt((X* - Z*)(Y* - Z*))

at one fixed reference stretch l* a specimen, that of its row of largest I1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.amplitudes import (
    LOAD_SHARE,
    LOG_EXPONENT,
    ROOT_WIDTH,
    amplitude_distances,
    largest_at,
    log_square,
    log_stress_scale,
    root,
)
from biaxbayes.laws.law import Law, SamplingLayout
from biaxbayes.laws.response import MaterialResponse, exponential_energy, register
from biaxbayes.parameters import Parameter, fibre_angle, scale

__all__ = ["FourFibreLaw"]


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


def _exponents(constants, X, Y, Z):
    Ex, Ey, Ed = _strains(constants, X, Y)
    return constants.k2_x * Ex * Ex, constants.k2_y * Ey * Ey, constants.k2_d * Ed * Ed


def _derivatives(constants, X, Y, Z, g):
    Ex, Ey, Ed = _strains(constants, X, Y)
    t = constants.cos2
    matrix = 0.5 * constants.c
    # dW/dE_f = n_f (k1_f / 2) E_f exp(k2_f E_f^2)
    diagonal = constants.k1_d * Ed * g[2]
    return (
        matrix + 0.5 * constants.k1_x * Ex * g[0] + t * diagonal,
        matrix + 0.5 * constants.k1_y * Ey * g[1] + (1.0 - t) * diagonal,
        matrix + 0.0 * diagonal,
    )


@inlined
def _curvature(k1, k2, E, g):
    """d2W/dE^2 of a single family."""
    # (k1 / 2) (1 + 2 k2 E^2) exp(k2 E^2), zero in compression
    return 0.5 * k1 * (1.0 + 2.0 * k2 * E * E) * g * (E.real > 0.0)


def _second_derivatives(constants, X, Y, Z, g):
    Ex, Ey, Ed = _strains(constants, X, Y)
    t = constants.cos2
    s = 1.0 - t
    diagonal = 2.0 * _curvature(constants.k1_d, constants.k2_d, Ed, g[2])
    zero = 0.0 * diagonal
    return (
        _curvature(constants.k1_x, constants.k2_x, Ex, g[0]) + t * t * diagonal,
        t * s * diagonal,
        zero,
        _curvature(constants.k1_y, constants.k2_y, Ey, g[1]) + s * s * diagonal,
        zero,
        zero,
    )


def _family_energy(k1, k2, E):
    return 0.25 * k1 * exponential_energy(k2, E * E)


def _energy(constants, X, Y, Z):
    Ex, Ey, Ed = _strains(constants, X, Y)
    return (
        0.5 * constants.c * (X + Y + Z - 3.0)
        + _family_energy(constants.k1_x, constants.k2_x, Ex)
        + _family_energy(constants.k1_y, constants.k2_y, Ey)
        + 2.0 * _family_energy(constants.k1_d, constants.k2_d, Ed)
    )


register(
    FourFibreConstants,
    exponents=_exponents,
    derivatives=_derivatives,
    second_derivatives=_second_derivatives,
    energy=_energy,
)


# --- sampling coordinates ----------------------------------------------------------------------


_C, _K1X, _K2X, _K1Y, _K2Y, _K1D, _K2D, _ALPHA = range(8)
_FAMILIES = (("k1_x", "k2_x"), ("k1_y", "k2_y"), ("k1_d", "k2_d"))


class FourFibreCoordinates(NamedTuple):
    """Constants of the sampling coordinates.

    Each parameter's field is 1 where it is held as a root; ``log_scale`` is ln s, s in kPa,
    ``log_matrix`` ln(S_c / c), (X, Y) the squared reference stretch.
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
def _family(coordinates, value, k1, k2, k1_held, k2_held, log_E):
    """Natural k1 and k2 of one family in place; the log Jacobian."""
    log_jacobian = 0.0
    if k2_held > 0.0:
        log_q, log_slope = log_square(value[k2])
        value[k2] = LOG_EXPONENT + log_q - 2.0 * log_E  # ln k2 = ln q - 2 ln E*
        log_jacobian += log_slope
    if k1_held > 0.0:
        # ln k1 = ln S - q - ln E*
        log_S, log_slope = log_square(value[k1])
        value[k1] = coordinates.log_scale + log_S - np.exp(value[k2] + 2.0 * log_E) - log_E
        log_jacobian += log_slope
    return log_jacobian


@inlined
def _log_strains(alpha, X, Y):
    cos2 = np.cos(alpha) ** 2
    return np.log(X - 1.0), np.log(Y - 1.0), np.log(cos2 * X + (1.0 - cos2) * Y - 1.0)


def _to_natural(coordinates, value):
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    log_x, log_y, log_d = _log_strains(alpha, coordinates.X, coordinates.Y)
    q = coordinates
    log_jacobian = _family(q, value, _K1X, _K2X, q.k1_x, q.k2_x, log_x)
    log_jacobian += _family(q, value, _K1Y, _K2Y, q.k1_y, q.k2_y, log_y)
    log_jacobian += _family(q, value, _K1D, _K2D, q.k1_d, q.k2_d, log_d)
    if q.c > 0.0:
        log_S, log_slope = log_square(value[_C])
        value[_C] = q.log_scale + log_S - q.log_matrix
        log_jacobian += log_slope
    return log_jacobian


def _constants_at(coordinates, value):
    return FourFibreConstants(
        value[_C],
        value[_K1X],
        value[_K2X],
        value[_K1Y],
        value[_K2Y],
        value[_K1D],
        value[_K2D],
        np.cos(value[_ALPHA]) ** 2,
    )


register(FourFibreCoordinates, to_natural=_to_natural, constants_at=_constants_at)


# --- the law -----------------------------------------------------------------------------------


_MATRIX_LOAD = 0.3  # share of the peak stress that a calibration's median material owes to it
_EXPONENT_DISTANCE = 0.1  # k2 E^2 at the largest stretch
_LEAST = (1e-3, *(1e-3, 1e-2) * 3)  # of stiffnesses and exponents to start from


def _stiffness(axis: str, words: str, letter: str) -> tuple[Parameter, Parameter]:
    """Stiffness and stiffening of a family."""
    return (
        scale(
            f"k1_{axis}",
            f"k_{{1{letter}}}",
            f"stiffness of the fibres {words}",
            "kPa",
            30.0,
            2.5,
            1e6,
            f"no fibres {words}",
        ),
        scale(
            f"k2_{axis}",
            f"k_{{2{letter}}}",
            f"stiffening of the fibres {words}",
            "1",
            10.0,
            2.0,
            1e4,
            f"no exponential stiffening {words}",
        ),
    )


class FourFibreLaw(Law):
    """Four fibre families, along x, y and two diagonals, in a neo-Hookean matrix."""

    name = "four-fibre"
    title = "four-fibre"
    source = "Baek, Gleason, Rajagopal, Humphrey, Comput. Methods Appl. Mech. Eng. 196 (2007) 3070"
    # As those of GOH: c is twice its C1, and fibres of any family are as stiff.
    parameters = (
        scale("c", "c", "matrix stiffness", "kPa", 20.0, 2.0, 1e5, "no matrix", positive=True),
        *_stiffness("x", "along x", "x"),
        *_stiffness("y", "along y", "y"),
        *_stiffness("d", "along the diagonals", "d"),
        fibre_angle("alpha", r"\alpha", "angle of the diagonals from x"),
    )
    amplitudes = ("c", "k1_x", "k1_y", "k1_d")
    least_protocols = 2  # one leaves five or six regions along alpha
    meaningless: ClassVar = {"alpha": (("k1_d", 0, "k1_d = 0"),)}

    @property
    def in_words(self) -> str:
        """The law as the object of a sentence."""
        return (
            "the incompressible four-fibre model, with fibre families along x, along y and along "
            "two diagonals of equal properties at ±alpha from the x axis in a neo-Hookean matrix; "
            "fibres carried load in extension only"
        )

    def constants_at_point(self, *point: Any) -> FourFibreConstants:
        """Constants at (c, k1_x, k2_x, k1_y, k2_y, k1_d, k2_d, cos^2 alpha)."""
        return FourFibreConstants(*point)

    # --- sampling coordinates ---

    def coordinates(self, layout: SamplingLayout) -> FourFibreCoordinates:
        """Constants of the sampling coordinates."""
        X, Y, Z = layout.widest
        held = {n: float(layout.structural and n in layout.free) for n in self.names[:_ALPHA]}
        return FourFibreCoordinates(
            **held,
            log_scale=log_stress_scale(layout.peak_kPa),
            log_matrix=0.5 * float(np.log((X - Z) * (Y - Z))),
            X=X,
            Y=Y,
        )

    def to_coordinates(
        self, coordinates: FourFibreCoordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of stiffnesses, exponents; radians."""
        out = dict(values)
        log_strains = _log_strains(values["alpha"], coordinates.X, coordinates.Y)
        for (k1, k2), log_E in zip(_FAMILIES, log_strains, strict=True):
            log_q = values[k2] + 2.0 * log_E
            if getattr(coordinates, k2) > 0.0:
                out[k2] = root(log_q - LOG_EXPONENT)
            if getattr(coordinates, k1) > 0.0:
                log_S = values[k1] + np.exp(log_q) + log_E
                out[k1] = root(log_S - coordinates.log_scale)
        if coordinates.c > 0.0:
            out["c"] = root(values["c"] + coordinates.log_matrix - coordinates.log_scale)
        return out

    def coordinate_bounds(
        self, coordinates: FourFibreCoordinates
    ) -> dict[str, tuple[float, float]]:
        """Bounds of the angle."""
        del coordinates
        return {"alpha": (0.0, 0.5 * np.pi)}

    def coordinate_widths(self, coordinates: FourFibreCoordinates) -> dict[str, float]:
        """Of the roots."""
        held = (name for name in self.names[:_ALPHA] if getattr(coordinates, name) > 0.0)
        return dict.fromkeys(held, ROOT_WIDTH)

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        return tuple(float(v) for v in np.clip(values, (*_LEAST, 3.0), (*[np.inf] * 7, 87.0)))

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """(c, k1, k2 of the families, cos^2 alpha) moved off its bounds."""
        return np.clip(point, (*_LEAST, 0.01), (*[np.inf] * 7, 0.99))

    # --- fits ---

    def shapes(
        self, size: int, largest: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches, and angles."""
        u = rng.random((size, 4))
        q = 10.0 ** (-2.0 + 3.0 * u[:, :3])
        t = np.cos(0.5 * np.pi * u[:, 3]) ** 2
        X, Y = np.maximum(largest.T, 1.0 + 1e-3) ** 2
        strain = np.column_stack([X - 1.0, Y - 1.0, t * X + (1.0 - t) * Y - 1.0])
        k2 = np.minimum(q / strain**2, self.upper[_K2X])
        one = np.ones(size)
        columns = [one, one, k2[:, 0], one, k2[:, 1], one, k2[:, 2], t]
        return np.column_stack(columns), np.column_stack([0.1 * np.log(q), t])

    # --- priors and what draws tell ---

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch.

        At the medians the exponents k2 E^2 are one there, the matrix carries 30 % of the stress,
        and the fibres along an axis and the diagonals half of the rest each.
        """
        strain = stretch**2 - 1.0
        # P = c (l - l^-5) and, for either family at 45 degrees, k1 E exp(k2 E^2) l, k2 E^2 = 1
        matrix = stretch - stretch**-5
        fibres = strain * np.e * stretch
        k1 = ("lognormal", 0.5 * (1.0 - _MATRIX_LOAD) * peak_kPa / fibres, 0.8)
        k2 = ("lognormal", strain**-2, 0.8)
        return {
            "c": ("lognormal", _MATRIX_LOAD * peak_kPa / matrix, 0.8),
            **{
                name: prior
                for names in _FAMILIES
                for name, prior in zip(names, (k1, k2), strict=True)
            },
            "alpha": ("uniform", 0.0, 90.0),
        }

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """The exponents of the families at the largest of some total stretches."""
        largest = _largest_exponents(material, tops)
        return {f"exponent {k2} E^2": q for (_, k2), q in zip(_FAMILIES, largest, strict=True)}

    nearness = (
        f"k2 where k2 E^2 at the largest stretch is below {_EXPONENT_DISTANCE:g}; c and k1 where "
        f"they carry less than {LOAD_SHARE:g} of the stress there"
    )

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """How near to a physical edge counts as near: small shares of stress and exponent."""
        out = amplitude_distances(material, tops)
        for (_, k2), q in zip(_FAMILIES, _largest_exponents(material, tops), strict=True):
            share = _EXPONENT_DISTANCE / max(float(np.median(q)), 1e-12)
            out[k2] = share * float(np.median(getattr(material.constants, k2)))
        return out


def _largest_exponents(material: MaterialResponse, tops: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Largest exponent of each draw and family at some total stretches, three of shape (n,)."""

    def exponent(family: int) -> np.ndarray:
        return largest_at(lambda X, Y, Z: _exponents(material.constants, X, Y, Z)[family], tops)

    return [exponent(family) for family in range(len(_FAMILIES))]
