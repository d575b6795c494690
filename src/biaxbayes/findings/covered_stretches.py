"""What a test covered: the convex hull of its states of stretch, and what lies outside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.specimens.specimen import Specimen

__all__ = ["BELOW", "BEYOND", "INSIDE", "OFF_PATH", "CoveredStretches", "covered_stretches"]

INSIDE = "no"
BELOW = "below the mounted state"
BEYOND = "beyond the tested range"
OFF_PATH = "off the tested paths"

RELATIVE_TOLERANCE = 0.05  # of the tested range: a path this close beside a tested one counts
ABSOLUTE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class CoveredStretches:
    """Convex hull of the tested states.

    Attributes
    ----------
    hull : ndarray, shape (m, 2)
        Corners, anticlockwise; one or two when the states lie on a point or a line.
    low, high : ndarray, shape (2,)
        Component-wise range.
    shift : float
        Distance by which the mounting stretch moved the tested paths: a path that starts at the
        unloaded state and runs beside a tested one within it was tested as well as it could be.
    """

    hull: np.ndarray
    low: np.ndarray
    high: np.ndarray
    shift: float = 0.0

    def extrapolation(self, stretch_x, stretch_y) -> np.ndarray:
        """Where each state lies.

        Parameters
        ----------
        stretch_x, stretch_y : array_like, shape (n,)

        Returns
        -------
        ndarray of str, shape (n,)
            :data:`INSIDE`; :data:`BELOW` a smallest, :data:`BEYOND` a largest tested stretch;
            or :data:`OFF_PATH`: each stretch was tested, but not together.
        """
        state = np.column_stack([np.ravel(stretch_x), np.ravel(stretch_y)]).astype(float)
        slack = RELATIVE_TOLERANCE * (self.high - self.low).max() + self.shift + ABSOLUTE_TOLERANCE
        label = np.full(len(state), INSIDE, dtype=object)
        label[_distance(self.hull, state) > slack] = OFF_PATH
        # A range's own ends count as tested to the rounding of the file only.
        label[(state < self.low - ABSOLUTE_TOLERANCE).any(axis=1)] = BELOW
        # Not a number is no tested state either.
        label[~(state <= self.high + ABSOLUTE_TOLERANCE).all(axis=1)] = BEYOND
        return label.astype(str)


def covered_stretches(
    specimen: Specimen, mounting_stretch: tuple[float, float] | np.ndarray = (1.0, 1.0)
) -> CoveredStretches:
    """The states of stretch that a specimen's protocols visited.

    Parameters
    ----------
    specimen : Specimen
    mounting_stretch : (float, float) or ndarray, shape (protocols, 2)
        Factor from measured to total stretch, one for all or one for each protocol; (1, 1) for
        the range of measured stretches.

    Returns
    -------
    CoveredStretches
    """
    factor = np.broadcast_to(np.asarray(mounting_stretch, float), (len(specimen.protocols), 2))
    state = np.vstack(
        [
            np.column_stack([p.stretch_x, p.stretch_y]) * lm
            for p, lm in zip(specimen.protocols, factor, strict=True)
        ]
    )
    shift = float(np.linalg.norm(factor - 1.0, axis=1).max())
    return CoveredStretches(_convex_hull(state), state.min(axis=0), state.max(axis=0), shift)


def _convex_hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull, anticlockwise, by Andrew's monotone chain."""
    ordered = [tuple(p) for p in np.unique(points, axis=0)]  # sorted by x, then y
    if len(ordered) < 3:
        return np.array(ordered)

    def chain(sequence) -> list[tuple[float, ...]]:
        corners: list[tuple[float, ...]] = []
        for p in sequence:
            while len(corners) > 1:
                (ax, ay), (bx, by) = corners[-2], corners[-1]
                if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 0.0:
                    break
                corners.pop()
            corners.append(p)
        return corners

    return np.array(chain(ordered)[:-1] + chain(reversed(ordered))[:-1])


def _distance(hull: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of points from a convex polygon; zero inside it."""
    start, end = hull, np.roll(hull, -1, axis=0)
    edge = end - start
    offset = points[:, None, :] - start[None, :, :]
    length = np.maximum((edge**2).sum(axis=1), 1e-300)
    along = np.clip((offset * edge).sum(axis=2) / length, 0.0, 1.0)
    nearest = np.linalg.norm(offset - along[:, :, None] * edge, axis=2).min(axis=1)
    if len(hull) < 3:
        return nearest
    cross = edge[:, 0] * offset[:, :, 1] - edge[:, 1] * offset[:, :, 0]
    return np.where((cross >= 0.0).all(axis=1), 0.0, nearest)
