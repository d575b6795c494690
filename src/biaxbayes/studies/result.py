"""A study as plain tables: who its specimens are, what their runs say, what it found."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.runs.folder import STATES
from biaxbayes.studies.entries import Entry
from biaxbayes.studies.groups import group_summaries, layer_contrasts

__all__ = [
    "COLUMNS",
    "CURVE",
    "DISTANCES",
    "FAILED",
    "INTERRUPTED",
    "LINEAR",
    "LOG",
    "MOST_WITHOUT_DONOR",
    "NOT_DETERMINED",
    "PARAMETER",
    "LayersFound",
    "StudyResult",
    "Tried",
    "are_distances",
    "are_notes",
    "are_rows",
    "donor_groups",
    "layers_found",
    "result_of",
    "rows_without_run",
    "study_table",
]

FAILED, INTERRUPTED = "failed", "interrupted"


@dataclass(frozen=True)
class Tried:
    """What became of a specimen.

    Attributes
    ----------
    state : str
        That of the run, ``failed`` or ``interrupted``.
    reason : str
    rows : list of dict
        Of the study table, without what the study knows itself.
    notes : list of str
    """

    state: str
    reason: str = ""
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def study_table(entries: list[Entry], tried: Mapping[str, Tried]) -> pd.DataFrame:
    """The study table: rows of every specimen in their order."""
    rows: list[dict[str, Any]] = []
    for e in entries:
        head = {
            "specimen": e.entry.label,
            "donor": e.donor,
            "layer": e.layer,
            "file": os.fspath(e.entry.file),
            "folder": e.folder,
        }
        rows += [head | row for row in tried[e.slug].rows]
    return pd.DataFrame(rows, columns=list(COLUMNS))


# --- the study table: rows of every specimen -----------------------------------------------------


PARAMETER, CURVE = "parameter", "curve"
"""Kinds of row: an unknown of the run, or what follows from the parameters and shapes the curve."""
COLUMNS = (
    "specimen",
    "donor",
    "layer",
    "file",
    "folder",
    "state",
    "reason",
    "kind",
    "quantity",
    "unit",
    "verdict",
    "mean",
    "sd",
    "q05",
    "q50",
    "q95",
    "stated_low",
    "stated_high",
    "stated_reason",
    "scale",
    "scale_sd",
    "contraction",
    "ess_bulk",
    "ess_tail",
    "rhat",
    "readings",
    "effective_readings",
    "beta",
)
TEXTS = ("state", "reason", "kind", "quantity", "unit", "verdict", "stated_reason", "scale")
"""Columns of a run that hold text; the others hold numbers."""
LOG, LINEAR = "log", "linear"
NOT_DETERMINED = "not determined"


def are_rows(found: object) -> bool:
    """Whether this could be the rows of a run; it was read from a file."""
    kinds = {name: str if name in TEXTS else (int, float) for name in COLUMNS[5:]}
    return (
        isinstance(found, list)
        and bool(found)
        and all(
            isinstance(row, dict)
            and row.get("state") in STATES
            and isinstance(row.get("reason"), str)
            and all(isinstance(value, kinds.get(name, ())) for name, value in row.items())
            for row in found
        )
    )


def rows_without_run(state: str, reason: str, law: str = DEFAULT_LAW) -> list[dict[str, Any]]:
    """Rows of a specimen that could not be sampled: its parameters, without numbers."""
    common = {"state": state, "reason": reason, "kind": PARAMETER}
    return [common | {"quantity": name} for name in law_named(law).names]


# --- the layers of a donor, and how far they are apart --------------------------------------------


MOST_WITHOUT_DONOR = 6
"""Specimens that are compared with one another where no donor is named."""
USABLE = ("converged", "tentative")
DISTANCES: dict[str, type] = {
    **dict.fromkeys(("run_a", "run_b", "kind", "quantity", "unit"), str),
    "total_stretch": float,
    **dict.fromkeys(("determined_in_a", "determined_in_b"), bool),
    **dict.fromkeys(("median_a", "median_b"), float),
    **dict.fromkeys(("difference_q05", "difference_q50", "difference_q95"), float),
    **dict.fromkeys(("standardised", "probability_b_greater", "kolmogorov"), float),
    "determined_in_both": bool,
}
"""Columns of the distances between runs, and what each holds."""


@dataclass(frozen=True)
class LayersFound:
    """Distances between the layers of one donor.

    Attributes
    ----------
    donor : str
    distances : DataFrame
        As of :func:`biaxbayes.comparison.compare.compare`, with ``layer_a`` and ``layer_b``.
    notes : list of str
        Differences that are none of tissue, or why there is no comparison.
    """

    donor: str
    distances: pd.DataFrame
    notes: list[str]


def donor_groups(table: pd.DataFrame) -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Donors with usable specimens of several layers: (donor, labels, layers).

    Where no donor is named at all, a small study is one group.
    """
    usable = table[table["state"].isin(USABLE)].drop_duplicates("specimen")
    usable = usable[usable["layer"] != ""]
    donors = [d for d in dict.fromkeys(usable["donor"]) if d]
    if not (table["donor"] != "").any() and len(usable) <= MOST_WITHOUT_DONOR:
        donors = [""]
    out = []
    for donor in donors:
        members = usable[usable["donor"] == donor]
        if members["layer"].nunique() > 1:
            out.append((donor, tuple(members["specimen"]), tuple(members["layer"])))
    return out


