"""The Holzapfel-Gasser-Ogden law: GOH with aligned fibres.

    W = C1 (X + Y + Z - 3) + (k1 / k2) (exp(k2 E^2) - 1),    E = X cos^2 alpha + Y sin^2 alpha - 1

It is the case kappa = 0 of :mod:`biaxbayes.laws.goh`, whose constants and response it shares, and a
candidate of its own: most printed materials have aligned fibres.

The sampler works in ln C1, ln S, ln q and alpha, which is folded at 0 and 90 degrees, with

    q = k2 E*^2,    S = k1 E* exp(q)

at one fixed reference stretch l* per specimen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.laws.coordinates import from_log_stress, log_fibre_strain, to_log_stress
from biaxbayes.laws.dispersed_fibres import (
    fibre_strain,
    structure_tensor,
    structure_tensor_from_cos2,
)
from biaxbayes.laws.goh import GOH, GOHConstants, GOHLaw
from biaxbayes.laws.law import Law, TransformInputs
from biaxbayes.laws.materials import MaterialResponse, constants_from_theta, to_slots
from biaxbayes.parameters import Parameter

_C1, _K1, _K2, _ALPHA = range(4)


class HGOTransform(NamedTuple):
    """Constants of the sampling transform.

    ``k1``, ``k2`` are 1 where ln S and ln q are sampled in their places; (X, Y) is the squared
    reference stretch.
    """

    k1: float
    k2: float
    X: float
    Y: float


@to_slots.register(HGOTransform)
def hgo_to_slots(transform, value):
    """Slots in place of (ln C1, ln S, ln q, alpha); the log Jacobian."""
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    log_E = log_fibre_strain(alpha, transform.X, transform.Y)
    from_log_stress(value, _K1, _K2, transform.k1, transform.k2, 2.0 * log_E, log_E)
    return 0.0


@constants_from_theta.register(HGOTransform)
def hgo_constants_from_theta(transform, theta):
    """Constants at theta, angles in radians."""
    Hx, Hy, Hz = structure_tensor(theta[_ALPHA], 0.0)
    return GOHConstants(theta[_C1], theta[_K1], theta[_K2], Hx, Hy, Hz, 0.0)


class HGOLaw(Law):
    """Holzapfel-Gasser-Ogden: aligned fibres in a neo-Hookean matrix."""

    name = "hgo"
    title = "Holzapfel-Gasser-Ogden"
    abbreviation = "HGO"
    source = "Holzapfel, Gasser, Ogden, J. Elast. 61 (2000) 1"
    doi = "10.1023/A:1010835316564"
    description = (
        "the incompressible Holzapfel-Gasser-Ogden model with two aligned fibre families at "
        "±alpha from the x axis and equal properties; fibres carried load in extension and "
        "compression"
    )
    parameters: ClassVar[tuple[Parameter, ...]] = GOHLaw.parameters[:4]
    ties = GOHLaw.ties
    amplitudes = ("C1", "k1")
    exponents: ClassVar = {"k2": "k2 E^2"}
    undefined_at: ClassVar = {"alpha": (("k1", 0, "k1 = 0"),)}

    def constants_from_fit(self, C1, k1, k2, t) -> GOHConstants:
        """Constants at t = cos^2 alpha."""
        Hx, Hy, Hz = structure_tensor_from_cos2(t, 0.0)
        return GOHConstants(C1, k1, k2, Hx, Hy, Hz, 0.0)

    def exponents_at(self, constants: GOHConstants, X: Any, Y: Any, Z: Any) -> tuple[Any, ...]:
        """The exponent of the fibres."""
        return (constants.k2 * fibre_strain(constants, X, Y, Z) ** 2,)

    def as_goh(self, values: Sequence[float]) -> GOH:
        """The equivalent GOH material, without dispersion."""
        C1, k1, k2, alpha = (float(v) for v in values)
        return GOH(C1, k1, k2, alpha, 0.0)

    def sampling_transform(self, inputs: TransformInputs) -> HGOTransform:
        """Constants of the sampling transform."""
        k1, k2 = inputs.reparametrised_flags("k1", "k2")
        return HGOTransform(k1, k2, *inputs.reference[:2])

    def to_sampling_coordinates(
        self, transform: HGOTransform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots: logs of C1, k1, k2; alpha in radians."""
        out = dict(slots)
        log_E = log_fibre_strain(slots["alpha"], transform.X, transform.Y)
        to_log_stress(out, "k1", "k2", transform.k1, transform.k2, 2.0 * log_E, log_E)
        return out

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """Fibres with E = l^2 - 1."""
        return {"k2": (stretch**2 - 1.0) ** -2}

    def derived_quantities(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor in the plane."""
        c = material.constants
        return {"Hx": c.Hx, "Hy": c.Hy}
