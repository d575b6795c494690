r"""Inflation of a thin-walled tube at a fixed axial stretch, and its posterior predictions.

The wall is a membrane: radial stress neglected, deformation uniform through the wall, no
residual stress (the tube is stress free at its unloaded mid radius R and wall thickness H).
With the circumferential stretch lt and the axial stretch la,

    r = lt R,    h = H / (lt la)                       incompressible wall
    p = s_t h / r = s_t H / (R lt^2 la) = P_t H / (R lt la)

which is the derivative of the stored energy by the volume inside the mid surface. The force
that a transducer reads on the closed tube (the reduced axial force) is

    f = 2 pi r h s_a - pi r^2 p
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.experiments import MMHG_PER_KPA
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import PredictionOptions
from biaxbayes.prediction.draws import with_free_sides
from biaxbayes.prediction.percentiles import (
    BANDS,
    band_columns,
    evenly_chosen,
    known_percentiles,
    tails,
)
from biaxbayes.prediction.stress import MAX_DRAWS, prediction_mounting, prediction_range
from biaxbayes.prediction.tissue import Tissue

# --- the tube ------------------------------------------------------------------------------------

GRID = 750  # states at which a crossing is looked for, equally spaced in log stretch
MAX_ROOT_STEPS = 80
ROOT_TOLERANCE = 1e-13  # of the stretch


@dataclass(frozen=True)
class ThinTube:
    """An unloaded thin-walled tube at a fixed axial stretch.

    Parameters
    ----------
    mid_radius_mm, thickness_mm : float
        Unloaded radius of the middle of the wall, and unloaded wall thickness.
    axial_stretch : float
        Total axial stretch, relative to the unloaded state.
    circumferential : {"x", "y"}
        The axis of the test that runs around the tube; the other runs along it.

    Raises
    ------
    ValueError
        If a dimension is not positive, the wall is thicker than the mid radius, or
        ``circumferential`` is not an axis.
    """

    mid_radius_mm: float
    thickness_mm: float
    axial_stretch: float = 1.0
    circumferential: str = "x"

    def __post_init__(self) -> None:
        values = (self.mid_radius_mm, self.thickness_mm, self.axial_stretch)
        if not all(np.isfinite(v) and v > 0.0 for v in values):
            raise ValueError("mid radius, wall thickness and axial stretch must be positive")
        if self.thickness_mm > self.mid_radius_mm:
            raise ValueError("the wall is thicker than the mid radius: not a thin-walled tube")
        if self.circumferential not in ("x", "y"):
            raise ValueError("circumferential must be 'x' or 'y'")

    def stretches(self, circumferential_stretch) -> tuple[Any, Any]:
        """(stretch_x, stretch_y) of the wall at a circumferential stretch of the mid surface."""
        axial = np.full_like(np.asarray(circumferential_stretch, dtype=float), self.axial_stretch)
        if self.circumferential == "x":
            return circumferential_stretch, axial
        return axial, circumferential_stretch

    def mid_diameter_mm(self, circumferential_stretch) -> Any:
        """Current diameter of the middle of the wall."""
        # d = 2 lt R
        return 2.0 * circumferential_stretch * self.mid_radius_mm

    def outer_diameter_mm(self, circumferential_stretch) -> Any:
        """Current outer diameter."""
        # d_o = 2 r + h
        wall = self.thickness_mm / (circumferential_stretch * self.axial_stretch)
        return self.mid_diameter_mm(circumferential_stretch) + wall


def inflation_pressure(
    material: MaterialResponse, tube: ThinTube, circumferential_stretch, *, piola_offset_kPa=0.0
) -> Any:
    """Pressure that holds the tube at a circumferential stretch.

    Parameters
    ----------
    material : Material
        One, or one per draw.
    circumferential_stretch : array_like
        Total stretch of the mid surface; broadcasts with the material.
    piola_offset_kPa : array_like
        Added to the circumferential first Piola-Kirchhoff stress: the misfit of a new specimen.

    Returns
    -------
    ndarray
        Pressure in kPa.
    """
    stretch_x, stretch_y = tube.stretches(circumferential_stretch)
    Px, Py = material.piola(stretch_x, stretch_y)
    hoop = Px if tube.circumferential == "x" else Py
    # p = P_t H / (R lt la)
    return (
        (hoop + piola_offset_kPa)
        * tube.thickness_mm
        / (tube.mid_radius_mm * circumferential_stretch * tube.axial_stretch)
    )


def inflation_axial_force(
    material: MaterialResponse, tube: ThinTube, circumferential_stretch
) -> Any:
    """Reduced axial force of the closed tube in mN (kPa mm^2); arguments as for the pressure."""
    stretch_x, stretch_y = tube.stretches(circumferential_stretch)
    s = material.cauchy(stretch_x, stretch_y)
    axial = s[1] if tube.circumferential == "x" else s[0]
    p = inflation_pressure(material, tube, circumferential_stretch)
    R, H = tube.mid_radius_mm, tube.thickness_mm
    # f = 2 pi r h s_a - pi r^2 p,  r h = R H / la
    return (
        2.0 * np.pi * R * H / tube.axial_stretch * axial
        - np.pi * (circumferential_stretch * R) ** 2 * p
    )


def inflation_stretch(
    material: MaterialResponse, tube: ThinTube, pressure_kPa, *, piola_offset_kPa=0.0
) -> np.ndarray:
    """Circumferential stretch at a pressure: the first state met from the unpressurised one.

    Parameters
    ----------
    material : Material
        One, or one per draw: its values have shape (n, 1).
    pressure_kPa : array_like, shape (m,)
    piola_offset_kPa : array_like, shape (n,) or scalar

    Returns
    -------
    ndarray, shape (n, m)
        NaN where no equilibrium lies inside :data:`BRACKET`.
    """
    offset = np.atleast_1d(np.asarray(piola_offset_kPa, dtype=float))[:, None]
    target = np.atleast_1d(np.asarray(pressure_kPa, dtype=float))

    def pressure(stretch: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            p = inflation_pressure(material, tube, stretch, piola_offset_kPa=offset)
        # Beyond the range of the exponential the wall is rigid, inwards as outwards.
        return np.where(np.isfinite(p), p, np.where(stretch > 1.0, np.inf, -np.inf))

    grid = np.geomspace(*BRACKET, GRID)
    coarse = pressure(grid[None, :])
    first, exists = _branch(grid, coarse, target, tube.axial_stretch)
    low, high = grid[first], grid[first + 1]
    for _ in range(MAX_ROOT_STEPS):
        middle = 0.5 * (low + high)
        below = pressure(middle) < target
        low, high = np.where(below, middle, low), np.where(below, high, middle)
        if np.max(high - low) <= ROOT_TOLERANCE:
            break
    return np.where(exists, 0.5 * (low + high), np.nan)


def _branch(
    grid: np.ndarray, coarse: np.ndarray, target: np.ndarray, axial_stretch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of the grid, shape (n, m), over which the pressure first rises through a target.

    Fibres that carry compression can hold a pressure in states of strong contraction as well;
    the branch that counts passes through the unpressurised state.
    """
    interval = np.arange(grid.size - 1)

    def rises(value: float) -> np.ndarray:
        return (coarse[:, :-1] < value) & (coarse[:, 1:] >= value)

    def nearest(candidates: np.ndarray, centre: np.ndarray) -> np.ndarray:
        distance = np.abs(interval - centre[:, None])
        return np.where(candidates, distance, grid.size).argmin(axis=1)

    # Unpressurised, an isotropic wall would rest at lt = la^(-1/2).
    isotropic = np.full(len(coarse), np.searchsorted(grid, axial_stretch**-0.5))
    start, at_rest = nearest(rises(0.0), isotropic), rises(0.0).any(axis=1)
    first = np.empty((len(coarse), target.size), dtype=int)
    exists = np.empty(first.shape, dtype=bool)
    for j, value in enumerate(target):
        side = interval >= start[:, None] if value >= 0.0 else interval <= start[:, None]
        candidates = rises(value) & side
        first[:, j] = nearest(candidates, start)
        exists[:, j] = candidates.any(axis=1) & at_rest
    return first, exists


