"""Uniformity of the ranks of a calibration, and coverage.

With N replications and ranks 0 ... L, the number of ranks up to r is Bin(N, z_r), with
z_r = (r + 1) / (L + 1). The smallest of its tail probabilities over all r decides (Saeilynoja,
Buerkner and Vehtari, Statistics and Computing 32 (2022) 32, section 2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binom, binomtest

from biaxbayes.errors import RunError
from biaxbayes.text_files import read_csv

BAND_PROBABILITY = 0.95
"""Probability that uniform ranks lie inside their simultaneous band everywhere."""


def rank_counts(ranks: np.ndarray, draws: int) -> np.ndarray:
    """Count the ranks that are at most r, for r = 0 ... draws - 1."""
    return np.cumsum(np.bincount(np.asarray(ranks, dtype=int), minlength=draws + 1))[:draws]


def tail_probabilities(counts: np.ndarray, replications: int, z: float | np.ndarray) -> np.ndarray:
    """2 min(P(X <= count), P(X >= count)) of counts up to ranks of the probability z."""
    below, above = binom.cdf(counts, replications, z), binom.sf(counts - 1, replications, z)
    return 2.0 * np.minimum(below, above)


def _allowed(replications: int, draws: int, level: float) -> list[tuple[int, int]]:
    """Smallest and largest count whose tail probability exceeds the level, for each rank."""
    z = np.arange(1, draws + 1)[:, None] / (draws + 1)
    inside = tail_probabilities(np.arange(replications + 1), replications, z) > level
    if not inside.any(axis=1).all():
        return []
    first, last = inside.argmax(axis=1), replications - inside[:, ::-1].argmax(axis=1)
    return list(zip(first.tolist(), last.tolist(), strict=True))


def probability_inside(replications: int, draws: int, level: float) -> float:
    """Probability, under uniform ranks, that every tail probability exceeds `level`, exactly.

    The counts form a Markov chain: count_r - count_(r-1) ~ Bin(N - count_(r-1), 1 / (L + 1 - r)).
    """
    low, probability = 0, np.ones(1)  # count before the first rank: 0
    allowed = _allowed(replications, draws, level)
    for r, (first, last) in enumerate(allowed):
        before = low + np.arange(probability.size)[:, None]
        more = np.arange(first, last + 1) - before
        probability = probability @ binom.pmf(more, replications - before, 1.0 / (draws + 1 - r))
        low = first
    return float(min(probability.sum(), 1.0)) if allowed else 0.0


@lru_cache(maxsize=64)
def band_level(replications: int, draws: int) -> float:
    """Largest pointwise level (to 1e-3) at which the bands contain all ranks in 95 % of cases."""
    low, high = np.log((1.0 - BAND_PROBABILITY) / (10.0 * draws)), np.log(1.0 - BAND_PROBABILITY)
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        enough = probability_inside(replications, draws, float(np.exp(middle))) >= BAND_PROBABILITY
        low, high = (middle, high) if enough else (low, middle)
    return float(np.exp(low))


def count_band(replications: int, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Simultaneous band of :func:`rank_counts`: lowest and highest count inside, shape (draws,)."""
    low, high = np.array(_allowed(replications, draws, band_level(replications, draws))).T
    return low, high


def uniformity_p_value(ranks: np.ndarray, draws: int) -> float:
    """p-value of uniform ranks; below 0.05 exactly if the ranks leave the 95 % band."""
    ranks, z = np.asarray(ranks), np.arange(1, draws + 1) / (draws + 1)
    worst = float(tail_probabilities(rank_counts(ranks, draws), ranks.size, z).min())
    return 1.0 - probability_inside(ranks.size, draws, min(worst, 1.0))


COVERAGE_LEVELS = (0.50, 0.80, 0.90, 0.95)


def coverage(below: np.ndarray, level: float) -> tuple[float, float, float]:
    """Coverage of central intervals, and its 95 % interval, from shares below the truth."""
    n = below.size
    hits = int(np.count_nonzero(np.abs(below - 0.5) <= 0.5 * level))
    interval = binomtest(hits, n).proportion_ci(0.95)
    return hits / n, float(interval.low), float(interval.high)


MIN_REPLICATIONS = 50
"""Replications below which even clearly wrong intervals leave uniform ranks."""
SIGNIFICANT = 0.05
"""p-value below which ranks are not uniform; the simultaneous bands contain 95 %."""


def calibration_table(ranks: pd.DataFrame, draws: int) -> pd.DataFrame:
    """Uniformity and coverage of every quantity, from one row per replication and quantity."""
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
        for level in COVERAGE_LEVELS:
            key = f"coverage_{100 * level:.0f}"
            row[key], row[f"{key}_low"], row[f"{key}_high"] = coverage(
                group["below"].to_numpy(), level
            )
        rows.append(row)
    return pd.DataFrame(rows)


def uniformity(table: pd.DataFrame) -> tuple[bool, float]:
    """Test of all ranks together: uniform or not, and the smallest p-value times their number."""
    p = min(float(table["uniformity_p"].min()) * len(table), 1.0)
    return p >= SIGNIFICANT, p


RANK_COLUMNS = (
    *("replication", "parameter", "unit", "truth", "rank", "below", "median", "sd"),
    *("state", "reason", "worst_ess", "worst_rhat", "rejected_draws", "seconds"),
)
TEXT_COLUMNS = ("parameter", "unit", "state", "reason")


def read_ranks(path: Path) -> pd.DataFrame:
    """``ranks.csv`` of a calibration."""
    try:
        table = read_csv(path, dtype=str, keep_default_na=False)
        if tuple(table.columns) != RANK_COLUMNS:
            raise ValueError
        for name in RANK_COLUMNS:
            if name not in TEXT_COLUMNS:
                # Python's parser reads back exactly what was written.
                table[name] = [float(v) if v else math.nan for v in table[name]]
        return table.astype({"replication": int, "rejected_draws": int})
    except (OSError, ValueError):
        raise RunError(
            f"{path}: is damaged or not a table of ranks; leave out `resume` to start again"
        ) from None


def rank_table(rows: Mapping[int, list[dict[str, Any]]]) -> pd.DataFrame:
    """``ranks.csv`` from the rows of each replication."""
    flat = [row for index in sorted(rows) for row in rows[index]]
    return pd.DataFrame(flat, columns=list(RANK_COLUMNS))
