"""Rows of the study table: what one run says, and what is known of a specimen that has no run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.findings.derived import derived_quantities
from biaxbayes.findings.prior_material import contractions, prior_material
from biaxbayes.findings.study_groups import DETERMINED
from biaxbayes.findings.verdict import Thresholds
from biaxbayes.mechanics.goh import PARAMETERS
from biaxbayes.output.run import Run
from biaxbayes.output.summary import COLUMNS as SUMMARY

__all__ = ["COLUMNS", "CURVE", "PARAMETER", "rows_of_run", "rows_without_run"]

PARAMETER, CURVE = "parameter", "curve"
"""Kinds of row: an unknown of the run, or what follows from the parameters and shapes the curve."""
COLUMNS = (
    "specimen",
    "donor",
    "layer",
    "file",
    "folder",
    "state",
    "reason",
    "kind",
    "quantity",
    "unit",
    "verdict",
    "mean",
    "sd",
    "q05",
    "q50",
    "q95",
    "scale",
    "scale_sd",
    "contraction",
    "ess_bulk",
    "ess_tail",
    "rhat",
    "readings",
    "effective_readings",
    "beta",
)
LOG, LINEAR = "log", "linear"
NOT_DETERMINED = "not determined"
MOST_DRAWS = 8000


def rows_of_run(run: Run) -> list[dict[str, Any]]:
    """One row a quantity of a finished run.

    ``scale_sd`` is the posterior standard deviation on the scale on which specimens are averaged:
    of the natural logarithm for stiffnesses and exponents, as it is for everything else. It is
    empty, as every number is, where the chains are unusable.
    """
    noise, convergence = run.provenance["noise"], run.provenance["convergence"]
    common = {
        "state": run.state,
        "reason": convergence["reason"] if run.state != "reliable" else "",
        "readings": noise["readings"],
        "effective_readings": noise["effective_readings"] or noise["readings"],
        "beta": noise["beta"],
    }
    verdicts = _verdicts(run)
    rows = []
    usable = run.state != "unusable"
    draws = run.draws if usable else pd.DataFrame()
    for record in run.summary.to_dict("records"):
        name = str(record["parameter"])
        found = verdicts.get(name, {})
        scale = LOG if name in ("C1", "k1", "k2", "noise_sd") else LINEAR
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
        )
    return rows + ([common | row for row in _curve_rows(run, draws)] if usable else [])


def rows_without_run(state: str, reason: str) -> list[dict[str, Any]]:
    """Rows of a specimen that could not be sampled: its parameters, without numbers."""
    common = {"state": state, "reason": reason, "kind": PARAMETER}
    return [common | {"quantity": name} for name in PARAMETERS]


def _curve_rows(run: Run, draws: pd.DataFrame) -> list[dict[str, Any]]:
    """Structure tensor and small-strain stiffness: often known where parameters trade."""
    posterior = run.posterior()
    few = draws.iloc[:: -(-len(draws) // MOST_DRAWS)]
    switch = posterior.settings.fibre_switch
    found, before = (
        derived_quantities(d, [], [1.0], fibre_switch=switch)
        for d in (few, prior_material(posterior, few))
    )
    rows = []
    for quantity, share in zip(found, contractions(before, found), strict=True):
        scale = LOG if quantity.unit else LINEAR
        known = run.state == "reliable" and share >= Thresholds().contraction
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
        table = pd.read_csv(path, comment="#")
        return {
            str(r["parameter"]): {
                "verdict": str(r["verdict"]),
                "contraction": float(r.get("contraction", math.nan)),
            }
            for r in table.to_dict("records")
        }
    except (OSError, ValueError, KeyError):
        return {}
