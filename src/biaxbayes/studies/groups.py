r"""Groups of a study: their means, and how they differ, from the draws of every converged specimen.

The model, y_i ~ N(mu_g, tau^2 + s_i^2), is that of docs/studies.md, the normal-normal one of
meta-analysis (Roever, J. Stat. Softw. 93 (2020) 6). mu_g, and the difference of two groups, are
mixtures of normal distributions over tau.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from biaxbayes.laws import all_parameters
from biaxbayes.parameters import MATERIAL, STRETCH, Parameter, Quantities

GROUP_COLUMNS = (
    *("group_by", "group", "quantity", "unit", "specimens", "converged", "scale"),
    *("mean", "mean_low", "mean_high", "lowest", "highest", "sd_between"),
)
GROUP_CONTRAST_COLUMNS = (
    *("group_a", "group_b", "quantity", "unit", "scale", "paired", "donors_a", "donors_b"),
    *("mean_a", "mean_b", "difference", "difference_low", "difference_high"),
    *("probability_larger", "detectable", "direction"),
)
PRIOR_COLUMNS = ("prior_q05", "prior_q50", "prior_q95")
"""Quantiles of the prior of a parameter, where that is normal or lognormal."""
Z90 = 1.6448536269514722
POWER = Z90 + 0.8416212335729143
"""A difference of so many sds is one that the 90 % intervals of four of five studies show."""
MOST_OF_PRIOR = 0.99
"""Largest r: a specimen that learned nothing counts hardly."""
LEAST_DONORS = 2
"""Donors of each group without which there is no spread to compare with."""
LARGER, SMALLER, OPEN = "larger", "smaller", "open"
LOG, LINEAR = "log", "linear"
KNOWN_QUANTITIES = Quantities(all_parameters())


@dataclass(frozen=True)
class Mixture:
    """A mixture of normal distributions."""

    weight: np.ndarray
    mean: np.ndarray
    sd: np.ndarray

    @property
    def total_sd(self) -> float:
        """Its sd."""
        centre = self.weight @ self.mean
        return math.sqrt(float(self.weight @ (self.sd**2 + (self.mean - centre) ** 2)))

    def below(self, x: np.ndarray) -> np.ndarray:
        """Probability below values."""
        return np.asarray(ndtr((np.atleast_1d(x)[:, None] - self.mean) / self.sd) @ self.weight)

    def quantiles(self) -> tuple[float, float, float]:
        """5, 50 and 95 % quantiles."""
        low, high = (self.mean - 8.0 * self.sd).min(), (self.mean + 8.0 * self.sd).max()
        x = np.linspace(low, high, 2_001)
        q05, q50, q95 = np.interp((0.05, 0.5, 0.95), self.below(x), x)
        return float(q05), float(q50), float(q95)


@dataclass(frozen=True)
class GroupMeans:
    """Means of groups at values of tau: weights (t,), means and variances (groups, t)."""

    tau: np.ndarray
    weight: np.ndarray
    mean: np.ndarray
    variance: np.ndarray

    def of(self, group: int) -> Mixture:
        """The mean of a group."""
        return Mixture(self.weight, self.mean[group], np.sqrt(self.variance[group]))

    def difference(self) -> Mixture:
        """The mean of the second group less that of the first."""
        sd = np.sqrt(self.variance.sum(axis=0))
        return Mixture(self.weight, self.mean[1] - self.mean[0], sd)


def group_means(groups: Sequence[tuple[np.ndarray, np.ndarray]], scale: float) -> GroupMeans:
    """Posterior of the means of groups, each given by values y and their sds s.

    For a given tau, with w_i = 1 / (tau^2 + s_i^2) and W_g = sum_i w_i,

        mu_g ~ N(m_g, 1 / W_g)            m_g = sum_i w_i y_i / W_g
        p(tau | y)  ~  p(tau) prod_g W_g^-1/2 prod_i w_i^1/2 exp(-w_i (y_i - m_g)^2 / 2)
    """
    tau = scale * np.concatenate([[0.0], np.geomspace(1e-3, 5.0, 200)])
    log = -0.5 * (tau / scale) ** 2
    means, variances = [], []
    for y, s in groups:
        w = 1.0 / (tau[:, None] ** 2 + s**2)
        total = w.sum(axis=1)
        mean = w @ y / total
        log += 0.5 * np.log(w).sum(axis=1) - 0.5 * np.log(total)
        log -= 0.5 * (w * (y - mean[:, None]) ** 2).sum(axis=1)
        means.append(mean)
        variances.append(1.0 / total)
    weight = np.exp(log - log.max()) * np.gradient(tau)
    return GroupMeans(tau, weight / weight.sum(), np.array(means), np.array(variances))


SPREAD_LOG, SPREAD_SHARE, SPREAD_STRETCH = 0.5, 0.15, 0.02
"""Scales of the half-normal priors of sds: of a log, as a share of a range, of a stretch."""


def spread_scale(p: Parameter, otherwise: float, *, log: bool) -> float:
    """Scale of the half-normal prior of an sd on the scale of its quantity."""
    if log:
        return SPREAD_LOG
    if p.kind == STRETCH:
        return SPREAD_STRETCH
    return SPREAD_SHARE * (p.high - p.low) if math.isfinite(p.high - p.low) else otherwise


def _parameter(name: str) -> Parameter:
    """The parameter of a name, or of a quantity that follows from parameters, its range."""
    if name in KNOWN_QUANTITIES:
        return KNOWN_QUANTITIES[name].parameter
    # a share of the fibres
    return Parameter(name, low=0.0, high=1.0) if name.startswith("H") else Parameter(name)


def _scale_of_tau(name: str, values: np.ndarray, *, log: bool) -> float:
    mean = float(np.abs(values).sum()) / max(values.size, 1)
    return spread_scale(_parameter(name), max(SPREAD_LOG * mean, 1e-300), log=log)


def group_names(table: pd.DataFrame, own: Sequence[str] = ()) -> pd.Series:
    """Group of each row: the values of the columns that the study states, else the layer."""
    columns = [table[c].fillna("").astype(str) for c in own or ("layer",)]
    return pd.Series([", ".join(values) for values in zip(*columns, strict=True)], table.index)


def _on_scale(part: pd.DataFrame) -> tuple[pd.DataFrame, bool]:
    """Converged rows of a quantity with values and sds on the scale; whether that is a log."""
    columns = ["q05", "q50", "q95", *PRIOR_COLUMNS]
    ends = part.reindex(columns=columns).to_numpy(dtype=float)
    known = np.isfinite(ends[:, :3]).all(axis=1) & (part["state"] == "converged").to_numpy()
    part, ends = part.loc[known], ends[known]
    log = bool((part["scale"] == LOG).any() and (ends[:, :3] > 0.0).all())
    with np.errstate(divide="ignore", invalid="ignore"):
        low, median, high, first, middle, last = (np.log(ends) if log else ends).T
        # a fixed or exactly known value still has a width that divides
        sd = np.maximum((high - low) / (2.0 * Z90), 1e-9 * np.maximum(np.abs(median), 1e-300))
        # r = d_i^2 / d_0^2, zero where there is no prior or a constant
        r = np.square(sd / (last - first) * 2.0 * Z90)
    r = np.where(np.isfinite(r), np.minimum(r, MOST_OF_PRIOR), 0.0)
    value = (median - np.where(r > 0.0, r * middle, 0.0)) / (1.0 - r)
    return part.assign(value=value, sd=sd / np.sqrt(1.0 - r)), log


def group_summaries(table: pd.DataFrame, own: Sequence[str] = ()) -> pd.DataFrame:
    """Means of layers, donors and the study, never across values of `own` columns.

    `mean` is mu_g with its 90 % interval, `lowest` and `highest` are medians of specimens, and
    `sd_between` is the median of tau: the scatter that the width of the posteriors leaves.
    """
    rows = []
    for group_by in ("layer", "donor", "all"):
        named = table if group_by == "all" else table[table[group_by].fillna("") != ""]
        columns = [*own, *(() if group_by == "all" else (group_by,))]
        keys = group_names(named, columns) if columns else "all"
        for group, members in named.assign(_group=keys).groupby("_group", sort=False):
            total = int(members["specimen"].nunique())
            for quantity, part in members.groupby("quantity", sort=False):
                head = {"group_by": group_by, "group": group, "quantity": quantity}
                rows.append(head | {"specimens": total} | _summary(str(quantity), part))
    return pd.DataFrame(rows, columns=list(GROUP_COLUMNS))


def _summary(quantity: str, part: pd.DataFrame) -> dict[str, Any]:
    known, log = _on_scale(part)
    unit = next((v for v in part["unit"] if isinstance(v, str)), "")
    out: dict[str, Any] = {"unit": unit, "converged": len(known), "scale": LOG if log else LINEAR}
    if known.empty:
        return out
    y, s = known["value"].to_numpy(), known["sd"].to_numpy()
    means = group_means([(y, s)], _scale_of_tau(quantity, y, log=log))
    back = np.exp if log else np.asarray
    limits = _parameter(quantity).range
    low, mean, high = np.clip(back(means.of(0).quantiles()), *limits).tolist()
    out |= {"mean": mean, "mean_low": low, "mean_high": high}
    out |= {"lowest": float(known["q50"].min()), "highest": float(known["q50"].max())}
    if len(known) > 1:
        out["sd_between"] = float(np.interp(0.5, means.weight.cumsum(), means.tau))
    return out


def group_contrasts(table: pd.DataFrame, own: Sequence[str] = ()) -> pd.DataFrame:
    """How groups differ: group b less group a, a ratio where the quantity is positive.

    A donor counts once (a specimen without one is its own): its specimens of a group are averaged
    with weights 1 / (scale^2 + s_i^2). Where two donors or more are in both groups, their
    differences are the values of one group, else the donors of either are those of two.
    """
    # properties of the tissue, not of a mounted state or a piece
    of_tissue = [
        "[" not in name and _parameter(name).kind == MATERIAL
        for name in map(str, table["quantity"])
    ]
    tissue = table[of_tissue]
    tissue = tissue.assign(
        group=group_names(tissue, own),
        unit_of_donor=tissue["donor"].fillna("").where(tissue["donor"] != "", tissue["specimen"]),
    )
    names = [name for name in dict.fromkeys(tissue["group"]) if name]
    rows = []
    for a, b in combinations(names, 2):
        for quantity, part in tissue.groupby("quantity", sort=False):
            known, log = _on_scale(part[part["group"].isin((a, b))])
            scale = _scale_of_tau(str(quantity), known["value"].to_numpy(), log=log)
            first, second = (_donors(known[known["group"] == g], scale) for g in (a, b))
            head = {"group_a": a, "group_b": b, "quantity": quantity}
            head |= {"unit": part["unit"].iloc[0], "scale": LOG if log else LINEAR}
            limits = _parameter(str(quantity)).range
            rows.append(head | _contrast(first, second, scale, limits, log=log))
    return pd.DataFrame(rows, columns=list(GROUP_CONTRAST_COLUMNS))


def _donors(part: pd.DataFrame, scale: float) -> pd.DataFrame:
    """Value and sd of each donor."""
    weight = 1.0 / (scale**2 + part["sd"] ** 2)
    sums = pd.DataFrame(
        {"w": weight, "y": weight * part["value"], "v": (weight * part["sd"]) ** 2}
    ).groupby(part["unit_of_donor"], sort=False)
    total = sums.sum()
    return pd.DataFrame({"value": total["y"] / total["w"], "sd": np.sqrt(total["v"]) / total["w"]})


def _contrast(
    a: pd.DataFrame, b: pd.DataFrame, scale: float, limits: tuple[float, float], *, log: bool
) -> dict[str, Any]:
    """The difference of two groups of donors, with its 90 % interval."""
    common = a.index.intersection(b.index)
    paired = len(common) >= LEAST_DONORS
    if paired:
        a, b = a.loc[common], b.loc[common]
    out: dict[str, Any] = {"paired": paired, "donors_a": len(a), "donors_b": len(b)}
    back = math.exp if log else float
    if min(len(a), len(b)) < LEAST_DONORS:
        return out
    both = [(v["value"].to_numpy(), v["sd"].to_numpy()) for v in (a, b)]
    means = group_means(both, scale)
    middles = [back(means.of(g).quantiles()[1]) for g in (0, 1)]
    out |= dict(zip(("mean_a", "mean_b"), np.clip(middles, *limits).tolist(), strict=True))
    apart = means.difference()
    if paired:
        within = np.hypot(both[0][1], both[1][1])
        own = group_means([(both[1][0] - both[0][0], within)], math.sqrt(2.0) * scale)
        apart = own.of(0)
    low, middle, high = apart.quantiles()
    numbers = dict(zip(("", "_low", "_high"), map(back, (middle, low, high)), strict=True))
    return out | {
        **{f"difference{k}": v for k, v in numbers.items()},
        "probability_larger": float(1.0 - apart.below(np.zeros(1))[0]),
        "detectable": back(POWER * apart.total_sd),
        "direction": LARGER if low > 0.0 else SMALLER if high < 0.0 else OPEN,
    }
