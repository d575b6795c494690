"""Rows of a population's tables as text: the same digits in the terminal and on the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from biaxbayes.identifiability.reported import DASH
from biaxbayes.identifiability.verdict import BOUNDED, FIXED, IDENTIFIED
from biaxbayes.parameters import unit_words
from biaxbayes.populations.model import LOG
from biaxbayes.studies.groups import OPEN

PARTS_OF_SPREAD = ("sd_donors", "sd_specimens")
TOTAL_SPREAD = ("sd_total",)


@dataclass(frozen=True)
class GroupRow:
    """A quantity of a group."""

    quantity: str
    unit: str
    median: str  # of the specimens of a typical donor
    reported: str  # 90 % interval or bound; a dash if not identified
    verdict: str
    identified: bool  # a value or a bound
    spreads: tuple[tuple[str, str], ...]  # median and 90 % interval of each sd (a factor for logs)
    spread_verdicts: tuple[str, ...]
    new: tuple[tuple[str, str], ...]  # the same of a new specimen and a new donor's median


@dataclass(frozen=True)
class ContrastRow:
    """A quantity of group b compared with group a."""

    quantity: str
    kind: str  # `ratio`, or `difference` with its unit
    median: str
    interval: str  # 90 %
    # `larger`, `smaller`, else `includes 1` (ratio) or `includes 0`; empty if not converged
    direction: str
    probability: str  # that it is larger in group b


def three_digits(value: float) -> str:
    """A number with three digits; a dash where there is none."""
    return DASH if math.isnan(value) else f"{float(f'{value:.3g}'):g}"


def interval(
    row: Mapping[Any, Any], part: str, write: Callable[[float], str] = three_digits
) -> tuple[str, str]:
    """Median and 90 % interval; a dash and nothing where there are no numbers."""
    median, low, high = (float(row[f"{part}_{q}"]) for q in ("q50", "q05", "q95"))
    if math.isnan(median):
        return DASH, ""
    return write(median), f"{write(low)} to {write(high)}"


def _ratio(log: float) -> str:
    return three_digits(math.exp(min(log, 700.0)))


def _words(value: object) -> str:
    return value if isinstance(value, str) else ""


def spread_parts(groups: pd.DataFrame) -> tuple[str, ...]:
    """The sds that are given: the total alone where donors and specimens cannot be separated."""
    split = groups["sd_donors_q50"].notna().any() or groups["sd_total_q50"].isna().all()
    return PARTS_OF_SPREAD if split else TOTAL_SPREAD


def group_rows(part: pd.DataFrame) -> list[GroupRow]:
    """Rows of population.csv of one group."""
    sides = spread_parts(part)
    rows = []
    for r in part.to_dict("records"):
        spreads = []
        for side in sides:
            median, ends = interval(r, side, _ratio if r["scale"] == LOG else three_digits)
            factor = r["scale"] == LOG and median != DASH
            spreads.append((f"factor {median}" if factor else median, ends))
        verdict = _words(r["verdict"])
        rows.append(
            GroupRow(
                str(r["quantity"]),
                "" if r["unit"] == "1" else str(r["unit"]),
                interval(r, "mean")[0],
                _words(r["reported"]) or DASH,
                verdict or DASH,
                verdict in (IDENTIFIED, BOUNDED, FIXED),
                tuple(spreads),
                tuple(_words(r[f"{side}_verdict"]) for side in sides),
                tuple(interval(r, name) for name in ("new_specimen", "new_donor")),
            )
        )
    return rows


def contrast_rows(part: pd.DataFrame) -> list[ContrastRow]:
    """Rows of contrasts.csv of one pair of groups."""
    rows = []
    for r in part.to_dict("records"):
        log, unit = r["scale"] == LOG, unit_words(str(r["unit"]))
        direction = _words(r["direction"]).replace(OPEN, "includes 1" if log else "includes 0")
        probability = float(r["probability_positive"])
        rows.append(
            ContrastRow(
                str(r["quantity"]),
                "ratio" if log else f"difference{' in' if unit else ''}{unit}",
                *interval(r, "difference", _ratio if log else three_digits),
                direction,
                DASH if math.isnan(probability) else f"{probability:.3f}",
            )
        )
    return rows
