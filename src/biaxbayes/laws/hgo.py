"""The Holzapfel-Gasser-Ogden law: GOH with aligned fibres.

    W = C1 (X + Y + Z - 3) + (k1 / k2) (exp(k2 E^2) - 1),    E = X cos^2 alpha + Y sin^2 alpha - 1

It is the case kappa = 0 of :mod:`biaxbayes.laws.goh`, whose constants and response it shares, and a
candidate of its own: most printed materials have aligned fibres.

The sampler works in ln C1, ln S, ln q and alpha, which is folded at 0 and 90 degrees, with

    q = k2 E*^2,    S = k1 E* exp(q)

at one fixed reference stretch l* a specimen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from biaxbayes.laws.amplitudes import LOAD_NEARNESS, amplitude_distances
from biaxbayes.laws.dispersed_fibres import structure_tensor
from biaxbayes.laws.goh import EXPONENT_NEARNESS, GOH, GOHConstants, GOHLaw
from biaxbayes.laws.law import Law, SamplingLayout
from biaxbayes.laws.response import MaterialResponse, register
from biaxbayes.parameters import Parameter

__all__ = ["HGOLaw"]


_C1, _K1, _K2, _ALPHA = range(4)


class HGOCoordinates(NamedTuple):
    """Constants of the sampling coordinates.

    ``k1_free``, ``k2_free`` are 1 where ln S and ln q are sampled; (X, Y) the squared reference
    stretch.
    """

    k1_free: float
    k2_free: float
    X: float
    Y: float


def _log_strain(alpha, X, Y):
    cos2 = np.cos(alpha) ** 2
    return np.log(cos2 * X + (1.0 - cos2) * Y - 1.0)


def _to_natural(coordinates, value):
    alpha = value[_ALPHA]
    if not 0.0 <= alpha <= 0.5 * np.pi:
        return -np.inf
    cos2 = np.cos(alpha) ** 2
    log_E = np.log(cos2 * coordinates.X + (1.0 - cos2) * coordinates.Y - 1.0)
    if coordinates.k2_free > 0.0:
        value[_K2] -= 2.0 * log_E  # ln k2 = ln q - 2 ln E*
    if coordinates.k1_free > 0.0:
        # ln k1 = ln S - q - ln E*
        value[_K1] -= np.exp(value[_K2] + 2.0 * log_E) + log_E
    return 0.0


def _constants_at(coordinates, value):
    Hx, Hy, Hz = structure_tensor(value[_ALPHA], 0.0)
    return GOHConstants(value[_C1], value[_K1], value[_K2], Hx, Hy, Hz, 0.0)


register(HGOCoordinates, to_natural=_to_natural, constants_at=_constants_at)


_GOH = GOHLaw()


class HGOLaw(Law):
    """Holzapfel-Gasser-Ogden: aligned fibres in a neo-Hookean matrix."""

    name = "hgo"
    title = "Holzapfel-Gasser-Ogden"
    abbreviation = "HGO"
    source = "Holzapfel, Gasser, Ogden, J. Elast. 61 (2000) 1"
    doi = "10.1023/A:1010835316564"
    parameters: ClassVar[tuple[Parameter, ...]] = GOHLaw.parameters[:4]
    ties = GOHLaw.ties
    amplitudes = ("C1", "k1")
    meaningless: ClassVar = {"alpha": (("k1", 0, "k1 = 0"),)}

    @property
    def in_words(self) -> str:
        """The law as the object of a sentence."""
        return (
            "the incompressible Holzapfel-Gasser-Ogden model with two aligned fibre families at "
            "±alpha from the x axis and equal properties; fibres carried load in extension and "
            "compression"
        )

    def as_goh(self, values: Sequence[float]) -> GOH:
        """The same without dispersion."""
        C1, k1, k2, alpha = (float(v) for v in values)
        return GOH(C1, k1, k2, alpha, 0.0)

    def constants_at_point(self, C1, k1, k2, t) -> GOHConstants:
        """Constants at t = cos^2 alpha."""
        return _GOH.constants_at_point(C1, k1, k2, t, 0.0)

    # --- sampling coordinates ---

    def coordinates(self, layout: SamplingLayout) -> HGOCoordinates:
        """Constants of the sampling coordinates."""
        X, Y, _ = layout.reference
        k1, k2 = (float(layout.structural and name in layout.free) for name in ("k1", "k2"))
        return HGOCoordinates(k1, k2, X, Y)

    def to_coordinates(
        self, coordinates: HGOCoordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of C1, k1, k2; alpha in radians."""
        out = dict(values)
        log_E = _log_strain(values["alpha"], coordinates.X, coordinates.Y)
        if coordinates.k2_free > 0.0:
            out["k2"] = values["k2"] + 2.0 * log_E
        if coordinates.k1_free > 0.0:
            out["k1"] = values["k1"] + np.exp(values["k2"] + 2.0 * log_E) + log_E
        return out

    def coordinate_bounds(self, coordinates: HGOCoordinates) -> dict[str, tuple[float, float]]:
        """Bounds of the angle."""
        del coordinates
        return {"alpha": (0.0, 0.5 * np.pi)}

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        return _GOH.inner((*values, 0.0))[:4]

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """(C1, k1, k2, t) moved off its bounds."""
        return _GOH.inner_point(np.append(point, 0.1))[:4]

    # --- fits ---

    def shapes(
        self, size: int, largest: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random exponents at the largest stretches, and angles, 0 and 90 degrees among them."""
        u = rng.random((size, 2))
        q = 10.0 ** (-2.0 + 3.5 * u[:, 0])
        t = np.cos(0.5 * np.pi * u[:, 1]) ** 2
        q[::9] = 0.0
        t[1::7], t[2::7] = 0.0, 1.0
        X, Y = np.maximum(largest.T, 1.0 + 1e-3) ** 2
        k2 = np.minimum(q / (t * X + (1.0 - t) * Y - 1.0) ** 2, self.upper[_K2])
        one = np.ones(size)
        return np.column_stack([one, one, k2, t]), np.column_stack([0.3 * q, t])

    # --- priors and what draws tell ---

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """As that of GOH, without dispersion."""
        prior = _GOH.scaled_prior(stretch, peak_kPa)
        return {name: prior[name] for name in self.names}

    def described(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor in the plane."""
        found = _GOH.described(material)
        return {name: found[name] for name in ("Hx", "Hy")}

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """The exponent of the fibres at the largest of some total stretches."""
        return _GOH.described_at(material, tops)

    nearness = f"{EXPONENT_NEARNESS}; C1 and k1 {LOAD_NEARNESS}"

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """How near to a physical edge counts as near: small shares of stress and exponent."""
        k2 = _GOH.edge_distances(material, tops)["k2"]
        return amplitude_distances(material, tops) | {"k2": k2}
