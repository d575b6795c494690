"""The mixture of laws: weights by left-out predictions, percentiles, draws and bands.

Stacking (Yao, Vehtari, Simpson, Gelman, Bayesian Anal. 13 (2018) 917) chooses the mixture of
predictive densities that predicts left-out readings best. With p_ki the density that model k gives
to reading i, b_i its effective number of readings, and a Dirichlet prior (a, ..., a) towards equal
weights,

    maximise  sum_i b_i ln sum_k w_k p_ki + (a - 1) sum_k ln w_k     over the simplex of w.

Evidences are not used: those of likelihoods with different powers cannot be compared.

A mixture of models that are each right about their own error spreads wider than the readings do
(Gneiting and Ranjan, Electron. J. Stat. 7 (2013) 1747, who fit a beta distribution of two shapes
together with the weights). The levels of its bands are learned from left-out readings: with F the
distribution of the stacked mixture, F(y_i) is taken for Beta(c, c),

    maximise  sum_i b_i ln beta(F(y_i); c, c) - (ln c)^2 / (2 s^2)     over c,

and a band to the level q is read at the level B_c^-1(q) of the mixture. At c = 1 nothing changes. A
mixture that is biased stays so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar
from scipy.special import betaincinv, betaln

from biaxbayes.comparison.law_comparison import MAX_LAW_DRAWS, WHOLE, Prediction
from biaxbayes.error_model import standard_cdf
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import CONTENT
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.bands import evenly_chosen, mixture_percentiles, tails
from biaxbayes.prediction.draws import protocol_mounting
from biaxbayes.specimens.specimen import Specimen

PRIOR_READINGS = 1.0
"""Readings in all that the Dirichlet prior is equivalent to, a = 1 + 1 / models."""
_STEPS, _TOLERANCE = 20_000, 1e-10


def stacking_weights(log_density: np.ndarray, worth: np.ndarray) -> np.ndarray:
    """Weights (models,) of the mixture that predicts left-out readings best.

    ``log_density`` (models, readings) is -inf where a model excludes a reading; ``worth``
    (readings,) are the independent readings that each counts for.
    """
    models = len(log_density)
    top = log_density.max(axis=0)
    predicted = np.isfinite(top)  # readings that all models exclude do not inform weights
    density = np.exp(log_density[:, predicted] - top[predicted])
    worth = worth[predicted]
    weight = np.full(models, 1.0 / models)
    prior = PRIOR_READINGS / models  # a - 1
    total = worth.sum() + PRIOR_READINGS
    for _ in range(_STEPS):
        # expectation maximisation: the fraction of every reading that each model explains
        joint = weight[:, None] * density
        mixture = joint.sum(axis=0)
        explained = (joint / mixture) @ worth + prior
        new = explained / total
        if np.abs(new - weight).max() < _TOLERANCE:
            return new
        weight = new
    return weight


def weighted_density(log_density: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Log density (readings,) of a mixture, from log densities (models, readings)."""
    with np.errstate(divide="ignore"):
        mixed: np.ndarray = np.logaddexp.reduce(log_density + np.log(weight)[:, None], axis=0)
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


# --- calibrated bands ----------------------------------------------------------------------------

SHARPNESS_LOG_SD = 0.25
"""Sd of the prior of ln c, set with the aorta and the valve of the documentation in sight: parts
are few, and their residuals are correlated. Half and twice of it change the fraction of left-out
readings in their bands by at most 0.08."""
LEAST_SHARPNESS, LARGEST_SHARPNESS = 0.3, 20.0
_LEAST_PROBABILITY = 1e-9


