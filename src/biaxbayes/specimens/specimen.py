"""A specimen on a planar biaxial machine: its loading paths, and what they refer to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from biaxbayes.errors import InputError

REST_FRACTION = 0.25
"""Rows count as at rest while they stay within this share of the mean increment."""
LOAD_ROWS = ("load_x", "load_y")
CURVES = ("stretch_x", "stretch_y", *LOAD_ROWS)
FOUND = -1
"""Stands for a number of rows at rest that is found from the curves."""
FINE_DIGITS = 0.1
"""A last digit below this share of the error of a mounting reading is no coarse one."""
RESOLUTION = 1e-6
"""Load that a load cell tells apart, as a share of the largest: one of 20 bits, which few reach.
What a noise-free record is missed by below it is rounding of its digits, and no error."""
STRETCH_RANGE = (0.2, 5.0)
STRETCH_REMEDY = "stretches are ratios near 1, not strains or per cent"
TIME_LIMIT_S = 1e9
REFERENCES = ("each protocol", "common")
"""What measured stretches are relative to: the first rows of each protocol, or one state."""
STRESS_PAIRS = {
    "force": ("force_x_N", "force_y_N"),
    "piola": ("piola_x_kPa", "piola_y_kPa"),
    "cauchy": ("cauchy_x_kPa", "cauchy_y_kPa"),
}
"""Columns of the stress pair a file may hold."""


class ReadingError(InputError):
    """A value of a protocol or a specimen that cannot be used.

    Parameters
    ----------
    fault : str
        What is wrong.
    argument : str
        Of :class:`Protocol` or :class:`Specimen`, such as ``load_x``.
    index : int, optional
        Of the value in its array, from 0.
    protocol : str, optional
        Name of the protocol, where it is one of them alone.
    remedy : str, optional
    """

    def __init__(
        self,
        fault: str,
        *,
        argument: str = "",
        index: int | None = None,
        protocol: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.fault, self.argument, self.index, self.protocol = fault, argument, index, protocol
        place = argument if index is None else f"{argument}[{index}] (row {index + 1})"
        where = None if protocol is None else f"protocol {protocol[:40]!r}"
        text = f"{place}: {fault}" if place else fault
        super().__init__(text, file=where, remedy=remedy)

    def at(
        self, file: object, lines: Sequence[int] | np.ndarray, columns: Mapping[str, str]
    ) -> InputError:
        """The same error by file, row and column.

        Parameters
        ----------
        file : path-like
        lines : sequence of int
            Line of the file that each value of the array stands in.
        columns : mapping of str to str
            Column of the file by argument; others are no column.
        """
        return InputError(
            self.fault,
            file=file,
            row=None if self.index is None else int(lines[self.index]),
            column=columns.get(self.argument),
            remedy=self.remedy,
        )


# --- one loading path, as recorded ---------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Protocol:
    """One loading path, as recorded.

    Parameters
    ----------
    name : str
    stretch_x, stretch_y : array_like, shape (n,)
        Measured stretches, relative to the mounted state. A :class:`Specimen` divides them by
        their value at rest where that is not one (see its ``reference``).
    load_x, load_y : array_like, shape (n,)
        The stress pair: N, or kPa (Piola or Cauchy).
    time_s : array_like, shape (n,), optional
    rest_rows : int, optional
        Leading rows recorded at the mounted state; found with :func:`rest_rows` where not given.
        Zero only for a protocol that starts elsewhere, in a specimen with one common reference.
    reference : (float, float)
        The stretches by which the columns were divided. No part of equality.

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
    rest_rows: int = FOUND
    reference: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        for key in (*CURVES, "time_s"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, self._column(key))
        self._check_stretches()
        if self.rest_rows == FOUND:
            load = np.column_stack([self.load_x, self.load_y])
            object.__setattr__(self, "rest_rows", rest_rows(self.stretch_x, self.stretch_y, load))
        if not 0 <= self.rest_rows <= self.rows:
            raise self._error("must lie between 1 and the number of rows", "rest_rows")

    def _error(
        self, fault: str, argument: str, index: int | None = None, remedy: str | None = None
    ) -> ReadingError:
        return ReadingError(
            fault, argument=argument, index=index, protocol=str(self.name), remedy=remedy
        )

    def _column(self, key: str) -> np.ndarray:
        """A frozen copy of one column, of the shape of the first and finite."""
        try:
            values = np.array(getattr(self, key), dtype=float)
        except (TypeError, ValueError):
            raise self._error("must be an array of numbers", key) from None
        if values.ndim != 1 or values.shape != np.shape(self.stretch_x) or not values.size:
            raise self._error(
                f"has shape {values.shape}, stretch_x has {np.shape(self.stretch_x)}",
                key,
                remedy="the columns of a protocol must be one-dimensional and equally long",
            )
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            more = f", and {bad.size - 1} more of {values.size}" if bad.size > 1 else ""
            raise self._error(
                f"is {values[bad[0]]:g}{more}",
                key,
                int(bad[0]),
                "leave out rows without a reading, in all columns",
            )
        values.setflags(write=False)
        return values

    def _check_stretches(self) -> None:
        for key in ("stretch_x", "stretch_y"):
            values = getattr(self, key)
            bad = np.flatnonzero((values < STRETCH_RANGE[0]) | (values > STRETCH_RANGE[1]))
            if bad.size:
                value = values[bad[0]]
                negative = value < 0.0 and np.median(values) > STRETCH_RANGE[0]
                remedy = "a stretch is positive; mend the value or remove the row"
                raise self._error(
                    f"a stretch of {value:g} cannot be",
                    key,
                    int(bad[0]),
                    remedy if negative else STRETCH_REMEDY,
                )
        time = np.empty(0) if self.time_s is None else self.time_s
        late = np.flatnonzero(np.abs(time) > TIME_LIMIT_S)
        if late.size:
            raise self._error(
                f"a time of {time[late[0]]:g} s",
                "time_s",
                int(late[0]),
                "give seconds from the start of the test",
            )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.stretch_x.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Protocol):
            return NotImplemented
        if (self.name, self.rest_rows) != (other.name, other.rest_rows):
            return False
        if (self.time_s is None) != (other.time_s is None):
            return False
        keys = CURVES if self.time_s is None else (*CURVES, "time_s")
        return all(np.array_equal(getattr(self, key), getattr(other, key)) for key in keys)

    def __hash__(self) -> int:
        return hash((self.name, self.rows, self.rest_rows))

    def __repr__(self) -> str:
        return f"Protocol({self.name!r}, {self.rows} rows)"

    def divided_by(self, reference: Sequence[float], stress_pair: str) -> Protocol:
        """The same path with stretches relative to another state.

        A Cauchy stress is divided as well: the lab multiplied the nominal stress by its own
        stretch, and the nominal stress must stay what it was.

        Parameters
        ----------
        reference : (float, float)
            Stretches of that state, as the columns measure them.
        stress_pair : {"force", "piola", "cauchy"}
        """
        x, y = (float(value) for value in reference)
        # Rounding leaves the mean of rows at rest within a few units in the last place of one;
        # dividing again would change what was written.
        if abs(x - 1.0) <= 1e-12 and abs(y - 1.0) <= 1e-12:
            return self
        by = (x, y) if stress_pair == "cauchy" else (1.0, 1.0)
        return replace(
            self,
            stretch_x=self.stretch_x / x,
            stretch_y=self.stretch_y / y,
            load_x=self.load_x / by[0],
            load_y=self.load_y / by[1],
            reference=(self.reference[0] * x, self.reference[1] * y),
        )

    def from_rest(self, stress_pair: str) -> Protocol:
        """The same path, its stretches divided by their mean over the rows at rest."""
        rest = slice(0, self.rest_rows)
        reference = self.stretch_x[rest].mean(), self.stretch_y[rest].mean()
        return self.divided_by(reference, stress_pair)

    def at_one(self) -> Protocol:
        """The same path, at rest only in leading rows that lie at the stretch (1, 1).

        They lie there within a quarter of the mean increment of the path, or three times the
        scatter of the stretches.
        """
        for stretch in (self.stretch_x, self.stretch_y):
            mean = stretch[: max(self.rest_rows, 1)].mean()
            if abs(mean - 1.0) > _tolerance(stretch):
                return replace(self, rest_rows=0)
        return self


