r"""Fung's exponential of the Green strains in a neo-Hookean matrix.

    W = c0 (X + Y + Z - 3) + (c / 2) (exp(Q) - 1)
    Q = b_x Ex^2 + b_y Ey^2 + 2 b_xy Ex Ey,    Ex = (X - 1) / 2,  Ey = (Y - 1) / 2

with the squared stretches X, Y, Z. The form Q is positive definite: b_x b_y > b_xy^2. Without the
matrix (c0 = 0) the unloaded state is singular under a dead load, so that c0 is positive.

The sampler works in ln c0, ln T, ln Q*, d and rho, with

    rho = b_xy / sqrt(b_x b_y)          d = ln(b_x / b_y)
    Q* = Q at one fixed reference stretch l* per specimen          T = c Q* exp(Q*)

because data determine the exponent and the stress at the largest stretch far better than c and b.
b_x and b_y follow from Q* = sqrt(b_x b_y) g,  g = exp(d/2) Ex*^2 + exp(-d/2) Ey*^2 + 2 rho Ex* Ey*.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.compilation import inlined
from biaxbayes.laws.law import ABSENT_STIFFNESS_FRACTION, Law, TransformInputs
from biaxbayes.laws.materials import (
    MaterialResponse,
    constants_from_theta,
    derivatives,
    energy,
    to_slots,
)
from biaxbayes.parameters import Parameter, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class FungConstants(NamedTuple):
    """c0, c in kPa and the numbers of the form."""

    c0: Any
    c: Any
    b_x: Any
    b_y: Any
    b_xy: Any


@inlined
def _exponent(constants, X, Y):
    """Q of the energy."""
    Ex, Ey = 0.5 * (X - 1.0), 0.5 * (Y - 1.0)
    return constants.b_x * Ex * Ex + constants.b_y * Ey * Ey + 2.0 * constants.b_xy * Ex * Ey


@derivatives.register(FungConstants)
def fung_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    Ex, Ey = 0.5 * (X - 1.0), 0.5 * (Y - 1.0)
    half = 0.5 * constants.c * np.exp(_exponent(constants, X, Y))
    # dQ/dX = b_x Ex + b_xy Ey;  dW/dX = c0 + (c/2) exp(Q) dQ/dX
    return (
        constants.c0 + half * (constants.b_x * Ex + constants.b_xy * Ey),
        constants.c0 + half * (constants.b_y * Ey + constants.b_xy * Ex),
        constants.c0 + 0.0 * half,
    )


@energy.register(FungConstants)
def fung_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    Q = _exponent(constants, X, Y)
    return constants.c0 * (X + Y + Z - 3.0) + 0.5 * constants.c * np.expm1(Q)


# --- sampling coordinates ----------------------------------------------------------------------


_C0, _C, _BX, _BY, _BXY = range(5)


class FungTransform(NamedTuple):
    """Constants of the sampling transform.

    ``reparametrised`` is 1 where ln T, ln Q* and d are sampled in the places of c, b_x and b_y,
    ``rho`` where rho is in that of b_xy; (Ex, Ey) are the Green strains at the reference stretch.
    """

    reparametrised: float
    rho: float
    Ex: float
    Ey: float


@to_slots.register(FungTransform)
def fung_to_slots(transform, value):
    """Slots in place of (ln c0, ln T, ln Q*, d, rho); the log Jacobian."""
    if transform.rho > 0.0 and not (-1.0 < value[_BXY] < 1.0):
        return -np.inf
    Ex, Ey = transform.Ex, transform.Ey
    if transform.reparametrised > 0.0:
        log_Q, d, rho = value[_BX], value[_BY], value[_BXY]
        # Q* = sqrt(b_x b_y) g
        half = np.exp(0.5 * d)
        g = half * Ex * Ex + Ey * Ey / half + 2.0 * rho * Ex * Ey
        value[_BX] = log_Q - np.log(g) + 0.5 * d
        value[_BY] = log_Q - np.log(g) - 0.5 * d
        # T = c Q* exp(Q*)
        value[_C] -= log_Q + np.exp(log_Q)
    mean = 0.5 * (value[_BX] + value[_BY])
    if transform.rho > 0.0:
        # b_xy = rho sqrt(b_x b_y);  |d b_xy / d rho| = sqrt(b_x b_y), that of the others is one
        value[_BXY] *= np.exp(mean)
        return mean
    if not abs(value[_BXY]) < np.exp(mean):
        return -np.inf
    return 0.0


@constants_from_theta.register(FungTransform)
def fung_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    return FungConstants(theta[_C0], theta[_C], theta[_BX], theta[_BY], theta[_BXY])


# --- the law -----------------------------------------------------------------------------------


_MAX_RHO = 0.98  # largest |rho| that sampling starts from


class FungLaw(Law):
    """Fung's exponential of the Green strains in a neo-Hookean matrix."""

    name = "fung"
    title = "Fung"
    source = "Fung, Fronek, Patitucci, Am. J. Physiol. 237 (1979) H620"
    description = (
        "the incompressible Fung model, an exponential of a quadratic form of the Green strains, "
        "in a neo-Hookean matrix"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        positive_parameter(
            "c0", "c_0", "matrix stiffness", "kPa", 10.0, 2.0, 1e5, "no matrix", positive=True
        ),
        positive_parameter(
            "c", "c", "stiffness of the exponential", "kPa", 10.0, 2.5, 1e6, "no exponential"
        ),
        positive_parameter(
            "b_x", "b_x", "exponent in x", "1", 10.0, 2.0, 1e4, "no stiffening in x"
        ),
        positive_parameter(
            "b_y", "b_y", "exponent in y", "1", 10.0, 2.0, 1e4, "no stiffening in y"
        ),
        Parameter(
            "b_xy",
            "b_{xy}",
            words="coupling of the exponents",
            sharp=1.0,
            width=0.1,
            largest=1e4,
            prior=("normal", 0.0, 30.0),
        ),
    )
    amplitudes = ("c0", "c")
    exponents: ClassVar = {"b_x": "Q", "b_y": "Q"}
    joint_parameters = ("b_x", "b_y", "b_xy")
    condition = "b_x b_y has to be larger than b_xy^2"

    def is_admissible(self, values: Mapping[str, Any]) -> Any:
        """True where the form is positive definite."""
        return np.asarray(values["b_xy"]) ** 2 < np.asarray(values["b_x"]) * values["b_y"]

    def constants_from_fit(self, c0, c, b_x, b_y, b_xy) -> FungConstants:
        """Constants; the coupling is clipped where the form would not be positive definite."""
        limit = np.sqrt(b_x * b_y)
        beyond = np.abs(np.real(b_xy)) > np.real(limit)
        clipped = np.where(np.real(b_xy) < 0.0, -limit, limit)
        return FungConstants(c0, c, b_x, b_y, np.where(beyond, clipped, b_xy)[()])

    def constants_from_theta(self, *values: Any) -> FungConstants:
        """Constants as they are."""
        return FungConstants(*values)

    def exponents_at(self, constants: FungConstants, X: Any, Y: Any, Z: Any) -> tuple[Any, ...]:
        """Q."""
        return (_exponent(constants, X, Y),)

    def sampling_transform(self, inputs: TransformInputs) -> FungTransform:
        """Constants of the sampling transform."""
        free = set(inputs.free)
        X, Y, _ = inputs.reference
        rho = inputs.reparametrised and "b_xy" in free
        return FungTransform(
            float(rho and {"c", "b_x", "b_y"} <= free),
            float(rho),
            0.5 * (X - 1.0),
            0.5 * (Y - 1.0),
        )

    def to_sampling_coordinates(
        self, transform: FungTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of c0, c, b_x, b_y."""
        out = dict(slots)
        log_x, log_y = slots["b_x"], slots["b_y"]
        if transform.rho > 0.0:
            out["b_xy"] = slots["b_xy"] * np.exp(-0.5 * (log_x + log_y))
        if transform.reparametrised > 0.0:
            Ex, Ey = transform.Ex, transform.Ey
            Q = np.exp(log_x) * Ex**2 + np.exp(log_y) * Ey**2 + 2.0 * slots["b_xy"] * Ex * Ey
            with np.errstate(divide="ignore", invalid="ignore"):  # a form that is not positive
                log_Q = np.log(Q)
            out["b_x"], out["b_y"] = log_Q, log_x - log_y
            out["c"] = slots["c"] + log_Q + Q
        return out

    def sampling_bounds(self, transform: FungTransform) -> dict[str, tuple[float, float]]:
        """Bounds of rho."""
        return {"b_xy": (-1.0, 1.0)} if transform.rho > 0.0 else {}

    def clip_inside(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its bounds, to where the sampling coordinates are regular."""
        *scales, b_xy = super().clip_inside(values)
        limit = _MAX_RHO * float(np.sqrt(scales[2] * scales[3]))
        return *scales, float(np.clip(b_xy, -limit, limit))

    def from_fit_coordinates(self, point: Any) -> tuple[float, ...]:
        """Parameters at a point of the fits, of a form that is positive definite."""
        return tuple(float(v) for v in self.constants_from_fit(*(float(v) for v in point)))

    def random_materials(
        self, size: int, max_stretch: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches, and couplings."""
        u = rng.random((size, 3))
        q = 10.0 ** (-2.0 + 3.2 * u[:, :2])  # the exponent of each direction alone
        rho = 1.8 * u[:, 2] - 0.9
        strain = np.maximum(0.5 * (max_stretch**2 - 1.0), 1e-3)
        b = np.minimum(q / strain**2, self.upper[_BX:_BXY])
        one = np.ones(size)
        features = np.column_stack([0.3 * np.log(q), rho])
        return np.column_stack([one, one, b, rho]), features

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """Q = (b_x + b_y) E^2 without coupling."""
        b = 0.5 / (0.5 * (stretch**2 - 1.0)) ** 2
        return {"b_x": b, "b_y": b, "b_xy": 0.0}

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch."""
        prior = super().scaled_prior(stretch, peak_kPa)
        return prior | {"b_xy": ("normal", 0.0, 0.5 * prior["b_x"][1])}

    def amplitude_tolerances(
        self, material: MaterialResponse, max_stretches: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """c0 and c that make 5 % of the small-strain stiffness, the trace of d s / d ln l."""
        c = material.constants
        # trace of the Hessian at l = 1: 16 c0 + c (b_x + b_y)
        per_c = c.b_x + c.b_y
        stiffness = ABSENT_STIFFNESS_FRACTION * float(np.median(16.0 * c.c0 + c.c * per_c))
        return {"c0": stiffness / 16.0, "c": stiffness / max(float(np.median(per_c)), 1e-9)}
