"""Stress that the posterior predicts on any path of stretches, and which paths a test covered."""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen, evenly_spaced
from biaxbayes.mechanics.mounting import with_free_side
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import PredictionOptions
from biaxbayes.prediction.draws import (
    mounting_labels,
    mounting_stretch,
    protocol_mounting,
    with_free_sides,
)
from biaxbayes.prediction.percentiles import band_columns, tails
from biaxbayes.prediction.tissue import Tissue
from biaxbayes.specimens.specimen import Specimen

# --- what a test covered: the convex hull of its states of stretch, and what lies outside it -----


INSIDE = "no"
BELOW = "below the mounted state"
BEYOND = "beyond the tested range"
OFF_PATH = "off the tested paths"

RELATIVE_TOLERANCE = 0.05  # of the tested range: a path this close beside a tested one counts
ABSOLUTE_TOLERANCE = 1e-6


class CoveredStretches:
    """States that protocols visited; ``mounting_stretch`` is one pair, or (protocols, 2).

    ``low`` and ``high`` (2,) are their range. Within ``slack`` a path counts as one that was
    tested: one that starts at the unloaded state and runs beside a tested one, as far off as the
    mounting stretch moved that, was tested as well as it could be.
    """

    def __init__(
        self, specimen: Specimen, mounting_stretch: tuple[float, float] | np.ndarray = (1.0, 1.0)
    ) -> None:
        from scipy.spatial import ConvexHull, QhullError

        factor = np.broadcast_to(np.asarray(mounting_stretch, float), (len(specimen.protocols), 2))
        pairs = zip(specimen.protocols, factor, strict=True)
        state = np.vstack([p.stretch * lm for p, lm in pairs])
        self.low, self.high = state.min(axis=0), state.max(axis=0)
        shift = float(np.max(np.linalg.norm(factor - 1.0, axis=1)))
        reach = float((self.high - self.low).max())
        self.slack = RELATIVE_TOLERANCE * reach + shift + ABSOLUTE_TOLERANCE
        # corners (m, 2), anticlockwise; one or two when the states lie on a point or a line
        self.hull = np.unique(state[np.isfinite(state).all(axis=1)], axis=0)  # by x, then y
        if len(self.hull) > 2:
            try:
                self.hull = self.hull[ConvexHull(self.hull).vertices]
            except QhullError:
                self.hull = self.hull[[0, -1]]

    def extrapolation(self, stretch_x, stretch_y) -> np.ndarray:
        """Position of states (n,) relative to the tested ones.

        :data:`INSIDE`; :data:`BELOW` a smallest, :data:`BEYOND` a largest tested stretch; or
        :data:`OFF_PATH`: each stretch was tested, but not together.
        """
        state = np.column_stack([np.ravel(stretch_x), np.ravel(stretch_y)]).astype(float)
        label = np.full(len(state), INSIDE, dtype=object)
        label[_distance(self.hull, state) > self.slack] = OFF_PATH
        # A range's own ends count as tested to the rounding of the file only.
        label[(state < self.low - ABSOLUTE_TOLERANCE).any(axis=1)] = BELOW
        # NaN is not a tested state either.
        label[~(state <= self.high + ABSOLUTE_TOLERANCE).all(axis=1)] = BEYOND
        return label.astype(str)


def _distance(hull: np.ndarray, points: np.ndarray, *, closed: bool = True) -> np.ndarray:
    """Distance of points from a convex polygon, zero inside it; or from an open line."""
    start, end = hull, np.roll(hull, -1, axis=0)
    if not closed and len(hull) > 1:
        start, end = hull[:-1], hull[1:]
    edge = end - start
    offset = points[:, None, :] - start[None, :, :]
    length = np.maximum((edge**2).sum(axis=1), 1e-300)
    along = np.clip((offset * edge).sum(axis=2) / length, 0.0, 1.0)
    nearest = np.linalg.norm(offset - along[:, :, None] * edge, axis=2).min(axis=1)
    if len(hull) < 3 or not closed:
        return nearest
    cross = edge[:, 0] * offset[:, :, 1] - edge[:, 1] * offset[:, :, 0]
    return np.where((cross >= 0.0).all(axis=1), 0.0, nearest)


# --- stress that the posterior predicts on any path of stretches ---------------------------------


MAX_DRAWS = 4000
"""Draws that carry the bands, evenly chosen: enough for their percentiles."""
MAX_STRESS_BLOCK = 2_000_000  # numbers in memory at once


def stretch_path(
    largest: float, *, ratio: tuple[float, float] = (1.0, 1.0), points: int = 51
) -> np.ndarray:
    """A straight path (points, 2) from 1 to the largest stretch; ``ratio`` is each share of it."""
    rise = np.asarray(ratio, dtype=float)
    if not np.isfinite(rise).all() or np.abs(rise).max() == 0.0:
        raise InputError(f"a stretch ratio of {rise[0]:g}:{rise[1]:g} stretches nothing")
    return 1.0 + np.linspace(0.0, largest - 1.0, points)[:, None] * rise / np.abs(rise).max()


