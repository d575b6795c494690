"""Tables of what was stated of the specimens, and of what of it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from studies.coverage.specimens import FAMILIES

LOGARITHMIC = ("C1", "k1", "k2")
INDEPENDENT = "/independent"
"""Behind the name of a product: with independent errors in place of its default."""
CASE = ["product", "family", "protocols", "seed"]
ROW = ["family", "protocols", "seed", "parameter"]


def row_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per product, specimen and parameter, of draws that have converged.

    ``inside`` is the truth in the 5 to 95 % range, ``holds`` in what the verdict leaves of the
    stated interval: both ends, one, or none. Widths of stiffnesses and exponents are logarithmic.
    """
    table = pd.DataFrame(
        [
            {
                **dict(zip(CASE, record["case"], strict=True)),
                "processor_seconds": record["seconds"]["processor, sampled"],
                **row,
            }
            for record in records
            for row in record["rows"]
            if record["state"] == "converged"
        ]
    )
    if table.empty:
        return table
    table["mounting"] = table["parameter"].str.startswith("mounting")
    true, one_end = table["true"], table["verdict"].eq("bounded")
    table["inside"] = (true >= table["q05"]) & (true <= table["q95"])
    two_ends = table["verdict"].isin(["identified", "only in combination"])
    low = table["low"].where(two_ends | (one_end & table["bound"].eq("low")))
    high = table["high"].where(two_ends | (one_end & table["bound"].eq("high")))
    table["stated"] = low.notna() | high.notna()
    table["holds"] = ~(true < low) & ~(true > high)
    logarithmic = table["parameter"].isin(LOGARITHMIC)
    ends = table[["q05", "q95", "low", "high"]].clip(lower=1e-9)
    for name, a, b in (("width", "q05", "q95"), ("stated_width", "low", "high")):
        table[name] = (table[b] - table[a]).where(~logarithmic, np.log(ends[b] / ends[a]))
    return table


def _held(values: pd.Series) -> str:
    return f"{int(values.sum())}/{len(values)} {values.mean():.2f}" if len(values) else "-"


def _in_order(rows: pd.DataFrame, by: list[str]) -> list[tuple[tuple[Any, ...], pd.DataFrame]]:
    """The groups of a table, families in their order."""
    place: dict[Any, Any] = {name: f"{i:02}" for i, name in enumerate(FAMILIES)}
    groups = [(tuple(key), part) for key, part in rows.groupby(by, sort=False)]
    return sorted(groups, key=lambda item: [str(place.get(k, k)) for k in item[0]])


def what_holds(rows: pd.DataFrame, beside: str, by: list[str]) -> pd.DataFrame:
    """What is stated and what of it holds, and the widths over those that ``beside`` states."""
    if rows.empty:
        return rows
    other = rows[rows["product"] == beside].set_index(ROW)["stated_width"].rename("other")
    out = []
    for key, part in _in_order(rows.join(other, on=ROW), by):
        identified, bounded = part["verdict"].eq("identified"), part["verdict"].eq("bounded")
        compared = part[np.isfinite(part["other"])]
        specimens = part.groupby(["family", "protocols", "seed"])["processor_seconds"].first()
        out.append(
            {
                **dict(zip(by, key, strict=True)),
                "specimens": len(specimens),
                "5 to 95 % holds": _held(part["inside"]),
                "truth below, above": f"{(part['true'] < part['q05']).sum()}, "
                f"{(part['true'] > part['q95']).sum()}",
                "identified": f"{identified.mean():.2f}",
                "bounded": f"{bounded.mean():.2f}",
                "stated holds": _held(part["holds"][part["stated"]]),
                "identified holds": _held(part["holds"][identified]),
                "bound holds": _held(part["holds"][bounded]),
                "width": part["width"].median(),
                f"over {beside}": (compared["width"] / compared["other"]).median(),
                "seconds": specimens.median(),
            }
        )
    return pd.DataFrame(out)


def cost(rows: pd.DataFrame) -> pd.DataFrame:
    """Widths over those of independent errors, by family."""
    behind = rows["product"].str.endswith(INDEPENDENT)
    other = rows[behind].assign(product=rows["product"].str.removesuffix(INDEPENDENT))
    sharp = other.set_index(["product", *ROW])["width"].rename("sharp")
    both = rows[~behind].join(sharp, on=["product", *ROW]).dropna(subset="sharp")
    both = both.assign(ratio=both["width"] / both["sharp"])
    out = []
    for (product, family), part in _in_order(both, ["product", "family"]):
        row = {"product": product, "family": family}
        for name, own in (
            ("parameters", part[~part["mounting"]]),
            ("C1", part[part["parameter"].eq("C1")]),
            ("mounting", part[part["mounting"]]),
        ):
            row |= {name: own["ratio"].median(), f"{name}, largest": own["ratio"].max()}
        out.append(row)
    return pd.DataFrame(out)


def band_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per product and specimen with a left-out path."""
    return pd.DataFrame(
        [
            {**dict(zip(CASE, record["case"], strict=True)), **record["bands"]}
            for record in records
            if "bands" in record and record["state"] == "converged"
        ]
    )


def band_means(bands: pd.DataFrame) -> pd.DataFrame:
    """Means over the specimens of a family."""
    out = []
    for (product, family), part in _in_order(bands, ["product", "family"]) if len(bands) else ():
        means = part.drop(columns=CASE).mean().to_dict()
        out.append({"product": product, "family": family, "specimens": len(part), **means})
    return pd.DataFrame(out)


def unfinished(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Specimens whose draws have not converged, or that were refused."""
    return pd.DataFrame(
        [
            {**dict(zip(CASE, record["case"], strict=True)), "state": record["state"]}
            for record in records
            if record["state"] != "converged"
        ]
    )