def second_difference_scatter(curve: np.ndarray) -> float:
    """Standard deviation of one reading about its neighbours, by second differences."""
    # var(second difference of white noise) = (1 + 4 + 1) sd^2
    if curve.size < 3:
        return 0.0
    return 1.4826 * float(np.median(np.abs(np.diff(curve, 2)))) / np.sqrt(6.0)


def _tolerance(curve: np.ndarray) -> float:
    """How far rows at rest may lie from each other in one curve."""
    increment = float(np.abs(curve - curve[0]).max()) / max(curve.size - 1, 1)
    return max(REST_FRACTION * increment, 3.0 * second_difference_scatter(curve))


def still_rows(stretch_x: np.ndarray, stretch_y: np.ndarray) -> int:
    """Leading rows in which neither stretch leaves its first value.

    They stay within a quarter of the mean increment of the path, or within three times the
    scatter of the stretch (second differences), of the first row; at least one.
    """
    if stretch_x.size < 3:
        return 1
    still = np.ones(stretch_x.size, dtype=bool)
    for stretch in (stretch_x, stretch_y):
        still &= np.abs(stretch - stretch[0]) <= _tolerance(stretch)
    moving = np.flatnonzero(~still)
    # A record that never moves has one mounting row; it is refused elsewhere.
    return int(moving[0]) if moving.size else 1


