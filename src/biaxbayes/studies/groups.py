"""Summaries of many specimens by layer and donor; contrasts of groups, and of layers of a donor.

Only specimens that identify a quantity are counted and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t

from biaxbayes.identifiability.verdict import BOUNDED, IDENTIFIED
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import MATERIAL, Quantities

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
GROUP_CONTRAST_COLUMNS = (
    *("group_a", "group_b", "quantity", "unit", "scale", "paired", "donors_a", "donors_b"),
    *("mean_a", "mean_b", "difference", "difference_low", "difference_high", "direction"),
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


# --- groups of a study: does a quantity differ between them? -------------------------------------

LEAST_DONORS = 2
"""Donors of each group without which there is no spread to compare with."""
LARGER, SMALLER, OPEN = "larger", "smaller", "open"


def group_names(table: pd.DataFrame, own: Sequence[str] = ()) -> pd.Series:
    """Group of each row: the values of the columns that the study states, else the layer."""
    columns = [table[c].fillna("").astype(str) for c in own or ("layer",)]
    return pd.Series([", ".join(values) for values in zip(*columns, strict=True)], table.index)


def group_contrasts(table: pd.DataFrame, own: Sequence[str] = ()) -> pd.DataFrame:
    """How groups differ: group b less group a, from the medians of specimens that identify it.

    A donor counts once (a specimen without one is its own), as the mean of its specimens. Where two
    donors or more are in both groups, their differences count, else the means of the groups:

        d = mean b - mean a,  90 %: d +- t(0.95, n) sqrt(s_a^2 / n_a + s_b^2 / n_b)   (Welch)

    On a log scale means are geometric, and the difference is a ratio.
    """
    tissue = table[[_is_of_tissue(str(q)) for q in table["quantity"]]]
    known = tissue[(tissue["state"] == "converged") & (tissue["verdict"] == IDENTIFIED)]
    medians, log = known["q50"].to_numpy(dtype=float), (known["scale"] == "log").to_numpy()
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(log, np.log(medians), medians)
    known = known.assign(
        group=group_names(known, own),
        unit_of_donor=known["donor"].fillna("").where(known["donor"] != "", known["specimen"]),
        value=values,
    )
    known = known[np.isfinite(values)]
    names = [name for name in dict.fromkeys(group_names(tissue, own)) if name]
    units = dict(zip(tissue["quantity"], tissue["unit"], strict=True))
    rows = []
    for a, b in combinations(names, 2):
        for quantity in dict.fromkeys(tissue["quantity"]):
            part = known[known["quantity"] == quantity]
            donors = [
                part[part["group"] == g].groupby("unit_of_donor", sort=False)["value"].mean()
                for g in (a, b)
            ]
            head = {"group_a": a, "group_b": b, "quantity": quantity, "unit": units[quantity]}
            scale = part["scale"].iloc[0] if len(part) else ""
            rows.append(head | {"scale": scale} | _contrast(*donors, log=scale == "log"))
    return pd.DataFrame(rows, columns=list(GROUP_CONTRAST_COLUMNS))


def _is_of_tissue(name: str) -> bool:
    if "[" in name:  # of a mounted state or a piece, which have names of their own
        return False
    quantity = Quantities(all_parameters()).get(name)
    return quantity is None or quantity.parameter.kind == MATERIAL


def _contrast(a: pd.Series, b: pd.Series, *, log: bool) -> dict[str, Any]:
    """Means of the donors of two groups and their difference, with its 90 % interval."""
    common = a.index.intersection(b.index)
    paired = len(common) >= LEAST_DONORS
    if paired:
        a, b = a[common], b[common]
    out: dict[str, Any] = {"paired": paired, "donors_a": len(a), "donors_b": len(b)}
    back = math.exp if log else float
    out |= {f"mean_{k}": back(v.mean()) for k, v in (("a", a), ("b", b)) if len(v)}
    if min(len(a), len(b)) < LEAST_DONORS:
        return out
    apart = float(b.mean() - a.mean())
    if paired:
        variances, freedom = [float((b - a).var()) / len(a)], float(len(a) - 1)
    else:
        variances = [float(v.var()) / len(v) for v in (a, b)]
        parts = [v**2 / (len(g) - 1) for v, g in zip(variances, (a, b), strict=True)]
        freedom = sum(variances) ** 2 / sum(parts) if sum(parts) > 0.0 else math.inf
    half = float(t.ppf(0.95, freedom)) * math.sqrt(sum(variances))
    low, high = apart - half, apart + half
    direction = LARGER if low > 0.0 else SMALLER if high < 0.0 else OPEN
    numbers = dict(zip(("", "_low", "_high"), map(back, (apart, low, high)), strict=True))
    return out | {f"difference{k}": v for k, v in numbers.items()} | {"direction": direction}


# --- layers of a donor ---------------------------------------------------------------------------


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
