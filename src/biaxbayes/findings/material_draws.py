"""Posterior draws as arrays: materials, mounted states, and the noise of a new reading."""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.mechanics.goh import GOH, PARAMETERS, fibre_strain, structure_tensor
from biaxbayes.specimens.specimen import Protocol, Specimen

__all__ = [
    "fibre_strains",
    "material",
    "mounting_labels",
    "mounting_stretch",
    "parameters",
    "piola_noise",
    "protocol_mounting",
]


Parameters = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def parameters(draws: pd.DataFrame) -> Parameters:
    """(C1, k1, k2, alpha in radians, kappa), each of shape (n, 1).

    Parameters
    ----------
    draws : DataFrame
        One row a draw; columns C1, k1 (kPa), k2, alpha (degrees), kappa.
    """
    C1, k1, k2, alpha, kappa = (draws[[name]].to_numpy(dtype=float) for name in PARAMETERS)
    return C1, k1, k2, np.radians(alpha), kappa


def material(draw: pd.Series, *, fibre_switch: bool = False) -> GOH:
    """The material of one draw."""
    C1, k1, k2, alpha, kappa = (float(draw[name]) for name in PARAMETERS)
    return GOH(C1, k1, k2, alpha, kappa, fibre_switch)


def mounting_labels(draws: pd.DataFrame) -> tuple[str, ...]:
    """Labels of the mounted states: none when it was not inferred, ``("",)`` when shared."""
    stem = "mounting_stretch_x"
    return tuple(
        "" if name == stem else name[len(stem) + 1 : -1]
        for name in map(str, draws.columns)
        if name == stem or (name.startswith(stem + "[") and name.endswith("]"))
    )


def mounting_stretch(draws: pd.DataFrame, label: str = "") -> np.ndarray:
    """Mounting stretches (x, y) of each draw, shape (n, 2); one where it was not inferred."""
    if not mounting_labels(draws):
        return np.ones((len(draws), 2))
    tail = f"[{label}]" if label else ""
    names = [f"mounting_stretch_x{tail}", f"mounting_stretch_y{tail}"]
    return draws[names].to_numpy(dtype=float)


def protocol_mounting(draws: pd.DataFrame, protocol: Protocol) -> np.ndarray:
    """Mounting stretches of each draw for one protocol, shape (n, 2)."""
    return mounting_stretch(draws, protocol.name if protocol.name in mounting_labels(draws) else "")


def fibre_strains(draws: pd.DataFrame, stretch_x, stretch_y) -> np.ndarray:
    """Fibre strain E of each draw, shape (n, m), at total stretches of shape (m,) or (n, m)."""
    _, _, _, alpha, kappa = parameters(draws)
    ax, ay = np.square(stretch_x), np.square(stretch_y)
    Hx, Hy, Hz = structure_tensor(alpha, kappa)
    return np.asarray(fibre_strain(Hx, Hy, Hz, ax, ay, 1.0 / (ax * ay)))


def piola_noise(
    draws: pd.DataFrame, specimen: Specimen, axis: int, piola: np.ndarray, mounting: np.ndarray
) -> np.ndarray:
    """Standard deviation of a new reading, as a first Piola-Kirchhoff stress.

    Parameters
    ----------
    draws : DataFrame
        With ``noise_sd`` (and ``noise_growth``, ``edge_x``, ``edge_y``, ``thickness`` where
        they are unknowns of the run), in the unit of the specimen's loads.
    specimen : Specimen
    axis : int
        0 for x, 1 for y.
    piola : ndarray, shape (n, m)
        Model stress, kPa, with the unloaded state as reference.
    mounting : ndarray, shape (n, 2)
        Mounting stretches of each draw.

    Returns
    -------
    ndarray, shape (n, 1) or (n, m)
        kPa.
    """
    across = ("edge_y", "edge_x")[axis]
    # A0_x = edge_y * thickness; mounted dimensions: A0_k = Am_k lm_k
    area = np.full((len(draws), 1), specimen.area[axis])
    for factor in (across, "thickness"):
        if factor in draws:
            area = area * draws[[factor]].to_numpy(dtype=float)
    if specimen.geometry == "mounted":
        area = area * mounting[:, axis : axis + 1]
    noise = draws[["noise_sd"]].to_numpy(dtype=float) / area
    if "noise_growth" not in draws:
        return noise
    # sd^2 = w^2 + (b f)^2
    return np.hypot(noise, draws[["noise_growth"]].to_numpy(dtype=float) * piola)
