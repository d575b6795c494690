"""The path that a protocol takes: its branches, and fewer rows along it with the same content.

Every k consecutive rows of a protocol become one: their mean stretches, their mean loads and the
scatter of the loads about their trend. For a residual that hardly changes within k rows,

    sum_j (f_j - m_j)^2 = k [(mean f - m)^2 + scatter],

so a Gaussian likelihood of the averaged rows, each counted k times with its scatter, is that of
all rows, for any noise sd. Rows are grouped by their number and not by the length of the
path, because the likelihood counts rows: bins of equal length would weigh the parts of a path
that was recorded slowly less than the record does, and change the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.specimens.protocol import Protocol, second_difference_scatter
from biaxbayes.specimens.specimen import Specimen

# --- loading and unloading branches of a record, from its own curves --------------------------

SWING = 0.3
"""Share of the whole range that a rise and a fall must have to count as a cycle."""
RELAPSE = 0.05
"""Tolerated drop below the running maximum, as a share of the range."""


@dataclass(frozen=True)
class Cycle:
    """Rows of one cycle: ``loading`` up to the peak, ``unloading`` from it on."""

    loading: slice
    unloading: slice


def progress(stretch: np.ndarray, load: np.ndarray) -> np.ndarray:
    """How far a test has come, 0 at its first row and 1 about where it goes furthest.

    The mean of the path in stretch and the path in load, each summed over both directions:
    stretch alone wanders in load-controlled tests, load alone is flat in the toe.

    Parameters
    ----------
    stretch, load : ndarray, shape (n, 2)

    Returns
    -------
    ndarray, shape (n,)
    """
    total = np.zeros(len(stretch))
    for curves in (stretch, load):
        away = curves - curves[0]
        furthest = away[np.abs(away).argmax(axis=0), [0, 1]]
        path = (away * np.where(furthest < 0.0, -1.0, 1.0)).sum(axis=1)
        range_ = np.abs(path).max()
        total += path / range_ if range_ > 0.0 else 0.0
    return total / 2.0


def scatter(path: np.ndarray) -> float:
    """Standard deviation of one row about its neighbours (second differences)."""
    return second_difference_scatter(path) if path.size >= 5 else 0.0


def relapse(path: np.ndarray) -> tuple[int, int] | None:
    """Where a path falls behind itself: the row of the peak, and the first row after it.

    None while it falls back by no more than 5 % of its range and its own scatter.
    """
    if path.size < 3:
        return None
    # One wrong reading is no branch: the median of three passes over it.
    calm = path.copy()
    calm[1:-1] = np.median([path[:-2], path[1:-1], path[2:]], axis=0)
    best = np.maximum.accumulate(calm)
    limit = RELAPSE * max(float(np.ptp(path)), 1e-300) + 5.0 * scatter(path)
    fallen = np.flatnonzero(best - calm > limit)
    if not fallen.size:
        return None
    near = max(int(np.argmax(calm[: fallen[0] + 1])) - 1, 0)
    peak = near + int(np.argmax(path[near : near + 3]))
    return peak, peak + 1


def cycles(path: np.ndarray) -> list[Cycle]:
    """Cycles of a record: a rise and a fall of at least 30 % of the whole range each.

    Rows at rest before a rise belong to its loading branch. A record that only rises is one
    cycle without an unloading branch.

    Parameters
    ----------
    path : ndarray, shape (n,)
        From :func:`progress`.
    """
    swing = SWING * float(np.ptp(path))
    # The valley is the lowest of many noisy rows: allow for both ends of the noise.
    level = 0.001 * float(np.ptp(path)) + 6.0 * scatter(path)
    turns = _turning_points(path, swing)
    cycles = []
    for number, (valley, peak) in enumerate(turns):
        before = turns[number - 1][1] if number else 0
        # The rest before the rise: rows as low as the valley, without a gap, up to it.
        high = np.flatnonzero(path[before:valley] > path[valley] + level)
        start = before + int(high[-1]) + 1 if high.size else before
        if number == 0 and path[: valley + 1].max() - path[valley] <= RELAPSE * np.ptp(path):
            start = 0  # the dip before the first rise is noise
        stop = turns[number + 1][0] if number + 1 < len(turns) else path.size
        if relapse(path[start:stop]) is None:
            peak = stop - 1  # the end of the record is the peak, up to noise
        cycles.append(Cycle(slice(start, peak + 1), slice(peak, stop)))
    return cycles


def _turning_points(path: np.ndarray, swing: float) -> list[tuple[int, int]]:
    """Rows (valley, peak) of every rise of at least ``swing``."""
    pairs: list[tuple[int, int]] = []
    low = high = 0
    rising = False
    for row, value in enumerate(path.tolist()):
        if rising:
            if value > path[high]:
                high = row
            elif path[high] - value >= swing:
                pairs.append((low, high))
                rising, low = False, row
        elif value <= path[low]:
            low = row
        elif value - path[low] >= swing:
            rising, high = True, row
    if rising:
        pairs.append((low, high))
    return pairs


# --- neighbouring rows of a record averaged along its path ---------------------------------------

AUTO_ABOVE = 200
"""Rows of a protocol, those at rest apart, beyond which thinning is worth it."""
AUTO_ROWS = 100
"""Rows of a protocol that are left then, at most."""
LEAST_ROWS = 10


@dataclass(frozen=True)
class ThinnedSpecimen:
    """A specimen with averaged rows.

    Attributes
    ----------
    specimen : Specimen
        Rows at rest as they are, the others averaged.
    scatter : tuple of ndarray, shape (n_p, 2)
        Mean square scatter of the loads in each averaged row about their trend, in the
        squared unit of :meth:`Specimen.load`; zero where nothing was averaged.
    weight : tuple of float
        Rows of the record for each row left, by protocol.
    """

    specimen: Specimen
    scatter: tuple[np.ndarray, ...]
    weight: tuple[float, ...]


def rows_to_keep(specimen: Specimen, thin: int | str, *, automatic: bool) -> int:
    """Rows of a protocol that longer ones are averaged to; 0 for all of them.

    Parameters
    ----------
    specimen : Specimen
    thin : int, "none" or "auto"
        A number is used as it is. ``auto`` averages to at most 100 rows a protocol where one
        has more than 200.
    automatic : bool
        Whether ``auto`` may average at all: not where the readings count as independent, since
        their number is part of the answer there.

    Raises
    ------
    InputError
        For another word, or fewer than ten rows.
    """
    if thin == "auto":
        longest = max(p.rows - p.rest_rows for p in specimen.protocols)
        return AUTO_ROWS if automatic and longest > AUTO_ABOVE else 0
    if thin == "none":
        return 0
    try:
        rows = int(thin)
    except (TypeError, ValueError):
        raise InputError(f"cannot thin to {thin!r}", remedy="a number, none or auto") from None
    if rows and rows < LEAST_ROWS:
        raise InputError(
            f"thinning to {rows} rows a protocol leaves no curve",
            remedy=f"{LEAST_ROWS} or more, or none",
        )
    return rows


def thinned_specimen(specimen: Specimen, rows: int) -> ThinnedSpecimen:
    """Average consecutive rows.

    Parameters
    ----------
    specimen : Specimen
    rows : int
        Rows at most that are left of each protocol, those at rest apart; 0 for all of them.

    Returns
    -------
    ThinnedSpecimen
    """
    protocols, scatter, weight = [], [], []
    for protocol in specimen.protocols:
        count = protocol.rows - protocol.rest_rows
        size = -(-count // rows) if rows else 1
        load = specimen.load(protocol)[protocol.rest_rows :]
        # Even groups: a short last one would count as a whole one, where the misfit is largest.
        groups = -(-count // max(size, 1))
        starts = np.arange(groups) * count // max(groups, 1)
        protocols.append(_averaged(protocol, starts) if size > 1 else protocol)
        scatter.append(_scatter(load, starts) if size > 1 else np.zeros_like(load))
        weight.append(count / max(len(starts), 1))
    thinned = replace(specimen, protocols=tuple(protocols))
    return ThinnedSpecimen(thinned, tuple(scatter), tuple(weight))


def averaged_specimen(specimen: Specimen, rows: int) -> Specimen:
    """The specimen with rows averaged, and the load noise of its own rows.

    Averaging removes the scatter of neighbouring rows from which the noise would be estimated.
    """
    averaged = thinned_specimen(specimen, rows).specimen
    return replace(averaged, load_noise=specimen.noise_sd or None)


def _averaged(protocol: Protocol, starts: np.ndarray) -> Protocol:
    rest = protocol.rest_rows

    def mean(column: np.ndarray) -> np.ndarray:
        tail = column[rest:]
        sizes = np.diff([*starts, tail.size])
        return np.concatenate([column[:rest], np.add.reduceat(tail, starts) / sizes])

    time_s = None if protocol.time_s is None else mean(protocol.time_s)
    return replace(
        protocol,
        stretch_x=mean(protocol.stretch_x),
        stretch_y=mean(protocol.stretch_y),
        load_x=mean(protocol.load_x),
        load_y=mean(protocol.load_y),
        time_s=time_s,
    )


def _scatter(load: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Mean square about a straight line in each group of rows, shape (groups, 2).

    A line through k readings leaves k - 2 of k - 1 parts of their scatter. In groups of two
    nothing is left of it; they get what the others of the record have.
    """
    out = np.full((len(starts), 2), np.nan)
    ends = [*starts[1:], len(load)]
    for i, (first, last) in enumerate(zip(starts, ends, strict=True)):
        k = last - first
        if k == 1:
            out[i] = 0.0
        elif k > 2:
            t = np.arange(k) - 0.5 * (k - 1)
            y = load[first:last] - load[first:last].mean(axis=0)
            slope = t @ y / (t @ t)
            out[i] = ((y - t[:, None] * slope) ** 2).sum(axis=0) * (k - 1) / (k - 2) / k
    pairs = np.isnan(out[:, 0])
    if pairs.any():
        # var(second difference) = 6 sd^2; the mean square of two about their mean is sd^2 / 2
        bend = np.diff(load, n=2, axis=0)
        out[pairs] = (bend**2).mean(axis=0) / 12.0 if len(bend) else 0.0
    return out
