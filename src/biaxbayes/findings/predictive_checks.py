"""Posterior predictive checks in words: for which tested paths the model must not be used."""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.findings.misfit import SMOOTH, misfit
from biaxbayes.inference.settings import Settings
from biaxbayes.specimens.specimen import Specimen

__all__ = ["checks_in_words", "path_warnings", "predictive_checks"]

MISSES = 0.05
"""Share of the peak load beyond which a miss matters to whoever uses the parameters."""
NOISE = 4.0
"""Noise sds of one reading that a largest miss of some hundred readings may have by chance."""
FEW_INSIDE = 0.8
"""Share of readings inside a 90 % predictive band, below which the band is too narrow."""


def predictive_checks(
    specimen: Specimen, draws: pd.DataFrame, *, settings: Settings | None = None
) -> pd.DataFrame:
    """Check every curve against the median model and the predictive band.

    Parameters
    ----------
    specimen : Specimen
    draws : DataFrame
        One row a draw, columns as in ``summary.csv``.
    settings : Settings, optional
        Those of the run.

    Returns
    -------
    DataFrame
        That of :func:`~biaxbayes.findings.misfit.misfit` with ``share`` (largest miss over the
        largest load of the protocol, both directions) and ``verdict``: ``noise`` (no more than
        the load cell's), ``small`` (more, but below 5 % of the peak), ``misses``.
    """
    table = misfit(specimen, draws, settings=settings)
    if table.empty:
        return table.assign(share=[], verdict=[])
    peak = table.groupby("protocol")["peak"].transform("max").clip(lower=1e-300)
    share = table["largest"].abs() / peak
    within = (table["largest"].abs() <= NOISE * table["noise"]) & (table["runs_z"] >= SMOOTH)
    verdict = np.where(within, "noise", np.where(share > MISSES, "misses", "small"))
    return table.assign(share=share, verdict=verdict)


def path_warnings(checks: pd.DataFrame, unit: str) -> list[str]:
    """One sentence for each protocol that the model misses; none where it misses none.

    Parameters
    ----------
    checks : DataFrame
        From :func:`predictive_checks`.
    unit : str
        Of the loads.
    """
    missed = checks[checks["verdict"] == "misses"].to_dict("records")
    out = []
    for protocol in dict.fromkeys(row["protocol"] for row in missed):
        worst = max((r for r in missed if r["protocol"] == protocol), key=lambda r: r["share"])
        out.append(
            f"GOH misses the {protocol} protocol by {worst['rms']:.2g} {unit} root mean square "
            f"and {abs(worst['largest']):.2g} {unit} ({100 * worst['share']:.0f} % of its peak) at "
            f"most, in {worst['direction']} at a measured stretch of {worst['at']:.3f}: do not use "
            "these parameters for that path where this matters."
        )
    return out


def checks_in_words(checks: pd.DataFrame, unit: str) -> list[str]:
    """The warnings, then what the rest of the checks says.

    Parameters
    ----------
    checks : DataFrame
        From :func:`predictive_checks`.
    unit : str
        Of the loads.
    """
    if checks.empty:
        return ["There are no readings beyond the mounted state to check the model with."]
    out = path_warnings(checks, unit)
    by_noise = checks[checks["verdict"] == "noise"]
    if len(by_noise) == len(checks):
        out.append("The model misses no reading by more than the load cell's noise.")
    elif not out:
        worst = max(checks.to_dict("records"), key=lambda r: r["share"])
        out.append(
            f"The model misses no protocol by more than {100 * worst['share']:.1f} % of its peak "
            f"({worst['protocol']} in {worst['direction']}, {abs(worst['largest']):.2g} {unit})."
        )
    for row in checks[checks["inside"] < FEW_INSIDE].to_dict("records"):
        out.append(
            f"Only {100 * row['inside']:.0f} % of the readings of {row['protocol']} in "
            f"{row['direction']} lie inside their own 90 % predictive band: it is too narrow there."
        )
    return out
