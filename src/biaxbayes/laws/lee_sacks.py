r"""The Lee-Sacks law: an isotropic and a fibre exponential, weighted, in a neo-Hookean matrix.

    W = c0 (I1 - 3) + (c1 / 2) (delta exp(c2 (I1 - 3)^2) + (1 - delta) exp(c3 E^2) - 1)
    I1 = X + Y + Z,    E = I4 - 1 = X cos^2 alpha + Y sin^2 alpha - 1

with the squared stretches X, Y, Z. I4 is shared by two families at +alpha and -alpha from x, which
an axis-aligned test strains alike; fibres carry load in extension and compression. delta is the
isotropic share of the exponentials. Without the matrix (c0 = 0) the unloaded state is singular
under a dead load, so that c0 is positive.

The sampler works in the roots (:mod:`biaxbayes.laws.amplitudes`) of S0, S2, q2, S3 and q3, in the
places of c0, c1, c2, delta and c3, and in alpha, which is folded at 0 and 90 degrees, with

    q2 = c2 (I1* - 3)^2          S2 = c1 delta c2 (I1* - 3) exp(q2)
    q3 = c3 E*^2                 S3 = c1 (1 - delta) c3 E* exp(q3)          S0 = c0

at one fixed reference stretch l* a specimen, that of its row of largest I1: the stress of each term
there, which data pin better than c1 and delta.
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
from biaxbayes.laws.response import MaterialResponse, register
from biaxbayes.parameters import Parameter, fibre_angle, scale

__all__ = ["LeeSacksLaw"]


# --- the model ---------------------------------------------------------------------------------


class LeeSacksConstants(NamedTuple):
    """c0 and c1 (kPa), the exponents c2 and c3, delta, and cos^2 alpha."""

    c0: Any
    c1: Any
    c2: Any
    c3: Any
    delta: Any
    cos2: Any


def _exponents(constants, X, Y, Z):
    J = X + Y + Z - 3.0
    E = constants.cos2 * X + (1.0 - constants.cos2) * Y - 1.0
    return constants.c2 * J * J, constants.c3 * E * E


def _derivatives(constants, X, Y, Z, g):
    t, delta = constants.cos2, constants.delta
    J = X + Y + Z - 3.0
    E = t * X + (1.0 - t) * Y - 1.0
    # dW/dI1 = c0 + c1 delta c2 J exp(c2 J^2),  dW/dE = c1 (1 - delta) c3 E exp(c3 E^2)
    isotropic = constants.c0 + constants.c1 * delta * constants.c2 * J * g[0]
    fibre = constants.c1 * (1.0 - delta) * constants.c3 * E * g[1]
    return isotropic + t * fibre, isotropic + (1.0 - t) * fibre, isotropic + 0.0 * fibre


def _second_derivatives(constants, X, Y, Z, g):
    t, delta = constants.cos2, constants.delta
    s = 1.0 - t
    J = X + Y + Z - 3.0
    E = t * X + s * Y - 1.0
    c2, c3 = constants.c2, constants.c3
    # d2W/dI1^2 = c1 delta c2 (1 + 2 c2 J^2) exp(c2 J^2), and alike for the fibres
    p = constants.c1 * delta * c2 * (1.0 + 2.0 * c2 * J * J) * g[0]
    f = constants.c1 * (1.0 - delta) * c3 * (1.0 + 2.0 * c3 * E * E) * g[1]
    p = p + 0.0 * f
    return p + t * t * f, p + t * s * f, p, p + s * s * f, p, p


def _energy(constants, X, Y, Z):
    delta = constants.delta
    isotropic, fibre = _exponents(constants, X, Y, Z)
    # delta + (1 - delta) = 1, which the last term takes away
    growth = delta * np.expm1(isotropic) + (1.0 - delta) * np.expm1(fibre)
    return constants.c0 * (X + Y + Z - 3.0) + 0.5 * constants.c1 * growth


register(
    LeeSacksConstants,
    exponents=_exponents,
    derivatives=_derivatives,
    second_derivatives=_second_derivatives,
    energy=_energy,
)


# --- sampling coordinates ----------------------------------------------------------------------


_C0, _C1, _C2, _C3, _DELTA, _ALPHA = range(6)


class LeeSacksCoordinates(NamedTuple):
    """Constants of the sampling coordinates.

    ``c0``, ``c2``, ``c3`` are 1 where these are held as roots, ``stresses`` where c1 and delta are
    held as the roots of S2 and S3; ``log_scale`` is ln s, s in kPa, ``log_J`` ln(I1* - 3), (X, Y)
    the squared reference stretch.
    """

    c0: float
    c2: float
    c3: float
    stresses: float
    log_scale: float
    log_J: float
    X: float
    Y: float


@inlined
def _log_strain(alpha, X, Y):
    cos2 = np.cos(alpha) ** 2
    return np.log(cos2 * X + (1.0 - cos2) * Y - 1.0)


def _to_natural(coordinates, value):
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    log_J = coordinates.log_J
    log_E = _log_strain(alpha, coordinates.X, coordinates.Y)
    log_jacobian = 0.0
    if coordinates.c0 > 0.0:
        log_S0, log_slope = log_square(value[_C0])
        value[_C0] = coordinates.log_scale + log_S0
        log_jacobian += log_slope
    if coordinates.c2 > 0.0:
        log_q, log_slope = log_square(value[_C2])
        value[_C2] = LOG_EXPONENT + log_q - 2.0 * log_J  # ln c2 = ln q2 - 2 ln(I1* - 3)
        log_jacobian += log_slope
    if coordinates.c3 > 0.0:
        log_q, log_slope = log_square(value[_C3])
        value[_C3] = LOG_EXPONENT + log_q - 2.0 * log_E
        log_jacobian += log_slope
    if coordinates.stresses > 0.0:
        log_S2, slope2 = log_square(value[_C1])
        log_S3, slope3 = log_square(value[_DELTA])
        # a = ln(c1 delta) = ln S2 - ln(c2 (I1* - 3)) - q2,  b = ln(c1 (1 - delta)) alike
        a = coordinates.log_scale + log_S2 - value[_C2] - log_J
        a -= np.exp(value[_C2] + 2.0 * log_J)
        b = coordinates.log_scale + log_S3 - value[_C3] - log_E
        b -= np.exp(value[_C3] + 2.0 * log_E)
        log_c1 = max(a, b) + np.log1p(np.exp(-abs(a - b)))
        value[_C1] = log_c1
        value[_DELTA] = np.exp(a - log_c1)
        # |d(ln c1, delta) / d(a, b)| = delta (1 - delta)
        log_jacobian += slope2 + slope3 + (a - log_c1) + (b - log_c1)
    elif not 0.0 <= value[_DELTA] <= 1.0:
        return -np.inf
    return log_jacobian


def _constants_at(coordinates, value):
    return LeeSacksConstants(
        value[_C0],
        value[_C1],
        value[_C2],
        value[_C3],
        value[_DELTA],
        np.cos(value[_ALPHA]) ** 2,
    )


register(LeeSacksCoordinates, to_natural=_to_natural, constants_at=_constants_at)


# --- the law -----------------------------------------------------------------------------------


_MATRIX_LOAD = 0.3  # share of the peak stress that a calibration's median material owes to it
_EXPONENT_DISTANCE = 0.1  # exponent at the largest stretch
_DELTA_DISTANCE = 0.02
_LEAST = (1e-3, 1e-3, 1e-2, 1e-2)  # of stiffnesses and exponents to start from


class LeeSacksLaw(Law):
    """Lee-Sacks: an isotropic and a fibre exponential, weighted, in a neo-Hookean matrix."""

    name = "lee-sacks"
    title = "Lee-Sacks"
    source = "Lee, Amini, Gorman, Gorman, Sacks, J. Biomech. 47 (2014) 2055"
    # Stiffnesses and exponents of soft tissue lie within two decades of these medians either way;
    # nothing is known of the share of the isotropic exponential.
    parameters = (
        scale("c0", "c_0", "matrix stiffness", "kPa", 10.0, 2.0, 1e5, "no matrix", positive=True),
        scale(
            "c1", "c_1", "stiffness of the exponentials", "kPa", 10.0, 2.5, 1e6, "no exponentials"
        ),
        scale("c2", "c_2", "isotropic stiffening", "1", 10.0, 2.0, 1e4, "no isotropic stiffening"),
        scale("c3", "c_3", "fibre stiffening", "1", 10.0, 2.0, 1e4, "no fibres"),
        Parameter(
            "delta",
            r"\delta",
            words="isotropic share",
            low=0.0,
            high=1.0,
            at_low="no isotropic exponential",
            at_high="no fibres",
            sharp=0.2,
            digits=".3f",
            prior=("uniform", 0.0, 1.0),
        ),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
    )
    amplitudes = ("c0", "c1")
    meaningless: ClassVar = {
        "alpha": (("delta", 1, "delta = 1"), ("c1", 0, "c1 = 0"), ("c3", 0, "c3 = 0"))
    }

    @property
    def in_words(self) -> str:
        """The law as the object of a sentence."""
        return (
            "the incompressible Lee-Sacks model, a weighted sum of an isotropic exponential and "
            "one of two fibre families at ±alpha from the x axis, in a neo-Hookean matrix; fibres "
            "carried load in extension and compression"
        )

    def constants_at_point(self, *point: Any) -> LeeSacksConstants:
        """Constants at (c0, c1, c2, c3, delta, cos^2 alpha)."""
        return LeeSacksConstants(*point)

    # --- sampling coordinates ---

    def coordinates(self, layout: SamplingLayout) -> LeeSacksCoordinates:
        """Constants of the sampling coordinates."""
        X, Y, Z = layout.widest
        free = set(layout.free) if layout.structural else set()
        return LeeSacksCoordinates(
            c0=float("c0" in free),
            c2=float("c2" in free),
            c3=float("c3" in free),
            stresses=float({"c1", "c2", "c3", "delta"} <= free),
            log_scale=log_stress_scale(layout.peak_kPa),
            log_J=float(np.log(X + Y + Z - 3.0)),
            X=X,
            Y=Y,
        )

    def to_coordinates(
        self, coordinates: LeeSacksCoordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of c0 to c3, delta, radians."""
        out = dict(values)
        log_J, log_scale = coordinates.log_J, coordinates.log_scale
        log_E = _log_strain(values["alpha"], coordinates.X, coordinates.Y)
        log_q2, log_q3 = values["c2"] + 2.0 * log_J, values["c3"] + 2.0 * log_E
        if coordinates.c0 > 0.0:
            out["c0"] = root(values["c0"] - log_scale)
        if coordinates.c2 > 0.0:
            out["c2"] = root(log_q2 - LOG_EXPONENT)
        if coordinates.c3 > 0.0:
            out["c3"] = root(log_q3 - LOG_EXPONENT)
        if coordinates.stresses > 0.0:
            c1, delta = values["c1"] - log_scale, values["delta"]
            with np.errstate(divide="ignore"):
                out["c1"] = root(c1 + np.log(delta) + log_q2 - log_J + np.exp(log_q2))
                out["delta"] = root(c1 + np.log1p(-delta) + log_q3 - log_E + np.exp(log_q3))
        return out

    def coordinate_bounds(self, coordinates: LeeSacksCoordinates) -> dict[str, tuple[float, float]]:
        """Bounds of the angle, and of delta where it is a coordinate."""
        share = {} if coordinates.stresses > 0.0 else {"delta": (0.0, 1.0)}
        return {**share, "alpha": (0.0, 0.5 * np.pi)}

    def coordinate_widths(self, coordinates: LeeSacksCoordinates) -> dict[str, float]:
        """Of the roots."""
        held = [name for name in ("c0", "c2", "c3") if getattr(coordinates, name) > 0.0]
        held += ["c1", "delta"] if coordinates.stresses > 0.0 else []
        return dict.fromkeys(held, ROOT_WIDTH)

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        low, high = (*_LEAST, 0.01, 3.0), (*[np.inf] * 4, 0.99, 87.0)
        return tuple(float(v) for v in np.clip(values, low, high))

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """(c0, c1, c2, c3, delta, cos^2 alpha) moved off its bounds."""
        return np.clip(point, (*_LEAST, 0.01, 0.01), (*[np.inf] * 4, 0.99, 0.99))

    # --- fits ---

    def shapes(
        self, size: int, largest: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches, their stresses' shares, and angles."""
        u = rng.random((size, 4))
        q = 10.0 ** (-2.0 + 3.0 * u[:, :2])
        t = np.cos(0.5 * np.pi * u[:, 3]) ** 2
        t[1::7], t[2::7] = 0.0, 1.0
        X, Y = np.maximum(largest.T, 1.0 + 1e-3) ** 2
        strain = np.column_stack([X + Y + 1.0 / (X * Y) - 3.0, t * X + (1.0 - t) * Y - 1.0])
        c = np.minimum(q / strain**2, self.upper[_C2])
        # delta where the isotropic exponential has a share u of S2 + S3
        stress = c * strain * np.exp(c * strain**2)
        share = u[:, 2] * stress[:, 1]
        delta = share / (share + (1.0 - u[:, 2]) * stress[:, 0])
        one = np.ones(size)
        points = np.column_stack([one, one, c, delta, t])
        return points, np.column_stack([0.1 * np.log(q), u[:, 2], t])

    # --- priors and what draws tell ---

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch.

        At the medians both exponents are one there, the matrix carries 30 % of the stress and the
        exponentials, at delta = 1/2, the rest.
        """
        J = 2.0 * stretch**2 + stretch**-4 - 3.0
        E = stretch**2 - 1.0
        # P = 2 c0 (l - l^-5); the exponentials, at 45 degrees and exponents of one, have
        # 2 (c1 / 2) (e / J) (l - l^-5) + (c1 / 2) (e / E) l
        per_c0 = 2.0 * (stretch - stretch**-5)
        per_c1 = 0.5 * np.e * (per_c0 / J + stretch / E)
        return {
            "c0": ("lognormal", _MATRIX_LOAD * peak_kPa / per_c0, 0.8),
            "c1": ("lognormal", (1.0 - _MATRIX_LOAD) * peak_kPa / per_c1, 0.8),
            "c2": ("lognormal", J**-2, 0.8),
            "c3": ("lognormal", E**-2, 0.8),
            "delta": ("uniform", 0.0, 1.0),
            "alpha": ("uniform", 0.0, 90.0),
        }

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """The exponents at the largest of some total stretches."""
        isotropic, fibre = _largest_exponents(material, tops)
        return {"exponent c2 (I1 - 3)^2": isotropic, "exponent c3 (I4 - 1)^2": fibre}

    nearness = (
        f"delta nearer than {_DELTA_DISTANCE:g}; c2 and c3 where their exponent at the largest "
        f"stretch is below {_EXPONENT_DISTANCE:g}; c0 and c1 where they carry less than "
        f"{LOAD_SHARE:g} of the stress there"
    )

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """How near to a physical edge counts as near: small shares of stress and exponents."""
        out = amplitude_distances(material, tops) | {"delta": _DELTA_DISTANCE}
        for name, q in zip(("c2", "c3"), _largest_exponents(material, tops), strict=True):
            share = _EXPONENT_DISTANCE / max(float(np.median(q)), 1e-12)
            out[name] = share * float(np.median(getattr(material.constants, name)))
        return out


def _largest_exponents(material: MaterialResponse, tops: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Largest exponents of each draw at some total stretches, two of shape (n,)."""

    def exponent(term: int) -> np.ndarray:
        return largest_at(lambda X, Y, Z: _exponents(material.constants, X, Y, Z)[term], tops)

    return [exponent(term) for term in range(2)]
