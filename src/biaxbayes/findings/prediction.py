"""Stress that the posterior predicts on any path of stretches.

Two bands, always both. The credible band holds the model's own value; the predictive band holds
a new measurement, the model's value plus the residual that the run inferred. Each is a
percentile range over the draws, row by row.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.findings.bands import evenly_chosen
from biaxbayes.findings.covered_stretches import CoveredStretches, covered_stretches
from biaxbayes.findings.material_draws import (
    mounting_labels,
    mounting_stretch,
    parameters,
    piola_noise,
    protocol_mounting,
)
from biaxbayes.findings.percentile_bands import band_columns, tails
from biaxbayes.mechanics.goh import piola_stress
from biaxbayes.specimens.specimen import Specimen

__all__ = ["MAX_DRAWS", "predict_stress", "stretch_path"]

MAX_DRAWS = 4000
"""Draws that carry the bands, evenly chosen: enough for their percentiles."""
BLOCK = 2_000_000  # numbers held at once


def stretch_path(
    largest: float, *, ratio: tuple[float, float] = (1.0, 1.0), points: int = 51
) -> np.ndarray:
    """A straight path of stretches from 1.

    Parameters
    ----------
    largest : float
        Largest stretch of the leading direction.
    ratio : (float, float)
        Share of the stretch beyond 1 that each direction takes, as in a ``1:0.5`` protocol.
    points : int

    Returns
    -------
    ndarray, shape (points, 2)
    """
    share = np.asarray(ratio, dtype=float)
    if not np.isfinite(share).all() or np.abs(share).max() == 0.0:
        raise InputError(f"a stretch ratio of {share[0]:g}:{share[1]:g} moves nothing")
    return 1.0 + np.linspace(0.0, largest - 1.0, points)[:, None] * share / np.abs(share).max()


def predict_stress(
    draws: pd.DataFrame,
    specimen: Specimen,
    path: np.ndarray,
    *,
    reference: str = "total",
    protocol: str | None = None,
    stress: str = "cauchy",
    probability: float = 0.9,
    fibre_switch: bool = False,
) -> pd.DataFrame:
    """Stress along a path of stretches, with credible and predictive bands.

    Parameters
    ----------
    draws : DataFrame
        Posterior draws; see :func:`biaxbayes.findings.material_draws.parameters`.
    specimen : Specimen
        What was tested: the range, the sections, the unit of the noise.
    path : ndarray, shape (m, 2)
        Stretches in x and y.
    reference : {"total", "measured"}
        Relative to the unloaded or to the mounted state.
    protocol : str, optional
        Whose mounted state measured stretches refer to, where each protocol has its own.
    stress : {"cauchy", "piola"}
        Cauchy, or first Piola-Kirchhoff with the unloaded state as reference; kPa.
    probability : float
        Content of each band.
    fibre_switch : bool
        Fibres carry no compression.

    Returns
    -------
    DataFrame
        One row a state: ``stretch_x``, ``stretch_y`` as given, ``total_stretch_x`` and
        ``total_stretch_y`` (posterior medians), five columns of each direction such as
        ``cauchy_x_kPa_median``, and ``extrapolation``.

    Raises
    ------
    InputError
        If an option does not fit the run, a stretch is not positive, or a stress overflows.
    """
    path = _checked(np.asarray(path, dtype=float))
    if reference not in ("total", "measured") or stress not in ("cauchy", "piola"):
        raise InputError("reference is total or measured, stress is cauchy or piola")
    tails(probability)
    draws = draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)]
    lm = prediction_mounting(draws, protocol, needed=reference == "measured")
    factor = lm if reference == "measured" else np.ones_like(lm)
    blocks = []
    rows = max(1, BLOCK // max(len(draws), 1))
    for first in range(0, len(path), rows):
        total = path[None, first : first + rows, :] * factor[:, None, :]
        with np.errstate(over="ignore", invalid="ignore"):
            model = piola_stress(
                *parameters(draws), total[:, :, 0], total[:, :, 1], fibre_switch=fibre_switch
            )
        _check_finite(model, path[first : first + rows])
        columns: dict[str, np.ndarray] = {}
        for axis, name in enumerate("xy"):
            noise = piola_noise(draws, specimen, axis, model[axis], lm)
            scale = total[:, :, axis] if stress == "cauchy" else 1.0  # s_k = l_k P_k
            columns |= band_columns(
                f"{stress}_{name}_kPa", model[axis] * scale, noise * scale, probability
            )
        blocks.append(pd.DataFrame(columns))
    middle = path * np.median(factor, axis=0)
    head = {
        "stretch_x": path[:, 0],
        "stretch_y": path[:, 1],
        "total_stretch_x": middle[:, 0],
        "total_stretch_y": middle[:, 1],
    }
    where = prediction_range(draws, specimen, protocol, reference).extrapolation(*path.T)
    table = pd.concat(blocks, ignore_index=True)
    return pd.concat([pd.DataFrame(head), table, pd.DataFrame({"extrapolation": where})], axis=1)


def prediction_mounting(
    draws: pd.DataFrame, protocol: str | None, *, needed: bool = False
) -> np.ndarray:
    """Mounting stretches (n, 2): of a protocol, or the mean over the mounted states.

    Raises
    ------
    InputError
        If the protocol has no mounted state of its own, or, where one is ``needed``, none was
        named and the run has several.
    """
    labels = mounting_labels(draws)
    if labels in ((), ("",)):
        return mounting_stretch(draws)
    if protocol is None and needed:
        raise InputError(
            "each protocol has a mounted state of its own, so a measured stretch needs one",
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
    draws: pd.DataFrame, specimen: Specimen, protocol: str | None, reference: str
) -> CoveredStretches:
    """What was tested, in the stretches that a prediction is asked in."""
    own = np.ones(2)
    if reference == "measured":
        # Other protocols' states, referred to the mounted state of this one.
        own = np.median(prediction_mounting(draws, protocol), axis=0)
    lms = [np.median(protocol_mounting(draws, p), axis=0) / own for p in specimen.protocols]
    return covered_stretches(specimen, np.array(lms))


def _checked(path: np.ndarray) -> np.ndarray:
    if path.ndim != 2 or path.shape[1] != 2 or not len(path):
        raise InputError("a path needs a stretch in x and one in y in every row")
    if not (np.isfinite(path).all() and (path > 0.0).all()):
        raise InputError("stretches must be positive numbers")
    return path


def _check_finite(model: tuple[np.ndarray, np.ndarray], path: np.ndarray) -> None:
    finite = np.isfinite(model[0]).all(axis=0) & np.isfinite(model[1]).all(axis=0)
    if not finite.all():
        x, y = path[np.argmin(finite)]
        raise InputError(
            f"the stress of some draws overflows at stretches of {x:g} and {y:g}",
            remedy="end the path earlier: nothing was tested near there",
        )
