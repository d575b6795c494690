"""The tables of docs/population-evidence.md from the records of the studies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.calibration.ranks import calibration_table, verdict
from biaxbayes.text_files import write_csv
from studies.page import put, table
from studies.population.calibration import RANKED_DRAWS
from studies.population.virtual import (
    CENTRES,
    PARAMETERS,
    SD_DONORS,
    SD_SPECIMENS,
    on_scale,
)
from studies.records import kept

__all__ = ["KINDS", "TABLES", "calibrated", "kind_of", "pooled", "write_tables"]

Records = list[dict[str, Any]]


def write_tables(folder: Path, page: Path | None) -> None:
    """Print what the records of a folder say, and put it into a page, long tables beside it."""
    for name, made in TABLES.items():
        text = made(folder)
        print(f"\n{name}\n\n{text}")
        if page and text:
            put(page, f"population-{name}", text)
    if page:
        for name, rows in {"agreement": agreed, "calibration": calibrated}.items():
            if not (found := rows(folder)).empty:
                write_csv(page.parent / "tables" / f"population-{name}.csv", found, digits=4)
        from studies.population.drawing import draw_evidence

        draw_evidence(folder, page.parent / "figures" / "population-evidence.png")


def _paragraph(text: str) -> str:
    return "\n".join(wrap(text, 100))


def _not_converged(records: Records) -> str:
    """How many populations and single runs did not reach their target."""
    states = [r["state"] for r in records]
    singles = [s for r in records for s in r["singles"]]
    bad = sum(s != "converged" for s in states), sum(s != "converged" for s in singles)
    return (
        f"{bad[0]} of {len(states)} populations and {bad[1]} of {len(singles)} single runs did not "
        f"reach their target (populations: at least {min(r['ess'] for r in records):.0f} effective "
        f"draws of every reported quantity, R-hat at most {max(r['rhat'] for r in records):.3f})"
    )


# --- agreement with NUTS -------------------------------------------------------------------------


def agreed(folder: Path) -> pd.DataFrame:
    """Means and sds of every hyperparameter beside those of NUTS."""
    found = kept(folder / "agreement.jsonl")
    rows = [
        {
            "quantity": r["quantity"],
            **{
                f"{k}{of}": x
                for k in ("mean", "sd")
                for of, x in zip(("", "_nuts"), r[k], strict=True)
            },
            "z_of_mean": r["z_mean"],
            "z_of_sd": r["z_sd"],
            **dict(zip(("ess", "ess_nuts"), r["ess"], strict=True)),
        }
        for r in (found[-1]["rows"] if found else ())
    ]
    return pd.DataFrame(rows)


def agreement(folder: Path) -> str:
    """How far means and sds are from those of NUTS."""
    rows = agreed(folder)
    if rows.empty:
        return ""
    record = kept(folder / "agreement.jsonl")[-1]
    z = np.abs(rows[["z_of_mean", "z_of_sd"]].to_numpy())
    worst = rows.loc[z.max(axis=1).argmax()]
    return _paragraph(
        f"The largest of the {z.size} differences is {z.max():.1f} Monte Carlo errors "
        f"({worst['quantity']}), their root mean square {np.sqrt((z**2).mean()):.1f}. NUTS made "
        f"{record['draws']} draws in 4 chains ({record['divergences']} divergences, R-hat at most "
        f"{max(r['rhat'] for r in record['rows']):.3f}). "
        "[All of them](tables/population-agreement.csv)"
    )


# --- calibration ---------------------------------------------------------------------------------

KINDS = {
    "hyperparameters": "means and sds",
    "specimen": "the first specimen, pooled",
    "new specimen": "values of a new specimen",
    "stress": "its stress",
}


def calibrated(folder: Path) -> pd.DataFrame:
    """Uniformity and coverage of every quantity over the studies."""
    ranks = pd.DataFrame(
        [
            {"parameter": name, "unit": "", "rank": rank, "below": r["below"][name]}
            for r in kept(folder / "calibration.jsonl")
            for name, rank in r["rank"].items()
        ]
    )
    return calibration_table(ranks, RANKED_DRAWS) if len(ranks) else ranks


def calibration(folder: Path) -> str:
    """Uniformity and coverage over the studies, by kinds of quantities."""
    judged = calibrated(folder)
    if judged.empty:
        return ""
    records = kept(folder / "calibration.jsonl")
    kind = judged["parameter"].map(kind_of)
    rows = []
    for name, words in KINDS.items():
        of = judged[kind == name]
        outside = int((of["inside_band"] == "no").sum())
        rows.append(
            [words, len(of), f"{verdict(of)[1]:.2g}", outside]
            + [_range(of[f"coverage_{level}"]) for level in (50, 80, 90)]
        )
    thrown = sum(r["rejected"] for r in records)
    said = (
        f"{len(records)} studies. All {len(judged)} quantities together: p = "
        f"{verdict(judged)[1]:.2g}. {_not_converged(records)}. {thrown} studies were drawn anew "
        "because a specimen had no stable mounted state. "
        "[Every quantity](tables/population-calibration.csv)"
    )
    head = ["quantities", "number", "p together", "outside their 95 % band"]
    head += [f"held by intervals of {level} %" for level in (50, 80, 90)]
    return _paragraph(said) + "\n\n" + table(head, rows)


def kind_of(name: str) -> str:
    """Which of the kinds a ranked quantity is."""
    if name.startswith("new stress"):
        return "stress"
    if name.startswith("new "):
        return "new specimen"
    return "specimen" if name.endswith(" of s0") else "hyperparameters"


def _range(values: pd.Series) -> str:
    return f"{values.min():.3f} to {values.max():.3f}"


# --- pooling -------------------------------------------------------------------------------------


class Pooled:
    """Records of one kind as arrays; single, pooled (studies, n, 3, p), mean (studies, 3, p)."""

    def __init__(self, records: Records) -> None:
        self.records = records
        parts = ("truth", "single", "pooled", "mean", "sd_donors", "sd_specimens", "protocols")
        arrays = {name: np.array([r[name] for r in records]) for name in parts}
        self.truth, self.single, self.pooled = (arrays[k] for k in parts[:3])
        self.mean, self.sd_donors, self.sd_specimens = (arrays[k] for k in parts[3:6])
        # the specimens with the fewest protocols
        few = arrays["protocols"] == arrays["protocols"].min()
        self.few = np.broadcast_to(few, self.truth.shape[:2])
        self.centre = on_scale(CENTRES["media"])

    def held(self, intervals: np.ndarray) -> np.ndarray:
        """Share of intervals (studies, n, 3, p) of these specimens that hold the truth, (p,)."""
        inside = (intervals[:, :, 0] <= self.truth) & (self.truth <= intervals[:, :, 2])
        return np.asarray(inside[self.few].mean(axis=0))

    def width(self) -> np.ndarray:
        """Median over these specimens of pooled over single widths, (p,)."""
        of = [x[:, :, 2] - x[:, :, 0] for x in (self.pooled, self.single)]
        return np.asarray(np.median((of[0] / of[1])[self.few], axis=0))

    def errors(self, *, of_these: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Rms errors of the pooled mean, and of the mean of the single medians, (p,).

        About the group's mean, or about that of the true values of these specimens.
        """
        medians = self.single[:, :, 1].mean(axis=1)
        about = self.truth.mean(axis=1) if of_these else self.centre
        pair = (self.mean[:, 1] - about, medians - about)
        first, second = (np.sqrt((x**2).mean(axis=0)) for x in pair)
        return first, second

    def scatter(self) -> np.ndarray:
        """Rms by which the mean of the true values misses the group's mean, (p,)."""
        missed = self.truth.mean(axis=1) - self.centre
        return np.asarray(np.sqrt((missed**2).mean(axis=0)))

    def mean_held(self) -> np.ndarray:
        """Share of the 90 % intervals of the group's mean that hold it, (p,)."""
        inside = (self.mean[:, 0] <= self.centre) & (self.centre <= self.mean[:, 2])
        return np.asarray(inside.mean(axis=0))


