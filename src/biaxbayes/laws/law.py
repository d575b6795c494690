r"""What a material law is.

One law is one file. It holds

- a ``NamedTuple`` of its constants and one of its sampling coordinates with their functions
  (:mod:`biaxbayes.laws.response`);
- a subclass of :class:`Law`: parameters with their default priors, fits, what its draws tell.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.amplitudes import screened
from biaxbayes.laws.response import (
    STEP,
    Material,
    MaterialResponse,
    PointMaterial,
    StatedMaterial,
    cauchy_components,
    first_derivatives,
    log_stretch_jacobian,
    second_derivatives,
    squared_stretches,
)
from biaxbayes.parameters import DEGREE, Parameter

if TYPE_CHECKING:
    from biaxbayes.laws.amplitudes import Screening

__all__ = ["Law", "SamplingLayout", "StressResponse"]


@dataclass(frozen=True, eq=False)
class StressResponse:
    """Cauchy stresses (kPa) at n states and their derivatives.

    Attributes
    ----------
    stress : ndarray, shape (2, n)
    by_coordinate : ndarray, shape (2, p, n)
        By the coordinates that fits move in.
    by_log_stretch : ndarray, shape (2, 2, n)
        First axis the stress, second the total stretch; symmetric.
    """

    stress: np.ndarray
    by_coordinate: np.ndarray
    by_log_stretch: np.ndarray

    def split(self, at: int) -> tuple[StressResponse, StressResponse]:
        """The first states, so many, and the others."""
        s, c, j = self.stress, self.by_coordinate, self.by_log_stretch
        return (
            StressResponse(s[:, :at], c[:, :, :at], j[:, :, :at]),
            StressResponse(s[:, at:], c[:, :, at:], j[:, :, at:]),
        )


@cache
def _steps(size: int) -> np.ndarray:
    """Imaginary step of every coordinate alone, one a column."""
    return 1j * STEP * np.eye(size)


@dataclass(frozen=True)
class Law(ABC):
    """A material law.

    Parameters
    ----------
    fibre_switch : bool
        Fibres carry no compression, where the law leaves that open.
    """

    fibre_switch: bool = False

    has_switch: ClassVar[bool] = False
    """Whether the law leaves open what its fibres do in compression."""
    name: ClassVar[str]
    title: ClassVar[str]
    abbreviation: ClassVar[str] = ""
    source: ClassVar[str]
    doi: ClassVar[str] = ""
    """Of the source, where it has one."""
    parameters: ClassVar[tuple[Parameter, ...]]
    ties: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Pairs of parameters of which the first can be tied to the second."""
    least_protocols: ClassVar[int] = 1
    """Protocols below which its posterior has several regions that are near-equal."""
    meaningless: ClassVar[Mapping[str, tuple[tuple[str, int, str], ...]]] = {}
    """Parameters that mean nothing where another is at an end of its range: its name, the side (0
    low, 1 high), and what the material is there; one for every such end."""

    @property
    def called(self) -> str:
        """The law as the subject of a sentence: its usual abbreviation, or its title."""
        return self.abbreviation or self.title

    # --- materials ---

    def constants(self, *values: Any) -> Any:
        """Constants at the natural values of the parameters in their order, angles in radians."""
        return self.constants_at_point(
            *(
                np.cos(v) ** 2 if p.mirror else v
                for p, v in zip(self.parameters, values, strict=True)
            )
        )

    @abstractmethod
    def constants_at_point(self, *point: Any) -> Any:
        """The same with cos^2 in place of angles, in which constants are regular at both ends."""

    def material(self, values: Any) -> Material:
        """Materials at parameters by name, in their own units.

        Parameters
        ----------
        values : mapping of str to array_like, or DataFrame
            Columns of draws will do; what is no parameter of the law is not looked at.

        Returns
        -------
        Material
            Of numbers, or of arrays of shape (n, 1) where the values have shape (n,).
        """
        columns = []
        for p in self.parameters:
            value = np.asarray(values[p.name], dtype=float)
            value = np.deg2rad(value) if p.unit == DEGREE else value
            columns.append(value[:, None] if value.ndim else float(value))
        return Material(self, tuple(columns))

    @property
    @abstractmethod
    def in_words(self) -> str:
        """The law as the object of a sentence, for the methods of a paper."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """One parameter by its name."""
        return self.parameters[self.names.index(name)]

    def known_name(self, name: str) -> str:
        """The name of a parameter that is given with its unit, as ``C1_kPa``; else as it is."""
        return next((p.name for p in self.parameters if p.label == name), name)

    def scalar(self, values: Sequence[float]) -> Any:
        """One material at parameters in their own units and order."""
        return self.material(dict(zip(self.names, values, strict=True)))

    def stated(self, values: Mapping[str, float]) -> StatedMaterial:
        """One material at parameters by name, with or without their unit.

        Raises
        ------
        InputError
            For a parameter that is unknown, given twice, missing or out of range.
        """
        labels = ", ".join(p.label for p in self.parameters)
        found: dict[str, float] = {}
        for given, value in values.items():
            name = self.known_name(given)
            if name not in self.names or name in found:
                problem = "is given twice" if name in found else "is no parameter"
                raise InputError(
                    f"{given} {problem} of the law {self.name}", remedy=f"parameters are {labels}"
                )
            p = self.parameter(name)
            if not (math.isfinite(value) and p.low <= value <= p.high):
                raise InputError(
                    f"{given} = {value:g} is out of range",
                    remedy=f"it lies between {p.low:g} and {p.high:g}{p.unit_words()}",
                )
            found[name] = float(value)
        missing = [p.label for p in self.parameters if p.name not in found]
        if missing:
            raise InputError(f"the law {self.name} needs {' and '.join(missing)}")
        self.check_condition(found)
        return StatedMaterial(self, self.material(found).theta)

    def as_goh(self, values: Sequence[float]) -> Any:
        """The same material as one of GOH, which finite-element programs have; None if it is none.

        Parameters
        ----------
        values : sequence of float
            Parameters in their own units and order.
        """
        del values

    condition: ClassVar[str] = ""
    """What parameters have to meet together, in words."""

    bound_together: ClassVar[tuple[str, ...]] = ()
    """Parameters that the condition is about."""

    def check_condition(self, values: Mapping[str, Any]) -> None:
        """Refuse numbers that do not meet :attr:`condition`, as far as they are given.

        Raises
        ------
        InputError
        """
        given = self.bound_together and set(self.bound_together) <= set(values)
        if given and not self.holds(values):
            raise InputError(f"no material of the law {self.name}: {self.condition}")

    def holds(self, values: Mapping[str, Any]) -> Any:
        """Whether parameters meet :attr:`condition`; of numbers or arrays."""
        del values
        return True

    # --- sampling coordinates ---

    @abstractmethod
    def coordinates(self, layout: SamplingLayout) -> Any:
        """Constants of the sampling coordinates, for the compiled density."""

    @abstractmethod
    def to_coordinates(
        self, coordinates: Any, values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Sampling coordinates at natural values (logs of scales, radians), by parameter."""

    def coordinate_bounds(self, coordinates: Any) -> dict[str, tuple[float, float]]:
        """Bounds of the sampling coordinates, by parameter, where they have any."""
        del coordinates
        return {}

    def coordinate_widths(self, coordinates: Any) -> dict[str, float]:
        """Widths of dispersed starts where they differ from the parameters' own."""
        del coordinates
        return {}

    def softens(self, coordinates: Any) -> bool:
        """Whether the sampling coordinates have a scale that :meth:`softening` suits."""
        del coordinates
        return False

    def softening(self, values: Mapping[str, Any]) -> float:
        """Scale of the sampling coordinates that suits materials by parameter (own units)."""
        del values
        return 1.0

    def inner(self, values: Sequence[float]) -> tuple[float, ...]:
        """A material moved off its edges, to where the sampling coordinates are regular."""
        return tuple(values)

    def inner_point(self, point: np.ndarray) -> np.ndarray:
        """A point of the fits moved off its bounds."""
        return point

    # --- fits ---

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates that fits move in."""
        return np.array([0.0 if p.mirror else max(p.low, -p.largest) for p in self.parameters])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates that fits move in."""
        return np.array([1.0 if p.mirror else min(p.high, p.largest) for p in self.parameters])

    def cauchy_of(self, constants: Any, stretch_x: Any, stretch_y: Any) -> np.ndarray:
        """Cauchy stresses of constants that broadcast against the stretches.

        Returns
        -------
        ndarray, shape (..., 2, n)
            x and y on the last axis but one.
        """
        X, Y, Z = squared_stretches(stretch_x, stretch_y)
        _, first = first_derivatives(constants, X, Y, Z)
        found = cauchy_components(X, Y, Z, *first)
        return np.stack(np.broadcast_arrays(*found), axis=-2)

    def coordinate(self, i: int, value: float) -> float:
        """Coordinate that fits move in: cos^2 of an angle, the others as they are.

        In cos^2 a structure tensor is linear and an angle of 0 or 90 degrees is an ordinary
        bound; in the angle the stress is stationary there whatever the data say.
        """
        if self.parameters[i].mirror:
            # cos^2 of 90 degrees is 4e-33 in floating point, not the bound it stands for
            return 0.0 if value == 90.0 else float(np.cos(np.deg2rad(value)) ** 2)
        return float(value)

    def natural(self, i: int, coordinate: float) -> float:
        """Parameter i in its own unit, inside its range; inverse of :meth:`coordinate`."""
        p = self.parameters[i]
        if p.mirror:
            t = min(max(float(coordinate), 0.0), 1.0)
            return min(float(np.rad2deg(np.arccos(np.sqrt(t)))), p.high)
        return min(max(float(coordinate), p.low), p.high) if p.bounded else float(coordinate)

    def point(self, values: Sequence[float]) -> np.ndarray:
        """Coordinates that fits move in, from parameters in their own units and order."""
        return np.array([self.coordinate(i, v) for i, v in enumerate(values)])

    def values(self, point: Any) -> tuple[float, ...]:
        """Parameters in their own units and order, from the coordinates that fits move in."""
        return tuple(self.natural(i, v) for i, v in enumerate(point))

    def at_point(self, point: np.ndarray) -> PointMaterial:
        """The material at coordinates that fits move in; complex coordinates are allowed."""
        return PointMaterial(self, tuple(point))

    def response(self, point: np.ndarray, stretch: np.ndarray) -> StressResponse:
        """Stresses and their derivatives at total stretches, by complex step.

        Parameters
        ----------
        point : ndarray, shape (p,)
            Coordinates that fits move in.
        stretch : ndarray, shape (2, n)
            Total stretches.
        """
        X, Y, Z = squared_stretches(*stretch)
        constants = self.constants_at_point(*point)
        g, (A, B, C) = first_derivatives(constants, X, Y, Z)
        second = second_derivatives(constants, X, Y, Z, g)
        xx, xy, yy = log_stretch_jacobian(X, Y, Z, A, B, C, second)
        # one row a coordinate, which is moved there: d s / d x_i = Im s(x + i h e_i) / h
        moved = self.constants_at_point(*(point[:, None] + _steps(point.size))[:, :, None])
        stepped = cauchy_components(X, Y, Z, *first_derivatives(moved, X, Y, Z)[1])
        by_coordinate = np.empty((2, point.size, X.size))
        for k, s in enumerate(stepped):
            by_coordinate[k] = s.imag / STEP
        return StressResponse(
            np.array(cauchy_components(X, Y, Z, A, B, C)),
            by_coordinate,
            np.array([[xx, xy], [xy, yy]]),
        )

    amplitudes: ClassVar[tuple[str, ...]] = ()
    """Parameters that the stress is linear in: screened materials get the best ones."""

    def shapes(
        self, size: int, largest: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Random materials for fits to start from, with one for every amplitude.

        A law states this, or a :meth:`screen` of its own.

        Parameters
        ----------
        size : int
        largest : ndarray, shape (size, 2)
            Largest total stretches: exponents are drawn at them, which makes curves more or less
            bent whatever the strain range.
        rng : numpy.random.Generator

        Returns
        -------
        points : ndarray, shape (size, p)
            Coordinates that fits move in.
        marks : ndarray, shape (size, k)
            Coordinates in which chosen points are kept apart from one another.
        """
        raise NotImplementedError(f"the law {self.name} states neither shapes nor a screen")

    def screen(self, data: Screening, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """Many random materials with their best amplitudes.

        Returns
        -------
        points : ndarray, shape (S, p)
        mounting : ndarray, shape (S, 2)
            Mounting stretches of each.
        cost : ndarray, shape (S,)
            Sum of squares; infinite where a material cannot be evaluated.
        marks : ndarray, shape (S, k)
            Coordinates in which chosen points are kept apart from one another.
        """
        return screened(self, data, rng)

    # --- priors and what draws tell ---

    @abstractmethod
    def scaled_prior(self, stretch: float, peak_kPa: float) -> dict[str, tuple[str, float, float]]:
        """Prior of tissue that reaches a nominal stress at a total equibiaxial stretch.

        Returns
        -------
        dict of str to (str, float, float)
            Distribution and its two numbers, as :attr:`Parameter.prior`.
        """

    def described(self, material: MaterialResponse) -> dict[str, Any]:
        """Quantities of the law that an axis-aligned test sees, beside stress and stiffness."""
        del material
        return {}

    def described_at(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, np.ndarray]:
        """What the law says of itself at the largest of some total stretches, shape (n,) each.

        Parameters
        ----------
        material : Material
            Of n draws.
        tops : sequence of ndarray, shape (n, 2)
        """
        del material, tops
        return {}

    nearness: ClassVar[str] = ""
    """What :meth:`edge_distances` calls near, in words."""

    def edge_distances(
        self, material: MaterialResponse, tops: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """How near to a physical edge counts as near, by parameter, in natural units.

        Parameters
        ----------
        material : Material
            Of n draws.
        tops : sequence of ndarray, shape (n, 2)
            Largest total stretches of each protocol.
        """
        del material, tops
        return {}


class SamplingLayout(NamedTuple):
    """What sampling coordinates may depend on: constants of a specimen and of a search.

    Attributes
    ----------
    free : tuple of str
        Parameters that are sampled, neither fixed nor tied.
    reference : (float, float, float)
        Squared reference stretches (X, Y, Z), both in-plane ones above 1.
    softening : float
        Scale of the coordinates near isotropy.
    structural : bool
        Coordinates that data pin, rather than the parameters themselves.
    chart : bool
        Whether a chart that is regular at the edges is asked for, where a law has one. With neither
        the coordinates are the parameters: logs of scales, radians, the others as they are.
    widest : (float, float, float)
        As ``reference``, of the row of largest I1: a state that the specimen has been in.
    peak_kPa : float
        Largest stress of the specimen, a scale of stiffnesses.
    """

    free: tuple[str, ...]
    reference: tuple[float, float, float]
    softening: float
    structural: bool
    chart: bool
    widest: tuple[float, float, float]
    peak_kPa: float
