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
from biaxbayes.laws.law import Law, SamplingLayout
from biaxbayes.laws.materials import MaterialResponse, constants_at, to_slots
from biaxbayes.parameters import Parameter

_C1, _K1, _K2, _ALPHA = range(4)


class HGOCoordinates(NamedTuple):
    """Constants of the sampling coordinates.

    ``k1``, ``k2`` are 1 where ln S and ln q are sampled in their places; (X, Y) is the squared
    reference stretch.
    """

    k1: float
    k2: float
    X: float
    Y: float


@to_slots.register(HGOCoordinates)
def hgo_to_slots(coordinates, value):
    """Natural values in place of (ln C1, ln S, ln q, alpha); the log Jacobian."""
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    log_E = log_fibre_strain(alpha, coordinates.X, coordinates.Y)
    from_log_stress(value, _K1, _K2, coordinates.k1, coordinates.k2, 2.0 * log_E, log_E)
    return 0.0


@constants_at.register(HGOCoordinates)
def hgo_constants_at(coordinates, value):
    """Constants at natural values."""
    Hx, Hy, Hz = structure_tensor(value[_ALPHA], 0.0)
    return GOHConstants(value[_C1], value[_K1], value[_K2], Hx, Hy, Hz, 0.0)


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

    def constants_at_point(self, C1, k1, k2, t) -> GOHConstants:
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

    def coordinates(self, layout: SamplingLayout) -> HGOCoordinates:
        """Constants of the sampling coordinates."""
        k1, k2 = layout.sampled("k1", "k2")
        return HGOCoordinates(k1, k2, *layout.reference[:2])

    def to_coordinates(
        self, coordinates: HGOCoordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of C1, k1, k2; alpha in radians."""
        out = dict(values)
        log_E = log_fibre_strain(values["alpha"], coordinates.X, coordinates.Y)
        to_log_stress(out, "k1", "k2", coordinates.k1, coordinates.k2, 2.0 * log_E, log_E)
        return out

    def typical(self, stretch: float) -> dict[str, float]:
        """Fibres with E = l^2 - 1."""
        return {"k2": (stretch**2 - 1.0) ** -2}

    def derived_quantities(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor in the plane."""
        c = material.constants
        return {"Hx": c.Hx, "Hy": c.Hy}
