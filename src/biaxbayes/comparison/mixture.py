"""Draws and bands of a mixture of laws over a whole record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.law_comparison import MOST_DRAWS, WHOLE, Prediction
from biaxbayes.comparison.pooling import calibrated_levels, mixed_percentiles
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import CONTENT
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.bands import evenly_chosen, tails
from biaxbayes.prediction.draws import protocol_mounting
from biaxbayes.specimens.specimen import Specimen

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
    for law, count in zip(laws, np.round(weight * MOST_DRAWS).astype(int), strict=True):
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