def layers_found(
    donor: str, layers: Mapping[str, str], rows: Sequence[dict[str, Any]], notes: list[str]
) -> LayersFound:
    """Put distances between runs together as those between the layers of a donor.

    Parameters
    ----------
    donor : str
    layers : mapping of str to str
        By the label of the run.
    rows : sequence of dict
        One a pair of runs and quantity, with the columns :data:`DISTANCES`.
    notes : list of str
    """
    table = pd.DataFrame(rows)
    table.insert(0, "donor", donor)
    for k, side in enumerate("ab"):
        table.insert(1 + k, f"layer_{side}", [layers[v] for v in table[f"run_{side}"]])
    return LayersFound(donor, table, notes)


def are_distances(found: object, labels: Sequence[str]) -> bool:
    """Whether these could be rows of :func:`layers_found`; they were read from a file."""
    return (
        isinstance(found, list)
        and bool(found)
        and all(
            isinstance(row, dict)
            and list(row) == list(DISTANCES)
            and all(_fits(row[name], kind) for name, kind in DISTANCES.items())
            and {row["run_a"], row["run_b"]} <= {*labels}
            for row in found
        )
    )


def are_notes(found: object) -> bool:
    """Whether these could be notes on a comparison, likewise."""
    return isinstance(found, list) and all(_fits(note, str) for note in found)


def _fits(value: object, kind: type) -> bool:
    return isinstance(value, kind) and (not isinstance(value, str) or value.isprintable())


# --- what a study found, as plain tables ---------------------------------------------------------


@dataclass(frozen=True)
class StudyResult:
    """A finished study.

    Attributes
    ----------
    name : str
    folder : Path
        Holds ``study.csv``, ``study.html`` and, in ``runs``, a run folder of each specimen.
    table : DataFrame
        One row a specimen and quantity, as ``study.csv``.
    distances : DataFrame
        Distances between the layers of each donor.
    notes : list of str
        What makes specimens of a donor hard to compare.
    """

    name: str
    folder: Path
    table: pd.DataFrame
    distances: pd.DataFrame = field(repr=False)
    notes: list[str] = field(default_factory=list)

    @cached_property
    def specimens(self) -> pd.DataFrame:
        """One row a specimen: donor, layer, state, reason, file, folder."""
        kept = ["specimen", "donor", "layer", "state", "reason", "file", "folder"]
        return self.table[kept].drop_duplicates("specimen").reset_index(drop=True)

    @cached_property
    def groups(self) -> pd.DataFrame:
        """Summaries across layers, donors and the whole; see :func:`group_summaries`."""
        return group_summaries(self.table)

    @cached_property
    def contrasts(self) -> pd.DataFrame:
        """How layers differ within donors; see :func:`layer_contrasts`."""
        return layer_contrasts(self.distances)

    @property
    def states(self) -> dict[str, int]:
        """Number of specimens by state."""
        return {str(k): int(v) for k, v in self.specimens["state"].value_counts().items()}

    @property
    def converged(self) -> bool:
        """Whether every specimen is."""
        return set(self.states) == {"converged"}

    @property
    def failures(self) -> dict[str, str]:
        """Reasons by specimen, of those that have no run."""
        bad = self.specimens[self.specimens["state"] == FAILED]
        return dict(zip(bad["specimen"], bad["reason"], strict=True))

    def __repr__(self) -> str:
        return f"StudyResult({self.name!r}: {_counts(self.states)})"

    def _repr_html_(self) -> str:
        """States and medians, for notebooks."""
        parameters = self.table[self.table["kind"] == "parameter"]
        wide = parameters.pivot(index="specimen", columns="quantity", values="q50")
        names = list(dict.fromkeys(parameters["quantity"]))
        shown = self.specimens[["specimen", "donor", "layer", "state"]].merge(
            wide[names].reset_index(), on="specimen"
        )
        head = f"<p>{escape(self.name)}: {escape(_counts(self.states))}; posterior medians</p>"
        return head + shown.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")


def _counts(states: dict[str, int]) -> str:
    return ", ".join(f"{n} {state}" for state, n in states.items())


def result_of(
    name: str, folder: Path, table: pd.DataFrame, found: Sequence[LayersFound]
) -> StudyResult:
    """Put the tables of a study together."""
    tables = [f.distances for f in found if len(f.distances)]
    notes = [f"{f.donor}: {note}" if f.donor else note for f in found for note in f.notes]
    distances = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    return StudyResult(name, folder, table, distances, notes)
