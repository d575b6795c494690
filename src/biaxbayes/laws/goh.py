r"""The Gasser-Ogden-Holzapfel law.

Two symmetric fibre families lie at +alpha and -alpha from x. An axis-aligned test gives both the
same fibre strain, so the strain energy of Eq. 5 of the method paper (Math. Comput. Appl. 2024,
29(4), 55) reads, with the squared stretches X, Y, Z,

    W = C1 (X + Y + Z - 3) + (k1 / k2) (exp(k2 E^2) - 1)
    E = Hx X + Hy Y + Hz Z - 1

and the diagonal (Hx, Hy, Hz) of the generalised structure tensor. With the fibre switch (Abaqus,
FEBio) fibres carry no compression; the paper has none.

The sampler works in ln C1, ln S, ln q, and the structure tensor's chart (d, v) of
:mod:`biaxbayes.laws.dispersed_fibres`, with

    q = k2 E*^2,    S = k1 E* exp(q) sqrt(gx gy),    gk = Hk lk*^2 - Hz lz*^2

at one fixed reference stretch l* per specimen: data determine the fibre stress and the exponent
at the largest stretch far better than k1, k2 and kappa one by one.

Fits move in (C1, k1, k2, t, kappa) with t = cos^2 alpha. In t the structure tensor is linear and
an angle of 0 or 90 degrees is an ordinary bound; in alpha the stress is stationary there
whatever the data say, and a descent method would stop at either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.laws.coordinates import from_log_stress, to_log_stress
from biaxbayes.laws.dispersed_fibres import (
    DispersedFibreLaw,
    angles_from_chart,
    chart_from_angles,
    fibre_energy,
    fibre_slope,
    fibre_strain,
    reference_state,
    structure_tensor,
    structure_tensor_from_cos2,
)
from biaxbayes.laws.law import ABSENT_STIFFNESS_FRACTION, TransformInputs
from biaxbayes.laws.materials import (
    MaterialResponse,
    constants_from_theta,
    derivatives,
    energy,
    to_slots,
)
from biaxbayes.parameters import Parameter, positive_parameter

# --- the model ---------------------------------------------------------------------------------


class GOHConstants(NamedTuple):
    """C1, k1 (kPa), k2, the structure tensor, and 1 where the fibres carry no compression."""

    C1: Any
    k1: Any
    k2: Any
    Hx: Any
    Hy: Any
    Hz: Any
    switch: Any


@derivatives.register(GOHConstants)
def goh_derivatives(constants, X, Y, Z):
    """Derivatives of W with respect to the squared stretches."""
    E = fibre_strain(constants, X, Y, Z)
    # dW/dX = C1 + Hx dW/dE
    slope = fibre_slope(constants, E)
    C1 = constants.C1
    return C1 + constants.Hx * slope, C1 + constants.Hy * slope, C1 + constants.Hz * slope


@energy.register(GOHConstants)
def goh_energy(constants, X, Y, Z):
    """W, zero where unloaded."""
    E = fibre_strain(constants, X, Y, Z)
    return constants.C1 * (X + Y + Z - 3.0) + fibre_energy(constants, E)


# --- sampling coordinates ----------------------------------------------------------------------


C1, K1, K2, ALPHA, KAPPA = range(5)


class GOHTransform(NamedTuple):
    """Constants of the sampling transform.

    ``chart`` is 1 for (d, v), 0 for (alpha, kappa); ``k1``, ``k2`` are 1 where ln S and ln q are
    sampled in their places; (X, Y, Z) is the squared reference stretch.
    """

    chart: float
    softening: float
    k1: float
    k2: float
    X: float
    Y: float
    Z: float
    switch: float


@to_slots.register(GOHTransform)
def goh_to_slots(transform, value):
    """Slots in place of (ln C1, ln S, ln q, d, v); the log Jacobian."""
    log_jacobian = 0.0
    if transform.chart > 0.0:
        if not 0.0 <= value[KAPPA] <= 1.0:
            return -np.inf
        alpha, kappa, log_jacobian = angles_from_chart(
            value[ALPHA], value[KAPPA], transform.softening
        )
        value[ALPHA], value[KAPPA] = alpha, kappa
    alpha, kappa = value[ALPHA], value[KAPPA]
    if not (0.0 <= kappa <= 1.0 / 3.0 and 0.0 <= alpha <= 0.5 * np.pi):
        return -np.inf
    log_E2, log_EG = reference_state(alpha, kappa, transform.X, transform.Y, transform.Z)
    from_log_stress(value, K1, K2, transform.k1, transform.k2, log_E2, log_EG)
    return log_jacobian


@constants_from_theta.register(GOHTransform)
def goh_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    Hx, Hy, Hz = structure_tensor(theta[ALPHA], theta[KAPPA])
    return GOHConstants(theta[C1], theta[K1], theta[K2], Hx, Hy, Hz, transform.switch)


# --- the law -----------------------------------------------------------------------------------


class GOHLaw(DispersedFibreLaw):
    """Gasser-Ogden-Holzapfel: dispersed fibres in a neo-Hookean matrix."""

    name = "goh"
    title = "Gasser-Ogden-Holzapfel"
    abbreviation = "GOH"
    source = "Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15"
    doi = "10.1098/rsif.2005.0073"
    description = (
        "the incompressible Gasser-Ogden-Holzapfel model with two fibre families at ±alpha from "
        "the x axis and equal properties; fibres carried load {load}"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        positive_parameter(
            "C1", "C_1", "matrix stiffness", "kPa", 10.0, 2.0, 1e5, "no matrix", positive=True
        ),
        *DispersedFibreLaw.fibre_parameters,
    )
    amplitudes = ("C1", "k1")
    exponents: ClassVar = {"k2": "k2 E^2"}
    undefined_at: ClassVar = {"alpha": (("kappa", 1, "kappa = 1/3"),)}

    def constants_from_fit(self, C1, k1, k2, t, kappa) -> GOHConstants:
        """Constants at t = cos^2 alpha."""
        Hx, Hy, Hz = structure_tensor_from_cos2(t, kappa)
        return GOHConstants(C1, k1, k2, Hx, Hy, Hz, float(self.fibre_switch))

    def exponents_at(self, constants: GOHConstants, X: Any, Y: Any, Z: Any) -> tuple[Any, ...]:
        """The exponent of the fibres."""
        return (constants.k2 * fibre_strain(constants, X, Y, Z) ** 2,)

    def material_at(self, values: Sequence[float]) -> GOH:
        """One material, checked, at parameters in their own units."""
        C1, k1, k2, alpha, kappa = values
        return GOH(C1, k1, k2, alpha, kappa, self.fibre_switch)

    def as_goh(self, values: Sequence[float]) -> GOH:
        """The material itself."""
        return self.material_at(values)

    def sampling_transform(self, inputs: TransformInputs) -> GOHTransform:
        """Constants of the sampling transform; the chart only where alpha and kappa are free."""
        chart = inputs.reparametrised and "alpha" in inputs.free and "kappa" in inputs.free
        k1, k2 = inputs.reparametrised_flags("k1", "k2")
        X, Y, Z = inputs.reference
        switch = float(self.fibre_switch)
        return GOHTransform(float(chart), inputs.softening, k1, k2, X, Y, Z, switch)

    def to_sampling_coordinates(
        self, transform: GOHTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of C1, k1, k2; alpha in radians."""
        out = dict(slots)
        alpha, kappa = slots["alpha"], slots["kappa"]
        if transform.chart > 0.0:
            out["alpha"], out["kappa"] = chart_from_angles(alpha, kappa, transform.softening)
        reference = reference_state(alpha, kappa, transform.X, transform.Y, transform.Z)
        to_log_stress(out, "k1", "k2", transform.k1, transform.k2, *reference)
        return out

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """Aligned fibres with E = l^2 - 1."""
        return {"k2": (stretch**2 - 1.0) ** -2, "kappa": 0.0}

    def amplitude_tolerances(
        self, material: MaterialResponse, max_stretches: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """C1 and k1 that make 5 % of the small-strain stiffness, the trace of d s / d ln l."""
        c = material.constants
        # trace of the Hessian at l = 1: 16 C1 + 8 k1 (gx^2 + gy^2), gk = Hk - Hz
        per_k1 = 8.0 * ((c.Hx - c.Hz) ** 2 + (c.Hy - c.Hz) ** 2)
        stiffness = ABSENT_STIFFNESS_FRACTION * float(np.median(16.0 * c.C1 + c.k1 * per_k1))
        return {"C1": stiffness / 16.0, "k1": stiffness / max(float(np.median(per_k1)), 1e-9)}


@dataclass(frozen=True)
class GOH(MaterialResponse):
    """A Gasser-Ogden-Holzapfel material.

    Parameters
    ----------
    C1_kPa, k1_kPa : float
        Stiffness of the matrix and of the fibre families.
    k2 : float
        Exponent of the fibres.
    alpha_deg : float
        Mean fibre angle from the x axis, 0 to 90 degrees.
    kappa : float
        Dispersion, 0 (aligned) to 1/3 (isotropic).
    fibre_switch : bool
        Fibres carry no compression, as in Abaqus and FEBio; the paper has no switch.

    Raises
    ------
    ValueError
        If a parameter lies outside its range.
    """

    C1_kPa: float
    k1_kPa: float
    k2: float
    alpha_deg: float
    kappa: float
    fibre_switch: bool = False

    def __post_init__(self) -> None:
        values = (self.C1_kPa, self.k1_kPa, self.k2, self.alpha_deg, self.kappa)
        if not np.all(np.isfinite(values)):
            raise ValueError("GOH parameters must be finite")
        if min(self.C1_kPa, self.k1_kPa, self.k2) < 0.0:
            raise ValueError("C1, k1 and k2 must not be negative")
        if not 0.0 <= self.alpha_deg <= 90.0:
            raise ValueError("alpha must lie between 0 and 90 degrees")
        if not 0.0 <= self.kappa <= 1.0 / 3.0 + 1e-12:
            raise ValueError("kappa must lie between 0 and 1/3")

    @property
    def law(self) -> GOHLaw:
        """The law, with this material's fibre switch."""
        return GOHLaw(self.fibre_switch)

    @property
    def values(self) -> tuple[float, float, float, float, float]:
        """(C1, k1, k2, alpha in degrees, kappa), in the order of the law's parameters."""
        return self.C1_kPa, self.k1_kPa, self.k2, self.alpha_deg, self.kappa

    @property
    def theta(self) -> tuple[float, float, float, float, float]:
        """(C1, k1, k2, alpha in radians, kappa)."""
        C1, k1, k2, alpha_deg, kappa = self.values
        return C1, k1, k2, float(np.deg2rad(alpha_deg)), kappa

    def structure_tensor(self) -> tuple[float, float, float]:
        """Diagonal (Hx, Hy, Hz) of the generalised structure tensor; sums to one."""
        return structure_tensor(self.theta[3], self.kappa)
