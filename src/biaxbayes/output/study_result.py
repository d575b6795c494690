"""What a study found, as plain tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path

import pandas as pd

from biaxbayes.findings.study_groups import group_summaries, layer_contrasts
from biaxbayes.output.batch_task import FAILED, LayersFound

__all__ = ["MOST_WITHOUT_DONOR", "StudyResult", "donor_groups", "result_of"]

MOST_WITHOUT_DONOR = 6
"""Specimens that are compared with one another where no donor is named."""
USABLE = ("reliable", "tentative")


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
    def reliable(self) -> bool:
        """Whether every specimen is."""
        return set(self.states) == {"reliable"}

    @property
    def failures(self) -> dict[str, str]:
        """Reasons by specimen, of those that have no run."""
        bad = self.specimens[self.specimens["state"] == FAILED]
        return dict(zip(bad["specimen"], bad["reason"], strict=True))

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


def result_of(
    name: str, folder: Path, table: pd.DataFrame, found: Sequence[LayersFound]
) -> StudyResult:
    """Put the tables of a study together."""
    tables = [f.distances for f in found if len(f.distances)]
    notes = [f"{f.donor}: {note}" if f.donor else note for f in found for note in f.notes]
    distances = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    return StudyResult(name, folder, table, distances, notes)
