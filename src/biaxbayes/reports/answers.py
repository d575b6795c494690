"""How groups differ, in sentences: stiffnesses at a common stretch first, then parameters.

`batch` and `population` print the same sentences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from biaxbayes.parameters import MATERIAL, unit_words
from biaxbayes.report_table import three_digits, truncate
from biaxbayes.reports.text import derived_text
from biaxbayes.studies.groups import KNOWN_QUANTITIES, LOG, OPEN, POWER, Z90

CHANCE = (
    "Intervals are 90 %: one in ten excludes equality by chance. What could be shown is the "
    "difference that four of five such studies would show."
)
MOST = 10000
"""Ratio beyond which a number says no more."""


def answers(contrasts: Sequence[Mapping[Any, Any]]) -> list[str]:
    """Sentences on the contrasts of two groups, rows as of :func:`.group_contrasts`."""
    stretches = [
        float(at)
        for r in contrasts
        for stem, _, at in [str(r["quantity"]).partition(" at ")]
        if stem.startswith("stiffness_") and at
    ]
    top = f" at {max(stretches):g}" if stretches else ""
    chosen = [f"stiffness_{axis}{top}" for axis in "xy" if top]
    rows = {str(r["quantity"]): r for r in contrasts}
    chosen += [
        name
        for name in rows
        if name in KNOWN_QUANTITIES and KNOWN_QUANTITIES[name].parameter.kind == MATERIAL
    ]
    known = (rows[name] for name in chosen if name in rows)
    return [sentence(r) for r in known if isinstance(r["direction"], str)]


def population_answers(part: pd.DataFrame, groups: pd.DataFrame) -> list[str]:
    """The same of the rows of a population's contrasts.csv, with donors of its groups."""
    donors = groups.drop_duplicates("group").set_index("group")["donors"]
    rows: list[dict[Any, Any]] = []
    for r in part.to_dict("records"):
        low, middle, high = (float(r[f"difference_{q}"]) for q in ("q05", "q50", "q95"))
        shown = POWER * (high - low) / (2.0 * Z90)
        ends = {"": middle, "_low": low, "_high": high}
        if r["scale"] == LOG:
            shown, ends = ratio_of(shown), {k: ratio_of(v) for k, v in ends.items()}
        rows.append(
            r
            | {f"difference{k}": v for k, v in ends.items()}
            | {f"donors_{k}": int(donors[r[f"group_{k}"]]) for k in "ab"}
            | {"detectable": shown, "probability_larger": float(r["probability_positive"])}
        )
    return answers(rows)


def ratio_of(value: float) -> float:
    """The ratio of a difference of logs; finite."""
    return math.exp(min(value, 700.0))


def sentence(row: Mapping[Any, Any]) -> str:
    """One contrast: "b is 1.5 times as stiff in x at 1.17 (1.2 to 1.9; probability 0.98)"."""
    quantity, b = str(row["quantity"]), truncate(row["group_b"], 40)
    log, unit = row["scale"] == LOG, unit_words(str(row["unit"]))
    middle, low, high = (float(row[f"difference{end}"]) for end in ("", "_low", "_high"))
    times = " times" if log else unit
    ends = f"{ends_text(low, high, log=log)}{times}"
    stem, _, at = quantity.partition(" at ")
    if row["direction"] == OPEN:
        count, shown = int(row["donors_a"] + row["donors_b"]), float(row["detectable"])
        what = f"stiffness in {stem[-1]} at {at}" if at else derived_text(quantity)
        text = f"{what}: no difference shown ({ends})"
        return text + (f"; {count} donors could show {three_digits(shown)}{times}" if shown else "")
    larger = float(row["probability_larger"])
    probability = max(larger, 1.0 - larger)
    sure = f"probability {probability:.2f}" if probability < 0.995 else "probability above 0.99"
    found = f"({ends}; {sure})"
    if log and stem.startswith("stiffness_"):
        return f"{b} is {three_digits(middle)} times as stiff in {stem[-1]} at {at} {found}"
    if log:
        return f"{derived_text(quantity)} of {b} is {three_digits(middle)} times as large {found}"
    word = "larger" if middle > 0.0 else "smaller"
    return f"{derived_text(quantity)} of {b} is {three_digits(abs(middle))}{unit} {word} {found}"


def ends_text(low: float, high: float, *, log: bool) -> str:
    """The interval of a difference or, ``log``, of a ratio."""
    return " to ".join(_end(value, log=log) for value in (low, high))


def _end(value: float, *, log: bool) -> str:
    """An end of the interval of a difference or, ``log``, of a ratio."""
    if log and value > MOST:
        return f"more than {MOST:g}"
    # an interval that excludes 1 does so in print
    texts = (three_digits(value), *(f"{value:.{digits}g}" for digits in (4, 5, 6)))
    return next((text for text in texts if text != "1" or not log), "1")
