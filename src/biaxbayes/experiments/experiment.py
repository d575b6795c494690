r"""What a kind of test has to tell: its file, its geometry, its words.

    q_i = sum_p sum_k  w_pik g_k s_k(l_p lm),    i = 1, 2 readings of a row,  k = x, y

with the stress s of the membrane (radial stress zero) at points p of the row, whose stretches l are
known but for the mounting stretch lm, and the section g of the mounted piece (`mounted_section`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np

DIMENSIONS = ("edge_x_mm", "edge_y_mm", "thickness_mm")
"""Header keys of the dimensions of a sheet, arguments of a specimen of the same names."""
FROM_SCATTER = "from the scatter of the rows"
OF_FORCES = "required with forces"
EDGE_MM = (0.01, 10_000.0)
LOAD_SD = (1e-15, 1e9)
STRETCH_RANGE = (0.2, 5.0)  # stretches that a test of soft tissue can reach


class Column(NamedTuple):
    """A column of a specimen file.

    It may stand for others; they are the same, or follow from all columns and the header.
    """

    meaning: str
    default: str
    stands_for: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # header keys and other columns
    follows: Callable[[Mapping[str, np.ndarray], Mapping[str, Any]], np.ndarray] | None = None


class Key(NamedTuple):
    """A header key of a specimen file; any text without range and choices."""

    meaning: str
    default: str = "none"
    range: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()


class Loads(NamedTuple):
    """Loads as a file has them."""

    columns: tuple[str, str]  # read in x and y; empty for a reading that a test never has
    units: tuple[str, str]
    words: str
    compared: str  # what a model compares, in the plural
    optional: tuple[int, ...] = ()  # readings that a file may lack
    noise_key_y: str = ""  # header key of the noise in y where its unit is another one
    times_stretch: bool = False  # a nominal load times the measured stretch


@dataclass(frozen=True, eq=False)
class Points:
    """States at which the material answers, and what the readings of their rows are of it."""

    stretch: np.ndarray  # (n, 2), measured; NaN in the direction whose sides are free
    weight: np.ndarray  # (n, 2, 2), of stress k in reading i
    row: np.ndarray  # (n,), ascending

    def sums(self, stress: np.ndarray) -> np.ndarray:
        """Readings (..., rows, 2) of stresses times sections (..., n, 2)."""
        # q_i = sum_p sum_k w_pik g_k s_k
        return self.of_rows(np.einsum("nik,...nk->...ni", self.weight, stress), axis=-2)

    def of_rows(self, values: np.ndarray, axis: int = 0) -> np.ndarray:
        """Sums of values over the points of each row."""
        if self.row.size == self.row[-1] + 1:
            return values
        first = np.flatnonzero(np.diff(self.row, prepend=-1))
        return np.add.reduceat(values, first, axis=axis)


class Experiment(ABC):
    """A kind of test.

    The rows of every kind are two stretches and two readings, in the directions of the tissue. A
    ``header`` holds dimensions (None where not stated), ``geometry`` and further header keys.
    """

    # --- words ---

    name: str  # as a specimen file names it (``# test: name``)
    meaning: str  # the test, and what is peculiar to its file
    words: str  # in a sentence or a heading
    curves: tuple[str, str] = ("x", "y")  # what a reading is called
    stretches: tuple[str, str] = ("stretch in x", "stretch in y")
    drawing: str = ""  # what its dimensions are: a title and shapes of an SVG of 300 x 200

    # --- the file ---

    loads: Mapping[str, Loads]  # that a file may hold, by their names (``Specimen.loads``)
    # beside stretches, time and protocol
    columns: ClassVar[Mapping[str, Column]] = MappingProxyType({})
    # that not every kind of test has
    keys: ClassVar[Mapping[str, Key]] = MappingProxyType({})

    # --- the test ---

    axes: tuple[int, ...] = (0, 1)  # directions with a reading
    free_side: int | None = None  # the direction whose sides carry no load
    is_mounted: bool = True  # stretches are relative to a mounted state, whose stretch is unknown
    is_biaxial: bool = False  # a planar test in both directions, which some methods are for alone

    def of(self, header: Mapping[str, Any], reads: Sequence[bool]) -> Experiment:
        """The test with dimensions from a header, and the readings (x, y) that were made."""
        return self

    def needed(self, loads: str) -> tuple[str, ...]:
        """Header keys that a file of such loads must have."""
        return ()

    def check(self, header: Mapping[str, Any], protocols: Sequence[Any]) -> None:  # noqa: B027
        """Refuse protocols of a specimen that this test cannot have, by a ReadingError."""

    def warnings(self, header: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
        """Code and message of what may mislead."""
        return iter(())

    def pulled(self, load: np.ndarray) -> tuple[int, ...]:
        """Directions that a path with these loads (rows, 2) is pulled in."""
        return self.axes

    @abstractmethod
    def points(self, stretch: np.ndarray) -> Points:
        """Points of rows at measured stretches (rows, 2)."""

    def area(self, header: Mapping[str, Any], loads: str) -> np.ndarray | None:
        """Force (N) per nominal stress (kPa), (x, y); None where no section, or weights have it."""
        return None

    def stresses(self, stretch: np.ndarray, load: np.ndarray) -> np.ndarray | None:
        """Mean Cauchy stresses of readings, both (rows, 2), or None where sections give them."""
        return None

    def paths(
        self, largest_stretch: float, along: Sequence[float], increments: int, readings: Any
    ) -> dict[str, np.ndarray]:
        """Stretches (rows, 2) of the protocols of a virtual test, by name.

        Up to one in x, `along` y held, a protocol each; `readings` of the material at stretches.
        """
        raise NotImplementedError(f"no virtual {self.name} test without a mounted state")

    # --- sentences ---

    def size(self, header: Mapping[str, Any]) -> str:
        """The dimensions that are stated; empty where none is."""
        return ""

    @abstractmethod
    def methods(self, header: Mapping[str, Any], paths: str) -> str:
        """What was done, as a paper says it; ``paths`` is such as "two loading paths"."""