# --- what the posterior predicts for a tube made of the specimen's tissue ------------------------


def predict_pressure(
    posterior: Posterior,
    draws: pd.DataFrame,
    tube: ThinTube,
    circumferential_stretch: np.ndarray,
    *,
    probability: float = PredictionOptions.probability,
) -> pd.DataFrame:
    """Pressure and reduced axial force of a tube at given diameters, with bands.

    The misfit of the law, as a stress of the wall, is carried into the pressure; the predictive
    band has the noise of the biaxial test besides, that of a pressure sensor is not in it.

    Parameters
    ----------
    posterior, draws, probability
        As in :func:`biaxbayes.prediction.stress.predict_stress`.
    circumferential_stretch : ndarray, shape (m,)
        Total stretches of the mid surface.

    Returns
    -------
    DataFrame
        ``circumferential_stretch``, ``mid_diameter_mm``, ``outer_diameter_mm``, bands of
        ``pressure_kPa`` and ``axial_force_mN``, ``extrapolation``.

    Raises
    ------
    InputError
        If a stretch is not positive or a pressure overflows.
    """
    stretch = np.atleast_1d(np.asarray(circumferential_stretch, dtype=float))
    if not (np.isfinite(stretch).all() and (stretch > 0.0).all()):
        raise InputError("circumferential stretches must be positive numbers")
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    material = posterior.law.material(draws)
    with np.errstate(over="ignore", invalid="ignore"):
        p = inflation_pressure(material, tube, stretch)
        force = inflation_axial_force(material, tube, stretch)
    if not (np.isfinite(p).all() and np.isfinite(force).all()):
        raise InputError(
            "the pressure of some draws overflows",
            remedy="end at a smaller circumferential stretch",
        )
    around = "xy".index(tube.circumferential)
    mean, sd, noise = _wall_misfit(posterior, draws, tube, stretch)
    # p = P_t H / (R lt la): effect of a misfit of the stress on the pressure
    lever = tube.thickness_mm / (tube.mid_radius_mm * stretch * tube.axial_stretch)
    # f = 2 pi R H P_a - pi (lt R)^2 p,  as s_a = la P_a
    wall = 2.0 * np.pi * tube.mid_radius_mm * tube.thickness_mm
    bore = np.pi * (stretch * tube.mid_radius_mm) ** 2 * lever

    def of_force(values: np.ndarray) -> np.ndarray:
        return np.hypot(wall * values[..., 1 - around], bore * values[..., around])

    force = force + wall * mean[..., 1 - around] - bore * mean[..., around]
    specimen = with_free_sides(draws, posterior.specimen, posterior.law)
    tested = prediction_range(draws, specimen, None, "total")
    return pd.DataFrame(
        {
            "circumferential_stretch": stretch,
            "mid_diameter_mm": tube.mid_diameter_mm(stretch),
            "outer_diameter_mm": tube.outer_diameter_mm(stretch),
            **band_columns(
                "pressure_kPa",
                p + lever * mean[..., around],
                lever * sd[..., around],
                lever * np.hypot(sd, noise)[..., around],
                probability,
            ),
            **band_columns(
                "axial_force_mN", force, of_force(sd), of_force(np.hypot(sd, noise)), probability
            ),
            "extrapolation": tested.extrapolation(*tube.stretches(stretch)),
        }
    )


