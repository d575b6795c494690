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

at one fixed reference stretch l* a specimen: data pin the fibre stress and the exponent at the
largest stretch far better than they pin k1, k2 and kappa one by one.

Fits move in (C1, k1, k2, t, kappa) with t = cos^2 alpha. In t the structure tensor is linear and
an angle of 0 or 90 degrees is an ordinary bound; in alpha the stress is stationary there
whatever the data say, and a descent method would stop at either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.laws.amplitudes import MATRIX_SHARE, Screening, best_pair, mounting_candidates
from biaxbayes.laws.dispersed_fibres import (
    angles_from_chart,
    chart_from_angles,
    fibre_curvature,
    fibre_energy,
    fibre_slope,
    fibre_strain,
    largest_fibre_strain2,
    reference_state,
    softening_of,
    structure_tensor,
    structure_tensor_of,
)
from biaxbayes.laws.law import Law, SamplingLayout, StressResponse
from biaxbayes.laws.response import (
    MaterialResponse,
    cauchy_components,
    log_stretch_jacobian,
    register,
)
from biaxbayes.parameters import Parameter, fibre_angle, scale

__all__ = ["EXPONENT_NEARNESS", "GOH", "GOHLaw"]


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


def _exponents(constants, X, Y, Z):
    E = fibre_strain(constants, X, Y, Z)
    return (constants.k2 * E * E,)


def _derivatives(constants, X, Y, Z, g):
    E = fibre_strain(constants, X, Y, Z)
    # dW/dX = C1 + Hx dW/dE
    slope = fibre_slope(constants, E, g[0])
    C1 = constants.C1
    return C1 + constants.Hx * slope, C1 + constants.Hy * slope, C1 + constants.Hz * slope


def _second_derivatives(constants, X, Y, Z, g):
    E = fibre_strain(constants, X, Y, Z)
    Hx, Hy, Hz = constants.Hx, constants.Hy, constants.Hz
    # W_XY = Hx Hy d2W/dE2
    c = fibre_curvature(constants, E, g[0])
    return c * Hx * Hx, c * Hx * Hy, c * Hx * Hz, c * Hy * Hy, c * Hy * Hz, c * Hz * Hz


def _energy(constants, X, Y, Z):
    E = fibre_strain(constants, X, Y, Z)
    return constants.C1 * (X + Y + Z - 3.0) + fibre_energy(constants, E)


register(
    GOHConstants,
    exponents=_exponents,
    derivatives=_derivatives,
    second_derivatives=_second_derivatives,
    energy=_energy,
)


# --- sampling coordinates ----------------------------------------------------------------------


C1, K1, K2, ALPHA, KAPPA = range(5)


class GOHCoordinates(NamedTuple):
    """Constants of the sampling coordinates.

    ``chart`` is 1 for (d, v), 0 for (alpha, kappa); ``structural`` 1 where k1 and k2 are held as
    ln S and ln q; ``k1_free``, ``k2_free`` 1 where they are sampled; (X, Y, Z) the squared
    reference stretch.
    """

    chart: float
    structural: float
    softening: float
    k1_free: float
    k2_free: float
    X: float
    Y: float
    Z: float
    switch: float


def _to_natural(coordinates, value):
    log_jacobian = 0.0
    if coordinates.chart > 0.0:
        if not 0.0 <= value[KAPPA] <= 1.0:
            return -np.inf
        alpha, kappa, log_jacobian = angles_from_chart(
            value[ALPHA], value[KAPPA], coordinates.softening
        )
        value[ALPHA], value[KAPPA] = alpha, kappa
    alpha, kappa = value[ALPHA], value[KAPPA]
    if not (0.0 <= kappa <= 1.0 / 3.0 and 0.0 <= alpha <= 0.5 * np.pi):
        return -np.inf
    if coordinates.structural > 0.0:
        log_E2, log_EG = reference_state(alpha, kappa, coordinates.X, coordinates.Y, coordinates.Z)
        if coordinates.k2_free > 0.0:
            value[K2] -= log_E2  # ln k2 = ln q - ln E*^2
        if coordinates.k1_free > 0.0:
            # ln k1 = ln S - q - ln(E* sqrt(gx gy))
            value[K1] -= np.exp(value[K2] + log_E2) + log_EG
    return log_jacobian


def _constants_at(coordinates, value):
    Hx, Hy, Hz = structure_tensor(value[ALPHA], value[KAPPA])
    return GOHConstants(value[C1], value[K1], value[K2], Hx, Hy, Hz, coordinates.switch)


register(GOHCoordinates, to_natural=_to_natural, constants_at=_constants_at)


# --- the law -----------------------------------------------------------------------------------


