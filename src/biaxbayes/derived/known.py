"""What is known best of the tissue, stresses and stiffnesses, and how stiff its pieces are."""

from __future__ import annotations

import pandas as pd

from biaxbayes.derived.determined import AT_MEASURED_STRETCH, AT_PHYSIOLOGICAL, RATIO
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import STIFFNESS, name_of
from biaxbayes.prediction.percentiles import quantiles
from biaxbayes.report_table import DASH, Column, Table, interval_texts

QUANTITIES = {
    "nominal stress x": "nominal stress x (kPa)",
    "nominal stress y": "nominal stress y (kPa)",
    "Cauchy stress x": "Cauchy stress x (kPa)",
    "Cauchy stress y": "Cauchy stress y (kPa)",
    "tangent stiffness xx": "tangent stiffness x (kPa)",
    "tangent stiffness yy": "tangent stiffness y (kPa)",
    RATIO: "stiffness x over y",
}
"""Quantities of ``determined.csv``, and how they are printed."""
SPLIT = f"^(.*?)({AT_MEASURED_STRETCH}|{AT_PHYSIOLOGICAL})?(?: of (.*))?$"
"""Quantity, where it is taken, and of several protocols which one."""
STATES = 2
"""States of the test: half-way and at the end of a protocol."""


def known_table(determined: pd.DataFrame) -> Table:
    """Medians with 90 % intervals at states of the test and in the body; empty without any.

    Half-way and at the end of a protocol, of several the one whose smaller stretch is the largest.
    Where the mounting stretch was inferred, stretches are relative to the mounted state.
    """
    label = "What is known"
    if determined.empty:
        return Table.of_texts([Column("")], [], label)
    split = determined["quantity"].str.extract(SPLIT)
    chosen = determined.assign(
        name=split[0],
        ending=split[1].fillna(""),
        protocol=split[2].fillna(""),
        smaller=determined[["stretch_x", "stretch_y"]].min(axis=1),
    )
    chosen = chosen[chosen["name"].isin(list(QUANTITIES)) & chosen["smaller"].notna()]
    body = chosen[chosen["ending"] == AT_PHYSIOLOGICAL]
    tested = chosen[chosen["ending"] == AT_MEASURED_STRETCH]
    measured = not tested.empty
    if measured:
        best = tested.groupby("protocol", sort=False)["smaller"].max().idxmax()
        tested = tested[tested["protocol"] == best]
    else:
        tested = chosen[chosen["ending"] == ""]
    columns = {}
    for x, y in tested[["stretch_x", "stretch_y"]].drop_duplicates().head(STATES).to_numpy():
        there = (tested["stretch_x"] == x) & (tested["stretch_y"] == y)
        columns[f"{x:g} in x, {y:g} in y"] = tested[there].set_index("name")
    if not body.empty:
        x, y = body[["stretch_x", "stretch_y"]].iloc[0]
        columns[f"in the body (total {x:g}, {y:g})"] = body.set_index("name")
    rows = [
        (text, *(_cell(name, column) for column in columns.values()))
        for name, text in QUANTITIES.items()
        if any(name in column.index for column in columns.values())
    ]
    relative = "Stretched from the mounted state to" if measured else "At total stretches"
    return Table.of_texts(
        [Column(relative), *(Column(head) for head in columns)],
        rows,
        label,
        f"{label} of the tissue: posterior medians with 90 % intervals. Tangent stiffness: "
        "derivative of the law's Cauchy stress with respect to the log of the stretch in one "
        "direction, at constant stretch in the other",
    )


def _cell(name: str, column: pd.DataFrame) -> str:
    """Median and interval of a quantity; a dash where it has none."""
    if name not in column.index:
        return DASH
    values = column.loc[[name], ["median", "low", "high"]].to_numpy(dtype=float)[0]
    median, low, high = interval_texts(values[0], values[1], values[2], log=name == RATIO)
    return f"{median} ({low} to {high})"


def piece_stiffnesses(posterior: Posterior, draws: pd.DataFrame) -> tuple[list[str], list[str]]:
    """A sentence on each further piece: those as stiff as the first, and those that differ."""
    alike, different = [], []
    first, *further = posterior.specimen.pieces
    for piece in further:
        low, median, high = quantiles(draws[name_of(STIFFNESS.name, piece.name)])
        middle, *ends = interval_texts(median, low, high, STIFFNESS)
        many = f"{middle} ({' to '.join(ends)})"
        text = f"piece {piece.name} is {many} times as stiff as {first.name}"
        if low <= 1.0 <= high:
            alike.append(text)
            continue
        different.append(
            f"{text}: it differs. The other intervals allow for a stiffness of its own, not for "
            "another fibre angle or layer: check its width and thickness and where it was cut"
        )
    return alike, different
