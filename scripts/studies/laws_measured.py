"""What ``biaxbayes laws`` says of a measured specimen, for the page on laws.

    biaxbayes laws aorta.csv --out laws
    python scripts/study.py laws_measured laws --place laws-aorta --page docs/laws-evidence.md

One row a law, the best prediction first: misfit of the fit, what it foretells of left-out
protocols, its weight, and its 90 % band of them. Writes the figure of the folder beside those of
the page.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.comparison.law_weights import STACKED
from studies.page import put, table


def bands(parts: pd.DataFrame, law: str) -> tuple[float, float]:
    """Share of all left-out readings inside the band of a law, and its mean width (kPa)."""
    of = parts[parts["law"] == law]
    coverage, width = (
        float(np.average(of[name], weights=of["readings"]))
        for name in ("band_coverage", "band_width")
    )
    return coverage, width


def law_rows(laws: pd.DataFrame, parts: pd.DataFrame) -> list[list[str]]:
    """Laws by the density of what was left out, the mixture last."""
    alone = laws[laws["law"] != STACKED].sort_values("left_out_density", ascending=False)
    rows = []
    for r in pd.concat([alone, laws[laws["law"] == STACKED]]).to_dict("records"):
        stacked = r["law"] == STACKED
        if not np.isfinite(r["left_out_density"]):
            rows.append([f"`{r['law']}`", f"{r['rms']:.2f}", *[r["state"]] * 5])
            continue
        coverage, width = bands(parts, r["law"])
        rows.append(
            [
                "stacked, weights and levels from the other protocols"
                if stacked
                else f"`{r['law']}`",
                "" if stacked else f"{r['rms']:.2f}",
                f"{r['left_out_rms']:.2f}",
                f"{r['left_out_density']:.1f}",
                "" if stacked else f"{r['weight']:.2f}",
                f"{coverage:.2f}",
                f"{width:.1f}",
            ]
        )
    return rows


def main() -> None:
    """Print the table of a folder, and put it into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of `biaxbayes laws`")
    parser.add_argument("--place", help="name of the table's place on the page")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    laws, parts = (pd.read_csv(asked.folder / name) for name in ("laws.csv", "left-out.csv"))
    heads = ["law", "rms", "left out", "density", "weight", "held by the band", "its width"]
    text = table(heads, law_rows(laws, parts))
    print(text)
    if asked.page is not None:
        put(asked.page, asked.place, text)
        figure = asked.page.parent / "figures" / f"{asked.place}.png"
        shutil.copyfile(asked.folder / "law-misfit.png", figure)


if __name__ == "__main__":
    main()
