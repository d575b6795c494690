"""A specimen on a planar biaxial machine: its loading paths, and what they refer to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

__all__ = [
    "STRESS_PAIRS",
    "Protocol",
    "Specimen",
    "pooled_reading",
    "referenced_protocol",
    "rest_rows",
]


# --- one loading path, as recorded ---------------------------------------------------------------


REST_FRACTION = 0.25
"""Rows count as at rest while they stay within this share of the mean increment."""

CURVES = ("stretch_x", "stretch_y", "load_x", "load_y")


def _frozen(values) -> np.ndarray:
    out = np.array(values, dtype=float)
    out.setflags(write=False)
    return out


RESOLUTION = 1e-6
"""Load that a load cell tells apart, as a share of the largest: one of 20 bits, which few reach.
What a noise-free record is missed by below it is rounding of its digits, and no error."""


@dataclass(frozen=True, eq=False)
class Protocol:
    """One loading path, as recorded.

    Attributes
    ----------
    name : str
    stretch_x, stretch_y : ndarray, shape (n,)
        Measured stretches, relative to the mounted state.
    load_x, load_y : ndarray, shape (n,)
        The stress pair as the file holds it: N, or kPa (Piola or Cauchy).
    time_s : ndarray, shape (n,), or None
    rest_rows : int
        Leading rows recorded at the mounted state, at least one.
    reference : (float, float)
        The stretches that the file gave for the mounted state, by which the reader divided.
        Not one where the reference drifted between protocols. No part of equality.
    """

    name: str
    stretch_x: np.ndarray
    stretch_y: np.ndarray
    load_x: np.ndarray
    load_y: np.ndarray
    time_s: np.ndarray | None = None
    rest_rows: int = 1
    reference: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        for key in (*CURVES, "time_s"):
            value = getattr(self, key)
            if value is not None:
                object.__setattr__(self, key, _frozen(value))
        shapes = {array.shape for array in self._arrays() if array is not None}
        if len(shapes) != 1 or self.stretch_x.ndim != 1:
            raise ValueError("the columns of a protocol must be one-dimensional and equally long")
        if not 1 <= self.rest_rows <= self.stretch_x.size:
            raise ValueError("rest_rows must lie between 1 and the number of rows")

    def _arrays(self) -> tuple[np.ndarray | None, ...]:
        return tuple(getattr(self, key) for key in (*CURVES, "time_s"))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.stretch_x.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Protocol):
            return NotImplemented
        if (self.name, self.rest_rows) != (other.name, other.rest_rows):
            return False
        for mine, theirs in zip(self._arrays(), other._arrays(), strict=True):
            if mine is None or theirs is None:
                if mine is not theirs:
                    return False
            elif not np.array_equal(mine, theirs):
                return False
        return True

    def __hash__(self) -> int:
        return hash((self.name, self.rows, self.rest_rows))

    def __repr__(self) -> str:
        return f"Protocol({self.name!r}, {self.rows} rows)"


def rest_rows(stretch_x: np.ndarray, stretch_y: np.ndarray) -> int:
    """Number of leading rows at rest.

    A row is at rest while both stretches stay within a quarter of the mean increment of the
    path, or within three times the stretch reading's own scatter (second differences), of the
    first row.

    Parameters
    ----------
    stretch_x, stretch_y : ndarray, shape (n,)

    Returns
    -------
    int
        At least one.
    """
    n = stretch_x.size
    if n < 3:
        return 1
    still = np.ones(n, dtype=bool)
    for stretch in (stretch_x, stretch_y):
        increment = np.abs(stretch - stretch[0]).max() / (n - 1)
        scatter = 1.4826 * float(np.median(np.abs(np.diff(stretch, 2)))) / np.sqrt(6.0)
        still &= np.abs(stretch - stretch[0]) <= max(REST_FRACTION * increment, 3.0 * scatter)
    moving = np.flatnonzero(~still)
    # A record that never moves has one mounting row; the readers refuse it elsewhere.
    return int(moving[0]) if moving.size else 1


def referenced_protocol(
    name: str,
    stretch: np.ndarray,
    load: np.ndarray,
    stress_pair: str,
    time_s: np.ndarray | None = None,
    resting: int | None = None,
) -> Protocol:
    """A protocol whose stretches start at one.

    Parameters
    ----------
    name : str
    stretch, load : ndarray, shape (n, 2)
        As the file holds them.
    stress_pair : str
        A Cauchy stress is divided by the reference as well: the lab multiplied the nominal
        stress by its own stretch, and the nominal stress must stay what it was.
    time_s : ndarray, shape (n,), optional
    resting : int, optional
        Leading rows at rest; found from the stretches where not given.
    """
    if resting is None:
        resting = rest_rows(stretch[:, 0], stretch[:, 1])
    reference = stretch[:resting].mean(axis=0)
    # Rounding leaves the mean of a referenced record within a few units in the last place of
    # one; dividing again would change what was written.
    if np.all(np.abs(reference - 1.0) <= 1e-12):
        reference = np.ones(2)
    else:
        stretch = stretch / reference
        if stress_pair == "cauchy":
            load = load / reference
    x, y = float(reference[0]), float(reference[1])
    return Protocol(
        name,
        stretch[:, 0],
        stretch[:, 1],
        load[:, 0],
        load[:, 1],
        time_s,
        resting,
        (x, y),
    )


# --- a specimen: what was measured, and what it refers to ----------------------------------------


STRESS_PAIRS = {
    "force": ("force_x_N", "force_y_N"),
    "piola": ("piola_x_kPa", "piola_y_kPa"),
    "cauchy": ("cauchy_x_kPa", "cauchy_y_kPa"),
}
"""Columns of the stress pair a file may hold."""


@dataclass(frozen=True)
class Specimen:
    """A planar biaxial specimen with its measured protocols.

    Parameters
    ----------
    name : str
    protocols : tuple of Protocol
    stress_pair : {"force", "piola", "cauchy"}
        What ``load_x`` and ``load_y`` of the protocols are.
    geometry : {"unloaded", "mounted"}
        The state that dimensions, and any stress in the file, refer to.
    edge_x_mm, edge_y_mm, thickness_mm : float, optional
        Required for forces. The force in x acts on ``edge_y_mm * thickness_mm``.
    load_noise : float, optional
        Standard deviation of one reading of the load cell, in :attr:`unit`.
    layer, axis_x, axis_y : str, optional
    metadata : mapping, optional
        Other known header keys (measurement uncertainties and the like), kept as numbers or text.
    notes : tuple of str
        What the reader did to the file (re-referencing and the like).
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
    metadata: Mapping[str, float | str] = field(default_factory=dict)
    notes: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "protocols", tuple(self.protocols))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))
        if not self.protocols:
            raise ValueError("a specimen needs at least one protocol")
        if self.stress_pair not in STRESS_PAIRS:
            raise ValueError(f"stress_pair must be one of {', '.join(STRESS_PAIRS)}")
        if self.geometry not in ("unloaded", "mounted"):
            raise ValueError("geometry must be 'unloaded' or 'mounted'")
        if self.stress_pair == "force" and None in (
            self.edge_x_mm,
            self.edge_y_mm,
            self.thickness_mm,
        ):
            raise ValueError("a force specimen needs edge_x_mm, edge_y_mm and thickness_mm")
        if len({p.time_s is None for p in self.protocols}) > 1:
            raise ValueError("either every protocol has time_s or none")

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
        """Mean load of the rows at rest, (x, y), in :attr:`unit`."""
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
        """Whether every mounting reading is zero: the prestretch is gone from the file."""
        readings = np.array([self.mounting_reading(p) for p in self.protocols])
        return bool(np.all(np.abs(readings) <= 1e-9 * max(self.peak_load, 1e-300)))

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
            In :attr:`unit`; m is 1 when shared, else the number of protocols. The sd is that
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
            readings.append(rest.mean(axis=0))
            sds.append(sd / np.sqrt(p.rest_rows))
        reading, sd = np.array(readings), np.array(sds)
        if not shared:
            return reading, sd
        mean, pooled = pooled_reading(reading, sd)
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
        """The same specimen with each protocol's mounting reading subtracted."""
        protocols = []
        for p in self.protocols:
            fx, fy = self.mounting_reading(p)
            scale = (p.stretch_x, p.stretch_y) if self.stress_pair == "cauchy" else (1.0, 1.0)
            protocols.append(
                replace(p, load_x=p.load_x - fx * scale[0], load_y=p.load_y - fy * scale[1])
            )
        return replace(self, protocols=tuple(protocols))

    def only(self, *names: str) -> Specimen:
        """The same specimen with the named protocols alone."""
        kept = tuple(p for p in self.protocols if p.name in names)
        return replace(self, protocols=kept)

    def without(self, name: str) -> Specimen:
        """The same specimen with one protocol left out."""
        return replace(self, protocols=tuple(p for p in self.protocols if p.name != name))


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
