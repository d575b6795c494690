"""Single draws that stand for a posterior: the median draw, the most probable one, a sample.

A vector of parameter-wise medians is no material of the posterior: where parameters trade with
each other its curves may lie outside every band. A draw is one.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.findings.material_draws import parameters, protocol_mounting
from biaxbayes.mechanics.goh import piola_stress
from biaxbayes.specimens.specimen import Specimen

__all__ = ["chosen_draws", "common_states", "median_draw", "most_probable_draw", "random_draws"]

STATES = 60  # of each protocol, evenly along the record


def common_states(draws: pd.DataFrame, specimen: Specimen) -> list[np.ndarray]:
    """Total stretches at which draws are compared, one array (m, 2) a protocol.

    The measured stretches times the posterior median of the mounting stretch: the same states
    for every draw, so that only the material differs.
    """
    out = []
    for protocol in specimen.protocols:
        index = np.unique(np.linspace(0, protocol.rows - 1, STATES).round().astype(int))
        measured = np.column_stack([protocol.stretch_x, protocol.stretch_y])[index]
        out.append(measured * np.median(protocol_mounting(draws, protocol), axis=0))
    return out


def median_draw(draws: pd.DataFrame, specimen: Specimen, *, fibre_switch: bool = False) -> int:
    """Row of the draw whose stress curves lie nearest the median curves.

    Parameters
    ----------
    draws : DataFrame
        Posterior draws.
    specimen : Specimen
    fibre_switch : bool

    Returns
    -------
    int
        Position in ``draws``. The distance is the sum of squares over directions and protocols,
        each curve in units of the largest value of its median curve.
    """
    distance = np.zeros(len(draws))
    for states in common_states(draws, specimen):
        for curve in piola_stress(*parameters(draws), *states.T, fibre_switch=fibre_switch):
            median = np.median(curve, axis=0)
            scale = max(float(np.abs(median).max()), 1e-300)
            distance += np.square((curve - median) / scale).mean(axis=1)
    return int(np.argmin(distance))


def most_probable_draw(draws: pd.DataFrame) -> int:
    """Row of the draw with the highest posterior density (column ``lp``).

    A density depends on its coordinates: here ln C1, ln k1, ln k2, alpha and kappa, the mounted
    state and the logarithm of the noise.

    Raises
    ------
    InputError
        If the draws carry no density.
    """
    if "lp" not in draws:
        raise InputError(
            "this run stores no posterior density of its draws", remedy="use --at median"
        )
    return int(np.argmax(draws["lp"].to_numpy(dtype=float)))


def random_draws(draws: pd.DataFrame, count: int, *, seed: int = 0) -> list[int]:
    """Rows of a random sample without replacement, in rising order.

    Raises
    ------
    InputError
        If there are fewer draws than asked for, or fewer than one is asked for.
    """
    if not 1 <= count <= len(draws):
        raise InputError(
            f"{count} draws asked for", remedy=f"the run holds {len(draws)}: ask for 1 to that many"
        )
    chosen = np.random.default_rng(seed).choice(len(draws), size=count, replace=False)
    return sorted(int(i) for i in chosen)


def chosen_draws(
    draws: pd.DataFrame,
    specimen: Specimen,
    *,
    count: int | None = None,
    at: str = "median",
    seed: int = 0,
    fibre_switch: bool = False,
) -> tuple[list[int], str]:
    """Positions of the draws to export, and what they are in words.

    Parameters
    ----------
    draws : DataFrame
    specimen : Specimen
    count : int, optional
        So many random draws; else one.
    at : {"median", "map"}
        Which one.
    seed : int
    fibre_switch : bool
    """
    if count is not None:
        return random_draws(draws, count, seed=seed), f"random posterior draw, seed {seed}"
    if at == "map":
        return [most_probable_draw(draws)], "most probable posterior draw"
    row = median_draw(draws, specimen, fibre_switch=fibre_switch)
    return [row], "posterior draw with the stress curves nearest the median curves"