def rest_rows(stretch_x: np.ndarray, stretch_y: np.ndarray, load: np.ndarray | None = None) -> int:
    """Number of leading rows at rest.

    A row is at rest while both stretches stay at their first value (:func:`still_rows`) and
    neither load has begun to rise: where the camera lags behind the load cell, the load rises
    while the stretch still rests. A load that falls there relaxes, and counts.

    Parameters
    ----------
    stretch_x, stretch_y : ndarray, shape (n,)
    load : ndarray, shape (n, 2), optional

    Returns
    -------
    int
        At least one.
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


LEAST_RISE_ROWS = 3
RISE_SHARE = 0.005
"""A rise of the load by less than this share of its range is drift and no start of the test."""


# --- a specimen: what was measured, and what it refers to ----------------------------------------


@dataclass(frozen=True)
class Specimen:
    """A planar biaxial specimen with its measured protocols.

    Parameters
    ----------
    name : str
    protocols : sequence of Protocol
    stress_pair : {"force", "piola", "cauchy"}
        What ``load_x`` and ``load_y`` of the protocols are.
    geometry : {"unloaded", "mounted"}
        The state that dimensions, and any stress in the file, refer to.
    edge_x_mm, edge_y_mm, thickness_mm : float, optional
        Required for forces. The force in x acts on ``edge_y_mm * thickness_mm``.
    load_noise : float, optional
        Standard deviation of one reading of the load cell, in :attr:`unit`.
    layer, axis_x, axis_y : str, optional
    reference : {"each protocol", "common"}, optional
        What the stretches of the protocols are relative to. ``each protocol`` (also where not
        given): the first rows of each are the mounted state, and its stretches are divided by
        their mean there. ``common``: one state for all protocols, the mounted state, where the
        stretch is (1, 1); a protocol that does not start there has no rows at rest.
    metadata : mapping, optional
        Other known header keys (measurement uncertainties and the like), kept as numbers or text.
    notes : tuple of str
        What the reader did to the file (re-referencing and the like).

    Raises
    ------
    ReadingError
        If an argument does not fit the others, or no protocol has a row at the mounted state.
    """

    name: str
    protocols: tuple[Protocol, ...]
    stress_pair: str
    geometry: str = "unloaded"
    edge_x_mm: float | None = None
    edge_y_mm: float | None = None
    thickness_mm: float | None = None
    load_noise: float | None = None
    layer: str | None = None
    axis_x: str | None = None
    axis_y: str | None = None
    reference: str | None = None
    metadata: Mapping[str, float | str] = field(default_factory=dict)
    notes: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))
        self._check_arguments()
        object.__setattr__(self, "protocols", self._referenced(tuple(self.protocols)))

    def _check_arguments(self) -> None:
        for argument, choices in (
            ("stress_pair", tuple(STRESS_PAIRS)),
            ("geometry", ("unloaded", "mounted")),
            ("reference", (*REFERENCES, None)),
        ):
            value = getattr(self, argument)
            if value not in choices:
                raise ReadingError(
                    f"{str(value)[:40]!r} is not known",
                    argument=argument,
                    remedy=f"use one of {', '.join(filter(None, choices))}",
                )
        dimensions = ("edge_x_mm", "edge_y_mm", "thickness_mm")
        missing = [name for name in dimensions if getattr(self, name) is None]
        if self.stress_pair == "force" and missing:
            raise ReadingError("is needed with forces", argument=missing[0], remedy="give it in mm")
        if not self.protocols:
            raise ReadingError("is empty", argument="protocols", remedy="give at least one")
        if len({p.time_s is None for p in self.protocols}) > 1:
            raise ReadingError(
                "is missing in some protocols", argument="time_s", remedy="give it in all or none"
            )

    def _referenced(self, protocols: tuple[Protocol, ...]) -> tuple[Protocol, ...]:
        """The protocols with stretches relative to the mounted state, and their rows there."""
        if self.reference == "common":
            protocols = tuple(p.at_one() for p in protocols)
            if not any(p.rest_rows for p in protocols):
                first = protocols[0]
                raise ReadingError(
                    "no protocol has a row at the mounted state, stretch (1, 1); the first starts "
                    f"at ({first.stretch_x[0]:.4g}, {first.stretch_y[0]:.4g})",
                    argument="reference",
                    remedy="state the stretch of the mounted state (mounted_state_x and _y), where "
                    "at least one protocol needs a row",
                )
            return protocols
        for p in protocols:
            if p.rest_rows == 0:
                raise ReadingError(
                    "must be at least 1 where each protocol has its own reference",
                    argument="rest_rows",
                    protocol=p.name,
                )
        return tuple(p.from_rest(self.stress_pair) for p in protocols)

    def __reduce__(self):
        # MappingProxyType does not pickle; workers need specimens.
        fields = {key: getattr(self, key) for key in self.__dataclass_fields__}
        fields["metadata"] = dict(self.metadata)
        return _rebuild, (fields,)

    def __hash__(self) -> int:
        return hash((self.name, self.stress_pair, len(self.protocols)))

    def __repr__(self) -> str:
        rows = sum(p.rows for p in self.protocols)
        layer = f", {self.layer}" if self.layer else ""
        count = len(self.protocols)
        protocols = "1 protocol" if count == 1 else f"{count} protocols"
        return f"Specimen({self.name!r}{layer}, {protocols}, {rows} rows of {self.stress_pair})"

    # --- units and sections ---

    @property
    def unit(self) -> str:
        """Unit of the measured quantity: ``"N"`` or ``"kPa"``."""
        return "N" if self.stress_pair == "force" else "kPa"

    @property
    def area(self) -> np.ndarray:
        """Measured quantity per kPa of first Piola-Kirchhoff stress, (x, y).

        N per kPa for forces (section in mm^2 times 1e-3), one for stresses.
        """
        if self.stress_pair != "force":
            return np.ones(2)
        # f_x [N] = P_x [kPa] * edge_y [mm] * thickness [mm] * 1e-3
        assert self.edge_x_mm and self.edge_y_mm and self.thickness_mm
        return np.array([self.edge_y_mm, self.edge_x_mm]) * self.thickness_mm * 1e-3

    # --- readings ---

    def load(self, protocol: Protocol) -> np.ndarray:
        """Force (N) or first Piola-Kirchhoff stress (kPa) of every row, shape (n, 2).

        A Cauchy stress, computed by the lab with the mounted state as reference, is divided
        by the measured stretch.
        """
        pair = np.column_stack([protocol.load_x, protocol.load_y])
        if self.stress_pair == "cauchy":
            pair = pair / np.column_stack([protocol.stretch_x, protocol.stretch_y])
        return pair

    def mounting_reading(self, protocol: Protocol) -> np.ndarray:
        """Mean load of the rows at rest, (x, y), in :attr:`unit`; NaN where there are none."""
        if protocol.rest_rows == 0:
            return np.full(2, np.nan)
        return self.load(protocol)[: protocol.rest_rows].mean(axis=0)

    @property
    def peak_load(self) -> float:
        """Largest absolute load over both directions and all protocols, in :attr:`unit`."""
        return max(float(np.abs(self.load(p)).max()) for p in self.protocols)

    @property
    def load_resolution(self) -> float:
        """Least load that a load cell tells apart, in :attr:`unit`: a millionth of the largest."""
        return RESOLUTION * self.peak_load

    @property
    def is_tared(self) -> bool:
        """Whether every mounting reading is zero: the prestretch is gone from the file.

        Zero in the digits of the file, as the mean of the rows at rest or as their first one,
        whichever the tare subtracted.
        """
        return all(
            self._is_zeroed(curve, p.rest_rows)
            for p in self.protocols
            if p.rest_rows
            for curve in (p.load_x, p.load_y)
        )

    def _is_zeroed(self, curve: np.ndarray, resting: int) -> bool:
        mean = abs(float(curve[:resting].mean()))
        if curve[0] == 0.0 or mean <= 1e-9 * max(self.peak_load, 1e-300):
            return True
        digit = float(np.diff(np.unique(curve)).min())
        # Where digits are as coarse as the noise, a mean of zero is no tare.
        return mean <= digit <= FINE_DIGITS * self.noise_sd / np.sqrt(resting)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one load reading, in :attr:`unit`.

        The header's value, else the high-frequency scatter of the record: third differences
        of the load along the rows, scaled to one reading (median over curves). Zero when the
        record is noise-free at the precision of the file.
        """
        if self.load_noise is not None:
            return self.load_noise
        return self.high_frequency_scatter()

    def high_frequency_scatter(self) -> float:
        """Scatter of the load between neighbouring rows, in :attr:`unit`; rounding is none."""
        scatter = []
        for protocol in self.protocols:
            if protocol.rows < 8:
                continue
            # var(third difference of white noise) = (1 + 9 + 9 + 1) sd^2
            third = np.diff(self.load(protocol), n=3, axis=0) / np.sqrt(20.0)
            scatter.extend(1.4826 * np.median(np.abs(third), axis=0))
        value = float(np.median(scatter)) if scatter else 0.0
        return value if value > 1e-9 * self.peak_load else 0.0

    def mounting_readings(self, *, shared: bool) -> tuple[np.ndarray, np.ndarray]:
        """Mounting load and its standard deviation, as the statistical model uses them.

        Parameters
        ----------
        shared : bool
            One mounted state for all protocols, or one each.

        Returns
        -------
        reading, sd : ndarray, shape (m, 2)
            In :attr:`unit`; m is 1 when shared, else the number of protocols, with NaN for one
            that does not start at the mounted state. The sd is that
            of the mean of the rows at rest: the load cell's noise, or the scatter of the rows
            where five or more show a larger one. When shared, the scatter between the
            protocols counts as well.
        """
        readings, sds = [], []
        for p in self.protocols:
            rest = self.load(p)[: p.rest_rows]
            sd = np.full(2, self.noise_sd)
            if p.rest_rows >= 5:
                sd = np.maximum(sd, rest.std(axis=0, ddof=1))
            readings.append(self.mounting_reading(p))
            sds.append(sd / np.sqrt(p.rest_rows) if p.rest_rows else np.full(2, np.nan))
        reading, sd = np.array(readings), np.array(sds)
        if not shared:
            return reading, sd
        at_rest = [p.rest_rows > 0 for p in self.protocols]
        mean, pooled = pooled_reading(reading[at_rest], sd[at_rest])
        return mean[None, :], pooled[None, :]

    # --- variants ---

    def with_mounting_force(self, x: float, y: float) -> Specimen:
        """The same tared specimen with a mounting load known from elsewhere put back on."""
        protocols = []
        for p in self.protocols:
            scale = (p.stretch_x, p.stretch_y) if self.stress_pair == "cauchy" else (1.0, 1.0)
            protocols.append(
                replace(p, load_x=p.load_x + x * scale[0], load_y=p.load_y + y * scale[1])
            )
        note = f"mounting force of {x:g}, {y:g} {self.unit} added to every row, as stated"
        return replace(self, protocols=tuple(protocols), notes=(*self.notes, note))

    def zeroed(self) -> Specimen:
        """The same specimen with each protocol's mounting reading subtracted, or else the mean."""
        protocols = []
        mean = self.mounting_readings(shared=True)[0][0]
        for p in self.protocols:
            fx, fy = self.mounting_reading(p) if p.rest_rows else mean
            scale = (p.stretch_x, p.stretch_y) if self.stress_pair == "cauchy" else (1.0, 1.0)
            protocols.append(
                replace(p, load_x=p.load_x - fx * scale[0], load_y=p.load_y - fy * scale[1])
            )
        return replace(self, protocols=tuple(protocols))

    def only(self, *names: str) -> Specimen:
        """The same specimen with the named protocols alone."""
        return self.with_protocols([p for p in self.protocols if p.name in names])

    def without(self, name: str) -> Specimen:
        """The same specimen with one protocol left out."""
        return self.with_protocols([p for p in self.protocols if p.name != name])

    def with_protocols(self, protocols: Sequence[Protocol]) -> Specimen:
        """The same specimen with some of its protocols.

        Where none of them starts at the mounted state, the rows at rest of another one are put
        in front of the first: with a common reference they are those of all.
        """
        chosen = tuple(protocols)
        if chosen and not any(p.rest_rows for p in chosen):
            source = next(p for p in self.protocols if p.rest_rows)
            columns = {
                key: np.concatenate(
                    [getattr(source, key)[: source.rest_rows], getattr(chosen[0], key)]
                )
                for key in CURVES
            }
            first = Protocol(chosen[0].name, **columns, rest_rows=source.rest_rows)  # type: ignore[arg-type]
            chosen = (first, *(replace(p, time_s=None) for p in chosen[1:]))
        return replace(self, protocols=chosen)


def _rebuild(fields: dict) -> Specimen:
    return Specimen(**fields)


def pooled_reading(reading: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of several readings of one mounting load, and its sd.

    Parameters
    ----------
    reading, sd : ndarray, shape (..., m, 2)
        Of each protocol.

    Returns
    -------
    mean, sd : ndarray, shape (..., 2)
        The sd is what the readings' own make it, or their scatter where that is larger.
    """
    count = reading.shape[-2]
    pooled = np.sqrt((sd**2).sum(axis=-2)) / count
    if count > 1:
        pooled = np.maximum(pooled, reading.std(axis=-2, ddof=1) / np.sqrt(count))
    return reading.mean(axis=-2), pooled
