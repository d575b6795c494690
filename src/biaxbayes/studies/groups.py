"""Summaries of many specimens by layer and donor, and contrasts of the layers of a donor.

Only specimens that identify a quantity are counted and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.identifiability.verdict import BOUNDED, IDENTIFIED

USABLE_VERDICTS = (IDENTIFIED, BOUNDED)
"""Verdicts with which the numbers of a specimen are used."""
GROUP_COLUMNS = (
    *("group_by", "group", "quantity", "unit", "specimens", "converged", "identified"),
    *("centre", "lowest", "highest", "scale", "sd_of_medians", "sd_within", "sd_between"),
)
LAYER_CONTRAST_COLUMNS = (
    *("layer_a", "layer_b", "quantity", "unit", "pairs", "identified", "b_greater", "b_less"),
    *("mean_difference", "lowest_difference", "highest_difference"),
)
COMPARABLE_KINDS = ("parameter", "structure tensor", "stiffness")
"""Kinds of distance that are comparable between donors; stresses are those at the end of the tests
of each donor."""


def group_summaries(table: pd.DataFrame, own: Sequence[str] = ()) -> pd.DataFrame:
    """Summarise the study table by layer, donor and study, never across values of `own` columns.

    `centre` is the mean of the medians of identified specimens (geometric on a log scale).
    `sd_between`^2 = max(`sd_of_medians`^2 - `sd_within`^2, 0) is the variance between specimens
    that the width of the posteriors (root mean square sd `sd_within`) does not explain.
    """
    rows = []
    for group_by in ("layer", "donor", "all"):
        named = table if group_by == "all" else table[table[group_by].fillna("") != ""]
        parts = [named[c].astype(str) for c in own]
        if group_by != "all":
            parts.append(named[group_by])
        elif not own:
            parts.append(pd.Series("all", index=named.index))
        keys = [", ".join(key) for key in zip(*parts, strict=True)]
        groups = named.assign(_group=keys)
        for group, members in groups.groupby("_group", sort=False):
            total = int(members["specimen"].nunique())
            for quantity, part in members.groupby("quantity", sort=False):
                head = {
                    "group_by": group_by,
                    "group": group,
                    "quantity": quantity,
                    "specimens": total,
                }
                rows.append(head | _summary(part))
    return pd.DataFrame(rows, columns=list(GROUP_COLUMNS))


def _summary(part: pd.DataFrame) -> dict[str, Any]:
    converged = part[part["state"] == "converged"]
    # Quantities that are not properties of the tissue have no verdict.
    usable = converged["verdict"].isin(USABLE_VERDICTS) | (converged["verdict"].fillna("") == "")
    known = converged[usable & np.isfinite(converged["q50"].astype(float))]
    units = [u for u in part["unit"] if isinstance(u, str)]
    scales = [s for s in part["scale"] if isinstance(s, str)]
    out: dict[str, Any] = {
        "unit": units[0] if units else "",
        "scale": scales[0] if scales else "",
        "converged": int(converged["specimen"].nunique()),
        "identified": len(known),
    }
    if known.empty:
        return out
    medians = known["q50"].to_numpy(dtype=float)
    log = out["scale"] == "log"
    if log:
        medians = medians[medians > 0.0]
    if not medians.size:
        return out
    on_scale = np.log(medians) if log else medians
    within = math.sqrt(float(np.mean(np.square(known["scale_sd"].to_numpy(dtype=float)))))
    out |= {
        "centre": float(np.exp(on_scale.mean()) if log else on_scale.mean()),
        "lowest": float(medians.min()),
        "highest": float(medians.max()),
        "sd_within": within,
    }
    if medians.size > 1:
        spread = float(on_scale.std(ddof=1))
        out["sd_of_medians"] = spread
        # var(medians) = between + mean of the posterior variances
        out["sd_between"] = math.sqrt(max(spread**2 - within**2, 0.0))
    return out


def layer_contrasts(distances: pd.DataFrame) -> pd.DataFrame:
    """Summarise over donors how the layers of a donor differ: medians of identified pairs b - a."""
    if distances.empty:
        return pd.DataFrame(columns=list(LAYER_CONTRAST_COLUMNS))
    same_for_all = distances["kind"].isin(COMPARABLE_KINDS) & (
        distances["total_stretch"].isna() | (distances["total_stretch"] == 1.0)
    )
    across = distances[same_for_all & (distances["layer_a"] != distances["layer_b"])].copy()
    # each pair with its layers in the order of the study
    names = dict.fromkeys([*distances["layer_a"], *distances["layer_b"]])
    order = {name: k for k, name in enumerate(names)}
    turn = across["layer_a"].map(order) > across["layer_b"].map(order)
    layers, ends = ["layer_a", "layer_b"], [f"difference_{q}" for q in ("q05", "q50", "q95")]
    across.loc[turn, layers] = across.loc[turn, layers[::-1]].to_numpy()
    across.loc[turn, ends] = -across.loc[turn, ends[::-1]].to_numpy()
    rows = []
    for (a, b, quantity), part in across.groupby([*layers, "quantity"], sort=False):
        known = part[part["identified_in_both"]]
        row = {
            "layer_a": a,
            "layer_b": b,
            "quantity": quantity,
            "unit": part["unit"].iloc[0],
            "pairs": len(part),
            "identified": len(known),
            "b_greater": int((known["difference_q05"] > 0.0).sum()),
            "b_less": int((known["difference_q95"] < 0.0).sum()),
        }
        if len(known):
            differences = known["difference_q50"]
            row |= {
                "mean_difference": float(differences.mean()),
                "lowest_difference": float(differences.min()),
                "highest_difference": float(differences.max()),
            }
        rows.append(row)
    return pd.DataFrame(rows, columns=list(LAYER_CONTRAST_COLUMNS))