def predict_stress(
    posterior: Posterior,
    draws: pd.DataFrame,
    path: np.ndarray,
    *,
    relative_to: str = "mounted",
    protocol: str | None = None,
    stress: str = "cauchy",
    strip: str | None = None,
    probability: float = PredictionOptions.probability,
) -> pd.DataFrame:
    """Stress along a path of stretches (m, 2), with credible and predictive bands.

    The credible band holds the tissue's own stress, that of the law and its misfit; the predictive
    band holds a new measurement of it. Each is a percentile range over the draws, row by row.

    ``path`` is ``relative_to`` the mounted state (of a ``protocol``, where each has its own) or the
    unloaded one; ``stress`` is cauchy, or piola with the unloaded state as reference. Of a
    ``strip`` along x or y the side takes the stretch at which it carries no stress, in each draw,
    whatever the path says. ``probability`` is the content of each band.

    One row per state: ``stretch_x``, ``stretch_y`` as given (across a strip the median),
    ``total_stretch_x`` and ``total_stretch_y`` (posterior medians), five columns of each direction
    that is pulled such as ``cauchy_x_kPa_median``, and ``extrapolation``. InputError if an option
    does not fit the run, a stretch is not positive, or a stress overflows.
    """
    path = np.asarray(path, dtype=float)
    if path.ndim != 2 or path.shape[1] != 2 or not len(path):
        raise InputError("a path needs a stretch in x and one in y in every row")
    free_sides = [] if strip is None else ["yx".index(strip)]
    if not (np.isfinite(path).all() and (path > 0.0).all()):
        raise InputError("stretches must be positive numbers")
    if relative_to not in ("unloaded", "mounted") or stress not in ("cauchy", "piola"):
        raise InputError("relative_to is mounted or unloaded, stress is cauchy or piola")
    tails(probability)  # refused before anything is computed
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    forward = posterior.forward
    specimen = with_free_sides(draws, posterior.specimen, posterior.law)
    lm = prediction_mounting(draws, specimen, protocol, needed=relative_to == "mounted")
    factor = lm if relative_to == "mounted" else np.ones_like(lm)
    material = forward.law.material(draws)
    for side in free_sides:
        few = evenly_chosen(len(draws), MEASURED_DRAWS)
        some = path[None] * factor[few, None]
        some[..., side] = np.nan
        some = with_free_side(forward.law.material(draws.iloc[few]).cauchy, some, side)
        path = path.copy()
        path[:, side] = np.median(some[..., side] / factor[few, side, None], axis=0)
    # the misfit belongs to the measured stretches; its loads to a nominal stress by the section
    measured = path if relative_to == "mounted" else path / np.median(lm, axis=0)
    section = forward.unloaded_section(draws, lm[:, None])
    misfit, misfit_sd, noise_sd = Tissue(posterior, draws).nominal_misfit(measured, section)
    blocks = []
    rows = max(1, MAX_STRESS_BLOCK // max(len(draws), 1))
    for first in range(0, len(path), rows):
        part = slice(first, first + rows)
        total = path[None, part, :] * factor[:, None, :]
        for side in free_sides:
            total[..., side] = np.nan
            total = with_free_side(material.cauchy, total, side)
        with np.errstate(over="ignore", invalid="ignore"):
            model = material.piola(total[:, :, 0], total[:, :, 1])
        finite = np.isfinite(model).all(axis=(0, 1))
        if not finite.all():
            x, y = path[first + int(np.argmin(finite))]
            raise InputError(
                f"the stress of some draws overflows at stretches of {x:g} and {y:g}"
                + ", or a free side has no stable state" * bool(free_sides),
                remedy="end the path earlier: nothing was tested near there",
            )
        columns: dict[str, np.ndarray] = {}
        for axis in (k for k in (0, 1) if k not in free_sides):
            name = "xy"[axis]
            scale = total[:, :, axis] if stress == "cauchy" else 1.0  # s_k = l_k P_k
            mean, sd = model[axis] + misfit[:, part, axis], misfit_sd[:, part, axis]
            noise = np.broadcast_to(noise_sd, misfit.shape)[:, part, axis]
            reading_sd = np.hypot(sd, noise)
            columns |= band_columns(
                f"{stress}_{name}_kPa", mean * scale, sd * scale, reading_sd * scale, probability
            )
        blocks.append(pd.DataFrame(columns))
    middle = path * np.median(factor, axis=0)
    head = {
        "stretch_x": path[:, 0],
        "stretch_y": path[:, 1],
        "total_stretch_x": middle[:, 0],
        "total_stretch_y": middle[:, 1],
    }
    where = prediction_range(draws, specimen, protocol, relative_to).extrapolation(*path.T)
    table = pd.concat(blocks, ignore_index=True)
    return pd.concat([pd.DataFrame(head), table, pd.DataFrame({"extrapolation": where})], axis=1)


MEASURED_ROWS, MEASURED_DRAWS = 200, 200
"""Readings of a protocol, and draws that their stresses are the medians of."""


def measured_stress(
    posterior: Posterior,
    draws: pd.DataFrame,
    path: np.ndarray,
    *,
    relative_to: str = "mounted",
    protocol: str | None = None,
    stress: str = "cauchy",
) -> pd.DataFrame:
    """Measured stresses along a path of stretches; arguments as in :func:`predict_stress`.

    One row per reading of a protocol that runs along the path, at most 200 of each: ``protocol``,
    ``stretch_x`` and ``stretch_y`` relative to the chosen state, and for each direction medians
    over the draws such as ``cauchy_x_kPa`` and ``cauchy_x_kPa_residual``, the reading less that of
    the tissue, the law and its misfit, at the state it was taken at. A file's sections and the
    mounting stretch, which make a stress of a reading, are those of each draw.
    """
    specimen = with_free_sides(draws, posterior.specimen, posterior.law)
    specimen = specimen.as_compared(posterior.settings.mounting)
    if not specimen.experiment.is_mounted:
        return pd.DataFrame()  # a pressure is not a stress
    draws = draws.iloc[evenly_chosen(len(draws), MEASURED_DRAWS)]
    own = np.ones(2)
    if relative_to == "mounted":
        own = np.median(prediction_mounting(draws, specimen, protocol), axis=0)
    covered = prediction_range(draws, specimen, protocol, relative_to)
    forward, tissue = posterior.forward, Tissue(posterior, draws)
    tables = []
    for i, p in enumerate(specimen.protocols):
        rows = evenly_spaced(p.rows, MEASURED_ROWS)
        stretch = p.stretch[rows]
        lm = protocol_mounting(draws, p)
        state = stretch * np.median(lm, axis=0) / own
        near = _distance(path, state, closed=False) <= covered.slack
        reached = _distance(state, path[-1:], closed=False)[0] <= covered.slack
        if not (near[-1] or reached):
            continue  # all protocols begin near a path; one that runs along it ends there, too
        stretch, state, rows = stretch[near], state[near], rows[near]
        total = stretch[None] * lm[:, None, :]
        section, read = forward.unloaded_section(draws, lm[:, None]), specimen.load(p)[rows]
        piola = (read - forward.offset(draws)) / section
        of_tissue = tissue.tested(i, posterior.specimen.protocols[i].stretch, rows).mean
        missed = (read - of_tissue) / section
        table = {"protocol": p.name, "stretch_x": state[:, 0], "stretch_y": state[:, 1]}
        for axis, name in enumerate("xy"):
            scale = total[..., axis] if stress == "cauchy" else 1.0  # s_k = l_k P_k
            table[f"{stress}_{name}_kPa"] = np.median(piola[..., axis] * scale, axis=0)
            residual = np.median(missed[..., axis] * scale, axis=0)
            table[f"{stress}_{name}_kPa_residual"] = residual
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def prediction_mounting(
    draws: pd.DataFrame, specimen: Specimen, protocol: str | None, *, needed: bool = False
) -> np.ndarray:
    """Mounting stretches (n, 2) of a protocol, or the mean over several if none is ``needed``."""
    labels = mounting_labels(draws, specimen)
    if labels in ((), ("",)):
        return mounting_stretch(draws)
    if protocol is None and needed:
        raise InputError(
            "each protocol has a mounted state of its own, so a measured stretch needs a protocol",
            remedy=f"name the protocol: {', '.join(labels)}",
        )
    if protocol is None:
        return np.mean([mounting_stretch(draws, label) for label in labels], axis=0)
    if protocol not in labels:
        raise InputError(
            f"no protocol {protocol!r} in this run", remedy=f"it has {', '.join(labels)}"
        )
    return mounting_stretch(draws, protocol)


def prediction_range(
    draws: pd.DataFrame, specimen: Specimen, protocol: str | None, relative_to: str
) -> CoveredStretches:
    """The tested range, in the stretches of the prediction."""
    own = np.ones(2)
    if relative_to == "mounted":
        # Other protocols' states, referred to the mounted state of this one.
        own = np.median(prediction_mounting(draws, specimen, protocol), axis=0)
    lms = [np.median(protocol_mounting(draws, p), axis=0) / own for p in specimen.protocols]
    return CoveredStretches(specimen, np.array(lms))
