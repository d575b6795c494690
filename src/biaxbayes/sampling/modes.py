"""Separate modes of a density, and Laplace's approximation at each.

No diagnostic notices a mode that all walkers miss: climbs start from very different points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse.csgraph import connected_components

from biaxbayes.sampling.target import LogDensity

MAX_NEWTON_STEPS = 40
STEP_FACTORS = np.array([1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 1e-3])
MAX_CURVATURE = 1e14  # curvature in units of scale; beyond it differences are noise
BOUND_MARGIN = 1e-3
"""Distance from the bounds that a climb keeps."""
DIFFERENCE = 0.3
"""Step of finite differences, in conditional sds of a coordinate."""
MIN_RISE = 1e-2
"""Rise of the log density below which a start is good enough."""


def local_mode(
    log_density: LogDensity,
    start: np.ndarray,
    scale: np.ndarray,
    bounds: np.ndarray,
    *,
    least_rise: float = MIN_RISE,
    step: float = DIFFERENCE,
) -> tuple[np.ndarray, np.ndarray]:
    """Climb to a mode (d,) by damped Newton steps on finite differences, inside the bounds.

    Many points at once cost microseconds, so finite differences suffice. The climb ends where a
    step raises the log density by less than ``least_rise``; differences are over ``step``
    conditional sds. Also returns a square root (d, d) of the covariance of the local Gaussian
    approximation, its widths limited to ``scale``: beyond it a direction counts as not determined.
    """
    low, high = bounds[:, 0] + BOUND_MARGIN, bounds[:, 1] - BOUND_MARGIN
    x = np.clip(start, low, high)
    value = float(log_density(x[None])[0])
    over = 0.02 * scale
    factor = np.diag(scale)
    for _ in range(MAX_NEWTON_STEPS):
        gradient, hessian = _differences(log_density, x, value, over, low, high)
        # Directions in units of scale, so that the eigenvalues compare with one.
        h = -hessian * np.outer(scale, scale)
        if not (np.isfinite(h).all() and np.isfinite(gradient).all()):
            break
        try:
            curvature, directions = np.linalg.eigh(0.5 * (h + h.T))
        except np.linalg.LinAlgError:
            break
        curvature = np.clip(np.abs(curvature), 1.0, MAX_CURVATURE)
        factor = scale[:, None] * directions / np.sqrt(curvature)
        move = factor @ (factor.T @ gradient)
        candidates = np.clip(x + STEP_FACTORS[:, None] * move, low, high)
        values = log_density(candidates)
        best = int(np.argmax(values))
        rise = float(values[best]) - value
        if rise > 0.0:
            x, value = candidates[best], float(values[best])
        # The conditional sd of each coordinate is from the diagonal of the precision.
        over = step * scale / np.sqrt((directions**2 * curvature).sum(axis=1))
        if rise < least_rise:
            break
    return x, factor


def _differences(
    log_density: LogDensity,
    x: np.ndarray,
    value: float,
    step: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian by central differences, moved inward at a bound."""
    d = x.size
    room = np.minimum(x - low, high - x)
    step = np.minimum(step, np.where(np.isfinite(room), np.maximum(0.9 * room, 1e-5), step))
    eye = np.diag(step)
    i, j = np.triu_indices(d, 1)
    points = np.concatenate([x + eye, x - eye, x + eye[i] + eye[j], x - eye[i] - eye[j]])
    values = np.maximum(log_density(points), value - 1e6)
    plus, minus = values[:d], values[d : 2 * d]
    both = values[2 * d : 2 * d + i.size] + values[2 * d + i.size :]
    gradient = (plus - minus) / (2.0 * step)
    hessian = np.diag((plus - 2.0 * value + minus) / step**2)
    # f(+,+) + f(-,-) - f(+i) - f(-i) - f(+j) - f(-j) + 2 f = 2 h_i h_j H_ij
    cross = both - plus[i] - minus[i] - plus[j] - minus[j] + 2.0 * value
    hessian[i, j] = hessian[j, i] = cross / (2.0 * step[i] * step[j])
    return gradient, hessian


MAX_MODES = 6
NEGLIGIBLE_LOG_MASS = 9.0
"""Log mass, and log height, below those of the best at which a mode is left out."""
SAME_MODE_DISTANCE = 2.0
"""Two modes count as one below this distance, root mean square per dimension, in local sds."""


@dataclass(frozen=True)
class Mode:
    """A mode with Laplace's approximation there."""

    location: np.ndarray  # (d,)
    factor: np.ndarray  # (d, d), square root of the local covariance, widths limited
    log_mass: float  # log p(location) + ln |factor| + d/2 ln 2 pi
    height: float = 0.0  # log p(location)


def find_modes(
    log_density: LogDensity, starts: np.ndarray, scale: np.ndarray, bounds: np.ndarray
) -> list[Mode]:
    """Climb from every start (n, d); the different modes that matter, the heaviest first."""
    # A start on a bound has its density, if any, next to it.
    inner = np.clip(starts, bounds[:, 0] + BOUND_MARGIN, bounds[:, 1] - BOUND_MARGIN)
    modes = []
    for start in inner[np.isfinite(log_density(inner))]:
        location, factor = local_mode(log_density, start, scale, bounds)
        height = float(log_density(location[None])[0])
        _, log_volume = np.linalg.slogdet(factor)
        log_mass = height + float(log_volume) + 0.5 * location.size * np.log(2.0 * np.pi)
        modes.append(Mode(location, factor, log_mass, height))
    modes.sort(key=lambda mode: -mode.log_mass)
    distinct: list[Mode] = []
    for mode in modes:
        lost_mass = modes[0].log_mass - mode.log_mass
        lost_height = max(m.height for m in modes) - mode.height
        matters = min(lost_mass, lost_height) < NEGLIGIBLE_LOG_MASS
        if matters and not any(_same(mode, m) for m in distinct):
            distinct.append(mode)
    return distinct[:MAX_MODES]


MAX_SADDLE_DEPTH = 3.0
"""Modes are in one cluster where the log density falls by less than this between them."""
LINE_POINTS = 33
"""Points of the straight line between two modes at which that is tested."""


def mode_clusters(log_density: LogDensity, modes: list[Mode]) -> list[list[Mode]]:
    """Clusters of modes that straight lines of high density join, in the order of the modes."""
    t = np.linspace(0.0, 1.0, LINE_POINTS)[:, None]
    connected = np.eye(len(modes))
    for i, j in combinations(range(len(modes)), 2):
        between = log_density((1.0 - t) * modes[i].location + t * modes[j].location)
        connected[i, j] = between.min() > min(modes[i].height, modes[j].height) - MAX_SADDLE_DEPTH
    count, label = connected_components(connected, directed=False)
    return [
        [m for m, k in zip(modes, label, strict=True) if k == cluster] for cluster in range(count)
    ]


def _same(first: Mode, second: Mode) -> bool:
    """Test whether two modes are within the local widths of both."""
    offset = first.location - second.location
    z = np.array([np.linalg.solve(m.factor, offset) for m in (first, second)])
    return bool((np.sqrt((z**2).mean(axis=1)) < SAME_MODE_DISTANCE).all())
