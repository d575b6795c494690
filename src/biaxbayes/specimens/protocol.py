"""One loading path of a record: its curves, its rows at rest, the reference of its stretches."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from biaxbayes.errors import ReadingError
from biaxbayes.experiments.experiment import STRETCH_RANGE

REST_FRACTION = 0.25  # of the mean increment, within which rows count as at rest
LEAST_RISE_ROWS = 3
RISE_SHARE = 0.005  # largest rise of the load, as a fraction of its range, that counts as drift
LOAD_ROWS = ("load_x", "load_y")
CURVES = ("stretch_x", "stretch_y", *LOAD_ROWS)
AUTO_REST_ROWS = -1  # ``rest_rows`` that are counted from the curves
STRETCH_REMEDY = "stretches are ratios near 1, not strains or per cent"
REST_REMEDY = "rest_rows counts the leading rows recorded before the test starts"
TIME_LIMIT_S = 1e9


@dataclass(frozen=True, eq=False)
class Protocol:
    """One loading path, as recorded.

    Parameters
    ----------
    name : str
    stretch_x, stretch_y : array_like, shape (n,)
        Relative to the mounted state; a :class:`Specimen` divides them by their value at rest (see
        its ``reference``). All NaN across a strip whose width was not measured.
    load_x, load_y : array_like, shape (n,)
        In N or kPa, as the test reads them; zero across a strip.
    time_s : array_like, shape (n,), optional
    rest_rows : int, optional
        Leading rows recorded at the mounted state; by default from :func:`rest_rows`. Zero only
        for a protocol that starts elsewhere, in a specimen with one common reference.
    reference : (float, float)
        The stretches by which the columns were divided. Not part of equality.

    Raises
    ------
    ReadingError
        For arrays of different shapes, and numbers that are not finite or cannot be stretches.
    """

    name: str
    stretch_x: np.ndarray
    stretch_y: np.ndarray
    load_x: np.ndarray
    load_y: np.ndarray
    time_s: np.ndarray | None = None
    rest_rows: int = AUTO_REST_ROWS
    reference: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        for key in (*CURVES, "time_s"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, self._column(key))
        low, high = STRETCH_RANGE
        for key in ("stretch_x", "stretch_y"):
            values = getattr(self, key)
            for index in np.flatnonzero((values < low) | (values > high)):
                remedy = STRETCH_REMEDY
                if values[index] < 0.0 and np.median(values) > low:
                    remedy = "a stretch is positive; mend the value or remove the row"
                problem = f"a stretch of {values[index]:g} is out of range"
                raise self._error(problem, key, int(index), remedy)
        time = np.empty(0) if self.time_s is None else self.time_s
        for index in np.flatnonzero(np.abs(time) > TIME_LIMIT_S):
            remedy = "give seconds from the start of the test"
            problem = f"a time of {time[index]:g} s is out of range"
            raise self._error(problem, "time_s", int(index), remedy)
        if self.rest_rows == AUTO_REST_ROWS:
            x, y = self.known_stretch.T
            rest = rest_rows(x, y, self.recorded_load)
            object.__setattr__(self, "rest_rows", rest)
        if not 0 <= self.rest_rows <= self.rows:
            problem = f"rest_rows of {self.rest_rows} is less than 0, or leaves no stretched row"
            raise self._error(problem, "rest_rows", None, REST_REMEDY)

    def _error(
        self, fault: str, argument: str, index: int | None = None, remedy: str | None = None
    ) -> ReadingError:
        return ReadingError(
            fault, argument=argument, index=index, protocol=str(self.name), remedy=remedy
        )

    def _column(self, key: str) -> np.ndarray:
        """A frozen copy of one column, of the shape of the first and finite."""
        given: Any = getattr(self, key)
        if np.ma.is_masked(given):
            masked = np.flatnonzero(np.ma.getmaskarray(given))
            remedy = "leave out masked rows, in all columns"
            raise self._error(f"is masked in {masked.size} rows", key, int(masked[0]), remedy)
        try:
            values = np.array(given, dtype=float)
        except (TypeError, ValueError):
            raise self._error("must be an array of numbers", key) from None
        if values.ndim != 1 or values.shape != np.shape(self.stretch_x) or not values.size:
            remedy = "the columns of a protocol must be one-dimensional and equally long"
            shapes = f"has shape {values.shape}, stretch_x has {np.shape(self.stretch_x)}"
            raise self._error(shapes, key, remedy=remedy)
        bad = np.flatnonzero(~np.isfinite(values))
        unmeasured = key in ("stretch_x", "stretch_y") and bool(np.isnan(values).all())
        if bad.size and not unmeasured:
            more = f", and {bad.size - 1} more of {values.size}" if bad.size > 1 else ""
            remedy = "leave out rows without a reading, in all columns"
            raise self._error(f"is {values[bad[0]]:g}{more}", key, int(bad[0]), remedy)
        values.setflags(write=False)
        return values

    @property
    def stretch(self) -> np.ndarray:
        """Measured stretches in x and y, shape (rows, 2)."""
        return np.column_stack([self.stretch_x, self.stretch_y])

    @property
    def known_stretch(self) -> np.ndarray:
        """The same with 1 across a strip whose width was not measured."""
        return np.nan_to_num(self.stretch, nan=1.0)

    @property
    def recorded_load(self) -> np.ndarray:
        """Loads as recorded, in x and y, shape (rows, 2)."""
        return np.column_stack([self.load_x, self.load_y])

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.stretch_x.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Protocol):
            return NotImplemented
        if (self.name, self.rest_rows) != (other.name, other.rest_rows):
            return False
        pairs = [(getattr(self, key), getattr(other, key)) for key in (*CURVES, "time_s")]
        return all(
            mine is theirs
            if mine is None or theirs is None
            else np.array_equal(mine, theirs, equal_nan=True)
            for mine, theirs in pairs
        )

    def __hash__(self) -> int:
        return hash((self.name, self.rows, self.rest_rows))

    def __repr__(self) -> str:
        return f"Protocol({self.name!r}, {self.rows} rows)"

    def divided_by(self, reference: Iterable[float], *, loads_too: bool) -> Protocol:
        """The same path with stretches relative to a state of the given (measured) stretches.

        Loads as well where they are Cauchy stresses: the nominal stress, which the lab multiplied
        by its own stretch, must stay what it was.
        """
        x, y = (1.0 if np.isnan(value) else float(value) for value in reference)
        # Rounding leaves the mean of rows at rest within a few units in the last place of one;
        # dividing again would change what was written.
        if abs(x - 1.0) <= 1e-12 and abs(y - 1.0) <= 1e-12:
            return self
        by = (x, y) if loads_too else (1.0, 1.0)
        return replace(
            self,
            stretch_x=self.stretch_x / x,
            stretch_y=self.stretch_y / y,
            load_x=self.load_x / by[0],
            load_y=self.load_y / by[1],
            reference=(self.reference[0] * x, self.reference[1] * y),
        )

    def divided_by_rest(self, *, loads_too: bool) -> Protocol:
        """The same path relative to the mean of its rows at rest."""
        return self.divided_by(np.mean(self.stretch[: self.rest_rows], axis=0), loads_too=loads_too)

    def at_rows(self, rows: slice | np.ndarray) -> Protocol:
        """The same path at some of its rows, without their times."""
        return replace(self, time_s=None, **{key: getattr(self, key)[rows] for key in CURVES})

    def with_common_reference(self) -> Protocol:
        """The same path, at rest only if its leading rows lie at the stretch (1, 1)."""
        x, y = self.known_stretch.T
        for stretch, other in ((x, y), (y, x)):
            mean = stretch[: max(self.rest_rows, 1)].mean()
            if abs(mean - 1.0) > _tolerance(stretch, other):
                return replace(self, rest_rows=0)
        return self


# --- rows at rest ---------------------------------------------------------------------------------


def second_difference_scatter(curve: np.ndarray) -> float:
    """Standard deviation of one reading about its neighbours, by second differences."""
    # var(second difference of white noise) = (1 + 4 + 1) sd^2
    if curve.size < 3:
        return 0.0
    return 1.4826 * float(np.median(np.abs(np.diff(curve, 2)))) / np.sqrt(6.0)


def _tolerance(curve: np.ndarray, other: np.ndarray | None = None) -> float:
    """Largest distance between rows at rest of one curve."""
    steps = np.abs(np.diff(curve))
    typical = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    increment = min(float(np.abs(curve - curve[0]).max()) / max(curve.size - 1, 1), typical)
    scatter = second_difference_scatter(curve)
    if other is not None and np.ptp(other) > 0.0 and curve.size >= 3:
        # steps of both stretches at once are of the path, as where rows are missing
        bends, others = np.diff(curve, 2), np.diff(other, 2)
        share = float(bends @ others) / max(float(others @ others), 1e-300)
        alone = second_difference_scatter(curve - share * other)
        scatter = alone if alone < 0.5 * scatter else scatter
    return max(REST_FRACTION * increment, 3.0 * scatter)


def still_rows(stretch_x: np.ndarray, stretch_y: np.ndarray) -> int:
    """Leading rows, at least one, in which neither stretch leaves its first value.

    They stay within a quarter of the mean increment of the path, or three times the scatter, of it.
    """
    if stretch_x.size < 3:
        return 1
    still = np.ones(stretch_x.size, dtype=bool)
    for stretch, other in ((stretch_x, stretch_y), (stretch_y, stretch_x)):
        still &= np.abs(stretch - stretch[0]) <= _tolerance(stretch, other)
    moving = np.flatnonzero(~still)
    # A record that never moves has one mounting row; it is refused elsewhere.
    return int(moving[0]) if moving.size else 1


def rest_rows(stretch_x: np.ndarray, stretch_y: np.ndarray, load: np.ndarray | None = None) -> int:
    """Number of leading rows at rest, at least one, from stretches (n,) and loads (n, 2).

    A row is at rest while both stretches stay (:func:`still_rows`) and neither load rises yet, as
    where the camera lags behind the load cell. A load that falls there relaxes, and counts.
    """
    still = still_rows(stretch_x, stretch_y)
    if load is None or still < LEAST_RISE_ROWS:
        return still
    rows = still
    for curve in np.asarray(load).T:
        part = curve[:still]
        quarter = still // 4 or 1
        scatter = second_difference_scatter(curve)
        rise = part[-quarter:].mean() - part[:quarter].mean()
        limit = max(RISE_SHARE * float(np.ptp(curve)), 4.0 * scatter * np.sqrt(2.0 / quarter))
        if rise > limit:
            level = part[0] + max(_tolerance(curve), 3.0 * scatter)
            rows = min(rows, int(np.flatnonzero(part > level)[0]) if np.any(part > level) else 1)
    return max(rows, 1)
