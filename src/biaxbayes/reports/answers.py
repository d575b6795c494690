"""How groups differ, in sentences: stiffnesses at a common stretch first, then parameters.

`batch` and `population` print the same sentences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from biaxbayes.parameters import MATERIAL, unit_words
from biaxbayes.report_table import quantiles_of, three_digits, truncate
from biaxbayes.reports.text import derived_text, text_or_empty
from biaxbayes.studies.groups import KNOWN_QUANTITIES, LOG, OPEN, POWER, Z90

CHANCE = (
    "Intervals are 90 %: one in ten excludes equality by chance. What could be shown is the "
    "difference that four of five such studies would show."
)


def answers(contrasts: Sequence[Mapping[Any, Any]]) -> list[str]:
    """Sentences on the contrasts of two groups, rows as of :func:`.group_contrasts`."""
    rows = {str(r["quantity"]): r for r in contrasts}
    at = [name.split(" at ") for name in rows if name.startswith("stiffness_") and " at " in name]
    top = max((float(stretch) for _, stretch in at), default=math.nan)
    materials = {q.name for q in KNOWN_QUANTITIES.of_kind(MATERIAL)}
    chosen = [f"stiffness_{axis} at {top:g}" for axis in "xy"]
    chosen += [name for name in rows if name in materials]
    known = (rows[name] for name in chosen if name in rows)
    return [sentence(r) for r in known if isinstance(r["direction"], str)]


def group_pairs(contrasts: pd.DataFrame) -> list[tuple[str, str, pd.DataFrame]]:
    """Names of both groups, and the rows of their contrasts."""
    pairs = contrasts.groupby(["group_a", "group_b"], sort=False)
    return [(truncate(a, 40), truncate(b, 40), part) for (a, b), part in pairs]


def direction_text(row: Mapping[Any, Any]) -> str:
    """`larger` or `smaller`, else what the interval includes; empty if not converged."""
    no_difference = f"includes {1 if row['scale'] == LOG else 0}"
    return text_or_empty(row["direction"]).replace(OPEN, no_difference)


def population_answers(part: pd.DataFrame, groups: pd.DataFrame) -> list[str]:
    """The same of the rows of a population's contrasts.csv, with donors of its groups."""
    donors = groups.drop_duplicates("group").set_index("group")["donors"]
    rows: list[dict[Any, Any]] = []
    for r in part.to_dict("records"):
        middle, low, high = quantiles_of(r, "difference")
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
    ends = []
    for value in (low, high):
        # an interval that excludes 1 does so in print
        texts = (three_digits(value), *(f"{value:.{digits}g}" for digits in (4, 5, 6)))
        end = next((text for text in texts if text != "1" or not log), "1")
        ends.append("more than 10000" if log and value > 1e4 else end)
    return " to ".join(ends)
