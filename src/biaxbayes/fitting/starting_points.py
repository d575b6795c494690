"""Starting points of deterministic fits, and their fixed parameters.

Many random materials are screened, each with its best amplitudes (:mod:`biaxbayes.laws.screening`),
and the best of them that differ from one another are chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.laws.screening import Screening, screen
from biaxbayes.specimens.rows import MeasuredRows

SCREENING_ROWS = 24  # of each protocol, enough to rank starting points
CANDIDATES = 512


def screened_points(
    data: MeasuredRows,
    count: int,
    rng: np.random.Generator,
    law: Law,
    *,
    point: np.ndarray,
    free: np.ndarray,
    with_mounting: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The best random materials (count, p) that differ, with mounting stretches (count, 2)."""
    # mounting readings first
    rows, states = data.chosen(SCREENING_ROWS), len(data.piece_of_state) * with_mounting
    stretch = np.vstack([np.ones((states, 2)), rows.stretch])
    load = np.vstack([data.mounting_load[:states], rows.load])
    piece = np.concatenate([data.piece_of_state[:states], rows.piece])
    for i, of_piece in enumerate(data.pieces):
        own = piece == i
        stresses = of_piece.experiment.stresses(stretch[own], load[own])
        if stresses is None:  # in kPa of the unloaded or mounted section
            load[own] /= of_piece.area
        else:  # P = s / l, none across free sides
            load[own] = np.nan_to_num(stresses / stretch[own])
    side = np.array([-1 if p.experiment.free_side is None else p.experiment.free_side
                     for p in data.pieces])[piece]  # fmt: skip
    unloaded = np.array([p.geometry != "mounted" for p in data.pieces])[piece, None]

    def factor(total: np.ndarray) -> np.ndarray:
        # per kPa of Cauchy stress, P = s / (l lm) of the unloaded section, s / l of the mounted one
        return 1.0 / np.where(unloaded, total, np.nan_to_num(stretch, nan=1.0))

    readings = Screening(stretch, load, side, with_mounting, point, free, CANDIDATES, factor)
    with np.errstate(all="ignore"):
        points, mounting, cost, features = screen(law, readings, rng)
    chosen = _distinct_points(cost, features, count)
    return points[chosen], mounting[chosen]


def _distinct_points(cost: np.ndarray, features: np.ndarray, count: int) -> np.ndarray:
    """Indices of low costs, no two close to each other while there is a choice."""
    order = np.argsort(cost, kind="stable")
    chosen: list[int] = []
    for distance in (0.25, 0.1, 0.0):
        for i in order:
            if len(chosen) == count:
                return np.array(chosen, dtype=int)
            near = [
                j for j in chosen if np.abs(features[i] - features[j]).max(initial=0.0) < distance
            ]
            if i not in chosen and not near:
                chosen.append(int(i))
    return np.array(chosen, dtype=int)


def fixed_and_free(fixed: Mapping[str, float] | None, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Fixed values as coordinates of the fit, and the indices of the free ones."""
    values = np.zeros(len(law.names))
    given = {law.known_name(name): value for name, value in dict(fixed or {}).items()}
    for name, value in given.items():
        if name not in law.names:
            raise InputError(
                f"unknown parameter {name!r} of the law {law.name}",
                remedy=f"one of {', '.join(law.names)}",
            )
        p = law.parameter(name)
        low, high = p.low, min(p.high, p.largest)
        if not (math.isfinite(value) and low <= value <= high + 1e-12):
            raise InputError(
                f"{name} = {value:g} is out of range",
                remedy=f"{name} lies between {low:g} and {high:g}{p.unit_words()}",
            )
        values[law.names.index(name)] = min(value, high)
    law.check_condition(given)
    point = np.where([n in given for n in law.names], law.to_fit_coordinates(tuple(values)), 0.0)
    return point, np.array([i for i, name in enumerate(law.names) if name not in given], dtype=int)
