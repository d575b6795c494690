"""Score the answers of all tools; needs NumPy and pandas alone.

python benchmark/score.py                      table of all folders of submissions/
python benchmark/score.py FOLDER --specimens   one submission, specimen by specimen
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

HERE = Path(__file__).resolve().parent
LOGARITHMIC = ("C1", "k1", "k2")
RANGES = {"alpha": 90.0, "kappa": 1.0 / 3.0}
"""Widths and errors of these are shares of their range; of logarithmic ones decades."""
LEVELS = ("q05", "q50", "q95")


def scaled(name: str, value: Any) -> Any:
    """A parameter on the scale of its errors; mounting stretches as they are."""
    return np.log10(value) if name in LOGARITHMIC else value / RANGES.get(name, 1.0)


def interval_rows(truths: dict[str, Any], quantiles: pd.DataFrame) -> pd.DataFrame:
    """A row for each parameter that has a truth and was answered."""
    said = quantiles.set_index(["specimen", "parameter"])[list(LEVELS)]
    rows = []
    for specimen, truth in truths.items():
        for name, value in truth["parameters"].items():
            if (specimen, name) not in said.index:
                continue
            low, middle, high = said.loc[(specimen, name)].astype(float)
            row = {"specimen": specimen, "parameter": name, "truth": value}
            row |= {"stated": np.isfinite([low, high]).all(), "holds": low <= value <= high}
            with np.errstate(divide="ignore"):
                row["width"] = scaled(name, high) - scaled(name, low)
                row["error"] = abs(scaled(name, middle) - scaled(name, value))
            rows.append(row)
    columns = ["specimen", "parameter", "truth", "stated", "holds", "width", "error"]
    return pd.DataFrame(rows, columns=columns)


def held_out_rows(truths: dict[str, Any], loads: pd.DataFrame) -> pd.DataFrame:
    """A row for each held-out path that was predicted, both directions together."""
    rows = []
    for specimen, table in loads.groupby("specimen", sort=False):
        truth = np.array(truths[specimen]["held_out"]["piola_kPa"])
        low, middle, high = (
            table.set_index("row")[[f"x_{q}", f"y_{q}"]].reindex(range(len(truth))).to_numpy()
            for q in LEVELS
        )
        peak = float(np.abs(truth).max())
        # rows that were left out count as missed
        rows.append(
            {
                "specimen": specimen,
                "stated": bool(table[["x_q05", "x_q95"]].notna().all(axis=None)),
                "inside": float(((low <= truth) & (truth <= high)).mean()),
                "width": pd.Series((high - low).ravel()).mean() / peak,
                "error": float(np.sqrt(np.nanmean((middle - truth) ** 2))) / peak,
            }
        )
    return pd.DataFrame(rows, columns=["specimen", "stated", "inside", "width", "error"])


def read_submission(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """The three files of a submission."""
    names = ("quantiles.csv", "held-out.csv", "seconds.csv")
    if missing := [name for name in names if not (folder / name).is_file()]:
        raise SystemExit(f"{folder}: no {missing[0]}; README.md describes the files")
    first, second, third = (pd.read_csv(folder / name) for name in names)
    return first, second, third


def scores(truths: dict[str, Any], folder: Path) -> dict[str, Any]:
    """One row of the table: counts, medians over what was answered, and the median time."""
    quantiles, loads, seconds = read_submission(folder)
    known = {name for name in quantiles["specimen"] if name in truths}
    row: dict[str, Any] = {"tool": folder.name, "specimens": len(known)}
    found = interval_rows(truths, quantiles)
    mounting = found["parameter"].str.startswith("mounting_stretch")
    for what, part in (("parameters", found[~mounting]), ("mounting", found[mounting])):
        stated = part[part["stated"]]
        row[f"{what} held"] = f"{int(stated['holds'].sum())} of {len(stated)}"
        row[f"{what} width"] = stated["width"].median()
        row[f"{what} error"] = part["error"].median()
    left_out = held_out_rows(truths, loads)
    stated = left_out[left_out["stated"]]
    row["left out inside, %"] = 100.0 * stated["inside"].mean()
    row["left out width, %"] = 100.0 * stated["width"].median()
    row["left out error, %"] = 100.0 * left_out["error"].median()
    row["seconds"] = seconds["seconds"].median()
    return row


def cell(value: Any) -> str:
    """A cell of the table: three digits of a number, a dash where there is none."""
    if not isinstance(value, float):
        return str(value)
    return "-" if np.isnan(value) else f"{value:.3g}"


def by_specimen(truths: dict[str, Any], folder: Path) -> pd.DataFrame:
    """What a submission says of each specimen."""
    quantiles, loads, seconds = read_submission(folder)
    found = interval_rows(truths, quantiles)
    found = found[found["stated"]].groupby("specimen")["holds"].agg(held="sum", of="count")
    left_out = held_out_rows(truths, loads).set_index("specimen").drop(columns="stated")
    return found.join(left_out, how="outer").join(seconds.set_index("specimen")).reset_index()


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("folders", nargs="*", type=Path)
    arguments.add_argument("--specimens", action="store_true", help="specimen by specimen")
    options = arguments.parse_args()
    truths = json.loads((HERE / "truth.json").read_text(encoding="utf-8"))
    submissions = (p for p in (HERE / "submissions").iterdir() if p.is_dir())
    folders = options.folders or sorted(submissions)
    if options.specimens:
        for folder in folders:
            print(f"\n{folder.name}\n{by_specimen(truths, folder).round(3).to_string(index=False)}")
        return
    rows = [scores(truths, folder) for folder in folders]
    for key in rows[0]:
        print("|", " | ".join([key, *(cell(row[key]) for row in rows)]), "|")
        if key == "tool":
            print("|---" * (1 + len(rows)) + "|")


if __name__ == "__main__":
    main()
