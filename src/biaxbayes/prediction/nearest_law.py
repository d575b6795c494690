"""The law nearest to each drawn tissue on the tested paths: what a simulation should use.

A drawn law and its misfit (its mean given the readings) share the curve of the tissue, T = f(theta,
lm) + delta, so that the law alone need not pass through the readings. At the drawn mounting
stretch lm this finds the parameters of the smallest relative distance

    min over theta of  sqrt(mean ((f(theta, lm) - T) / D)^2)      D = sqrt(T^2 + (0.05 peak)^2)

over the tested rows of all pieces, peak the largest |T| of a curve.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from biaxbayes.evenly import evenly_chosen
from biaxbayes.forward import ForwardModel
from biaxbayes.model.misfit import FLOOR
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.prediction.draws import median_draw
from biaxbayes.prediction.tissue import Tissue

ROWS = 30
"""Rows of a protocol, evenly chosen, that laws are compared at."""
EVALUATIONS = 60
"""Evaluations of a descent; on the shipped specimens 10 to 30 were enough."""
TO_TISSUE, TO_READINGS = "distance_to_tissue", "distance_to_readings"
"""Columns of :func:`nearest_laws`."""


@dataclass(frozen=True)
class _Curve:
    """A tested path of a piece; loads (draws, n, 2) on the scale of the law's loads."""

    forward: ForwardModel
    stretch: np.ndarray  # (n, 2), measured
    mounting: np.ndarray  # (draws, 2)
    axes: list[int]
    factor: np.ndarray  # (draws, 1, 2): load of the piece per load of the law at its stated section
    tissue: np.ndarray
    reading: np.ndarray
    scale: np.ndarray

    def residuals(self, draw: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Relative residuals of a law to the tissue, and their derivatives; flat."""
        lm = np.broadcast_to(self.mounting[draw], self.stretch.shape)
        at = self.forward.response(point, self.stretch, lm)
        scale = self.scale[draw]
        residual = (at.load * self.factor[draw] - self.tissue[draw]) / scale
        slope = at.by_fit_coordinate * (self.factor[draw] / scale)[..., None]
        return residual[:, self.axes].ravel(), slope[:, self.axes].reshape(-1, point.size)

    def to_readings(self, draw: int, point: np.ndarray) -> np.ndarray:
        """Relative residuals of a law to the readings; flat."""
        residual, _ = self.residuals(draw, point)
        apart = (self.tissue[draw] - self.reading[draw]) / self.scale[draw]
        return np.asarray(residual + apart[:, self.axes].ravel())


def nearest_laws(posterior: Posterior, draws: pd.DataFrame) -> pd.DataFrame:
    """The draws with the parameters of the law nearest to the tissue of each, 10 to 60 ms a draw.

    Fixed and tied parameters stay as drawn; ``distance_to_tissue`` and ``distance_to_readings`` are
    relative root mean squares.
    """
    law = posterior.law
    free = [i for i, n in enumerate(law.names) if isinstance(posterior.priors[n], Prior)]
    lower, upper = law.lower[free], law.upper[free]
    how: dict[str, Any] = {"bounds": (lower, upper), "x_scale": "jac", "max_nfev": EVALUATIONS}
    curves = list(_curves(posterior, draws))
    drawn = draws[list(law.names)].to_numpy(dtype=float)
    values, distances = [], []
    for i, theta in enumerate(drawn):
        start = np.array(law.to_fit_coordinates(tuple(theta)))

        def point_of(x: np.ndarray, start: np.ndarray = start) -> np.ndarray:
            point = start.copy()
            point[free] = x
            return point

        def residuals(x: np.ndarray, i: int = i) -> np.ndarray:
            parts = [curve.residuals(i, point_of(x))[0] for curve in curves]
            return np.nan_to_num(np.concatenate(parts), nan=1e6, posinf=1e6, neginf=-1e6)

        def slopes(x: np.ndarray, i: int = i) -> np.ndarray:
            parts = [curve.residuals(i, point_of(x))[1][:, free] for curve in curves]
            return np.nan_to_num(np.concatenate(parts), posinf=1e6, neginf=-1e6)

        inside = np.clip(start[free], lower + 1e-9 * (upper - lower), upper)
        with np.errstate(all="ignore"):
            found = least_squares(residuals, inside, slopes, **how)
            point = point_of(found.x)
            to_readings = np.concatenate([c.to_readings(i, point) for c in curves])
        values.append(law.from_fit_coordinates(point))
        distances.append([np.sqrt(np.mean(r**2)) for r in (found.fun, to_readings)])
    out = draws.copy()
    out[list(law.names)] = np.array(values)
    out[[TO_TISSUE, TO_READINGS]] = np.array(distances)
    return out


MEDIAN_OF, SPREAD_OF = 24, 120
"""Draws, evenly chosen, among whose nearest laws the median one is chosen, and of all of which the
spread is taken: the 5 % point of 24 draws is about the second least."""


def median_nearest_law(posterior: Posterior, draws: pd.DataFrame) -> tuple[pd.DataFrame, int]:
    """Nearest laws of some draws, and which row of all draws has the one with the median curves."""
    rows = evenly_chosen(len(draws), MEDIAN_OF)
    laws = nearest_laws(posterior, draws.iloc[rows])
    return laws, int(rows[median_draw(laws, posterior.specimen, posterior.law)])


def simulation_table(posterior: Posterior, draws: pd.DataFrame) -> pd.DataFrame:
    """The median nearest law, and the spread of many: a row per parameter, and per distance."""
    few, row = median_nearest_law(posterior, draws)
    laws = nearest_laws(posterior, draws.iloc[evenly_chosen(len(draws), SPREAD_OF)])
    units = {p.name: p.unit for p in posterior.law.parameters}
    return pd.DataFrame(
        [
            {
                "quantity": name,
                "unit": units.get(name, "1"),
                "median_card": float(few.loc[draws.index[row], name]),
                "q05": float(laws[name].quantile(0.05)),
                "q95": float(laws[name].quantile(0.95)),
            }
            for name in (*posterior.law.names, TO_TISSUE, TO_READINGS)
        ]
    )


def drawn_distances(posterior: Posterior, draws: pd.DataFrame) -> np.ndarray:
    """Relative root mean square distance of each drawn law to the readings, (draws,)."""
    law, curves = posterior.law, list(_curves(posterior, draws))
    points = [law.to_fit_coordinates(tuple(v)) for v in draws[list(law.names)].to_numpy(float)]
    with np.errstate(all="ignore"):
        parts = [
            np.concatenate([c.to_readings(i, np.array(p)) for c in curves])
            for i, p in enumerate(points)
        ]
    return np.array([np.sqrt(np.mean(part**2)) for part in parts])


def _curves(posterior: Posterior, draws: pd.DataFrame) -> Iterator[_Curve]:
    """The tested paths of all pieces."""
    for k, piece in enumerate(posterior.pieces):
        tissue = Tissue(posterior, draws, piece=k)
        specimen = piece.specimen.as_compared(posterior.settings.mounting)
        # the section and stiffness of each draw over those that the piece states
        factor = piece.forward.section(draws) / piece.forward.area
        for i, protocol in enumerate(specimen.protocols):
            rows = np.arange(protocol.rest_rows, protocol.rows)
            rows = rows[evenly_chosen(rows.size, ROWS)]
            loads = tissue.tested(i, protocol.stretch, rows)
            offset = piece.forward.offset(draws)
            load = np.broadcast_to(loads.mean, loads.law.shape) - offset
            peak = np.abs(load).max(axis=1, keepdims=True)
            lm = piece.forward.mounting_stretch(draws, protocol.name)[:, 0]
            yield _Curve(
                piece.forward,
                protocol.stretch[rows],
                np.broadcast_to(lm, (len(draws), 2)),
                list(specimen.experiment.axes),
                np.broadcast_to(factor, (len(draws), 1, 2)),
                load,
                specimen.load(protocol)[rows] - np.broadcast_to(offset, load.shape),
                np.sqrt(load**2 + (FLOOR * peak) ** 2),
            )
