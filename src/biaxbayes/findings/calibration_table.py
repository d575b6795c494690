"""What the ranks of a study say, parameter by parameter."""

from __future__ import annotations

import pandas as pd

from biaxbayes.findings.coverage import LEVELS, coverage
from biaxbayes.findings.rank_bands import uniformity_p_value

__all__ = ["SIGNIFICANT", "calibration_table", "verdict"]

SIGNIFICANT = 0.05
"""The simultaneous bands hold 95 % of uniform studies."""


def calibration_table(ranks: pd.DataFrame, draws: int) -> pd.DataFrame:
    """Uniformity and coverage of every ranked quantity.

    Parameters
    ----------
    ranks : DataFrame
        One row a replication and quantity, with ``parameter``, ``unit``, ``rank``, ``below``.
    draws : int
        Draws that a true value was ranked among.

    Returns
    -------
    DataFrame
        ``parameter``, ``unit``, ``replications``, ``uniformity_p``, ``inside_band``, and for
        each probability ``coverage_50``, its binomial interval ``_low`` and ``_high``.
    """
    rows = []
    for name, group in ranks.groupby("parameter", sort=False):
        p = uniformity_p_value(group["rank"].to_numpy(dtype=int), draws)
        row: dict[str, object] = {
            "parameter": name,
            "unit": group["unit"].iloc[0],
            "replications": len(group),
            "uniformity_p": p,
            "inside_band": "yes" if p >= SIGNIFICANT else "no",
        }
        for level in LEVELS:
            found, key = coverage(group["below"].to_numpy(), level), f"coverage_{100 * level:.0f}"
            row |= {key: found.observed, f"{key}_low": found.low, f"{key}_high": found.high}
        rows.append(row)
    return pd.DataFrame(rows)


def verdict(table: pd.DataFrame) -> tuple[bool, float]:
    """Whether the ranks of all quantities together are compatible with uniform ones.

    Returns
    -------
    calibrated : bool
        Whether ``p`` is at least 0.05.
    p : float
        Smallest p-value times the number of quantities (Bonferroni: one parameter in twenty
        leaves its own band by chance).
    """
    p = min(float(table["uniformity_p"].min()) * len(table), 1.0)
    return p >= SIGNIFICANT, p
