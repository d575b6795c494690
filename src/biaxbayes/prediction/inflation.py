"""What the posterior predicts for the inflation of a tube made of the specimen's tissue."""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.laws.response import Material
from biaxbayes.mechanics.inflation import (
    MMHG_PER_KPA,
    Tube,
    inflation_axial_force,
    inflation_pressure,
    inflation_stretch,
)
from biaxbayes.options import PredictionOptions
from biaxbayes.prediction.bands import (
    BANDS,
    band_columns,
    credible_columns,
    evenly_chosen,
    known_percentiles,
    tails,
)
from biaxbayes.prediction.draws import piola_noise
from biaxbayes.prediction.stress import MAX_DRAWS, prediction_mounting, prediction_range
from biaxbayes.specimens.specimen import Specimen

__all__ = ["predict_diameter", "predict_pressure"]


def predict_pressure(
    draws: pd.DataFrame,
    specimen: Specimen,
    law: Law,
    tube: Tube,
    circumferential_stretch: np.ndarray,
    *,
    probability: float = PredictionOptions.probability,
) -> pd.DataFrame:
    """Pressure and reduced axial force of a tube at stated diameters, with bands.

    The predictive band carries the residual of the biaxial test, as a stress of the wall, into
    the pressure; the noise of a pressure sensor is not in it.

    Parameters
    ----------
    draws, specimen, law, probability
        As in :func:`biaxbayes.prediction.stress.predict_stress`.
    tube : Tube
    circumferential_stretch : ndarray, shape (m,)
        Total stretches of the mid surface.

    Returns
    -------
    DataFrame
        ``circumferential_stretch``, ``mid_diameter_mm``, ``outer_diameter_mm``, bands of
        ``pressure_kPa``, median and credible band of ``axial_force_mN``, ``extrapolation``.

    Raises
    ------
    InputError
        If a stretch is not positive or a pressure overflows.
    """
    stretch = np.atleast_1d(np.asarray(circumferential_stretch, dtype=float))
    if not (np.isfinite(stretch).all() and (stretch > 0.0).all()):
        raise InputError("circumferential stretches must be positive numbers")
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    material = law.material(draws)
    with np.errstate(over="ignore", invalid="ignore"):
        p = inflation_pressure(material, tube, stretch)
        force = inflation_axial_force(material, tube, stretch)
    if not (np.isfinite(p).all() and np.isfinite(force).all()):
        raise InputError(
            "the pressure of some draws overflows",
            remedy="end at a smaller circumferential stretch",
        )
    # p = P_t H / (R lt la): what a residual of the stress does to the pressure
    lever = tube.thickness_mm / (tube.mid_radius_mm * stretch * tube.axial_stretch)
    lm = prediction_mounting(draws, specimen, None)
    axis = "xy".index(tube.circumferential)
    noise = piola_noise(draws, specimen, axis, p / lever, lm) * lever
    tested = prediction_range(draws, specimen, None, "total")
    return pd.DataFrame(
        {
            "circumferential_stretch": stretch,
            "mid_diameter_mm": tube.mid_diameter_mm(stretch),
            "outer_diameter_mm": tube.outer_diameter_mm(stretch),
            **band_columns("pressure_kPa", p, noise, probability),
            **credible_columns("axial_force_mN", force, probability),
            "extrapolation": tested.extrapolation(*tube.stretches(stretch)),
        }
    )


def predict_diameter(
    draws: pd.DataFrame,
    specimen: Specimen,
    law: Law,
    tube: Tube,
    pressure_kPa: np.ndarray,
    *,
    probability: float = PredictionOptions.probability,
    seed: int = 0,
) -> pd.DataFrame:
    """Diameter of a tube at stated pressures, with bands.

    Parameters
    ----------
    draws, specimen, law, tube, probability
        As in :func:`predict_pressure`.
    pressure_kPa : ndarray, shape (m,)
    seed : int
        Of the residuals behind the predictive band: one offset of the wall's stress a draw.

    Returns
    -------
    DataFrame
        ``pressure_kPa``, ``pressure_mmHg``, bands of ``circumferential_stretch`` and of
        ``outer_diameter_mm``, ``share_without_equilibrium`` (draws that have no state inside
        stretches of 0.5 to 2; they are left out of the bands), ``extrapolation`` (of the
        median).
    """
    pressure = np.atleast_1d(np.asarray(pressure_kPa, dtype=float))
    if not np.isfinite(pressure).all():
        raise InputError("pressures must be numbers, in kPa")
    levels = tails(probability)
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    material = law.material(draws)
    model = inflation_stretch(material, tube, pressure)
    # P_t = p R lt la / H at the model's state
    piola = np.nan_to_num(
        pressure * model * tube.mid_radius_mm * tube.axial_stretch / tube.thickness_mm
    )
    axis = "xy".index(tube.circumferential)
    noise = piola_noise(draws, specimen, axis, piola, prediction_mounting(draws, specimen, None))
    unit = np.random.default_rng(seed).standard_normal((len(draws), 1))
    new = _disturbed_stretch(material, tube, pressure, noise * unit)
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
    tested = prediction_range(draws, specimen, None, "total")
    return pd.DataFrame({**columns, "extrapolation": tested.extrapolation(*states)})


def _disturbed_stretch(
    material: Material, tube: Tube, pressure: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """Stretches (n, m) when each draw's wall stress is off by ``offset``, (n, 1) or (n, m)."""
    # The noise is one number a draw unless it grows with the load: then one a pressure as well.
    if offset.shape[1] == 1:
        parts = [(pressure, offset)]
    else:
        parts = [(pressure[j : j + 1], offset[:, j : j + 1]) for j in range(pressure.size)]
    return np.hstack(
        [inflation_stretch(material, tube, p, piola_offset_kPa=shift[:, 0]) for p, shift in parts]
    )
