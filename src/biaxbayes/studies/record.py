"""The record of a study, ``study.json``: its finished runs, and the columns of its specimens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.runs.folder import STUDY
from biaxbayes.stored_data import json_text, read_object
from biaxbayes.studies.study_file import Study
from biaxbayes.text_files import atomic_write_text, read_csv


def recorded_runs(folder: Path) -> dict[str, str]:
    """Fingerprints of finished runs; empty if the record cannot be read."""
    done = read_object(folder / STUDY).get("done")
    return {str(k): str(v) for k, v in done.items()} if isinstance(done, dict) else {}


def record_runs(study: Study, folder: Path, finished: Mapping[str, str]) -> None:
    """Write the fingerprints of the finished runs, and the additional columns of the study."""
    record = {"biaxbayes": biaxbayes.__version__, "name": study.name, "done": finished}
    if study.columns:
        values = {e.label: dict(e.columns) for e in study.specimens}
        record |= {"columns": list(study.columns), "values": values}
    atomic_write_text(folder / STUDY, json_text(record))


@dataclass(frozen=True)
class StudyRun:
    """A specimen of a finished study."""

    label: str
    donor: str
    group: str
    folder: Path
    state: str
    reason: str = ""


def members_of_study(folder: Path) -> tuple[str, list[StudyRun]]:
    """Name and specimens of a finished study."""
    try:
        record = read_object(folder / STUDY)
        if not record:
            raise ValueError("no record")
        table = read_csv(folder / "study.csv", dtype=str, keep_default_na=False)
        rows = table.drop_duplicates("specimen").to_dict("records")
        labels = [str(r["specimen"]) for r in rows]
        columns = [str(c) for c in record.get("columns", [])]
        values: dict[str, dict[str, str]] = record.get("values", {})
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        raise InputError(
            "is not the folder of a finished study",
            file=folder,
            remedy="run 'biaxbayes batch' first, or give the study file",
        ) from None
    by = columns or (["layer"] if any(str(r["layer"]) for r in rows) else [])
    members = []
    for label, row in zip(labels, rows, strict=True):
        own = {"layer": str(row["layer"]), "donor": str(row["donor"])} | values.get(label, {})
        for column in by:
            if not own.get(column):
                raise InputError(
                    f"{label} has no {column}, which defines its group",
                    file=folder,
                    remedy=f"give {column} in the study file, or name others in columns",
                )
        group = ", ".join(own[column] for column in by) or "all"
        run, state, reason = (str(row[key]) for key in ("folder", "state", "reason"))
        members.append(StudyRun(label, str(row["donor"]), group, folder / run, state, reason))
    return str(record.get("name", folder.name)), members
