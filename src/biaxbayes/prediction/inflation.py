"""Inflation of a thin-walled tube at a fixed axial stretch, and its posterior predictions.

The stresses of the middle of the wall stand for all of it; it is stress free without load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.experiments.tube import MMHG_PER_KPA, Tube
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import PredictionOptions
from biaxbayes.prediction.draws import with_free_sides
from biaxbayes.prediction.percentiles import BANDS, band_columns, known_percentiles, tails
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
    InputError
        If a dimension is not positive, or the wall is thicker than the mid radius.
    """

    mid_radius_mm: float
    thickness_mm: float
    axial_stretch: float = 1.0
    circumferential: str = "x"

    def __post_init__(self) -> None:
        values = (self.mid_radius_mm, self.thickness_mm, self.axial_stretch)
        if not all(np.isfinite(v) and v > 0.0 for v in values):
            raise InputError("mid radius, wall thickness and axial stretch must be positive")
        if self.thickness_mm > self.mid_radius_mm:
            raise InputError("the wall is thicker than the mid radius: not a thin-walled tube")

    @property
    def tube(self) -> Tube:
        """The tube with one point through the wall."""
        outer = self.mid_radius_mm + 0.5 * self.thickness_mm
        return Tube(outer, self.thickness_mm, points_through_wall=1)

    def outer_diameter_mm(self, outer_stretch: np.ndarray) -> np.ndarray:
        """Outer diameter at circumferential stretches of the outer surface."""
        return 2.0 * self.tube.outer_radius_mm * np.asarray(outer_stretch)

    def wall(self, outer_stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State (..., 2) of the middle of the wall, and the weights (..., 2, 2) of its stresses.

        Both are around and along the tube; the weights give pressure (kPa) and axial force (N).
        """
        outer = np.asarray(outer_stretch, dtype=float)
        axial = np.full(outer.size, self.axial_stretch)
        points = self.tube.points(np.column_stack([outer.ravel(), axial]))
        return points.stretch.reshape(*outer.shape, 2), points.weight.reshape(*outer.shape, 2, 2)

    def in_test(self, around_along: np.ndarray) -> np.ndarray:
        """Values (..., 2) around and along the tube as those in x and y, and back."""
        return around_along if self.circumferential == "x" else around_along[..., ::-1]

    def loads(
        self,
        material: MaterialResponse,
        outer_stretch: np.ndarray,
        misfit_kPa: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """Pressure (kPa) and axial force on the closed tube (N), (..., 2).

        Of one material, or one per draw with values (n, 1), at circumferential stretches (m,) or
        (n, m) of the outer surface. ``misfit_kPa``, (..., 2) around and along, is added to the
        nominal stresses of the wall.
        """
        state, weight = self.wall(outer_stretch)
        x, y = np.moveaxis(self.in_test(state), -1, 0)
        stress = self.in_test(np.stack(np.broadcast_arrays(*material.cauchy(x, y)), axis=-1))
        # s = l P
        return np.einsum("...ik,...k->...i", weight, stress + state * misfit_kPa)


def stretch_at_pressure(
    material: MaterialResponse,
    tube: ThinTube,
    pressure_kPa: np.ndarray,
    misfit_kPa: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Outer circumferential stretch at a pressure: the first state met from the unpressurised one.

    Shape (n, m), NaN where no equilibrium lies inside :data:`BRACKET`, of one material or one per
    draw, at pressures (m,); ``misfit_kPa`` as in :meth:`ThinTube.loads`, broadcast with (n, m, 2).
    """
    target = np.atleast_1d(np.asarray(pressure_kPa, dtype=float))
    misfit = np.asarray(misfit_kPa, dtype=float)

    def known(pressure: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        # Beyond the range of the exponential the wall is rigid, inwards as outwards.
        return np.where(np.isfinite(pressure), pressure, np.where(stretch > 1.0, np.inf, -np.inf))

    with np.errstate(over="ignore", invalid="ignore"):
        grid = np.geomspace(*BRACKET, GRID)
        of_law = np.atleast_2d(tube.loads(material, grid)[..., 0])
        misfit = np.broadcast_to(misfit, (len(of_law), target.size, 2))
        state, weight = tube.wall(grid)
        lever = weight[:, 0, 0] * state[:, 0]
        first = np.empty(misfit.shape[:2], dtype=int)
        exists = np.empty(first.shape, dtype=bool)
        for j, wanted in enumerate(target):
            coarse = known(of_law + misfit[:, j, :1] * lever, grid)
            first[:, j], exists[:, j] = _branch(grid, coarse, wanted, tube.axial_stretch)
        low, high = grid[first], grid[first + 1]
        for _ in range(MAX_ROOT_STEPS):
            middle = 0.5 * (low + high)
            below = known(tube.loads(material, middle, misfit)[..., 0], middle) < target
            low, high = np.where(below, middle, low), np.where(below, high, middle)
            if np.max(high - low) <= ROOT_TOLERANCE:
                break
    return np.where(exists, 0.5 * (low + high), np.nan)


def _branch(
    grid: np.ndarray, coarse: np.ndarray, target: float, axial_stretch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of the grid, shape (n,), over which the pressure first rises through a target.

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
    at_rest = rises(0.0)
    start = nearest(at_rest, isotropic)
    side = interval >= start[:, None] if target >= 0.0 else interval <= start[:, None]
    candidates = rises(target) & side
    exists = np.asarray(candidates.any(axis=1) & at_rest.any(axis=1))
    return nearest(candidates, start), exists


# --- what the posterior predicts for a tube made of the specimen's tissue ------------------------


def predict_pressure(
    posterior: Posterior,
    draws: pd.DataFrame,
    tube: ThinTube,
    circumferential_stretch: np.ndarray,
    *,
    probability: float = PredictionOptions.probability,
) -> pd.DataFrame:
    """Pressure and axial force of a tube at given diameters, with bands.

    The misfit of the law, as a stress of the wall, is carried into both; the predictive band has
    the noise of the biaxial test besides, that of a pressure sensor is not in it.

    Parameters
    ----------
    posterior, draws, probability
        As in :func:`biaxbayes.prediction.stress.predict_stress`.
    circumferential_stretch : ndarray, shape (m,)
        Total stretches of the outer surface: outer diameters over the unloaded one.

    Returns
    -------
    DataFrame
        ``circumferential_stretch``, ``outer_diameter_mm``, bands of ``pressure_kPa`` and
        ``axial_force_mN``, ``extrapolation``.

    Raises
    ------
    InputError
        If a stretch is not positive or leaves no lumen, or a pressure overflows.
    """
    stretch = np.atleast_1d(np.asarray(circumferential_stretch, dtype=float))
    if not (np.isfinite(stretch).all() and (stretch > 0.0).all()):
        raise InputError("circumferential stretches must be positive numbers")
    state, weight = tube.wall(stretch)
    if not np.isfinite(state).all():
        raise InputError(
            "there is no lumen: the wall fills the outer diameter",
            remedy="begin at a larger circumferential stretch",
        )
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    mean, sd, noise = _wall_misfit(posterior, draws, tube, state)
    with np.errstate(over="ignore", invalid="ignore"):
        loads = tube.loads(posterior.law.material(draws), stretch, mean)
    if not np.isfinite(loads).all():
        raise InputError(
            "the pressure of some draws overflows",
            remedy="end at a smaller circumferential stretch",
        )
    # s = l P, and q_i = sum_k w_ik s_k
    of_tissue, of_reading = (
        np.sqrt(np.einsum("mik,dmk->dmi", weight**2, np.square(state * spread)))
        for spread in (sd, np.hypot(sd, noise))
    )
    columns: dict[str, np.ndarray] = {}
    for i, (name, unit) in enumerate((("pressure_kPa", 1.0), ("axial_force_mN", 1000.0))):
        spreads = (unit * of_tissue[..., i], unit * of_reading[..., i])
        columns |= band_columns(name, unit * loads[..., i], *spreads, probability)
    return pd.DataFrame(
        {
            "circumferential_stretch": stretch,
            "outer_diameter_mm": tube.outer_diameter_mm(stretch),
            **columns,
            "extrapolation": _extrapolation(posterior, draws, tube, state),
        }
    )


def _wall_misfit(
    posterior: Posterior, draws: pd.DataFrame, tube: ThinTube, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Misfit of the nominal stresses around and along: mean, sd, and sd of noise; (draws, m, 2)."""
    lm = prediction_mounting(draws, posterior.specimen, None)
    section = posterior.forward.unloaded_section(draws, lm[:, None])
    path = tube.in_test(state) / np.median(lm, axis=0)
    mean, sd, noise = Tissue(posterior, draws).nominal_misfit(path, section)
    return tube.in_test(mean), tube.in_test(sd), tube.in_test(np.broadcast_to(noise, sd.shape))


def _extrapolation(
    posterior: Posterior, draws: pd.DataFrame, tube: ThinTube, state: np.ndarray
) -> np.ndarray:
    specimen = with_free_sides(draws, posterior.specimen, posterior.law)
    tested = prediction_range(draws, specimen, None, "unloaded")
    return tested.extrapolation(*tube.in_test(state).T)


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
        ``pressure_kPa``, ``pressure_mmHg``, bands of ``circumferential_stretch`` (of the outer
        surface) and ``outer_diameter_mm``, ``share_without_equilibrium`` (draws that have no state
        inside stretches of 0.3 to 4; they are left out of the bands), ``extrapolation`` (of the
        median).
    """
    pressure = np.atleast_1d(np.asarray(pressure_kPa, dtype=float))
    if not np.isfinite(pressure).all():
        raise InputError("pressures must be numbers, in kPa")
    levels = tails(probability)
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    material = posterior.law.material(draws)
    law = stretch_at_pressure(material, tube, pressure)
    middle = np.nan_to_num(known_percentiles(law, (0.5,))[0], nan=1.0)
    mean, sd, noise = _wall_misfit(posterior, draws, tube, tube.wall(middle)[0])
    # one number a draw: the misfit is smooth
    z = np.random.default_rng(seed).standard_normal((len(draws), 1, 1))
    model = stretch_at_pressure(material, tube, pressure, mean + sd * z) if np.any(sd) else law
    new = stretch_at_pressure(material, tube, pressure, mean + np.hypot(sd, noise) * z)
    columns: dict[str, np.ndarray] = {
        "pressure_kPa": pressure,
        "pressure_mmHg": pressure * MMHG_PER_KPA,
    }
    diameter_mm = 2.0 * tube.tube.outer_radius_mm
    for name, unit in (("circumferential_stretch", 1.0), ("outer_diameter_mm", diameter_mm)):
        tissue = known_percentiles(unit * model, (0.5, *levels))
        values = tissue, known_percentiles(unit * new, levels)
        columns |= {f"{name}_{band}": v for band, v in zip(BANDS, np.vstack(values), strict=True)}
    columns["share_without_equilibrium"] = np.isnan(model).mean(axis=0)
    state, _ = tube.wall(columns["circumferential_stretch_median"])
    extrapolation = _extrapolation(posterior, draws, tube, state)
    return pd.DataFrame({**columns, "extrapolation": extrapolation})
