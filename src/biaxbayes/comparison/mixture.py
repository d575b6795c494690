"""The mixture of laws: weights by left-out predictions, percentiles, draws and bands.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that predicts left-out readings best. With p_ki the density that model k gives
to reading i, and a Dirichlet prior (a, ..., a) towards equal weights,

    maximise  sum_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

A mixture of models that are each right about their own error spreads wider than the readings do
(Gneiting and Ranjan, Electron. J. Stat. 7 (2013) 1747), so its bands hold more than they say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from biaxbayes.comparison.law_comparison import (
    MAX_LAW_DRAWS,
    WHOLE,
    PredictedReadings,
    Prediction,
    band_rows,
)
from biaxbayes.laws import law_named
from biaxbayes.options import CONTENT
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.draws import protocol_mounting
from biaxbayes.prediction.percentiles import evenly_chosen, mixture_percentiles, tails
from biaxbayes.specimens.specimen import Specimen

PRIOR_READINGS = 1.0
"""Readings in all that the Dirichlet prior is equivalent to, a = 1 + 1 / models."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray) -> np.ndarray:
    """Weights (models,) of the mixture that predicts left-out readings best.

    ``log_density`` (models, readings) is -inf where a model excludes a reading.
    """
    models = len(log_density)
    top = log_density.max(axis=0)
    predicted = np.isfinite(top)  # readings that all models exclude do not inform weights
    density = np.exp(log_density[:, predicted] - top[predicted])
    weight = np.full(models, 1.0 / models)
    prior = PRIOR_READINGS / models  # a - 1
    total = predicted.sum() + PRIOR_READINGS
    for _ in range(_STEPS):
        # expectation maximisation: the fraction of every reading that each model explains
        joint = weight[:, None] * density
        explained = (joint / joint.sum(axis=0)).sum(axis=1) + prior
        new = explained / total
        if np.abs(new - weight).max() < _TOLERANCE:
            return new
        weight = new
    return weight


def weighted_density(log_density: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Log density (readings,) of a mixture, from log densities (models, readings)."""
    with np.errstate(divide="ignore"):
        mixed: np.ndarray = logsumexp(log_density + np.log(weight)[:, None], axis=0)
    return mixed


def mixed_percentiles(
    model: Sequence[np.ndarray],
    sd: Sequence[np.ndarray],
    weight: np.ndarray,
    levels: tuple[float, ...],
) -> list[np.ndarray]:
    """Percentiles (readings,) of a mixture by level: laws give draws in proportion to their weight.

    ``model`` and ``sd`` of each law: curves and sds of readings about them, (draws, readings).
    """
    size = min(len(m) for m in model)
    counts = np.round(weight * size).astype(int)
    counts[np.argmax(weight)] += size - counts.sum()
    chosen = [evenly_chosen(len(m), max(int(n), 1)) for m, n in zip(model, counts, strict=True)]
    used = [k for k, n in enumerate(counts) if n > 0]
    return mixture_percentiles(
        np.vstack([model[k][chosen[k]] for k in used]),
        np.vstack([sd[k][chosen[k]] for k in used]),
        levels,
    )


# --- draws and bands over a whole record ---------------------------------------------------------


def mixture_draws(
    specimen: Specimen,
    laws: Sequence[str],
    weight: np.ndarray,
    predictions: Mapping[tuple[str, str], Prediction],
) -> pd.DataFrame:
    """Draws of every law by its weight, with the quantities that all laws share.

    Mounting stretches, small-strain stiffnesses and Cauchy stresses (kPa) at the largest measured
    stretches of each protocol.
    """
    tables = []
    for law, count in zip(laws, np.round(weight * MAX_LAW_DRAWS).astype(int), strict=True):
        table = predictions[law, WHOLE].draws
        table = table.iloc[evenly_chosen(len(table), max(int(count), 1))] if count else table[:0]
        if table.empty:
            continue
        material = law_named(law).material(table)
        shared: dict[str, Any] = {"law": law}
        for name in shared_stretches(table, specimen):
            shared[name] = table[name].to_numpy(dtype=float)
        slope = material.cauchy_by_log_stretch(1.0, 1.0)
        for k, name in enumerate(("stiffness_xx_kPa", "stiffness_yy_kPa")):
            shared[name] = np.ravel(slope[k, k])
        for protocol in specimen.protocols:
            # at the largest measured stretches, times each draw's own mounting stretches
            top = int(np.argmax(protocol.stretch_x * protocol.stretch_y))
            lm = protocol_mounting(table, protocol)
            x, y = lm[:, :1] * protocol.stretch_x[top], lm[:, 1:] * protocol.stretch_y[top]
            for axis, values in zip("xy", material.cauchy(x, y), strict=True):
                shared[f"cauchy_{axis}_kPa[{protocol.name}]"] = np.ravel(values)
        tables.append(pd.DataFrame(shared))
    return pd.concat(tables, ignore_index=True)


def mixture_bands(
    specimen: Specimen, predicted: Sequence[PredictedReadings], weight: np.ndarray
) -> pd.DataFrame:
    """Bands of a mixture over the whole record, from the readings that each law predicts.

    Columns as of :func:`~biaxbayes.prediction.bands.bands`, in the unit of the file.
    """
    levels = (tails(CONTENT)[0], 0.5, tails(CONTENT)[1])
    quantiles = {}
    for kind in ("credible", "predictive"):
        model, sd = zip(
            *(p.curves(of_readings=kind == "predictive") for p in predicted), strict=True
        )
        for q, values in zip(levels, mixed_percentiles(model, sd, weight, levels), strict=True):
            name = f"{kind}_q{100 * q:04.1f}".removesuffix(".0")
            quantiles[name] = values.reshape(-1, 2)
    quantiles = {"measured": predicted[0].measured, **quantiles}
    tables, first = [], 0
    for p in specimen.protocols:
        rows = band_rows(p)
        here = slice(first, first := first + len(rows))
        stretch = p.stretch[rows]
        scale = specimen.per_nominal(stretch)
        for axis, direction in enumerate("xy"):
            cells: dict[str, Any] = {
                "protocol": p.name,
                "direction": direction,
                "row": rows,
                "stretch": stretch[:, axis],
            }
            of_axis = {k: v[here, axis] * scale[:, axis] for k, v in quantiles.items()}
            tables.append(pd.DataFrame(cells | of_axis))
    return pd.concat(tables, ignore_index=True)


def shared_stretches(table: pd.DataFrame, specimen: Specimen) -> list[str]:
    """Names of the mounting stretches that a table of draws has."""
    states = ("", *(p.name for p in specimen.protocols))
    return [n for s in states for n in mounting_names("stretch", s) if n in table]
