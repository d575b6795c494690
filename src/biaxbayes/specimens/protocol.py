"""One loading path of a planar biaxial test, as recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Protocol", "referenced_protocol", "rest_rows"]

REST_FRACTION = 0.25
"""Rows count as at rest while they stay within this share of the mean increment."""

CURVES = ("stretch_x", "stretch_y", "load_x", "load_y")


def _frozen(values) -> np.ndarray:
    out = np.array(values, dtype=float)
    out.setflags(write=False)
    return out


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
