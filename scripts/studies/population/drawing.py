"""The figure of docs/population-evidence.md from the records of the studies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.stats import binom

from studies.figure import figure
from studies.population.tables import KINDS, calibrated, kind_of, pooled
from studies.population.virtual import PARAMETERS
from studies.records import kept

__all__ = ["draw_evidence"]

CONTENT, INSIDE = 0.9, 0.95
SYMBOLS = {"C1": "$C_1$", "k1": "$k_1$", "k2": "$k_2$", "alpha": "α", "kappa": "κ"}
COLOURS = ("#0072B2", "#009E73", "#D55E00", "#555555")


def draw_evidence(folder: Path, path: Path) -> None:
    """Coverage over the calibration, and what pooling does to intervals and to the mean."""
    judged, records = calibrated(folder), kept(folder / "calibration.jsonl")
    of = pooled(folder, "ridge")
    if judged.empty or of is None:
        return
    with figure(path, 1, 2, height=3.1) as (drawing, axes):
        # room for the legends below
        drawing.get_layout_engine().set(rect=(0.0, 0.2, 1.0, 0.8))
        left, right = axes[0]
        kind = judged["parameter"].map(kind_of)
        low, high = binom.ppf([(1 - INSIDE) / 2, (1 + INSIDE) / 2], len(records), CONTENT)
        left.axhspan(low / len(records), high / len(records), color="0.9", lw=0)
        left.axhline(CONTENT, color="0.6", lw=0.8)
        at = 0
        for (name, words), colour in zip(KINDS.items(), COLOURS, strict=True):
            held = judged[kind == name]["coverage_90"].to_numpy()
            left.plot(at + np.arange(len(held)), held, "o", ms=3, color=colour, label=words)
            at += len(held) + 2
        left.set(
            xticks=[],
            ylim=(0.8, 1.0),
            ylabel="held by intervals of 90 %",
            title=f"Calibration, {len(records)} studies",
        )
        left.legend(
            loc="upper left",
            bbox_to_anchor=(-0.1, -0.06),
            ncols=2,
            handletextpad=0.2,
            columnspacing=1.0,
        )
        error, plain = of.errors()
        place = np.arange(len(PARAMETERS))
        right.axhline(1.0, color="0.6", lw=0.8)
        for values, mark, words in (
            (of.width(), "s", "width of an interval, pooled over alone"),
            (error / plain, "o", "error of the group's mean over the mean of medians'"),
            (of.scatter() / plain, "_", "error of the true values' mean over the same"),
        ):
            right.plot(place, values, mark, ms=5 if mark != "_" else 14, mew=1.2, label=words)
        right.set(
            xticks=place,
            xticklabels=[SYMBOLS[name] for name in PARAMETERS],
            ylim=(0, 1.2),
            ylabel="ratio",
            title=f"Long ridges, {len(of.records)} studies",
        )
        right.legend(loc="upper left", bbox_to_anchor=(-0.1, -0.12), handletextpad=0.3)
        for part in (left, right):
            part.get_legend().set_in_layout(False)
