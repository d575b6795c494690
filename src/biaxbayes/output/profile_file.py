"""profile.csv and profile-intervals.csv: profile likelihoods as tables."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from biaxbayes.findings.profile import FLAT, THRESHOLD, Profile
from biaxbayes.output.annotated_table import write_annotated

__all__ = ["as_json", "interval_table", "write_profiles"]


def interval_table(profiles: Sequence[Profile]) -> pd.DataFrame:
    """One row a profile: interval, what is open, what kind it is."""
    return pd.DataFrame(
        [
            {
                "parameter": p.parameter,
                "unit": p.unit,
                "estimate": p.estimate,
                "low_95": p.low,
                "high_95": p.high,
                "open_low": p.open_low,
                "open_high": p.open_high,
                "kind": p.kind,
                "in_words": p.in_words(),
            }
            for p in profiles
        ]
    )


def write_profiles(profiles: Sequence[Profile], folder: Path, about: str) -> None:
    """Write both tables into a folder.

    Parameters
    ----------
    profiles : sequence of Profile
    folder : Path
    about : str
        What was profiled, for the head of the files.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    beta = profiles[0].beta
    notes = (
        about,
        f"deviance: n_eff ln RSS plus squared errors of the mounting readings, above its minimum; "
        f"n_eff = {beta:.4g} n; error sd profiled out, no prior",
        f"interval: deviance below {THRESHOLD:.4g} (95 %); structural: flat to {FLAT:g}; "
        "practical: open on a side; finite: crossed on both sides (an angle of 0 or 90 degrees is "
        "a mirror and counts as closed)",
        "C1, k1 in kPa, alpha in degrees; error_sd in the unit of the specimen's loads",
    )
    tables = []
    for profile in profiles:
        table = profile.table.copy()
        table.insert(0, "profiled", profile.parameter)
        tables.append(table)
    curves = pd.concat(tables, ignore_index=True)
    write_annotated(curves, notes, folder / "profile.csv", digits=8)
    write_annotated(interval_table(profiles), notes, folder / "profile-intervals.csv")


def as_json(profiles: Sequence[Profile]) -> str:
    """Intervals and curves as JSON."""
    told = []
    for row, profile in zip(interval_table(profiles).to_dict("records"), profiles, strict=True):
        curve = {str(k): v for k, v in profile.table.to_dict("list").items()}
        told.append({**{str(k): _plain(v) for k, v in row.items()}, "curve": curve})
    return json.dumps(told, indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: object) -> object:
    return value if not isinstance(value, float) or math.isfinite(value) else None
