"""What a run found as lines and JSON; profile likelihoods as tables."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from biaxbayes.errors import printable
from biaxbayes.identifiability.profile.profile import FLAT, THRESHOLD, Profile
from biaxbayes.identifiability.reported import row_lines
from biaxbayes.runs.result import DIGITS, RunResult, as_record
from biaxbayes.text_files import atomic_write_text, write_csv

# --- what a run found, in lines and as JSON ------------------------------------------------------


def terminal_lines(result: RunResult) -> list[str]:
    """The reported table, how well the law fits, and what would help most."""
    more = [result.fit, result.advice, *result.warnings]
    if len(result.directions):
        more += [result.directions[0]["in_words"], result.same_curves_in_words]
    return [*row_lines(result.rows), "", *(printable(text) for text in more if text)]


def as_json(result: RunResult) -> str:
    """What stands in ``results.json``."""
    return json.dumps(as_record(result), indent=2, allow_nan=False, ensure_ascii=False)


# --- profile.csv and profile-intervals.csv: profile likelihoods as tables ------------------------


def interval_table(profiles: Sequence[Profile]) -> pd.DataFrame:
    """One row a profile: interval, what is open, what kind it is."""
    return pd.DataFrame(
        [
            {
                "parameter": p.parameter,
                "unit": p.unit,
                "estimate": p.estimate,
                "low_90": p.low,
                "high_90": p.high,
                "open_low": p.open_low,
                "open_high": p.open_high,
                "kind": p.kind,
                "in_words": p.in_words(),
            }
            for p in profiles
        ]
    )


def write_profiles(profiles: Sequence[Profile], folder: Path, about: str) -> None:
    """Write both tables and profile-provenance.json into a folder.

    Parameters
    ----------
    profiles : sequence of Profile
    folder : Path
    about : str
        What was profiled.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    record = {
        "about": about,
        "deviance": "n_eff ln RSS plus squared errors of the mounting readings, above its minimum; "
        "error sd profiled out, no prior",
        "n_eff_share": profiles[0].beta,
        "deviance_of_90_percent": THRESHOLD,
        "deviance_of_flat": FLAT,
        "kinds": "structural: flat; practical: open on a side; finite: crossed on both sides (an "
        "angle of 0 or 90 degrees is a mirror and counts as closed)",
    }
    tables = []
    for profile in profiles:
        table = profile.table.copy()
        table.insert(0, "profiled", profile.parameter)
        tables.append(table)
    curves = pd.concat(tables, ignore_index=True)
    write_csv(folder / "profile.csv", curves, digits=8)
    write_csv(folder / "profile-intervals.csv", interval_table(profiles), digits=DIGITS)
    text = json.dumps(record, indent=2, ensure_ascii=False) + "\n"
    atomic_write_text(folder / "profile-provenance.json", text)


def profiles_as_json(profiles: Sequence[Profile]) -> str:
    """Intervals and curves as JSON."""
    records = []
    for row, profile in zip(interval_table(profiles).to_dict("records"), profiles, strict=True):
        curve = {str(k): v for k, v in profile.table.to_dict("list").items()}
        records.append({**{str(k): _plain(v) for k, v in row.items()}, "curve": curve})
    return json.dumps(records, indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: object) -> object:
    """JSON knows no infinity."""
    return value if not isinstance(value, float) or math.isfinite(value) else None
