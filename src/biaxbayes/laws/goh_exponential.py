r"""GOH fibres in an exponential matrix.

    W = (C1 / b) (exp(b (X + Y + Z - 3)) - 1) + (k1 / k2) (exp(k2 E^2) - 1)
    E = Hx X + Hy Y + Hz Z - 1

with the squared stretches X, Y, Z and the structure tensor of :mod:`biaxbayes.laws.goh`, which is
the case b -> 0. The exponential matrix is that of Demiray (J. Biomech. 5 (1972) 309).

The fibres are sampled in the coordinates of GOH, and the matrix in ln S_m and ln q_m, with

    q_m = b (I1* - 3)          S_m = C1 exp(q_m)

at the reference stretch, because data pin the exponent and the stiffness at the largest stretch far
better than b and C1. Fits move in (C1, b, k1, k2, t, kappa) with t = cos^2 alpha.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.laws import goh
from biaxbayes.laws.amplitudes import LOAD_NEARNESS, amplitude_distances
from biaxbayes.laws.dispersed_fibres import (
    fibre_curvature,
    fibre_energy,
    fibre_slope,
    fibre_strain,
    structure_tensor,
    structure_tensor_of,
)
from biaxbayes.laws.law import Law, SamplingLayout
from biaxbayes.laws.response import MaterialResponse, exponential_energy, register, to_natural
from biaxbayes.parameters import Parameter, scale

__all__ = ["GOHExponentialLaw"]


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


def _exponents(constants, X, Y, Z):
    E = fibre_strain(constants, X, Y, Z)
    return constants.b * (X + Y + Z - 3.0), constants.k2 * E * E


def _derivatives(constants, X, Y, Z, g):
    E = fibre_strain(constants, X, Y, Z)
    # dW/dX = C1 exp(b (I1 - 3)) + Hx dW/dE
    matrix = constants.C1 * g[0]
    slope = fibre_slope(constants, E, g[1])
    return (
        matrix + constants.Hx * slope,
        matrix + constants.Hy * slope,
        matrix + constants.Hz * slope,
    )


def _second_derivatives(constants, X, Y, Z, g):
    E = fibre_strain(constants, X, Y, Z)
    Hx, Hy, Hz = constants.Hx, constants.Hy, constants.Hz
    # W_XY = C1 b exp(b (I1 - 3)) + Hx Hy d2W/dE2
    m = constants.C1 * constants.b * g[0]
    c = fibre_curvature(constants, E, g[1])
    return (
        m + c * Hx * Hx,
        m + c * Hx * Hy,
        m + c * Hx * Hz,
        m + c * Hy * Hy,
        m + c * Hy * Hz,
        m + c * Hz * Hz,
    )


def _energy(constants, X, Y, Z):
    E = fibre_strain(constants, X, Y, Z)
    matrix = constants.C1 * exponential_energy(constants.b, X + Y + Z - 3.0)
    return matrix + fibre_energy(constants, E)


register(
    GOHExponentialConstants,
    exponents=_exponents,
    derivatives=_derivatives,
    second_derivatives=_second_derivatives,
    energy=_energy,
)


# --- sampling coordinates ----------------------------------------------------------------------


_C1, _B, _K1, _K2, _ALPHA, _KAPPA = range(6)


class GOHExponentialCoordinates(NamedTuple):
    """Constants of the sampling coordinates.

    ``fibres`` are those of GOH; ``C1_free``, ``b_free`` are 1 where ln S_m and ln q_m are sampled;
    ``log_I`` is ln(I1 - 3) at the reference stretch.
    """

    fibres: goh.GOHCoordinates
    C1_free: float
    b_free: float
    log_I: float


def _to_natural(coordinates, value):
    if coordinates.b_free > 0.0:
        value[_B] -= coordinates.log_I  # ln b = ln q_m - ln(I1* - 3)
    if coordinates.C1_free > 0.0:
        value[_C1] -= np.exp(value[_B] + coordinates.log_I)  # ln C1 = ln S_m - q_m
    # the slots of GOH, with b in the place of C1, which its fibres do not ask for
    return to_natural(coordinates.fibres, value[_B:])


def _constants_at(coordinates, value):
    Hx, Hy, Hz = structure_tensor(value[_ALPHA], value[_KAPPA])
    return GOHExponentialConstants(
        value[_C1], value[_B], value[_K1], value[_K2], Hx, Hy, Hz, coordinates.fibres.switch
    )


register(GOHExponentialCoordinates, to_natural=_to_natural, constants_at=_constants_at)


# --- the law -----------------------------------------------------------------------------------


_EXPONENT_DISTANCE = 0.1  # b (I1 - 3) at the largest stretch


def _without_b(values: Sequence[Any]) -> tuple[Any, ...]:
    return (values[_C1], *values[_K1:])


class GOHExponentialLaw(Law):
    """Gasser-Ogden-Holzapfel fibres in an exponential matrix."""

    name = "goh-exponential"
    has_switch = True
    title = "GOH with an exponential matrix"
    source = (
        "Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15; "
        "Demiray, J. Biomech. 5 (1972) 309"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        goh.GOHLaw.parameters[0],
        scale("b", "b", "matrix stiffening", "1", 5.0, 2.0, 1e3, "a neo-Hookean matrix"),
        *goh.GOHLaw.parameters[1:],
    )
    ties = goh.GOHLaw.ties
    amplitudes = ("C1", "k1")
    meaningless: ClassVar = {
        "alpha": (*goh.GOHLaw.meaningless["alpha"], ("k1", 0, "k1 = 0")),
    }

    @property
    def _goh(self) -> goh.GOHLaw:
        return goh.GOHLaw(self.fibre_switch)

    @property
    def in_words(self) -> str:
        """The law as the object of a sentence."""
        return f"{self._goh.in_words}, in a matrix that stiffens exponentially with I1"

    def constants_at_point(self, C1, b, k1, k2, t, kappa) -> GOHExponentialConstants:
        """Constants at t = cos^2 alpha."""
        Hx, Hy, Hz = structure_tensor_of(t, kappa)
        return GOHExponentialConstants(C1, b, k1, k2, Hx, Hy, Hz, float(self.fibre_switch))

    # --- sampling coordinates ---

    def coordinates(self, layout: SamplingLayout) -> GOHExponentialCoordinates:
        """Constants of the sampling coordinates."""
        C1, b = (float(layout.structural and name in layout.free) for name in ("C1", "b"))
        log_I = float(np.log(sum(layout.reference) - 3.0))
        return GOHExponentialCoordinates(self._goh.coordinates(layout), C1, b, log_I)

    def to_coordinates(
        self, coordinates: GOHExponentialCoordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of C1, b, k1, k2; alpha in radians."""
        out = self._goh.to_coordinates(coordinates.fibres, values)
        if coordinates.C1_free > 0.0:
            out["C1"] = values["C1"] + np.exp(values["b"] + coordinates.log_I)
        if coordinates.b_free > 0.0:
            out["b"] = values["b"] + coordinates.log_I
        return out

    def coordinate_bounds(
        self, coordinates: GOHExponentialCoordinates
    ) -> dict[str, tuple[float, float]]:
        """Bounds of the sampling coordinates, by parameter."""
        return self._goh.coordinate_bounds(coordinates.fibres)

    def coordinate_widths(self, coordinates: GOHExponentialCoordinates) -> dict[str, float]:
        """Of kappa itself, where the chart is not used."""
        return self._goh.coordinate_widths(coordinates.fibres)

    def softens(self, coordinates: GOHExponentialCoordinates) -> bool:
        """Where the chart is used."""
        return self._goh.softens(coordinates.fibres)

    def softening(self, values: Mapping[str, Any]) -> float:
        """Scale of the chart near isotropy for materials by parameter, in their own units."""
        return self._goh.softening(values)

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        C1, *fibres = self._goh.inner(_without_b(values))
        return C1, max(values[_B], 1e-2), *fibres

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """(C1, b, k1, k2, t, kappa) moved off its bounds."""
        moved = self._goh.inner_point(np.delete(point, _B))
        return np.insert(moved, _B, max(point[_B], 1e-2))

    # --- fits ---

    def shapes(
        self, size: int, largest: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches and angles, some of them at their ends."""
        u = rng.random((size, 4))
        q_m = 10.0 ** (-2.0 + 2.8 * u[:, 0])
        q = 10.0 ** (-2.0 + 3.5 * u[:, 1])
        t = np.cos(0.5 * np.pi * u[:, 2]) ** 2
        kappa = u[:, 3] / 3.0
        q_m[::4], q[::9] = 0.0, 0.0
        t[1::7], t[2::7] = 0.0, 1.0
        kappa[3::5] = 0.0
        X, Y = np.maximum(largest.T, 1.0 + 1e-3) ** 2
        Z = 1.0 / (X * Y)
        Hx, Hy, Hz = structure_tensor_of(t, kappa)
        E = np.maximum(Hx * X + Hy * Y + Hz * Z - 1.0, 1e-6)
        b = np.minimum(q_m / (X + Y + Z - 3.0), self.upper[_B])
        k2 = np.minimum(q / E**2, self.upper[_K2])
        one = np.ones(size)
        marks = np.column_stack([0.3 * q_m, 0.3 * q, t, 3.0 * kappa])
        return np.column_stack([one, b, one, k2, t, kappa]), marks

    # --- priors and what draws tell ---

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """As that of GOH; at the medians the exponent of the matrix is one there too."""
        prior = self._goh.scaled_prior(stretch, peak_kPa)
        family, C1, spread = prior["C1"]
        I1 = 2.0 * stretch**2 + stretch**-4
        prior["C1"] = (family, C1 * math.exp(-1.0), spread)  # P = 2 C1 exp(b (I1 - 3)) (l - l^-5)
        prior["b"] = ("lognormal", 1.0 / (I1 - 3.0), 0.8)
        return {name: prior[name] for name in self.names}

    def described(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor: what an axis-aligned test sees of the fibres."""
        return self._goh.described(material)

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """The exponents of matrix and fibres at the largest of some total stretches."""
        matrix = {"exponent b (I1 - 3)": material.constants.b[:, 0] * _largest_I(tops)}
        return matrix | self._goh.described_at(material, tops)

    nearness = (
        f"kappa nearer than *_edge_distance; b where b (I1 - 3) at the largest stretch is below "
        f"{_EXPONENT_DISTANCE:g}; {goh.EXPONENT_NEARNESS}; C1 and k1 {LOAD_NEARNESS}"
    )

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """As those of GOH but for C1 and k1, which have to carry load; b by its exponent."""
        I1 = max(float(np.median(_largest_I(tops))), 1e-12)
        fibres = self._goh.edge_distances(material, tops) | amplitude_distances(material, tops)
        return {"b": _EXPONENT_DISTANCE / I1} | fibres


def _largest_I(tops: Sequence[np.ndarray]) -> np.ndarray:
    """Largest I1 - 3 at some total stretches, shape (n,)."""
    largest = np.zeros(1)
    for top in tops:
        X, Y = top.T**2
        largest = np.maximum(largest, X + Y + 1.0 / (X * Y) - 3.0)
    return largest
