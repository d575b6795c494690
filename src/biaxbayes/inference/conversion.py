"""Between sampling coordinates and natural quantities of draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from biaxbayes.inference import kernel
from biaxbayes.inference.assemble import Assembly, mounting_names
from biaxbayes.inference.coordinates import SHEAR, reference_state, shear_from_angles
from biaxbayes.inference.priors import LOG_SCALE, Prior
from biaxbayes.inference.problem import FORCE, MOUNTING
from biaxbayes.inference.settings import Settings
from biaxbayes.mechanics.goh import cauchy_stress, structure_tensor

__all__ = ["natural_values", "sampling_coordinates", "to_slot"]


def natural_values(
    assembly: Assembly, settings: Settings, u: np.ndarray
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Tempered log likelihood of the curves, and every slot and mounting force by name.

    Parameters
    ----------
    assembly : Assembly
    settings : Settings
    u : ndarray, shape (n, d)

    Returns
    -------
    log_likelihood : ndarray, shape (n,)
    values : dict of ndarray, shape (n,)
        C1, k1 (kPa), k2, alpha (degrees), ...; forces in the unit of the file's stress pair.
    """
    _, likelihood, value = kernel.evaluate(assembly.problem, u)
    out: dict[str, np.ndarray] = {}
    for i, name in enumerate(assembly.slots):
        out[name] = np.rad2deg(value[:, i]) if name == "alpha" else value[:, i]
    if settings.infers_mounting:
        _add_mounting_forces(assembly, settings, u, out)
    return likelihood, out


def _add_mounting_forces(
    assembly: Assembly, settings: Settings, u: np.ndarray, out: dict[str, np.ndarray]
) -> None:
    problem = assembly.problem
    material = [out["C1"], out["k1"], out["k2"], np.deg2rad(out["alpha"]), out["kappa"]]
    area = problem.area[:, None] * np.array([out["edge_y"], out["edge_x"]]) * out["thickness"]
    for m, label in enumerate(assembly.mounts):
        lm = [out[n] for n in mounting_names("stretch", label)]
        stress = cauchy_stress(*material, *lm, fibre_switch=settings.fibre_switch)
        for k, name in enumerate(mounting_names("force", label)):
            place = MOUNTING + 2 * m + k
            i = problem.slot[place]
            if problem.mounting_mode == FORCE:
                # Sampled (or the reading): as it is, not recomputed from the root.
                reading = problem.fixed[place] - out[f"load_offset_{'xy'[k]}"]
                out[name] = u[:, i].copy() if i >= 0 else reading
            else:
                # p0 = A s / lm; mounted dimensions: p0 = A s
                out[name] = area[k] * stress[k] / (1.0 if problem.mounted else lm[k])


def sampling_coordinates(assembly: Assembly, parameters: Mapping[str, Any]) -> np.ndarray:
    """Sampling coordinates of parameters by the names of their slots, shape (n, d)."""
    problem = assembly.problem

    def given(name: str) -> np.ndarray:
        prior = assembly.priors[name]
        fixed = not isinstance(prior, Prior) and isinstance(prior, int | float)
        return np.atleast_1d(np.asarray(prior if fixed else parameters[name], dtype=float))

    alpha, kappa = np.deg2rad(given("alpha")), given("kappa")
    values = {
        name: to_slot(name, np.atleast_1d(np.asarray(parameters[name], dtype=float)))
        for name in assembly.free
    }
    if problem.chart == SHEAR:
        values["alpha"], values["kappa"] = shear_from_angles(alpha, kappa, problem.softening)
    if problem.structural:
        log_E2, log_EG = reference_state(*structure_tensor(alpha, kappa), *problem.reference)
        if "k2" in values:
            values["k2"] = values["k2"] + log_E2
        if "k1" in values:
            values["k1"] = values["k1"] + given("k2") * np.exp(log_E2) + log_EG
    return np.column_stack(np.broadcast_arrays(*(values[n] for n in assembly.free)))


def to_slot(name: str, value: np.ndarray) -> np.ndarray:
    """From natural units to the scale that a slot holds."""
    if name in LOG_SCALE:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(value)
    return np.deg2rad(value) if name == "alpha" else value