def pooled(folder: Path, kind: str) -> Pooled | None:
    """Records of one kind of study, or None."""
    records = kept(folder / f"{kind}.jsonl")
    return Pooled(records) if records else None


def ridge(folder: Path) -> str:
    """What further protocols of a few do for the ridges of the others."""
    parts = []
    for kind, said in (
        ("ridge", "Nine of twelve media with an equibiaxial test alone, three with three"),
        ("alike", "All twelve with an equibiaxial test alone"),
    ):
        of = pooled(folder, kind)
        if of is None:
            continue
        held, own = of.held(of.pooled), of.held(of.single)
        width, (error, plain), mean = of.width(), of.errors(), of.mean_held()
        ours, theirs = of.errors(of_these=True)
        floor = of.scatter()
        rows = [
            [name, f"{width[k]:.2f}", f"{own[k]:.2f}", f"{held[k]:.2f}"]
            + [f"{x[k]:.3g}" for x in (error, plain, floor)]
            + [f"{error[k] / plain[k]:.2f}"]
            + [f"{ours[k] / theirs[k]:.2f}", f"{mean[k]:.2f}"]
            for k, name in enumerate(PARAMETERS)
        ]
        head = ["parameter", "width, pooled over alone", "held alone", "held pooled"]
        head += ["rms error of the mean", "of the mean of medians", "of the mean of the truths"]
        head += ["ratio of the first two", "the same about the truths' mean", "mean held"]
        text = f"{said}: {len(of.records)} studies; {_not_converged(of.records)}."
        parts.append(_paragraph(text) + "\n\n" + table(head, rows))
    return "\n".join(parts)


