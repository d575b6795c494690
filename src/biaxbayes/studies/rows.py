"""Rows of the study table from one run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import contractions, prior_material
from biaxbayes.identifiability.determined import derived_quantities, some_draws
from biaxbayes.identifiability.reported import WIDEST
from biaxbayes.identifiability.verdict import FIXED, IDENTIFIED, NOT_IDENTIFIED, Thresholds
from biaxbayes.runs.run import Run
from biaxbayes.studies.result import CURVE, LINEAR, LOG, PARAMETER

NUMBERS = ("mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat")
"""Columns from the summary of a run."""


def rows_of_run(run: Run) -> list[dict[str, Any]]:
    """One row per quantity of a finished run; `scale_sd` is the sd of its log or of itself."""
    noise, convergence = run.provenance["noise"], run.provenance["convergence"]
    common = {
        "state": run.state,
        "reason": convergence["reason"] if run.state != "converged" else "",
        "readings": noise["readings"],
        "effective_readings": noise["effective_readings"] or noise["readings"],
        "beta": noise["beta"],
    }
    result = run.result
    reported = {row["parameter"]: row for row in result.to_frame().to_dict("records")}
    rows = []
    usable = run.state != "unusable"
    draws = run.draws if usable else pd.DataFrame()
    for record in run.summary.to_dict("records"):
        name = str(record["parameter"])
        row = reported.get(name, {})
        scale = LOG if run.quantities[name].parameter.logarithmic else LINEAR
        rows.append(
            common
            | {str(k): v for k, v in record.items() if k in NUMBERS}
            | {
                "kind": PARAMETER,
                "quantity": name,
                "unit": record["unit"],
                "verdict": row.get("verdict", FIXED if record["q05"] == record["q95"] else ""),
                "reported_low": row.get("low", math.nan),
                "reported_high": row.get("high", math.nan),
                "reported": row.get("interval", ""),
                "reported_reason": row.get("reason", ""),
                "scale": scale,
                "scale_sd": _spread(draws[name], scale) if name in draws else math.nan,
            }
        )
    return rows + ([common | row for row in _curve_rows(run, draws)] if usable else [])


def _curve_rows(run: Run, draws: pd.DataFrame) -> list[dict[str, Any]]:
    """Structure tensor and small-strain stiffness, often known if parameters are correlated."""
    posterior = run.posterior()
    few = some_draws(draws)
    after, before = (
        derived_quantities(d, posterior.law, [], [1.0])
        for d in (few, prior_material(posterior, few))
    )
    rows = []
    for quantity, share in zip(after, contractions(before, after), strict=True):
        scale = LOG if quantity.unit else LINEAR
        q05, q50, q95 = np.quantile(quantity.values, [0.05, 0.5, 0.95])
        narrow = scale == LINEAR or q95 <= WIDEST * q05
        known = run.state == "converged" and share >= Thresholds().contraction and narrow
        rows.append(
            {
                "kind": CURVE,
                "quantity": quantity.key,
                "unit": quantity.unit or "1",
                "verdict": IDENTIFIED if known else NOT_IDENTIFIED,
                "mean": quantity.values.mean(),
                "sd": quantity.values.std(ddof=1),
                "q05": q05,
                "q50": q50,
                "q95": q95,
                "scale": scale,
                "scale_sd": _spread(quantity.values, scale),
            }
        )
    return rows


def _spread(values: pd.Series | np.ndarray, scale: str) -> float:
    natural = np.asarray(values, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(natural) if scale == LOG else natural
    return float(moved.std()) if np.isfinite(moved).all() else math.nan
