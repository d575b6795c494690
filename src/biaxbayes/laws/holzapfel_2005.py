r"""The law of Holzapfel, Sommer, Gasser and Regitnig for coronary arteries.

    W = mu/2 (X + Y + Z - 3) + (k1 / k2) (exp(k2 F) - 1)
    F = (1 - rho) max(I4 - 1, 0)^2 + rho (I1 - 3)^2

    I1 = X + Y + Z,    I4 = X cos^2 alpha + Y sin^2 alpha

with the squared stretches X, Y, Z. Two equal families of fibres lie at +alpha and -alpha from x; an
axis-aligned test stretches both alike. rho = 0 are aligned fibres, rho = 1 is an isotropic law; the
paper's own rho is 1 - rho here. Fibres carry load in extension only, as in the paper.

The sampler works in ln mu, ln S, ln q, alpha, which is folded at 0 and 90 degrees, and rho, with

    q = k2 F*,    S = k1 G* exp(q),    G = (1 - rho) (I4 - 1) I4 + rho (I1 - 3) (X + Y - 2 Z)

at one fixed reference stretch l* a specimen: 4 S is the sum of both stresses of the exponential
there. Data pin it and the exponent far better than k1 and k2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.amplitudes import LOAD_NEARNESS, amplitude_distances, largest_at
from biaxbayes.laws.law import Law, SamplingLayout
from biaxbayes.laws.response import MaterialResponse, exponential_energy, register
from biaxbayes.parameters import Parameter, fibre_angle, scale

__all__ = ["Holzapfel2005Law"]


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
    """(I1 - 3, max(I4 - 1, 0), 1 where fibres are stretched)."""
    E = constants.cos2 * X + (1.0 - constants.cos2) * Y - 1.0
    active = 1.0 * (E.real > 0.0)
    return X + Y + Z - 3.0, E * active, active


@inlined
def _form(constants, X, Y, Z):
    """F, which the exponent is k2 times."""
    J, E, _ = _strains(constants, X, Y, Z)
    return (1.0 - constants.rho) * E * E + constants.rho * J * J


def _exponents(constants, X, Y, Z):
    return (constants.k2 * _form(constants, X, Y, Z),)


def _derivatives(constants, X, Y, Z, g):
    J, E, _ = _strains(constants, X, Y, Z)
    growth = 2.0 * constants.k1 * g[0]
    # dW/dI1 = mu/2 + 2 k1 exp(k2 F) rho (I1 - 3),  dW/dI4 = 2 k1 exp(k2 F) (1 - rho) (I4 - 1)
    matrix = 0.5 * constants.mu + growth * constants.rho * J
    fibres = growth * (1.0 - constants.rho) * E
    return matrix + constants.cos2 * fibres, matrix + (1.0 - constants.cos2) * fibres, matrix


def _second_derivatives(constants, X, Y, Z, g):
    J, E, active = _strains(constants, X, Y, Z)
    cx, cy = constants.cos2, 1.0 - constants.cos2
    # W_XY = k1 exp(k2 F) (d2F/dXdY + k2 dF/dX dF/dY)
    growth = constants.k1 * g[0]
    by_I1 = 2.0 * constants.rho * J
    by_I4 = 2.0 * (1.0 - constants.rho) * E
    Fx, Fy, Fz = by_I1 + cx * by_I4, by_I1 + cy * by_I4, by_I1
    k2 = constants.k2
    m, f = 2.0 * constants.rho, 2.0 * (1.0 - constants.rho) * active
    return (
        growth * (m + cx * cx * f + k2 * Fx * Fx),
        growth * (m + cx * cy * f + k2 * Fx * Fy),
        growth * (m + k2 * Fx * Fz),
        growth * (m + cy * cy * f + k2 * Fy * Fy),
        growth * (m + k2 * Fy * Fz),
        growth * (m + k2 * Fz * Fz),
    )


def _energy(constants, X, Y, Z):
    matrix = 0.5 * constants.mu * (X + Y + Z - 3.0)
    return matrix + constants.k1 * exponential_energy(constants.k2, _form(constants, X, Y, Z))


register(
    Holzapfel2005Constants,
    exponents=_exponents,
    derivatives=_derivatives,
    second_derivatives=_second_derivatives,
    energy=_energy,
)


# --- sampling coordinates ----------------------------------------------------------------------


_MU, _K1, _K2, _ALPHA, _RHO = range(5)


class Holzapfel2005Coordinates(NamedTuple):
    """Constants of the sampling coordinates.

    ``k1_free``, ``k2_free`` are 1 where ln S and ln q are sampled; (X, Y, Z) the squared reference
    stretch.
    """

    k1_free: float
    k2_free: float
    X: float
    Y: float
    Z: float


@inlined
def _reference_state(coordinates, alpha, rho):
    """(ln F*, ln G*) at the reference stretch, where fibres are stretched."""
    X, Y, Z = coordinates.X, coordinates.Y, coordinates.Z
    cos2 = np.cos(alpha) ** 2
    I4 = cos2 * X + (1.0 - cos2) * Y
    E, J = I4 - 1.0, X + Y + Z - 3.0
    F = (1.0 - rho) * E * E + rho * J * J
    G = (1.0 - rho) * E * I4 + rho * J * (X + Y - 2.0 * Z)
    return np.log(F), np.log(G)


def _to_natural(coordinates, value):
    alpha, rho = value[_ALPHA], value[_RHO]
    if not (0.0 <= alpha <= 0.5 * np.pi and 0.0 <= rho <= 1.0):
        return -np.inf
    log_F, log_G = _reference_state(coordinates, alpha, rho)
    if coordinates.k2_free > 0.0:
        value[_K2] -= log_F  # ln k2 = ln q - ln F*
    if coordinates.k1_free > 0.0:
        # ln k1 = ln S - q - ln G*
        value[_K1] -= np.exp(value[_K2] + log_F) + log_G
    return 0.0


def _constants_at(coordinates, value):
    cos2 = np.cos(value[_ALPHA]) ** 2
    return Holzapfel2005Constants(value[_MU], value[_K1], value[_K2], cos2, value[_RHO])


register(Holzapfel2005Coordinates, to_natural=_to_natural, constants_at=_constants_at)


# --- the law -----------------------------------------------------------------------------------


_MATRIX_LOAD = 0.3  # share of the peak stress that a calibration's median material owes to it
_RHO_DISTANCE = 0.05
_EXPONENT_DISTANCE = 0.1  # k2 F at the largest stretch


class Holzapfel2005Law(Law):
    """Fibres and an isotropic invariant in one exponential, in a neo-Hookean matrix."""

    name = "holzapfel-2005"
    title = "Holzapfel 2005"
    source = "Holzapfel, Sommer, Gasser, Regitnig, Am. J. Physiol. Heart 289 (2005) H2048"
    doi = "10.1152/ajpheart.00934.2004"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        scale("mu", r"\mu", "matrix stiffness", "kPa", 20.0, 2.0, 1e5, "no matrix", positive=True),
        scale("k1", "k_1", "stiffness of the exponential", "kPa", 30.0, 2.5, 1e6, "no exponential"),
        scale("k2", "k_2", "stiffening", "1", 10.0, 2.0, 1e4, "no exponential stiffening"),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
        Parameter(
            "rho",
            r"\rho",
            words="isotropic share of the exponent",
            low=0.0,
            high=1.0,
            at_low="aligned fibres",
            at_high="isotropic",
            sharp=0.2,
            digits=".3f",
            width=0.15,
            prior=("uniform", 0.0, 1.0),
        ),
    )
    ties = (("k1", "mu"), ("mu", "k1"))
    amplitudes = ("mu", "k1")
    meaningless: ClassVar = {"alpha": (("rho", 1, "rho = 1"), ("k1", 0, "k1 = 0"))}

    def constants_at_point(self, mu, k1, k2, t, rho) -> Holzapfel2005Constants:
        """Constants at t = cos^2 alpha."""
        return Holzapfel2005Constants(mu, k1, k2, t, rho)

    @property
    def in_words(self) -> str:
        """The law as the object of a sentence."""
        return (
            "the incompressible model of Holzapfel et al. (2005) with two fibre families at ±alpha "
            "from the x axis and equal properties, which share an exponential with I1; fibres "
            "carried load in extension only"
        )

    # --- sampling coordinates ---

    def coordinates(self, layout: SamplingLayout) -> Holzapfel2005Coordinates:
        """Constants of the sampling coordinates."""
        k1, k2 = (float(layout.structural and name in layout.free) for name in ("k1", "k2"))
        return Holzapfel2005Coordinates(k1, k2, *layout.reference)

    def to_coordinates(
        self, coordinates: Holzapfel2005Coordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of mu, k1, k2; alpha in radians."""
        out = dict(values)
        log_F, log_G = _reference_state(coordinates, values["alpha"], values["rho"])
        if coordinates.k2_free > 0.0:
            out["k2"] = values["k2"] + log_F
        if coordinates.k1_free > 0.0:
            out["k1"] = values["k1"] + np.exp(values["k2"] + log_F) + log_G
        return out

    def coordinate_bounds(
        self, coordinates: Holzapfel2005Coordinates
    ) -> dict[str, tuple[float, float]]:
        """Bounds of the angle and of rho."""
        del coordinates
        return {"alpha": (0.0, 0.5 * np.pi), "rho": (0.0, 1.0)}

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        mu, k1, k2, alpha, rho = values
        return (
            max(mu, 1e-3),
            max(k1, 1e-3),
            max(k2, 1e-2),
            float(np.clip(alpha, 3.0, 87.0)),
            float(np.clip(rho, 0.02, 0.98)),
        )

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """(mu, k1, k2, t, rho) moved off its bounds."""
        return np.clip(point, [1e-3, 1e-3, 1e-2, 0.01, 0.02], [*[np.inf] * 3, 0.99, 0.98])

    # --- fits ---

    def shapes(
        self, size: int, largest: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches, angles and rho, some at their ends."""
        u = rng.random((size, 3))
        q = 10.0 ** (-2.0 + 3.4 * u[:, 0])
        t = np.cos(0.5 * np.pi * u[:, 1]) ** 2
        rho = u[:, 2].copy()
        q[::9] = 0.0
        t[1::7], t[2::7] = 0.0, 1.0
        rho[3::5] = 0.0
        X, Y = np.maximum(largest.T, 1.0 + 1e-3) ** 2
        one = np.ones(size)
        F = _form(Holzapfel2005Constants(one, one, one, t, rho), X, Y, 1.0 / (X * Y))
        k2 = np.minimum(q / F, self.upper[_K2])
        return np.column_stack([one, one, k2, t, rho]), np.column_stack([0.3 * q, t, rho])

    # --- priors and what draws tell ---

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch.

        At the medians, rho = 1/2 and 45 degrees, the exponent k2 F is one there, and matrix and
        exponential carry 30 and 70 % of the stress.
        """
        E, J = stretch**2 - 1.0, 2.0 * stretch**2 + stretch**-4 - 3.0
        shear = stretch - stretch**-5
        # P = mu (l - l^-5) and k1 exp(1) ((1 - rho) 2 E l + rho 4 J (l - l^-5))
        exponential = np.e * (E * stretch + 2.0 * J * shear)
        return {
            "mu": ("lognormal", _MATRIX_LOAD * peak_kPa / shear, 0.8),
            "k1": ("lognormal", (1.0 - _MATRIX_LOAD) * peak_kPa / exponential, 0.8),
            "k2": ("lognormal", 2.0 / (E * E + J * J), 0.8),
            "alpha": ("uniform", 0.0, 90.0),
            "rho": ("uniform", 0.0, 1.0),
        }

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """The exponent at the largest of some total stretches."""
        return {"exponent k2 F": _largest_exponent(material, tops)}

    nearness = (
        f"rho nearer than {_RHO_DISTANCE:g}; k2 where the exponent at the largest stretch is below "
        f"{_EXPONENT_DISTANCE:g}; mu and k1 {LOAD_NEARNESS}"
    )

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """How near to a physical edge counts as near: small shares of stress and exponent."""
        k2 = np.ravel(material.constants.k2)
        exponent = np.maximum(_largest_exponent(material, tops), 1e-12)
        return amplitude_distances(material, tops) | {
            "k2": _EXPONENT_DISTANCE * float(np.median(k2 / exponent)),
            "rho": _RHO_DISTANCE,
        }


def _largest_exponent(material: MaterialResponse, tops: Sequence[np.ndarray]) -> np.ndarray:
    """Largest exponent of each draw at some total stretches, shape (n,)."""
    return largest_at(lambda X, Y, Z: _exponents(material.constants, X, Y, Z)[0], tops)