def mixed_probabilities(
    measured: np.ndarray, model: Sequence[np.ndarray], sd: Sequence[np.ndarray], weight: np.ndarray
) -> np.ndarray:
    """Probability (readings,) of the mixture below each reading; NaN where all draws overflow.

    Arguments as of :func:`mixed_percentiles`. A law all of whose draws overflow at a reading has
    no part in the mixture there.
    """
    # F(y_i) = sum_k w_k mean_s Phi((y_i - m_ksi) / sd_ksi)
    by_law, weights = [], []
    with np.errstate(invalid="ignore", divide="ignore"):
        for m, s, w in zip(model, sd, weight, strict=True):
            below = standard_cdf((measured - m) / s)
            finite = np.isfinite(below)
            mean = np.where(finite, below, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
            by_law.append(mean)
            weights.append(w * finite.any(axis=0))
        mixed = np.sum(np.multiply(weights, by_law), axis=0)
        probability: np.ndarray = mixed / np.sum(weights, axis=0)
    return probability


def sharpness(probability: np.ndarray, worth: np.ndarray) -> float:
    """The c of Beta(c, c) for the probabilities (readings,) of left-out readings; NaN is left out.

    Above 1 where readings lie nearer to the middle of the mixture than it predicts.
    """
    finite = np.isfinite(probability)
    u, worth = probability[finite], worth[finite]
    u = np.clip(u, _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY)
    logs, total = float(worth @ (np.log(u) + np.log1p(-u))), float(worth.sum())

    def minus_log_density(log_c: float) -> float:
        c = np.exp(log_c)
        # sum b ln beta(u; c, c) = (c - 1) sum b ln(u (1 - u)) - ln B(c, c) sum b
        prior = 0.5 * (log_c / SHARPNESS_LOG_SD) ** 2
        return float(prior - (c - 1.0) * logs + total * betaln(c, c))

    bounds = (np.log(LEAST_SHARPNESS), np.log(LARGEST_SHARPNESS))
    optimum = minimize_scalar(minus_log_density, bounds=bounds, method="bounded")
    return float(np.exp(optimum.x))


def calibrated_levels(levels: tuple[float, ...], sharpness: float) -> tuple[float, ...]:
    """Levels of the mixture at which bands to these levels are read; sharpness 1 changes none."""
    return tuple(float(betaincinv(sharpness, sharpness, level)) for level in levels)


# --- draws and bands over a whole record ---------------------------------------------------------

BAND_DRAWS = 500


def mixture_draws(
    specimen: Specimen,
    laws: Sequence[str],
    weight: np.ndarray,
    predictions: Mapping[tuple[str, str], Prediction],
    posteriors: Mapping[str, Posterior],
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
        material = posteriors[law].law.material(table)
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
    specimen: Specimen,
    used: Sequence[str],
    weight: np.ndarray,
    predictions: Mapping[tuple[str, str], Prediction],
    posteriors: Mapping[str, Posterior],
    sharpness: float,
) -> pd.DataFrame:
    """Bands of the mixture over the whole record, one row per reading, in the unit of the file.

    Both bands are read at the same levels, and a credible one ends where the predictive one does.
    No left-out reading tests the credible band.
    """
    model, sd = [], []
    for law in used:
        table = predictions[law, WHOLE].draws
        table = table.iloc[evenly_chosen(len(table), BAND_DRAWS)]
        measured = posteriors[law].rows
        load, spread = posteriors[law].forward.predict_rows(table, measured)
        model.append(load.reshape(len(load), -1))
        sd.append(spread.reshape(len(load), -1))
    shape = measured.load.shape
    levels = (tails(CONTENT)[0], 0.5, tails(CONTENT)[1])
    names = [f"q{100 * q:04.1f}".removesuffix(".0") for q in levels]
    read_at = calibrated_levels(levels, sharpness)
    credible = mixed_percentiles(model, [1e-300 * s for s in sd], weight, read_at)
    predictive = mixed_percentiles(model, sd, weight, read_at)
    credible = [np.clip(c, predictive[0], predictive[-1]) for c in credible]
    # a Cauchy stress is the nominal one times the measured stretch
    scale = measured.stretch if specimen.stress_pair == "cauchy" else np.ones(shape)
    # number of each row within its protocol, those at rest not counted
    row = np.arange(len(scale)) - np.searchsorted(measured.protocol, measured.protocol)
    tables = []
    for axis, direction in enumerate("xy"):
        cells: dict[str, Any] = {
            "protocol": [measured.names[i] for i in measured.protocol],
            "direction": direction,
            "row": row,
            "stretch": measured.stretch[:, axis],
            "measured": measured.load[:, axis] * scale[:, axis],
        }
        for kind, values in (("credible", credible), ("predictive", predictive)):
            for name, value in zip(names, values, strict=True):
                cells[f"{kind}_{name}"] = value.reshape(shape)[:, axis] * scale[:, axis]
        tables.append(pd.DataFrame(cells))
    return pd.concat(tables, ignore_index=True)


def shared_stretches(table: pd.DataFrame, specimen: Specimen) -> list[str]:
    """Names of the mounting stretches that a table of draws has."""
    states = ("", *(p.name for p in specimen.protocols))
    return [n for s in states for n in mounting_names("stretch", s) if n in table]
