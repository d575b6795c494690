"""Residuals at the mode of a posterior whose noise grows with the load.

The deterministic fit weighs every load alike; with a growing sd the toe counts for more, and
its residuals are other ones. What the rows are worth is read from the residuals of the model that
is sampled, in units of their own sd.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.inference.assemble import mounting_names
from biaxbayes.inference.basins import find_basins
from biaxbayes.inference.noise import (
    EffectiveReadings,
    effective_readings,
    systematic_readings,
)
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.proposal import edge_array
from biaxbayes.inference.search import start_parameters
from biaxbayes.mechanics.goh import cauchy_stress

__all__ = ["modal_residuals", "sampled_readings"]


def sampled_readings(posterior: Posterior) -> EffectiveReadings:
    """What the rows are worth, from the residuals of the model that is sampled."""
    systematic = posterior.settings.noise == "systematic"
    judged = systematic_readings if systematic else effective_readings
    readings = judged(posterior.start.residuals)
    if not posterior.settings.noise_growth:
        return readings
    provisional = Posterior(
        posterior.specimen,
        **{**posterior.options(), "thin": 0},
        start=posterior.start,
        beta=readings.beta,
    )
    return judged(*modal_residuals(provisional))


def modal_residuals(posterior: Posterior) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Residuals and their sd at the posterior's mode, one array (n_p, 2) a protocol.

    Parameters
    ----------
    posterior : Posterior
        With a noise that grows with the load, and all of its rows.

    Returns
    -------
    residuals, sd : list of ndarray
        Measured minus model, and the model's own sd there, in the unit of the file.
    """
    edges = edge_array(posterior.edges, posterior.dimension)
    base = start_parameters(posterior)
    starts = [base]
    if "noise_sd" in base and "noise_growth" in base:
        small = 0.1 * base["noise_sd"]
        starts += [base | {"noise_sd": small, "noise_growth": b} for b in (0.03, 0.1)]
    points = np.vstack([posterior.coordinates(s) for s in starts])
    scale = np.full(posterior.dimension, 1.0)
    for i, name in enumerate(posterior.free):
        if name.startswith("mounting_force"):
            scale[i] = max(float(posterior.specimen.noise_sd), 1e-6 * posterior.specimen.peak_load)
        elif name.startswith("mounting_stretch"):
            scale[i] = 0.02
    found = find_basins(posterior.log_prob, points, scale, edges)
    mode = found[0].mode if found else points[0]
    return _residuals_at(posterior, mode)


def _residuals_at(
    posterior: Posterior, point: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    at = {name: float(value[0]) for name, value in posterior.natural(point).items()}
    data, settings = posterior.thinned.specimen, posterior.settings
    edge = np.array([at.get("edge_y", 1.0), at.get("edge_x", 1.0)])
    section = data.area * edge * at.get("thickness", 1.0)
    offset = np.array([at.get("load_offset_x", 0.0), at.get("load_offset_y", 0.0)])
    residuals, sds = [], []
    for number, protocol in enumerate(data.protocols):
        lm = np.ones(2)
        if settings.infers_mounting:
            shared = len(posterior.mounts) == 1
            label = posterior.mounts[0 if shared else number]
            lm = np.array([at[name] for name in mounting_names("stretch", label)])
        kept = slice(protocol.rest_rows, None)
        stretch = np.column_stack([protocol.stretch_x, protocol.stretch_y])[kept]
        total = stretch * lm
        stress = np.column_stack(
            cauchy_stress(
                at["C1"],
                at["k1"],
                at["k2"],
                np.deg2rad(at["alpha"]),
                at["kappa"],
                total[:, 0],
                total[:, 1],
                fibre_switch=settings.fibre_switch,
            )
        )
        # f_k = A P_k = A s_k / (l_k lm_k); mounted dimensions: times lm_k
        load = section * stress / (stretch if data.geometry == "mounted" else total)
        residuals.append(data.load(protocol)[kept] - load - offset)
        # sd^2 = w^2 + (b f)^2
        sds.append(np.hypot(at["noise_sd"], at.get("noise_growth", 0.0) * load))
    return residuals, sds
