"""A piece of tissue in a test: its loading curves, their reference states, and further pieces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from biaxbayes.errors import InputError, ReadingError
from biaxbayes.experiments import BIAXIAL, EXPERIMENTS, Experiment
from biaxbayes.experiments.experiment import DIMENSIONS, Loads
from biaxbayes.experiments.sheet import REFERENCES
from biaxbayes.parameters import Parameter, PieceLabels, Quantities, mounting_names
from biaxbayes.specimens.keys import (
    GEOMETRIES,
    METADATA_KEYS,
    NO_GRIPS,
    checked_value,
    keys_of_others,
    measured_stretch,
)
from biaxbayes.specimens.protocol import CURVES, Protocol

PHYSIOLOGICAL = ("physiological_stretch_x", "physiological_stretch_y")
FINE_DIGITS = 0.1
"""Digits finer than this fraction of the standard error of a mounting reading can show a tare."""


@dataclass(frozen=True)
class Specimen:
    """A piece of tissue with its measured protocols, and further pieces of the same tissue.

    Parameters
    ----------
    name : str
    protocols : sequence of Protocol
    loads : str
        What ``load_x`` and ``load_y`` of the protocols are: ``force``, ``piola`` or ``cauchy`` of a
        sheet, ``pressure`` of a tube. All zero in a direction that was not read.
    test : str, optional
        Kind of test, a key of :data:`biaxbayes.experiments.EXPERIMENTS`.
    geometry : {"unloaded", "mounted"}
        The state that dimensions, and any stress in the file, refer to.
    edge_x_mm, edge_y_mm, thickness_mm : float, optional
        Required for forces, of a strip its width and thickness. The force in x acts on
        ``edge_y_mm * thickness_mm``.
    load_noise : float, optional
        Standard deviation of one reading of the load cell, in :attr:`unit`.
    layer, axis_x, axis_y : str, optional
    reference : {"each protocol", "common"}, optional
        ``each protocol`` (the default): the first rows of each protocol are the mounted state, and
        its stretches are divided by their mean there. ``common``: one mounted state for all, where
        the stretch is (1, 1); a protocol that does not start there has no rows at rest.
    metadata : mapping, optional
        Further header keys of a specimen file, such as measurement uncertainties, as numbers or
        text.
    notes : tuple of str
        Changes made when reading, such as re-referenced stretches.
    further : tuple of Specimen, optional
        Other pieces of the same tissue, each tested on its own.

    Raises
    ------
    ReadingError
        If an argument does not fit the others, or no protocol has a row at the mounted state.
    """

    name: str
    protocols: tuple[Protocol, ...]
    loads: str
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
    test: str = BIAXIAL.name
    further: tuple[Specimen, ...] = ()

    def __post_init__(self) -> None:
        test = EXPERIMENTS[self.test] if self.test in tuple(EXPERIMENTS) else BIAXIAL
        for argument, choices in (
            ("test", tuple(EXPERIMENTS)),
            ("geometry", GEOMETRIES),
            ("reference", (*REFERENCES, None)),
            ("loads", tuple(test.loads)),
        ):
            if (value := getattr(self, argument)) not in choices:
                problem = f"{argument} {str(value)[:40]!r} is not one of the choices"
                remedy = f"use one of {', '.join(filter(None, choices))}"
                raise ReadingError(problem, argument=argument, remedy=remedy)
        for argument in DIMENSIONS:
            value = getattr(self, argument)
            if value is not None:
                object.__setattr__(self, argument, _checked(argument, value))
        for key in test.needed(self.loads):
            if getattr(self, key, self.metadata.get(key)) is None:
                problem = f"is needed with {test.loads[self.loads].words}"
                raise ReadingError(problem, argument=key, remedy="give it in mm")
        for key in keys_of_others(test):
            if key in self.metadata or getattr(self, key, None) is not None:
                problem = f"{key} does not belong to a {self.test} test"
                raise ReadingError(problem, argument=key, remedy="leave it out")
        if not test.is_mounted and self.geometry != "unloaded":
            problem = f"dimensions of a {self.test} are those of the unloaded one"
            raise ReadingError(problem, argument="geometry", remedy="leave it out")
        if self.load_noise is not None:
            try:
                noise = float(self.load_noise)
            except (TypeError, ValueError):
                noise = np.nan
            if not 0.0 <= noise < np.inf:
                problem = f"load_noise must be a number from 0, not {str(self.load_noise)[:40]!r}"
                remedy = f"give the standard deviation of one reading in {self.unit}"
                raise ReadingError(problem, argument="load_noise", remedy=remedy)
            object.__setattr__(self, "load_noise", noise)
        for key in self.metadata:
            if key not in METADATA_KEYS:
                problem = f"unknown metadata key {str(key)[:40]!r}"
                remedy = f"known keys are {', '.join(METADATA_KEYS)}"
                raise ReadingError(problem, argument="metadata", remedy=remedy)
        metadata = {key: _checked(key, value) for key, value in self.metadata.items()}
        object.__setattr__(self, "metadata", metadata)
        given = [key for key in PHYSIOLOGICAL if key in metadata]
        if len(given) == 1:
            problem = "one of the two physiological stretches is missing"
            remedy = f"give {' and '.join(PHYSIOLOGICAL)}"
            raise ReadingError(problem, argument=given[0], remedy=remedy)
        object.__setattr__(self, "protocols", self._referenced_protocols())
        self.experiment.check(self.header, self.protocols)
        names = [piece.name for piece in self.pieces]
        for name in (name for name in names if names.count(name) > 1):
            problem = f"two pieces are called {name[:40]!r}"
            remedy = "give each a name of its own (# specimen: ...)"
            raise ReadingError(problem, argument="further", remedy=remedy)

    def _referenced_protocols(self) -> tuple[Protocol, ...]:
        """The protocols with stretches relative to the mounted state, and their rows there."""
        protocols = tuple(self.protocols) if isinstance(self.protocols, Iterable) else ()
        if not protocols or not all(isinstance(p, Protocol) for p in protocols):
            problem = "must be a sequence of at least one Protocol"
            remedy = "for example [Protocol(name, stretch_x, stretch_y, load_x, load_y)]"
            raise ReadingError(problem, argument="protocols", remedy=remedy)
        if len({p.time_s is None for p in protocols}) > 1:
            problem, remedy = "is missing in some protocols", "give it in all or none"
            raise ReadingError(problem, argument="time_s", remedy=remedy)
        test = EXPERIMENTS[self.test]
        if not test.is_mounted:
            return tuple(replace(p, rest_rows=0) for p in protocols)
        if self.reference == "common":
            protocols = tuple(p.with_common_reference() for p in protocols)
            if not any(p.rest_rows for p in protocols):
                problem = "no protocol has a row at the mounted state, stretch (1, 1); the first "
                problem += "starts at ({:.4g}, {:.4g})".format(*protocols[0].stretch[0])
                remedy = "state the stretch of the mounted state (mounted_state_x and _y), where "
                remedy += "at least one protocol needs a row"
                raise ReadingError(problem, argument="reference", remedy=remedy)
            return protocols
        for p in protocols:
            if p.rest_rows == 0:
                problem = "rest_rows must be at least 1 where each protocol has its own reference"
                remedy = "count its first row, or state '# reference: common'"
                raise ReadingError(problem, argument="rest_rows", protocol=p.name, remedy=remedy)
        loads_too = test.loads[self.loads].times_stretch
        return tuple(p.divided_by_rest(loads_too=loads_too) for p in protocols)

    def __hash__(self) -> int:
        return hash((self.name, self.loads, len(self.protocols)))

    def __repr__(self) -> str:
        rows = sum(p.rows for p in self.protocols)
        layer = f", {self.layer}" if self.layer else ""
        protocols = f"{len(self.protocols)} protocol{'s' * (len(self.protocols) != 1)}"
        return f"Specimen({self.name!r}{layer}, {protocols}, {rows} rows of {self.loads})"

    # --- the test, and the pieces of the tissue ---

    @cached_property
    def experiment(self) -> Experiment:
        """The kind of test, with the dimensions of this piece."""
        reads = np.any([p.recorded_load.any(axis=0) for p in self.protocols], axis=0)
        return EXPERIMENTS[self.test].of(self.header, reads.tolist())

    @property
    def header(self) -> dict[str, Any]:
        """Dimensions, geometry and further header keys."""
        return {k: getattr(self, k) for k in (*DIMENSIONS, "geometry")} | dict(self.metadata)

    @property
    def physiological(self) -> tuple[float, float] | None:
        """Total stretches (x, y) in the body, where the header gives them."""
        stated = [float(self.metadata[key]) for key in PHYSIOLOGICAL if key in self.metadata]
        return (stated[0], stated[1]) if stated else None

    @property
    def kind_of_loads(self) -> Loads:
        """What the loads are."""
        return self.experiment.loads[self.loads]

    @property
    def pieces(self) -> tuple[Specimen, ...]:
        """All pieces of the tissue, this one first."""
        return (replace(self, further=()) if self.further else self, *self.further)

    def with_pieces(self, further: Iterable[Specimen]) -> Specimen:
        """The same tissue with more pieces."""
        return replace(self, further=(*self.further, *further))

    def quantities(self, material: Sequence[Parameter], *, shared: bool) -> Quantities:
        """Quantities of a run with all pieces; shared: one mounted state for all its protocols."""
        labels = []
        for i, piece in enumerate(self.pieces):
            label = piece.name if i else ""
            own = [f"{label}: {p.name}" if label else p.name for p in piece.protocols]
            axes = piece.experiment.axes if piece.experiment.is_mounted else ()
            labels.append(PieceLabels(label, (label,) if shared else tuple(own), axes, piece.unit))
        return Quantities(material, labels)

    @property
    def needs_grip_correction(self) -> bool:
        """True if the header describes hooks and the loads are still those measured on them."""
        return self.has_hooks and "grip_correction" not in self.metadata

    @property
    def has_hooks(self) -> bool:
        """True if the header describes hooks."""
        return self.metadata.get("grips", NO_GRIPS) != NO_GRIPS

    @property
    def directions(self) -> tuple[str, str]:
        """Names of the axes, ``x`` and ``y`` where the header names none."""
        return self.axis_x or "x", self.axis_y or "y"

    # --- units and sections ---

    @property
    def unit(self) -> str:
        """Unit of the reading in x, and in y but for an axial force: ``"N"`` or ``"kPa"``."""
        return self.units[0]

    @property
    def units(self) -> tuple[str, str]:
        """Units of the readings in x and y."""
        return self.kind_of_loads.units

    def same_unit(self, axis: int) -> list[int]:
        """Directions whose readings have the unit of one of them."""
        return [k for k in self.experiment.axes if self.units[k] == self.units[axis]] or [axis]

    @property
    def area(self) -> np.ndarray:
        """Measured quantity per kPa of first Piola-Kirchhoff stress, (x, y); one for stresses."""
        area = self.experiment.area(self.header, self.loads)
        return np.ones(2) if area is None else area

    # --- readings ---

    def load(self, protocol: Protocol) -> np.ndarray:
        """Force (N) or first Piola-Kirchhoff stress (kPa) of every row, shape (n, 2).

        A Cauchy stress, of a lab with the mounted state as reference, over the measured stretch.
        """
        return protocol.recorded_load / self.per_nominal(protocol.known_stretch)

    def per_nominal(self, stretch: np.ndarray) -> np.ndarray:
        """What the file has per nominal load: the measured stretch for Cauchy stresses, else 1."""
        return stretch if self.kind_of_loads.times_stretch else np.ones_like(stretch)

    def stresses(self, protocol: Protocol) -> np.ndarray:
        """Stresses (n, 2) that the loads of every row mean, kPa: nominal, or of the wall."""
        load = self.load(protocol)
        stresses = self.experiment.stresses(protocol.stretch, load)
        return load / self.area if stresses is None else stresses

    def mounting_reading(self, protocol: Protocol) -> np.ndarray:
        """Mean load of the rows at rest, (x, y), in :attr:`unit`; NaN where there are none."""
        if protocol.rest_rows == 0:
            return np.full(2, np.nan)
        return self.load(protocol)[: protocol.rest_rows].mean(axis=0)

    @cached_property
    def peak_loads(self) -> np.ndarray:
        """Largest absolute load of all protocols and all directions of a unit, (x, y)."""
        largest = np.max([np.abs(self.load(p)).max(axis=0) for p in self.protocols], axis=0)
        return np.array([largest[self.same_unit(k)].max() for k in range(2)])

    @property
    def peak_load(self) -> float:
        """Largest absolute load of all protocols, in :attr:`unit`."""
        return float(self.peak_loads[0])

    @property
    def load_scale(self) -> np.ndarray:
        """Readings in y over those in x of equal weight: 1, of two units their peaks' ratio."""
        peaks = self.peak_loads
        return np.array([1.0, peaks[1] / peaks[0] if peaks.all() else 1.0])

    @property
    def load_resolution(self) -> float:
        """Resolution that a load cell is assumed to have (20 bit), in :attr:`unit`."""
        return 1e-6 * self.peak_load

    @property
    def measured_mounting(self) -> np.ndarray:
        """Mean and sd of the mounting stretches that the header gives, (2, 2); NaN elsewhere."""
        texts = [self.metadata.get(name) for name in mounting_names("stretch")]
        known = [measured_stretch(str(t)) if t is not None else (np.nan, np.nan) for t in texts]
        return np.array(known).T

    @property
    def is_tared(self) -> bool:
        """True if every mounting reading, mean or first row, is zero in the digits of the file."""
        if not self.experiment.is_mounted:
            return False
        for p in (p for p in self.protocols if p.rest_rows):
            for k in self.experiment.axes:
                written, reading = p.recorded_load[:, k], self.mounting_reading(p)[k]
                # Zero mean at rest; a Cauchy stress as it is written, or as a nominal stress
                mean = abs(float(written[: p.rest_rows].mean()))
                is_zero = min(mean, abs(float(reading))) <= 1e-9 * self.peak_load
                if written[0] == 0.0 or is_zero:
                    continue
                # Zero but for the last digit, which must be fine: with digits as coarse as the
                # noise, a zero mean does not indicate taring.
                digit = float(np.diff(np.unique(written)).min(initial=np.inf))
                fine = FINE_DIGITS * self.noise_sd / np.sqrt(p.rest_rows)
                if mean > digit or digit > fine:
                    return False
        return True

    @cached_property
    def noise_sds(self) -> np.ndarray:
        """Standard deviation of one load reading, (x, y), in :attr:`units`.

        The header's value; otherwise the median over curves of a unit of their third differences,
        scaled to one reading. Zero for a record without noise at the precision of the file.
        """
        stated = [self.load_noise, self.load_noise]
        if key := self.kind_of_loads.noise_key_y:
            stated[1] = self.metadata.get(key)  # type: ignore[assignment]
        return np.array(
            [self.high_frequency_scatter(k) if s is None else s for k, s in enumerate(stated)]
        )

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one load reading, in :attr:`unit`."""
        return float(self.noise_sds[0])

    def high_frequency_scatter(self, axis: int = 0) -> float:
        """Scatter of loads of one unit between neighbouring rows; 0 for rounding alone."""
        scatter: list[float] = []
        axes = self.same_unit(axis)
        for protocol in self.protocols:
            if protocol.rows < 8:
                continue
            load, rows = self.load(protocol)[:, axes], np.arange(protocol.rows)
            even = third_difference_scatter(load, rows)
            path = np.nansum(np.abs(protocol.stretch - protocol.stretch[0]), axis=1)
            places = [path] if protocol.time_s is None else [path, protocol.time_s]
            uneven = np.min([third_difference_scatter(load, place) for place in places], axis=0)
            # where rows are missing, the curve itself looks like noise over the number of a row
            scatter.extend(np.where(uneven < 0.5 * even, uneven, even))
        value = float(np.median(scatter)) if scatter else 0.0
        return value if value > 1e-9 * self.peak_loads[axis] else 0.0

    def mounting_readings(self, *, shared: bool) -> tuple[np.ndarray, np.ndarray]:
        """Mounting load and its standard deviation (m, 2), in :attr:`unit`, as the model uses them.

        One for all protocols when `shared`, else one for each, NaN where it does not start at the
        mounted state. The sd is that of the mean of the rows at rest: the load cell's noise, or a
        larger scatter of five or more rows; when shared, or that between the protocols.
        """
        if not self.experiment.is_mounted:
            nothing = np.zeros((1 if shared else len(self.protocols), 2))
            return nothing, nothing
        reading = np.array([self.mounting_reading(p) for p in self.protocols])
        sd = np.full_like(reading, np.nan)
        for p, sd_of_mean in zip(self.protocols, sd, strict=True):
            scatter = np.full(2, self.noise_sd)
            if p.rest_rows >= 5:
                rest = self.load(p)[: p.rest_rows]
                scatter = np.maximum(scatter, rest.std(axis=0, ddof=1))
            if p.rest_rows:
                scatter[~np.isin([0, 1], self.experiment.axes)] = 0.0
                sd_of_mean[:] = scatter / np.sqrt(p.rest_rows)
        if not shared:
            return reading, sd
        at_rest = [p.rest_rows > 0 for p in self.protocols]
        mean, pooled = pooled_reading(reading[at_rest], sd[at_rest])
        return mean[None, :], pooled[None, :]

    # --- variants ---

    def with_noise_of(self, source: Specimen) -> Specimen:
        """The same specimen with the load noise of another one, which averaged rows do not show."""
        x, y = source.noise_sds.tolist()
        key = self.kind_of_loads.noise_key_y
        of_y = {key: y} if key and y > 0.0 else {}
        return replace(self, load_noise=x or None, metadata={**self.metadata, **of_y})

    def with_mounting_force(self, x: float, y: float) -> Specimen:
        """The same tared specimen with a known mounting load added back."""
        note = f"mounting force of {x:g}, {y:g} {self.unit} added to every row, as stated"
        protocols = tuple(self._shifted(p, x, y) for p in self.protocols)
        return replace(self, protocols=protocols, notes=(*self.notes, note))

    def as_compared(self, mounting: str) -> Specimen:
        """The record as a model with this mounting mode compares it."""
        return self.zeroed() if mounting == "zeroed" else self

    def zeroed(self) -> Specimen:
        """The same specimen with the mounting reading of each protocol subtracted.

        Where a protocol has no row at rest, the mean over the others is subtracted.
        """
        mean = self.mounting_readings(shared=True)[0][0]
        readings = [self.mounting_reading(p) if p.rest_rows else mean for p in self.protocols]
        protocols = zip(self.protocols, readings, strict=True)
        return replace(self, protocols=tuple(self._shifted(p, -f[0], -f[1]) for p, f in protocols))

    def _shifted(self, p: Protocol, x: float, y: float) -> Protocol:
        """A protocol with a nominal load added to every row."""
        added_x, added_y = (self.per_nominal(p.stretch) * [x, y]).T
        return replace(p, load_x=p.load_x + added_x, load_y=p.load_y + added_y)

    def only(self, *names: str) -> Specimen:
        """The same specimen with only the named protocols."""
        return self.with_protocols([p for p in self.protocols if p.name in names])

    def with_protocols(self, protocols: Sequence[Protocol]) -> Specimen:
        """The same specimen with the given protocols of it.

        If none of them starts at the mounted state, the rows at rest of another one are put in
        front of the first: with a common reference they hold for all.
        """
        chosen = tuple(protocols)
        if chosen and self.experiment.is_mounted and not any(p.rest_rows for p in chosen):
            source = next(p for p in self.protocols if p.rest_rows)
            rest = source.rest_rows
            curves: Any = {
                key: np.concatenate([getattr(source, key)[:rest], getattr(chosen[0], key)])
                for key in CURVES
            }
            first = Protocol(chosen[0].name, **curves, rest_rows=rest)
            chosen = (first, *(replace(p, time_s=None) for p in chosen[1:]))
        return replace(self, protocols=chosen)


def third_difference_scatter(load: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Scatter of loads (n, 2) about parabolas through neighbouring rows at some places (n,)."""
    # four readings are combined so that a parabola gives zero: (-1, 3, -3, 1) at even places
    span = max(float(np.ptp(place)), 1e-300)
    at = place / span + 1e-9 * np.arange(place.size)  # no two the same
    windows = np.lib.stride_tricks.sliding_window_view(at, 4)
    apart = windows[:, :, None] - windows[:, None, :] + np.eye(4)
    apart = np.where(apart == 0.0, 1e-12, apart)
    weights = 1.0 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    loads = np.lib.stride_tricks.sliding_window_view(load, 4, axis=0)
    return 1.4826 * np.median(np.abs((loads * weights[:, None, :]).sum(axis=2)), axis=0)


def _checked(key: str, value: object) -> Any:
    """Value of a header key; an error names it as an argument."""
    try:
        return checked_value(key, value)
    except InputError as error:
        raise ReadingError(error.problem, argument=key, remedy=error.remedy) from None


def pooled_reading(reading: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (..., 2) of readings (..., m, 2) of one load; its sd from theirs, or their scatter."""
    count = reading.shape[-2]
    pooled = np.sqrt((sd**2).sum(axis=-2)) / count
    if count > 1:
        pooled = np.maximum(pooled, reading.std(axis=-2, ddof=1) / np.sqrt(count))
    return reading.mean(axis=-2), pooled