def _wall_misfit(
    posterior: Posterior,
    draws: pd.DataFrame,
    tube: ThinTube,
    circumferential_stretch: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Misfit of the wall's nominal stress: mean, sd, and sd of noise; kPa, (draws, m, 2)."""
    lm = prediction_mounting(draws, posterior.specimen, None)
    path = np.stack(np.broadcast_arrays(*tube.stretches(circumferential_stretch)), axis=-1)
    tissue = Tissue(posterior, draws)
    section = posterior.forward.unloaded_section(draws, lm[:, None])
    return tissue.nominal_misfit(path / np.median(lm, axis=0), section)


def predict_diameter(
    posterior: Posterior,
    draws: pd.DataFrame,
    tube: ThinTube,
    pressure_kPa: np.ndarray,
    *,
    probability: float = PredictionOptions.probability,
    seed: int = 0,
) -> pd.DataFrame:
    """Diameter of a tube at given pressures, with bands.

    Parameters
    ----------
    posterior, draws, tube, probability
        As in :func:`predict_pressure`.
    pressure_kPa : ndarray, shape (m,)
    seed : int
        Of the misfit behind the bands: the wall's stress of each draw is off by a draw of it.

    Returns
    -------
    DataFrame
        ``pressure_kPa``, ``pressure_mmHg``, bands of ``circumferential_stretch`` and of
        ``outer_diameter_mm``, ``share_without_equilibrium`` (draws that have no state inside
        stretches of 0.3 to 4; they are left out of the bands), ``extrapolation`` (of the
        median).
    """
    pressure = np.atleast_1d(np.asarray(pressure_kPa, dtype=float))
    if not np.isfinite(pressure).all():
        raise InputError("pressures must be numbers, in kPa")
    levels = tails(probability)
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    material = posterior.law.material(draws)
    law = inflation_stretch(material, tube, pressure)
    around = "xy".index(tube.circumferential)
    middle = np.nan_to_num(known_percentiles(law, (0.5,))[0], nan=1.0)
    mean, sd, noise = (v[..., around] for v in _wall_misfit(posterior, draws, tube, middle))
    unit = np.random.default_rng(seed).standard_normal((len(draws), 1))

    def stretches(offset: np.ndarray) -> np.ndarray:
        """Stretches (draws, m) with offsets of the wall's stress, one for each pressure."""
        offset = np.broadcast_to(offset, law.shape)
        return np.hstack(
            [
                inflation_stretch(
                    material, tube, pressure[k : k + 1], piola_offset_kPa=offset[:, k]
                )
                for k in range(pressure.size)
            ]
        )

    # one number a draw: the misfit is smooth
    model = stretches(mean + sd * unit) if np.any(sd) else law
    new = stretches(mean + np.hypot(sd, noise) * unit)
    columns: dict[str, np.ndarray] = {
        "pressure_kPa": pressure,
        "pressure_mmHg": pressure * MMHG_PER_KPA,
    }
    for name, of_model, of_new in (
        ("circumferential_stretch", model, new),
        ("outer_diameter_mm", tube.outer_diameter_mm(model), tube.outer_diameter_mm(new)),
    ):
        values = (*known_percentiles(of_model, (0.5, *levels)), *known_percentiles(of_new, levels))
        columns |= {f"{name}_{band}": v for band, v in zip(BANDS, values, strict=True)}
    columns["share_without_equilibrium"] = np.isnan(model).mean(axis=0)
    states = tube.stretches(columns["circumferential_stretch_median"])
    specimen = with_free_sides(draws, posterior.specimen, posterior.law)
    tested = prediction_range(draws, specimen, None, "total")
    return pd.DataFrame({**columns, "extrapolation": tested.extrapolation(*states)})
