r"""Base class of the material laws.

The file of a law holds its energy and a subclass of :class:`Law`, from which all else follows.

The values of the parameters are written in five ways:

- natural: in their own units, angles in degrees;
- theta: the same with angles in radians, as stresses need them;
- slots: theta with the logs of positive parameters, on which priors are defined;
- sampling coordinates: what the sampler moves in, stresses and exponents at a reference state;
- fit coordinates: natural values with cos^2 in place of angles, what least squares move in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.coordinates import ROOT_WIDTH, STRESS_SHARE, Transform, from_slots
from biaxbayes.laws.materials import (
    STEP,
    CheckedMaterial,
    Material,
    MaterialResponse,
    cauchy_stress,
    constants_type,
    exponents,
    squared_stretches,
)
from biaxbayes.parameters import DEGREE, Parameter, positive_parameter

MATRIX_STRESS_FRACTION = 0.3
"""Fraction of the peak stress that the matrix carries at the medians of a scaled prior."""

ABSENT_STRESS_FRACTION = 0.05
"""Terms that carry less than this fraction of the stress at the largest stretch count as absent."""
ABSENT_STIFFNESS_FRACTION = 0.05
"""The same for laws that compare amplitudes with the small-strain stiffness."""
ABSENT_EXPONENT = 0.1
"""An exponent below this at the largest stretch counts as absent."""
SMALLEST_DRAWS_FRACTION = 0.05
"""Fraction of the draws, those with the smallest amplitude, that its tolerance is computed from:
amplitude and exponent are correlated, so that a small amplitude may carry as much load."""

INTERIOR_MINIMUM = {"kPa": 1e-3, "1": 1e-2}
"""Smallest stiffness and exponent of a material that is moved off its bounds, by unit."""
INTERIOR_MARGIN, INTERIOR_MARGIN_DEG = 0.02, 3.0  # fraction of a range; degrees


def matrix_stiffness(name: str, symbol: str, median_kPa: float) -> Parameter:
    """The stiffness of a matrix, which is never zero."""
    of = ("kPa", median_kPa, 2.0, 1e5, "no matrix")
    return positive_parameter(name, symbol, "matrix stiffness", *of, positive=True)


def stiffening(
    name: str, symbol: str, words: str, at_low: str = "no exponential stiffening"
) -> Parameter:
    """A parameter that an exponent is proportional to."""
    return positive_parameter(name, symbol, words, "1", 10.0, 2.0, 1e4, at_low)


@dataclass(frozen=True)
class Law:
    """A material law.

    ``fibre_switch``, for laws that leave it open, makes fibres carry no compression.
    """

    fibre_switch: bool = False

    has_switch: ClassVar[bool] = False
    """True if the law leaves open what its fibres do in compression."""
    energy: ClassVar[Callable[..., Any]]
    """W in kPa, zero where unloaded, of squared stretches X, Y, Z and the parameters in their
    order; angles are given as cos^2, and with ``has_switch`` the last argument is 1 where fibres
    carry no compression, else 0."""
    name: ClassVar[str]
    text: ClassVar[str] = ""
    """The file of a user's own law."""
    title: ClassVar[str]
    abbreviation: ClassVar[str] = ""
    source: ClassVar[str]
    doi: ClassVar[str] = ""
    description: ClassVar[str]
    """The law as the object of a sentence, for the methods of a paper; ``{load}`` is replaced by
    when fibres carry load, where the switch decides that."""
    parameters: ClassVar[tuple[Parameter, ...]]
    ties: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Pairs of parameters of which the first can be tied to the second."""
    least_protocols: ClassVar[int] = 1
    """Number of protocols below which its posterior has several modes of similar mass."""
    undefined_at: ClassVar[Mapping[str, tuple[tuple[str, int, str], ...]]] = {}
    """Parameters that are undefined where another is at an end of its range: the name of the other,
    the side (0 low, 1 high), and the material there as text; one entry for every such end."""
    amplitudes: ClassVar[tuple[str, ...]]
    """Parameters that the stress is linear in, the stiffness of the matrix first."""
    exponential_stress_fraction: ClassVar[float] = 1.0 - MATRIX_STRESS_FRACTION
    """Fraction of the stress that an exponential carries at the medians of the scaled prior."""
    exponents: ClassVar[Mapping[str, str]] = {}
    """Formula of each exponent, by the parameter that it is proportional to, such as
    ``{"k2": "k2 E^2"}``, in the order of the exponentials of the energy, which parameters may
    share."""
    roots: ClassVar[bool] = False
    """Whether roots are sampled in place of logs, because terms can stand in for one another."""
    typical: ClassVar[Mapping[str, float]] = {}
    """Medians of scaled priors of parameters that are neither amplitudes nor exponents."""
    bound_by: ClassVar[tuple[str, ...]] = ()
    """A parameter b, and two others with b_x b_y > b^2."""
    compares_stiffness: ClassVar[bool] = False
    """Whether an amplitude counts as absent by the small-strain stiffness, not by the stress."""
    fraction_tolerances: ClassVar[Mapping[str, float]] = {}
    """Distances from a bound within which a dispersion or a fraction counts as being at it."""
    least: ClassVar[Mapping[str, float]] = {}
    """Lower bounds of fits where the energy has no value at the end of a range."""
    condition: ClassVar[str] = ""
    """Condition of admissibility on several parameters together, as text."""
    joint_parameters: ClassVar[tuple[str, ...]] = ()
    """Parameters in the condition."""

    @property
    def key(self) -> str:
        """What :func:`.law_named` knows the law by: its name, or the text of its file."""
        return self.text or self.name

    @property
    def short_name(self) -> str:
        """The law as the subject of a sentence: its usual abbreviation, or its title."""
        return self.abbreviation or self.title

    @property
    def in_words(self) -> str:
        """:attr:`description` of this law."""
        load = "in extension only" if self.fibre_switch else "in extension and compression"
        return self.description.format(load=load)

    # --- materials ---

    _constants_type: ClassVar[Any]

    def __init_subclass__(cls) -> None:
        """Stresses and exponents from the energy, for a class that has one."""
        if "energy" in vars(cls):
            names, mirrored = zip(*((p.name, p.mirror) for p in cls.parameters), strict=True)
            cls._constants_type = constants_type(cls.energy, names, mirrored, switch=cls.has_switch)

    def constants(self, *values: Any) -> Any:
        """Constants at the parameters in their order, cos^2 in place of angles."""
        switch = (float(self.fibre_switch),) if self.has_switch else ()
        return self._constants_type(*values, *switch)

    def constants_from_fit(self, *point: Any) -> Any:
        """Constants at fit coordinates."""
        # In cos^2 a structure tensor is linear, and an angle of 0 or 90 degrees an ordinary bound;
        # in the angle the stress is stationary there whatever the data say.
        return self.constants(*point)

    def constants_from_theta(self, *values: Any) -> Any:
        """Constants at the parameters in their order, angles in radians."""
        pairs = zip(self.parameters, values, strict=True)
        return self.constants(*(np.cos(v) ** 2 if p.mirror else v for p, v in pairs))

    @property
    def formulas(self) -> tuple[str, ...]:
        """Formulas of the exponents, each once."""
        return tuple(dict.fromkeys(self.exponents.values()))

    def exponent_per_unit(self, name: str, constants: Any, X: Any, Y: Any, Z: Any) -> Any:
        """The exponent at squared stretches where one parameter is 1 and the others are 0."""
        none = dict.fromkeys((*self.exponents, *self.bound_by[:1]), 0.0)
        alone = constants._replace(**(none | {name: 1.0}))
        return exponents(alone, X, Y, Z)[self.formulas.index(self.exponents[name])]

    def material(self, values: Any) -> Material:
        """Materials at parameters by name, in their own units; shape (n,) becomes (n, 1)."""
        columns = []
        for p in self.parameters:
            value = np.asarray(values[p.name], dtype=float)
            value = np.deg2rad(value) if p.unit == DEGREE else value
            columns.append(value[:, None] if value.ndim else float(value))
        return Material(self, tuple(columns))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """The parameter of a name."""
        return self.parameters[self.names.index(name)]

    def known_name(self, name: str) -> str:
        """The name of a parameter that is given with its unit, as ``C1_kPa``; else as it is."""
        return next((p.name for p in self.parameters if p.label == name), name)

    def material_at(self, values: Sequence[float]) -> Any:
        """One material at parameters in their own units and order."""
        return self.material(dict(zip(self.names, values, strict=True)))

    def checked_material(self, values: Mapping[str, float]) -> CheckedMaterial:
        """One material at parameters by name, with or without their unit.

        InputError for a parameter that is unknown, given twice, missing or out of range.
        """
        labels = ", ".join(p.label for p in self.parameters)
        checked: dict[str, float] = {}
        for given, value in values.items():
            name = self.known_name(given)
            if name not in self.names or name in checked:
                problem = "is given twice" if name in checked else "is not a parameter"
                raise InputError(
                    f"{given} {problem} of the law {self.name}", remedy=f"parameters are {labels}"
                )
            p = self.parameter(name)
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and p.low <= value <= p.high):
                raise InputError(
                    f"{given} = {value if number else repr(value)[:40]} is out of range",
                    remedy=f"it lies between {p.low:g} and {p.high:g}{p.unit_words()}",
                )
            checked[name] = float(value)
        missing = [p.label for p in self.parameters if p.name not in checked]
        if missing:
            raise InputError(f"the law {self.name} needs {' and '.join(missing)}")
        self.check_condition(checked)
        return CheckedMaterial(self, self.material(checked).theta)

    def as_goh(self, values: Sequence[float]) -> Any:
        """The equivalent GOH material at parameters in their own units and order, or None."""
        return None

    def check_condition(self, values: Mapping[str, Any]) -> None:
        """Raise InputError for given numbers that do not meet :attr:`condition`."""
        given = self.joint_parameters and set(self.joint_parameters) <= set(values)
        if given and not self.is_admissible(values):
            raise InputError(f"not a material of the law {self.name}: {self.condition}")

    def is_admissible(self, values: Mapping[str, Any]) -> Any:
        """True where parameters, numbers or arrays, meet :attr:`condition`."""
        return True

    def _sharing(self, name: str) -> int:
        """Number of exponents that share the exponential of one."""
        return list(self.exponents.values()).count(self.exponents[name])

    # --- sampling coordinates ---

    charted: ClassVar[tuple[str, ...]] = ()
    """Angle and dispersion that are sampled in their chart where both are free."""

    def sampling_transform(
        self,
        free: Collection[str],
        reference: tuple[float, float, float],
        isotropy_scale: float,
        max_I1_state: tuple[float, float, float],
        peak_kPa: float,
        *,
        reparametrised: bool = True,
    ) -> Transform:
        """Constants of the sampling coordinates.

        ``free`` are parameters that are neither fixed nor tied, ``reference`` squared stretches
        (X, Y, Z), both in-plane ones above 1, ``max_I1_state`` those of the measured row of largest
        I1, and ``peak_kPa`` is the largest stress of the specimen. With ``reparametrised`` stresses
        and exponents there are sampled, which the data determine well and which are regular at the
        bounds, else the slots themselves.
        """
        sampled = {n for n in self.names if reparametrised and n in free}
        chart = bool(self.charted) and set(self.charted) <= sampled
        share = bool(self.bound_by) and self.bound_by[0] in sampled
        ranges = {p.name: np.array(p.range) for p in self.parameters if p.bounded}
        ranges |= {p.name: np.deg2rad(p.range) for p in self.parameters if p.unit == DEGREE}
        if chart:
            ranges |= dict(zip(self.charted, np.array([(-np.inf, np.inf), (0, 1)]), strict=True))
        if share:
            ranges[self.bound_by[0]] = np.array([-1.0, 1.0])
        state = max_I1_state if self.roots else reference
        low, high = np.array([ranges.get(n, (-np.inf, np.inf)) for n in self.names]).T.copy()
        exponential = {n: self.formulas.index(f) for n, f in self.exponents.items()}
        first = {}  # of two that share an exponential
        for one, other in permutations(self.exponents, 2):
            if exponential[one] == exponential[other] and {one, other} <= sampled:
                first[other] = self.names.index(one)
                break
        alpha, kappa = (self.names.index(n) if chart else -1 for n in self.charted or ("", ""))
        bound = [self.names.index(n) for n in self.bound_by] or [-1, -1, -1]
        return Transform(
            constants=self.constants(*(1.0 for _ in self.names)),
            low=low,
            high=high,
            logarithmic=np.array([p.logarithmic for p in self.parameters]),
            exponential=np.array([exponential.get(n, -1) for n in self.names]),
            in_exponents=np.array([n in (*exponential, *self.bound_by[:1]) for n in self.names]),
            first=np.array([first.get(n, -1) for n in self.names]),
            amplitude=np.array([n in self.amplitudes for n in self.names]),
            sampled=np.array([n in sampled for n in self.names]),
            bound=np.array(bound),
            as_share=share,
            alpha=alpha,
            kappa=kappa,
            isotropy_scale=float(isotropy_scale),
            roots=self.roots,
            log_scale=math.log(STRESS_SHARE * peak_kPa),
            **dict(zip("XYZ", state, strict=True)),
        )

    def to_sampling_coordinates(
        self, transform: Transform, slots: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at slots (logs of positive parameters, radians), by parameter."""
        columns = np.stack(np.broadcast_arrays(*(slots[n] for n in self.names)))
        with np.errstate(all="ignore"):  # an end of a range may have none
            return dict(zip(self.names, from_slots(transform, columns), strict=True))

    def sampling_bounds(self, transform: Transform) -> dict[str, tuple[float, float]]:
        """Bounds of the sampling coordinates that have some, by parameter."""
        bounds = zip(self.names, transform.low.tolist(), transform.high.tolist(), strict=True)
        return {name: (low, high) for name, low, high in bounds if math.isfinite(high)}

    def sampling_widths(self, transform: Transform) -> dict[str, float]:
        """Widths of dispersed starts where they differ from the parameters' own."""
        rooted = zip(self.names, transform.sampled, strict=True) if self.roots else ()
        stretched = (*self.amplitudes, *self.exponents)
        return {n: ROOT_WIDTH for n, sampled in rooted if sampled and n in stretched}

    def isotropy_scale(self, values: Mapping[str, Any]) -> float:
        """The s of asinh(h / s) for materials around these natural values, by parameter."""
        return 1.0

    # --- coordinates of fits: cos^2 of angles, the others as they are ---

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the fit coordinates."""
        lower = [0.0 if p.mirror else max(p.low, -p.largest) for p in self.parameters]
        return np.array([self.least.get(n, v) for n, v in zip(self.names, lower, strict=True)])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the fit coordinates."""
        return np.array([1.0 if p.mirror else min(p.high, p.largest) for p in self.parameters])

    def to_fit_coordinates(self, values: Sequence[float]) -> np.ndarray:
        """Fit coordinates at natural values in the order of the parameters."""
        point = np.array(values, dtype=float)
        for i, p in enumerate(self.parameters):
            if p.mirror:
                # cos^2 of 90 degrees is 4e-33 in floating point, not the bound it stands for
                point[i] = 0.0 if point[i] == 90.0 else np.cos(np.deg2rad(point[i])) ** 2
        return point

    def from_fit_coordinates(self, point: Any) -> tuple[float, ...]:
        """Natural values in the order of the parameters, in their ranges, from fit coordinates."""
        values = []
        for p, value in zip(self.parameters, map(float, point), strict=True):
            if p.mirror:
                t = min(max(value, 0.0), 1.0)
                value = min(float(np.rad2deg(np.arccos(np.sqrt(t)))), p.high)
            values.append(min(max(value, p.low), p.high) if p.bounded else value)
        return tuple(values)

    def clip_inside(self, values: Sequence[float]) -> tuple[float, ...]:
        """Natural values moved off their bounds, where sampling coordinates may be singular."""
        moved = []
        for p, value in zip(self.parameters, values, strict=True):
            if p.bounded:
                margin = INTERIOR_MARGIN_DEG if p.mirror else INTERIOR_MARGIN * (p.high - p.low)
                value = min(max(value, p.low + margin), p.high - margin)
            moved.append(max(value, INTERIOR_MINIMUM[p.unit]) if p.logarithmic else value)
        return tuple(float(v) for v in moved)

    def response(
        self, point: np.ndarray, stretch: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cauchy stresses (n, 2) at fit coordinates (p,) and total stretches (n, 2).

        With their derivatives by fit coordinate (n, 2, p) and by log stretch (n, 2, 2).
        """
        p = point.size
        # one material and state per coordinate and log stretch, each with an imaginary step
        step = 1j * STEP * np.eye(p + 2)
        constants = self.constants_from_fit(*(point + step[:, :p]).T[:, :, None])
        lx, ly = (stretch[:, k] * (1.0 + step[:, p + k, None]) for k in range(2))
        stress = np.stack(cauchy_stress(constants, *squared_stretches(lx, ly)), axis=1).T
        slope = stress.imag / STEP
        return stress[..., 0].real, slope[..., :p], slope[..., p:]

    # --- starting points of fits ---

    def random_materials(
        self, size: int, max_stretch: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random materials for fits to start from, with amplitudes of 1; some are at bounds.

        Exponents at total stretches (size, 2) are log-uniform from 0.01 to 30, whatever the strain
        range. Returns fit coordinates (size, p) and features (size, k), exponents first.
        """
        points, features = np.ones((size, len(self.parameters))), []
        for i, p in enumerate(self.parameters):
            if p.bounded:
                u = rng.random(size)
                if p.mirror:
                    points[:, i] = np.cos(0.5 * np.pi * u) ** 2
                    points[1::7, i], points[2::7, i] = 0.0, 1.0
                else:
                    points[:, i] = p.low + (p.high - p.low) * u
                    points[3::5, i] = p.low
                features.append(points[:, i] / self.upper[i])
            elif p.name not in (*self.amplitudes, *self.exponents, *self.bound_by):
                family, centre, sd = p.prior or ("lognormal", 1.0, 1.0)
                z = rng.standard_normal(size)
                points[:, i] = centre * np.exp(sd * z) if family == "lognormal" else centre + sd * z
        X, Y = np.maximum(max_stretch.T, 1.0 + 1e-3) ** 2
        squared, constants = (X, Y, 1.0 / (X * Y)), self.constants_from_fit(*points.T)
        for k, name in enumerate(self.exponents):
            # q = k2 F, log-uniform, and k2 = q / F with F the exponent at k2 = 1
            q = 10.0 ** (-2.0 + 3.5 * rng.random(size)) / self._sharing(name)
            q[k::9] = 0.0
            F = self.exponent_per_unit(name, constants, *squared)
            points[:, self.names.index(name)] = q / np.maximum(F, 1e-12)
            features.insert(k, 0.3 * q)
        if self.bound_by:
            b, first, second = (self.names.index(n) for n in self.bound_by)
            rho = rng.uniform(-0.9, 0.9, size)
            points[:, b] = rho * np.sqrt(points[:, first] * points[:, second])
            features.append(rho)
        # a law may have amplitudes alone
        chosen = np.column_stack([np.empty((size, 0)), *features])
        return np.clip(points, self.lower, self.upper), chosen

    # --- priors, derived quantities, distances from bounds ---

    def prior_medians(self, stretch: float) -> dict[str, float]:
        """Prior medians of all but the amplitudes: exponents are 1 at an equibiaxial stretch."""
        priors = {p.name: p.prior[1] for p in self.parameters if p.prior}
        priors |= {p.name: 0.5 * (p.low + p.high) for p in self.parameters if p.bounded}
        priors |= dict(self.typical)
        medians = {n: m for n, m in priors.items() if n not in self.amplitudes}
        constants = self.material(dict.fromkeys(self.amplitudes, 1.0) | medians).constants
        squared = stretch**2, stretch**2, stretch**-4
        for name in self.exponents:
            F = self.exponent_per_unit(name, constants, *squared)
            medians[name] = 1.0 / (self._sharing(name) * F)
        return {n: float(m) for n, m in medians.items()}

    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Priors of tissue that reaches a nominal stress at a total equibiaxial stretch.

        At the medians (45 degrees, no dispersion) the exponents are one there, and matrix and
        exponentials carry 30 and 70 % of the stress; a single amplitude carries all of it.
        """
        of_matrix = MATRIX_STRESS_FRACTION if len(self.amplitudes) > 1 else 1.0
        medians = self.prior_medians(stretch)
        priors: dict[str, tuple[str, float, float]] = {}
        for p in self.parameters:
            if p.name in self.amplitudes:
                # P is linear in the amplitude k: median of k = fraction * peak / P(k = 1)
                alone = dict.fromkeys(self.amplitudes, 0.0) | medians | {p.name: 1.0}
                per_unit = max(self.material(alone).piola(stretch, stretch))
                matrix = p.name == self.amplitudes[0]
                fraction = of_matrix if matrix else self.exponential_stress_fraction
                priors[p.name] = ("lognormal", fraction * peak_kPa / float(per_unit), 0.8)
            elif p.bounded:
                priors[p.name] = ("uniform", p.low, p.high)
            else:
                priors[p.name] = ("lognormal", medians[p.name], 0.8)
        return priors

    def derived_quantities(self, material: MaterialResponse) -> dict[str, Any]:
        """Quantities that an axis-aligned test determines, besides stress and stiffness."""
        return {}

    def largest_exponents(
        self, constants: Any, max_stretches: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """Largest value of each exponent and draw at some total stretches (n, 2), (n,) each."""
        states = [squared_stretches(top[:, :1], top[:, 1:]) for top in max_stretches]
        at_states = [exponents(constants, *state)[: len(self.formulas)] for state in states]
        return [np.max(list(q), axis=0)[:, 0] for q in zip(*at_states, strict=True)]

    def bound_tolerances(
        self, material: MaterialResponse, max_stretches: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """Distances from a bound within which a parameter of draws counts as being at it."""
        distances = dict(self.fraction_tolerances)
        largest = self.largest_exponents(material.constants, max_stretches)
        for name, formula in self.exponents.items():
            # q = k2 F: the k2 at which q is ABSENT_EXPONENT is that fraction of k2 / q
            value = np.ravel(material.theta[self.names.index(name)])
            per_unit = value / np.maximum(largest[self.formulas.index(formula)], 1e-12)
            distances[name] = ABSENT_EXPONENT * float(np.median(per_unit))
        # amplitudes below which their terms carry too little of stress or stiffness to count
        indices = [self.names.index(name) for name in self.amplitudes]
        units = {}  # materials with one amplitude of 1 and no other
        for i in indices:
            alone = list(material.theta)
            for j in indices:
                alone[j] = np.full_like(alone[j], float(i == j))
            units[i] = Material(self, tuple(alone))
        if self.compares_stiffness:
            stiffness = {
                i: np.trace(unit.cauchy_by_log_stretch(1.0, 1.0)).ravel()
                for i, unit in units.items()
            }
            whole = sum(np.ravel(material.theta[i]) * stiffness[i] for i in indices)
            absent = ABSENT_STIFFNESS_FRACTION * float(np.median(whole))
            return distances | {
                self.names[i]: absent / max(float(np.median(s)), 1e-9) for i, s in stiffness.items()
            }

        def stresses(response: MaterialResponse) -> np.ndarray:
            cauchy = [response.cauchy(s[:, :1], s[:, 1:]) for s in max_stretches]
            return np.array([np.maximum((x + y)[:, 0], 1e-12) for x, y in cauchy])

        for i, unit in units.items():
            # s is linear in the amplitude k: k_all = s / s(k = 1, other amplitudes 0) would carry
            # all of the stress, in the protocol in which it carries most
            k_all = np.min(stresses(material) / stresses(unit), axis=0)
            size = np.broadcast_to(np.ravel(material.theta[i]), k_all.shape)
            count = max(1, round(SMALLEST_DRAWS_FRACTION * size.size))
            smallest = np.argsort(size, kind="stable")[:count]
            distances[self.names[i]] = ABSENT_STRESS_FRACTION * float(np.median(k_all[smallest]))
        return distances
