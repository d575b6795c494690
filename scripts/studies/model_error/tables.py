"""The tables of the study of error models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from studies.model_error.judge import FAR, judged
from studies.model_error.kept_draws import kept, read
from studies.model_error.truths import make_case
from studies.page import table

__all__ = ["coverage_table", "judge_all"]

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


def coverage_table(data: pd.DataFrame) -> str:
    """Share of 90 % intervals that hold the truth, and their median width."""
    names = list(dict.fromkeys(data["candidate"]))
    far = data.drop_duplicates("seed")["far"]
    head = (
        f"{data['seed'].nunique()} specimens, {int(far.sum())} of them mounted at 1.1 to 1.3. "
        "Share of 90 % intervals that hold the truth (median width, as a share of it).\n\n"
    )
    rows: list[list[str]] = []

    def add(label: str, part: pd.DataFrame) -> None:
        of = [part[part["candidate"] == c] for c in names]
        cells = [
            f"{p['inside'].mean():.2f} ({100 * p['width'].median():.2g} %)" if len(p) else "-"
            for p in of
        ]
        rows.append([label, *cells])

    for label, group in GROUPS.items():
        part = data[data["group"] == group]
        add(label, part)
        if group in SPLIT:
            add("- mounted at up to 1.08", part[~part["far"]])
            add("- mounted at 1.1 to 1.3", part[part["far"]])
            for kind, of_kind in part.groupby("truth"):
                add(f"- {kind}", of_kind)
    rows += _stated_rows(data, names)
    rows += _verdict_rows(data, names)
    runs = data.drop_duplicates(["seed", "candidate"])
    of_each = [runs[runs["candidate"] == c] for c in names]
    bad = [str(int((r["state"] != "converged").sum())) for r in of_each]
    rows.append(["runs short of their target", *bad])
    cpu = [f"{r['cpu_s'].median():.1f} s" for r in of_each]
    rows.append(["median processor time", *cpu])
    return head + table(["90 % intervals of", *names], rows)


def _stated_rows(data: pd.DataFrame, names: list[str]) -> list[list[str]]:
    """How often something is stated that may be left open."""
    rows = []
    for label, part in (("", data), (", of those mounted at 1.1 to 1.3", data[data["far"]])):
        total = part["seed"].nunique()
        for what, group, unit, of in (
            ("stress at total stretches is stated", "tissue at total stretches", ["seed"], total),
            ("a mounting stretch is a value", "mounting, stated value", None, 2 * total),
            ("its low end alone is stated", "mounting, stated low end", None, 2 * total),
        ):
            cells = []
            for name in names:
                found = part[(part["candidate"] == name) & (part["group"] == group)]
                count = len(found.drop_duplicates(unit)) if unit else len(found)
                cells.append(f"{count} of {of}")
            rows.append([f"{what}{label}", *cells])
    return rows


def _verdict_rows(data: pd.DataFrame, names: list[str]) -> list[list[str]]:
    """What the verdict on the mounting stretch is worth."""

    def row(label: str, cell) -> list[str]:
        return [label, *(cell(data[data["candidate"] == c]) for c in names)]

    def share(group: str):
        def cell(part: pd.DataFrame) -> str:
            of = part[part["group"] == group]
            return f"{of['inside'].mean():.2f} of {len(of)}" if len(of) else "- of 0"

        return cell

    return [
        row("mounting stretches that stand: their interval", share("mounting, stands")),
        row("not identified: their interval", share("mounting, not identified")),
        row("not identified: the range of refits", share("mounting, not identified, range")),
    ]
