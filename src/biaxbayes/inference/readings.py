"""All rows of a specimen in flat arrays, as a fit needs them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from biaxbayes.specimens.specimen import Specimen

__all__ = ["Readings", "readings"]


@dataclass(frozen=True, eq=False)
class Readings:
    """Rows of all protocols, one below the other.

    Attributes
    ----------
    stretch : ndarray, shape (2, n)
        Measured stretches, relative to the mounted state.
    load : ndarray, shape (2, n)
        Force (N) or first Piola-Kirchhoff stress (kPa) in the file's geometry.
    group : ndarray of int, shape (n,)
        Which mounted state a row belongs to.
    at_rest : ndarray of bool, shape (n,)
        Rows recorded at the mounted state, before the test starts.
    mounting_load, mounting_sd : ndarray, shape (2, m)
        Reading of each mounted state and its standard deviation, in the unit of ``load``.
    area : ndarray, shape (2,)
        Load per kPa.
    mounted : bool
        Whether the dimensions refer to the mounted state.
    rows : tuple of slice
        The rows of each protocol.
    """

    stretch: np.ndarray
    load: np.ndarray
    group: np.ndarray
    at_rest: np.ndarray
    mounting_load: np.ndarray
    mounting_sd: np.ndarray
    area: np.ndarray
    mounted: bool
    rows: tuple[slice, ...]

    @property
    def peak(self) -> float:
        """Largest absolute load, at least the smallest normal number."""
        return max(float(np.abs(self.load).max()), 1e-300)

    def thinned(self, per_protocol: int) -> Readings:
        """At most so many stretched rows of each protocol, evenly chosen, the last included."""
        keep = []
        for rows in self.rows:
            index = np.arange(rows.start, rows.stop)
            index = index[~self.at_rest[rows]]
            chosen = np.unique(np.linspace(0, index.size - 1, per_protocol).round().astype(int))
            keep.append(index[chosen] if index.size else index)
        kept = np.concatenate(keep)
        ends = np.cumsum([0, *(k.size for k in keep)])
        return replace(
            self,
            stretch=self.stretch[:, kept],
            load=self.load[:, kept],
            group=self.group[kept],
            at_rest=self.at_rest[kept],
            rows=tuple(slice(a, b) for a, b in pairwise(ends)),
        )

    def stretched(self) -> Readings:
        """Without the rows at rest, which enter a posterior through the mounting reading."""
        return self.thinned(self.at_rest.size)


def readings(specimen: Specimen, *, shared: bool, zeroed: bool = False) -> Readings:
    """Flatten a specimen.

    Parameters
    ----------
    specimen : Specimen
    shared : bool
        One mounted state for all protocols, or one each.
    zeroed : bool
        Subtract each protocol's mounting reading from its loads.
    """
    source = specimen.zeroed() if zeroed else specimen
    loads = [source.load(p) for p in source.protocols]
    reading, sd = source.mounting_readings(shared=shared)
    sizes = [p.rows for p in source.protocols]
    ends = np.cumsum([0, *sizes])
    return Readings(
        stretch=np.concatenate([[p.stretch_x, p.stretch_y] for p in source.protocols], axis=1),
        load=np.concatenate(loads).T.copy(),
        group=np.zeros(ends[-1], dtype=int) if shared else np.repeat(np.arange(len(sizes)), sizes),
        at_rest=np.concatenate([np.arange(p.rows) < p.rest_rows for p in source.protocols]),
        mounting_load=reading.T.copy(),
        mounting_sd=sd.T.copy(),
        area=specimen.area,
        mounted=specimen.geometry == "mounted",
        rows=tuple(slice(a, b) for a, b in pairwise(ends)),
    )
