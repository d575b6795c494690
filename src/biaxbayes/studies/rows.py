"""Rows of the study table: what one run says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import contractions, prior_material
from biaxbayes.identifiability.determined import derived_quantities, some_draws
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.runs.run import COLUMNS as SUMMARY
from biaxbayes.runs.run import Run
from biaxbayes.studies.groups import DETERMINED
from biaxbayes.studies.result import CURVE, LINEAR, LOG, NOT_DETERMINED, PARAMETER
from biaxbayes.text_files import read_csv

__all__ = ["rows_of_run"]


def rows_of_run(run: Run) -> list[dict[str, Any]]:
    """One row a quantity of a finished run.

    ``scale_sd`` is the posterior standard deviation on the scale on which specimens are averaged:
    of the natural logarithm for stiffnesses and exponents, as it is for everything else. It is
    empty, as every number is, where the chains are unusable. What is stated of a mounting stretch
    of the tissue is that of the run.
    """
    noise, convergence = run.provenance["noise"], run.provenance["convergence"]
    common = {
        "state": run.state,
        "reason": convergence["reason"] if run.state != "converged" else "",
        "readings": noise["readings"],
        "effective_readings": noise["effective_readings"] or noise["readings"],
        "beta": noise["beta"],
    }
    verdicts, stated = _verdicts(run), run.stated
    rows = []
    usable = run.state != "unusable"
    draws = run.draws if usable else pd.DataFrame()
    for record in run.summary.to_dict("records"):
        name = str(record["parameter"])
        found = verdicts.get(name, {})
        scale = LOG if run.quantities[name].parameter.logarithmic else LINEAR
        rows.append(
            common
            | {str(k): v for k, v in record.items() if k in SUMMARY[2:]}
            | {
                "kind": PARAMETER,
                "quantity": name,
                "unit": record["unit"],
                "verdict": found.get("verdict", ""),
                "contraction": found.get("contraction", math.nan),
                "scale": scale,
                "scale_sd": _spread(draws[name], scale) if name in draws else math.nan,
            }
            | ({f"stated_{k}": v for k, v in vars(stated[name]).items()} if name in stated else {})
        )
    return rows + ([common | row for row in _curve_rows(run, draws)] if usable else [])


def _curve_rows(run: Run, draws: pd.DataFrame) -> list[dict[str, Any]]:
    """Structure tensor and small-strain stiffness: often known where parameters trade."""
    posterior = run.posterior()
    few = some_draws(draws)
    found, before = (
        derived_quantities(d, posterior.law, [], [1.0])
        for d in (few, prior_material(posterior, few))
    )
    rows = []
    for quantity, share in zip(found, contractions(before, found), strict=True):
        scale = LOG if quantity.unit else LINEAR
        known = run.state == "converged" and share >= Thresholds().contraction
        q05, q50, q95 = np.quantile(quantity.values, [0.05, 0.5, 0.95])
        rows.append(
            {
                "kind": CURVE,
                "quantity": quantity.key,
                "unit": quantity.unit or "1",
                "verdict": DETERMINED if known else NOT_DETERMINED,
                "contraction": share,
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


def _verdicts(run: Run) -> dict[str, dict[str, Any]]:
    path = run.path / "identifiability.csv"
    try:
        table = read_csv(path)
        return {
            str(r["parameter"]): {
                "verdict": str(r["verdict"]),
                "contraction": float(r.get("contraction", math.nan)),
            }
            for r in table.to_dict("records")
        }
    except (OSError, ValueError, KeyError):
        return {}