_MATRIX_LOAD = 0.3  # share of the peak stress that a calibration's median material owes to it
_KAPPA_DISTANCE = 0.02
_EXPONENT_DISTANCE = 0.1  # k2 E^2 at the largest stretch
_STIFFNESS_SHARE = 0.05  # of the small-strain stiffness
EXPONENT_NEARNESS = f"k2 where k2 E^2 at the largest stretch is below {_EXPONENT_DISTANCE:g}"
"""What counts as near to no exponential stiffening of fibres, in words."""


class GOHLaw(Law):
    """Gasser-Ogden-Holzapfel: dispersed fibres in a neo-Hookean matrix."""

    name = "goh"
    has_switch = True
    title = "Gasser-Ogden-Holzapfel"
    abbreviation = "GOH"
    source = "Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15"
    doi = "10.1098/rsif.2005.0073"
    parameters = (
        scale("C1", "C_1", "matrix stiffness", "kPa", 10.0, 2.0, 1e5, "no matrix", positive=True),
        scale("k1", "k_1", "fibre stiffness", "kPa", 30.0, 2.5, 1e6, "no fibres"),
        scale("k2", "k_2", "fibre stiffening", "1", 10.0, 2.0, 1e4, "no exponential stiffening"),
        fibre_angle("alpha", r"\alpha", "fibre angle from x"),
        Parameter(
            "kappa",
            r"\kappa",
            words="fibre dispersion",
            low=0.0,
            high=1.0 / 3.0,
            at_low="aligned fibres",
            at_high="isotropic",
            sharp=0.1,
            digits=".3f",
            prior=("uniform", 0.0, 1.0 / 3.0),
        ),
    )
    ties = (("k1", "C1"), ("C1", "k1"))
    meaningless: ClassVar = {"alpha": (("kappa", 1, "kappa = 1/3"),)}

    def constants_at_point(self, C1, k1, k2, t, kappa) -> GOHConstants:
        """Constants at t = cos^2 alpha."""
        Hx, Hy, Hz = structure_tensor_of(t, kappa)
        return GOHConstants(C1, k1, k2, Hx, Hy, Hz, float(self.fibre_switch))

    @property
    def in_words(self) -> str:
        """The law as the object of a sentence."""
        load = "in extension only" if self.fibre_switch else "in extension and compression"
        return (
            "the incompressible Gasser-Ogden-Holzapfel model with two fibre families at ±alpha "
            f"from the x axis and equal properties; fibres carried load {load}"
        )

    # --- sampling coordinates ---

    def coordinates(self, layout: SamplingLayout) -> GOHCoordinates:
        """Constants of the sampling coordinates; the chart only where both angles are free."""
        free = layout.free
        chart = layout.chart and "alpha" in free and "kappa" in free
        return GOHCoordinates(
            float(chart),
            float(layout.structural),
            layout.softening,
            float("k1" in free),
            float("k2" in free),
            *layout.reference,
            float(self.fibre_switch),
        )

    def to_coordinates(
        self, coordinates: GOHCoordinates, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values: logs of C1, k1, k2; alpha in radians."""
        out = dict(values)
        alpha, kappa = values["alpha"], values["kappa"]
        if coordinates.chart > 0.0:
            out["alpha"], out["kappa"] = chart_from_angles(alpha, kappa, coordinates.softening)
        if coordinates.structural > 0.0:
            log_E2, log_EG = reference_state(
                alpha, kappa, coordinates.X, coordinates.Y, coordinates.Z
            )
            out["k2"] = values["k2"] + log_E2
            out["k1"] = values["k1"] + np.exp(values["k2"]) * np.exp(log_E2) + log_EG
        return out

    def coordinate_bounds(self, coordinates: GOHCoordinates) -> dict[str, tuple[float, float]]:
        """Bounds of the sampling coordinates, by parameter."""
        if coordinates.chart > 0.0:
            return {"kappa": (0.0, 1.0)}
        return {"alpha": (0.0, 0.5 * np.pi), "kappa": (0.0, 1.0 / 3.0)}

    def coordinate_widths(self, coordinates: GOHCoordinates) -> dict[str, float]:
        """Of kappa itself, where the chart is not used."""
        return {} if coordinates.chart > 0.0 else {"kappa": 0.06}

    def softens(self, coordinates: GOHCoordinates) -> bool:
        """Where the chart is used."""
        return coordinates.chart > 0.0

    def softening(self, values: Mapping[str, Any]) -> float:
        """Scale of the chart near isotropy for materials by parameter, in their own units."""
        return softening_of(np.deg2rad(values["alpha"]), values["kappa"])

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        C1, k1, k2, alpha, kappa = values
        return (
            max(C1, 1e-3),
            max(k1, 1e-3),
            max(k2, 1e-2),
            float(np.clip(alpha, 3.0, 87.0)),
            float(np.clip(kappa, 0.01, 0.32)),
        )

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """(C1, k1, k2, t, kappa) moved off its bounds."""
        low, high = [1e-3, 1e-3, 1e-2, 0.01, 0.01], [np.inf, np.inf, np.inf, 0.99, 0.32]
        return np.clip(point, low, high)

    # --- fits ---

    def scalar(self, values: Sequence[float]) -> GOH:
        """One material, checked, at parameters in their own units."""
        C1, k1, k2, alpha, kappa = values
        return GOH(C1, k1, k2, alpha, kappa, self.fibre_switch)

    def as_goh(self, values: Sequence[float]) -> GOH:
        """The material itself."""
        return self.scalar(values)

    def response(self, point: np.ndarray, stretch: np.ndarray) -> StressResponse:
        """Stresses and their derivatives by (C1, k1, k2, t, kappa), in closed form."""
        _, k1, _, t, kappa = point
        c = self.at_point(point).constants
        one = c._replace(k1=1.0)
        X, Y = stretch * stretch
        Z = 1.0 / (X * Y)
        E = fibre_strain(c, X, Y, Z)
        g = (np.exp(c.k2 * E * E),)
        first, second = _derivatives(c, X, Y, Z, g), _second_derivatives(c, X, Y, Z, g)
        # e = 2 dW/dE, the fibre stress factor, and its slope
        unit = 2.0 * fibre_slope(one, E, g[0])
        slope = 2.0 * fibre_curvature(c, E, g[0])
        e = k1 * unit
        spread = 1.0 - 3.0 * kappa
        # dE/dt and dE/dkappa, from dHx/dt = 1 - 3 kappa, dHx/dkappa = 1 - 3 t and Hx + Hy + Hz = 1
        E_t = spread * (X - Y)
        E_kappa = (1.0 - 3.0 * t) * X + (3.0 * t - 2.0) * Y + Z
        by_coordinate = np.empty((2, 5, X.size), dtype=np.result_type(point, stretch))
        for k, (H, a, H_t, H_kappa) in enumerate(
            ((c.Hx, X, spread, 1.0 - 3.0 * t), (c.Hy, Y, -spread, 3.0 * t - 2.0))
        ):
            gk = H * a - c.Hz * Z
            by_coordinate[k, 0] = 2.0 * (a - Z)  # ds/dC1 = 2 (lk^2 - lz^2)
            by_coordinate[k, 1] = unit * gk  # ds/dk1 = e gk / k1
            by_coordinate[k, 2] = e * E * E * gk  # ds/dk2 = e E^2 gk
            by_coordinate[k, 3] = slope * E_t * gk + e * H_t * a
            by_coordinate[k, 4] = slope * E_kappa * gk + e * (H_kappa * a - Z)
        A, B, C = first
        xx, xy, yy = log_stretch_jacobian(X, Y, Z, A, B, C, second)
        stress = np.array(cauchy_components(X, Y, Z, A, B, C))
        return StressResponse(stress, by_coordinate, np.array([[xx, xy], [xy, yy]]))

    def screen(self, data: Screening, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """Random (q, t, kappa) and mounting stretches, with the best C1 and k1 of each.

        For a given (k2, t, kappa) and mounting stretch the stress is linear in C1 and k1, so the
        best pair follows from a nonnegative least-squares problem of two unknowns, in closed
        form. The exponent is drawn through q = k2 E*^2 at the largest stretch, which is what
        makes a curve more or less bent whatever the strain range.
        """
        q, t, kappa, lm = _candidates(data.size, rng, data.with_mounting)
        point, free, upper = data.point, data.free, self.upper
        total = data.stretch * lm[:, :, None]  # (S, 2, n)
        t = np.where(3 in free, t, point[3])[:, None]
        kappa = np.where(4 in free, kappa, point[4])[:, None]
        X, Y = total[:, 0] ** 2, total[:, 1] ** 2
        Z = 1.0 / (X * Y)
        spread = 1.0 - 3.0 * kappa
        Hx, Hy, Hz = kappa + spread * t, kappa + spread * (1.0 - t), kappa
        E = Hx * X + Hy * Y + Hz * Z - 1.0
        matrix = 2.0 * np.stack([X - Z, Y - Z], axis=1)
        fibre = np.stack([Hx * X - Hz * Z, Hy * Y - Hz * Z], axis=1)
        top = np.maximum((E * E).max(axis=1), 1e-12)
        k2 = np.where(2 in free, np.minimum(q / top, upper[2]), point[2])
        # exp(k2 (E^2 - E*^2)): normalised at the top, so that nothing overflows
        relative = np.exp(k2[:, None] * (E * E - top[:, None]))
        fibre = fibre * (4.0 * E * relative)[:, None, :]
        log_peak = np.minimum(k2 * top, 600.0)
        factor = data.load_factor(total)
        known = [
            None if i in free else v for i, v in ((0, point[0]), (1, point[1] * np.exp(log_peak)))
        ]
        C1, K, cost = best_pair(
            (matrix * factor).reshape(len(t), -1),
            (fibre * factor).reshape(len(t), -1),
            np.broadcast_to(data.load, total.shape).reshape(len(t), -1),
            known,
        )
        k1 = (
            np.clip(K * np.exp(-log_peak), 0.0, upper[1])
            if 1 in free
            else np.full(k2.shape, point[1])
        )
        if data.with_mounting and 0 in free:
            peak = float(np.abs(data.load / data.area[:, None]).max())
            C1 = np.maximum(C1, MATRIX_SHARE * peak)
        points = np.column_stack([np.clip(C1, 0.0, upper[0]), k1, k2, t[:, 0], kappa[:, 0]])
        cost = np.where(np.isfinite(cost) & np.isfinite(points).all(axis=1), cost, np.inf)
        return points, lm, cost, np.column_stack([0.3 * log_peak, t[:, 0], 3.0 * kappa[:, 0]])

    # --- priors and what draws tell ---

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch.

        At the medians the fibres' exponent k2 E^2 is one there, and matrix and fibres carry 30
        and 70 % of the stress.
        """
        strain = stretch**2 - 1.0  # fibre strain of an equibiaxial stretch without dispersion
        # P = 2 C1 (l - l^-5) and 4 k1 E exp(k2 E^2) Hx l with Hx = 1/2 and k2 E^2 = 1
        matrix = 2.0 * (stretch - stretch**-5)
        fibres = 2.0 * strain * np.e * stretch
        return {
            "C1": ("lognormal", _MATRIX_LOAD * peak_kPa / matrix, 0.8),
            "k1": ("lognormal", (1.0 - _MATRIX_LOAD) * peak_kPa / fibres, 0.8),
            "k2": ("lognormal", strain**-2, 0.8),
            "alpha": ("uniform", 0.0, 90.0),
            "kappa": ("uniform", 0.0, 1.0 / 3.0),
        }

    def described(self, material: MaterialResponse) -> dict[str, np.ndarray]:
        """The structure tensor: what an axis-aligned test sees of the fibres."""
        c = material.constants
        return {"Hx": c.Hx, "Hy": c.Hy, "Hz": c.Hz}

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """The exponent of the fibres at the largest of some total stretches."""
        k2 = material.constants.k2[:, 0]
        return {"exponent k2 E^2": k2 * largest_fibre_strain2(material, tops)}

    nearness = (
        f"kappa nearer than *_edge_distance; {EXPONENT_NEARNESS}; C1 and k1 where they carry less "
        f"than {_STIFFNESS_SHARE:g} of the small-strain stiffness"
    )

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """How near to a physical edge counts as near, by parameter, in natural units.

        kappa: 0.02. k2: the exponent k2 E^2 at the largest stretch is below 0.1. C1 and k1: less
        than 5 % of the small-strain stiffness (trace of d s / d ln l) is the matrix's, or the
        fibres'.

        Parameters
        ----------
        material : Material
            Of n draws.
        tops : sequence of ndarray, shape (n, 2)
            Largest total stretches of each protocol.
        """
        c = material.constants
        # trace of the Hessian at l = 1: 16 C1 + 8 k1 (gx^2 + gy^2), gk = Hk - Hz
        per_k1 = 8.0 * ((c.Hx - c.Hz) ** 2 + (c.Hy - c.Hz) ** 2)
        stiffness = _STIFFNESS_SHARE * float(np.median(16.0 * c.C1 + c.k1 * per_k1))
        strain2 = largest_fibre_strain2(material, tops)
        return {
            "C1": stiffness / 16.0,
            "k1": stiffness / max(float(np.median(per_k1)), 1e-9),
            "k2": _EXPONENT_DISTANCE / max(float(np.median(strain2)), 1e-12),
            "kappa": _KAPPA_DISTANCE,
        }


def _candidates(size: int, rng: np.random.Generator, with_mounting: bool):
    """Random q, t, kappa and mounting stretches, with the corners of the box among them."""
    u = rng.random((size, 4))
    q = 10.0 ** (-2.0 + 3.5 * u[:, 0])
    t = np.cos(0.5 * np.pi * u[:, 1]) ** 2
    kappa = u[:, 2] / 3.0
    q[::9] = 0.0
    t[1::7], t[2::7] = 0.0, 1.0
    kappa[3::5] = 0.0
    return q, t, kappa, mounting_candidates(u[:, 3], rng, with_mounting)


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
