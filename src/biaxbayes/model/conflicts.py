"""What in a posterior contradicts the data or a limit of the program, as findings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.specimens.findings import Finding

NEAR_EDGE = 0.05
"""Draws within this share of a limit of the mounting stretch count as lying at it."""
FEW_DRAWS = 0.001


def bracket_findings(stretches: Mapping[str, np.ndarray]) -> list[Finding]:
    """Mounting stretches whose draws lie at the limits between which they are searched.

    Parameters
    ----------
    stretches : mapping of str to ndarray
        Draws of each mounting stretch by its name.
    """
    low, high = BRACKET
    findings = []
    for name, draws in stretches.items():
        below, above = draws < low * (1.0 + NEAR_EDGE), draws > high * (1.0 - NEAR_EDGE)
        share = float(np.mean(below | above))
        if share <= FEW_DRAWS:
            continue
        limit = low if below.mean() > above.mean() else high
        findings.append(
            Finding(
                "mounting-stretch-limit",
                "warning",
                f"{100 * share:.2g} % of the draws of {name} lie at {limit:g}, the limit of the "
                f"search ({low:g} to {high:g}): its interval is cut there. Check the mounting "
                "force and its unit, or state a narrower --mounting-sd",
            )
        )
    return findings
