"""The tables of the study of error models."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from studies.figure import figure
from studies.model_error.judge import FAR, judged
from studies.model_error.kept_draws import kept, read
from studies.model_error.truths import make_case
from studies.page import number, table

__all__ = ["coverage", "draw_coverage", "judge_all", "page_table", "result"]

GROUPS = {
    "stress of the tissue at measured stretches": "tissue at measured stretches",
    "stress of the model at measured stretches": "model at measured stretches",
    "stress of the tissue at total stretches, where it is stated": "tissue at total stretches",
    "stress of the model at total stretches": "model at total stretches",
    "readings of a held-out path (predictive band)": "held-out readings",
    "mounting stretch, the interval of the posterior": "mounting",
    "mounting stretch, a value is stated": "mounting, stated value",
    "mounting stretch, the low end is stated (median below the truth)": "mounting, stated low end",
    "parameters, where the truth has them (smooth misfit)": "parameters",
}
SPLIT = (
    "tissue at measured stretches",
    "tissue at total stretches",
    "mounting, stated value",
    "mounting, stated low end",
)


def judge_all(folder: Path, seeds: range, candidates: list[str]) -> pd.DataFrame:
    """Judge the specimens that every candidate has sampled."""
    common = [seed for seed in seeds if all(kept(folder, seed, c) for c in candidates)]
    tables = []
    for seed in common:
        case = make_case(seed)
        for candidate in candidates:
            answer = read(folder, seed, candidate)
            table = judged(case, seed, answer)
            far = bool(case.mounting.mean() > FAR)
            told = table.assign(seed=seed, truth=case.kind, far=far, state=answer.state)
            tables.append(told.assign(candidate=candidate, cpu_s=answer.cpu_s))
    data = pd.concat(tables, ignore_index=True)
    data["inside"] = (data["true"] >= data["low"]) & (data["true"] <= data["high"])
    high = data["high"].where(
        np.isfinite(data["high"]), data["true"]
    )  # of a low end: how far below
    data["width"] = (high - data["low"]) / data["true"].abs()
    return data


FAR_PART = "mounted at 1.1 to 1.3"
MOUNTED = ("mounted at up to 1.08", FAR_PART)
PROCESSOR = "median processor time"
RUNS_SHORT = "runs short of their target"


def coverage(data: pd.DataFrame) -> pd.DataFrame:
    """Of every quantity, part of the specimens and candidate, what its intervals are worth.

    Returns
    -------
    DataFrame
        ``quantity``, ``part`` (all specimens where it is empty), ``candidate``; ``share_held`` of
        the true values and ``median_width_percent`` (as a share of the true value); ``count`` and
        ``of`` how many; ``processor_s`` (median).
    """
    rows: list[dict[str, object]] = []
    for candidate, of in data.groupby("candidate", sort=False):
        told = [*_covered(of), *_stated(of), *_verdicts(of)]
        runs = of.drop_duplicates("seed")
        short = int((runs["state"] != "converged").sum())
        told.append({"quantity": RUNS_SHORT, "count": short, "of": len(runs)})
        told.append({"quantity": PROCESSOR, "processor_s": runs["cpu_s"].median()})
        rows += [{"part": "", "candidate": candidate} | row for row in told]
    return pd.DataFrame(rows)[list(COLUMNS)]


COLUMNS = (
    *("quantity", "part", "candidate"),
    *("share_held", "median_width_percent", "count", "of", "processor_s"),
)


def page_table(found: pd.DataFrame, specimens: int, far: int, link: str) -> str:
    """The rows of all specimens together, a column a candidate.

    Parameters
    ----------
    found : DataFrame
        As of :func:`coverage`.
    specimens, far : int
        How many there are, and how many of them are mounted far.
    link : str
        To all rows.
    """
    names = list(dict.fromkeys(found["candidate"]))
    rows = []
    beside = {RUNS_SHORT, *(what for what, _ in VERDICTS)}
    for quantity, of_all in found[found["part"] == ""].groupby("quantity", sort=False):
        cells = dict(zip(of_all["candidate"], map(_cell, of_all.itertuples()), strict=True))
        if quantity not in beside:
            rows.append([quantity, *(cells.get(name, "-") for name in names)])
    head = (
        f"{specimens} specimens, {far} of them {FAR_PART}. Share of 90 % intervals that hold the "
        "truth (median width, as a share of it); [by truth and mounting, and what the verdicts are "
        f"worth]({link}).\n\n"
    )
    return head + table(["90 % intervals of", *names], rows)


def result(found: pd.DataFrame, specimens: int) -> str:
    """What the intervals of the first candidate are worth, in two sentences."""
    one = found[found["candidate"] == found["candidate"].iloc[0]]
    measured, measured_model, total, total_model, *_, value, low_end, _ = GROUPS
    stated, values, ends = (what for what, *_ in STATED)
    all_of = one[one["part"] == ""].set_index("quantity")
    held = 100.0 * all_of["share_held"].reindex(list(GROUPS))
    kinds = one[(one["quantity"] == measured) & ~one["part"].isin(["", *MOUNTED])]["share_held"]
    return (
        f"**Of {specimens} virtual specimens that GOH cannot represent, 90 % intervals of the "
        f"tissue's stresses hold the truth in {held[measured]:.0f} % at measured stretches "
        f"({100 * kinds.min():.0f} to {100 * kinds.max():.0f} % by kind of tissue) and in "
        f"{held[total]:.0f} % at total ones (stated for {all_of['count'][stated]:.0f} specimens), "
        f"those of the model in {held[measured_model]:.0f} % and {held[total_model]:.0f} %. Of the "
        f"mounting stretches {all_of['count'][values]:.0f} are stated as a value "
        f"({held[value]:.0f} % hold) and {all_of['count'][ends]:.0f} as a low end "
        f"({held[low_end]:.0f} % hold).**"
    )


def _cell(row: Any) -> str:
    if np.isfinite(row.processor_s):
        return f"{row.processor_s:.1f} s"
    if np.isfinite(row.share_held):
        return f"{row.share_held:.2f} ({number(row.median_width_percent, 2)} %)"
    return f"{row.count:.0f} of {row.of:.0f}"


def _covered(data: pd.DataFrame) -> Iterator[dict[str, object]]:
    for label, group in GROUPS.items():
        of_group = data[data["group"] == group]
        parts = {"": of_group}
        if group in SPLIT:
            parts[MOUNTED[0]] = of_group[~of_group["far"]]
            parts[FAR_PART] = of_group[of_group["far"]]
            parts |= {str(kind): part for kind, part in of_group.groupby("truth")}
        for part, found in parts.items():
            if len(found):
                yield {
                    "quantity": label,
                    "part": part,
                    "share_held": found["inside"].mean(),
                    "median_width_percent": 100 * found["width"].median(),
                    "of": len(found),
                }


STATED = (
    ("stress at total stretches is stated", "tissue at total stretches", 1),
    ("a mounting stretch is a value", "mounting, stated value", 2),
    ("its low end alone is stated", "mounting, stated low end", 2),
)


def _stated(data: pd.DataFrame) -> Iterator[dict[str, object]]:
    """How often something is stated that may be left open."""
    for part, found in (("", data), (FAR_PART, data[data["far"]])):
        specimens = found["seed"].nunique()
        for what, group, each in STATED:
            stated = found[found["group"] == group]
            count = len(stated) if each == 2 else stated["seed"].nunique()
            yield {"quantity": what, "part": part, "count": count, "of": each * specimens}


VERDICTS = (
    ("mounting stretches that stand: their interval", "mounting, stands"),
    ("not identified: their interval", "mounting, not identified"),
    ("not identified: the range of refits", "mounting, not identified, range"),
)


def _verdicts(data: pd.DataFrame) -> Iterator[dict[str, object]]:
    """What the verdict on the mounting stretch is worth."""
    for what, group in VERDICTS:
        found = data[data["group"] == group]
        yield {"quantity": what, "share_held": found["inside"].mean(), "of": len(found)}


def draw_coverage(found: pd.DataFrame, path: Path) -> None:
    """Draw the share of intervals that hold the truth, by truth and of all quantities."""
    one = found[found["candidate"] == found["candidate"].iloc[0]]
    with figure(path, 1, 2, height=2.9, sharex=True) as (drawing, axes):
        measured, _, total, *_, low_end, _ = GROUPS
        parts = list(one.loc[one["quantity"] == measured, "part"])
        for quantity, marker, colour in zip(
            (measured, total, low_end), "osv", ("#0072B2", "#D55E00", "#009E73"), strict=True
        ):
            of = one[one["quantity"] == quantity].set_index("part")["share_held"]
            kept = [p for p in parts if p in of]
            axes[0, 0].plot(
                of[kept], [parts.index(p) for p in kept], marker, color=colour, mfc="none", ms=5,
                label=SHORT[quantity],
            )  # fmt: skip
        axes[0, 0].set_yticks(range(len(parts)), [p or "all specimens" for p in parts])
        rows = [q for q in GROUPS if ((one["quantity"] == q) & (one["part"] == "")).any()]
        all_of = one[one["part"] == ""].set_index("quantity")["share_held"]
        axes[0, 1].plot(all_of[rows], range(len(rows)), "ok", ms=4)
        axes[0, 1].set_yticks(range(len(rows)), [SHORT[q] for q in rows])
        for ax in axes[0]:
            ax.axvline(0.9, color="0.6", lw=0.8, zorder=0)
            ax.invert_yaxis()
            ax.set(xlim=(0.3, 1.02), xlabel="share of truths held, 90 % intervals")
            ax.grid(axis="y", color="0.92", lw=0.6)
            ax.set_axisbelow(True)
        drawing.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)


SHORT = dict(
    zip(
        GROUPS,
        (
            "tissue, measured stretches",
            "model, measured stretches",
            "tissue, total stretches",
            "model, total stretches",
            "held-out readings",
            "mounting stretch, posterior",
            "mounting stretch, value",
            "mounting stretch, low end",
            "parameters",
        ),
        strict=True,
    )
)
"""The quantities as the figure has them."""