def misfit(folder: Path) -> str:
    """What an error of the law does that all specimens share, beside one of each its own."""
    parts = []
    sharp = {r["seed"]: r for r in kept(folder / "no-misfit.jsonl")}
    for kind, said in (
        ("common-misfit", "The same misfit in all specimens of a study"),
        ("own-misfit", "A misfit of each specimen's own"),
        ("no-misfit", "The same specimens without misfit, independent noise"),
    ):
        of = pooled(folder, kind)
        if of is None:
            continue
        own, held, mean = of.held(of.single), of.held(of.pooled), of.mean_held()
        medians = of.sd_specimens[:, 1]
        # total variance of a specimen about the group's mean, donors and specimens together
        total = np.sqrt(medians**2 + of.sd_donors[:, 1] ** 2)
        true = np.hypot(SD_DONORS, SD_SPECIMENS)
        paired = [r for r in of.records if r["seed"] in sharp and kind != "no-misfit"]
        own_sd = np.array([r["sd_specimens"][1] for r in paired])
        sharp_sd = np.array([sharp[r["seed"]]["sd_specimens"][1] for r in paired])
        without = np.median(own_sd / sharp_sd, axis=0) if paired else np.ones(0)
        error, _ = of.errors()
        stated = np.sqrt((((of.mean[:, 2] - of.mean[:, 0]) / 3.29) ** 2).mean(axis=0))
        rows = [
            [name, f"{own[k]:.2f}", f"{held[k]:.2f}", f"{mean[k]:.2f}"]
            + [f"{error[k] / stated[k]:.2f}"]
            + [f"{np.median(medians[:, k]) / SD_SPECIMENS[k]:.2f}"]
            + [f"{np.median(total[:, k]) / true[k]:.2f}"]
            + ([f"{without[k]:.2f}"] if paired else [])
            for k, name in enumerate(PARAMETERS)
        ]
        head = ["parameter", "held alone", "held pooled", "mean held"]
        head += ["rms error of the mean over its stated sd", "sd_specimens over the true one"]
        head += ["total sd over the true one"]
        head += [f"sd_specimens over that without misfit, {len(paired)} studies"] if paired else []
        beta = np.concatenate([r["beta"] for r in of.records])
        text = (
            f"{said}: {len(of.records)} studies of {of.truth.shape[1]} specimens; weights "
            f"{beta.min():.2f} to {beta.max():.2f}, median {np.median(beta):.2f}; "
            f"{_not_converged(of.records)}."
        )
        parts.append(_paragraph(text) + "\n\n" + table(head, rows))
    return "\n".join(parts)


# --- time ----------------------------------------------------------------------------------------


def times(folder: Path) -> str:
    """Seconds by specimens, and the power of the growth."""
    records = kept(folder / "time.jsonl")
    if not records:
        return ""
    rows = []
    for r in records:
        of = r["convergence"]
        rows.append(
            [r["specimens"], f"{r['cpu']:.0f}", f"{r['cpu'] / r['specimens']:.2f}"]
            + [f"{r['wall']:.0f}", of["kept_sweeps"], f"{of['worst_ess']:.0f}", r["state"]]
        )
    head = ["specimens", "processor s", "a specimen", "wall s", "kept sweeps", "worst ESS", "state"]
    first, last = records[0], records[-1]
    said = ""
    if len(records) > 1:
        ratio = np.log(last["cpu"] / first["cpu"])
        power = ratio / np.log(last["specimens"] / first["specimens"])
        loads = [r["load"] for r in records]
        threads = f"{first['workers']} thread{'s' * (first['workers'] > 1)}"
        said = (
            f"From {first['specimens']} to {last['specimens']} specimens processor time grows as "
            f"the power {power:.2f} of their number. {last['distinct']} finished runs; where there "
            "are more specimens they are the same again as of other donors. A machine of "
            f"{first['processors']} processors with load {min(loads):.1f} to {max(loads):.1f} at "
            f"the start of a population, {threads}; on a busy one processor time is longer, too."
        )
    return table(head, rows, left=0) + "\n" + _paragraph(said)


TABLES: dict[str, Callable[[Path], str]] = {
    "agreement": agreement,
    "calibration": calibration,
    "ridge": ridge,
    "misfit": misfit,
    "time": times,
}
"""By the mark on the page, ``population-`` before it."""
