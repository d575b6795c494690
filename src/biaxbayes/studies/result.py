"""A study as plain tables: specimens, rows of their runs, and summaries."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import contractions, prior_material
from biaxbayes.identifiability.determined import derived_quantities, thin_draws
from biaxbayes.identifiability.verdict import FIXED, IDENTIFIED, NOT_IDENTIFIED, Thresholds
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.prediction.percentiles import QUANTILES, quantiles
from biaxbayes.runs.run import Run
from biaxbayes.studies.groups import group_contrasts, group_names, group_summaries, layer_contrasts
from biaxbayes.studies.study_file import LoadedSpecimen

FAILED, INTERRUPTED = "failed", "interrupted"
PARAMETER, CURVE = "parameter", "curve"
"""Kinds of row: an unknown of the run, or a derived quantity that shapes the curve."""
STUDY_COLUMNS = (
    *("specimen", "donor", "layer", "file", "folder", "state", "reason", "kind", "quantity"),
    *("unit", "verdict", "reported", "reported_reason"),
    *("mean", "sd", "q05", "q50", "q95", "scale", "scale_sd", "ess_bulk", "ess_tail", "rhat"),
    *("readings", "misfit", "law_misses"),
)
LOG, LINEAR = "log", "linear"
SUMMARY_NUMBERS = ("mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat")
"""Columns from the summary of a run."""


@dataclass(frozen=True)
class SpecimenOutcome:
    """Outcome of one specimen."""

    state: str  # of the run, or ``failed`` or ``interrupted``
    reason: str = ""
    # of the study table, without the columns of the study
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def study_table(
    entries: list[LoadedSpecimen], outcomes: Mapping[str, SpecimenOutcome]
) -> pd.DataFrame:
    """The study table: rows of every specimen in their order, with the columns of the study."""
    rows: list[dict[str, Any]] = []
    for e in entries:
        head = {
            "specimen": e.listing.label,
            "donor": e.donor,
            "layer": e.layer,
            "file": os.fspath(e.listing.file),
            "folder": e.folder,
            **e.listing.columns,
        }
        rows += [head | row for row in outcomes[e.slug].rows]
    own = [name for e in entries for name in e.listing.columns]
    names = dict.fromkeys([*STUDY_COLUMNS[:3], *own, *STUDY_COLUMNS[3:]])
    return pd.DataFrame(rows, columns=list(names))


def rows_without_run(state: str, reason: str, law: str = DEFAULT_LAW) -> list[dict[str, Any]]:
    """Rows of a specimen that could not be sampled: its parameters, without numbers."""
    common = {"state": state, "reason": reason, "kind": PARAMETER}
    return [common | {"quantity": name} for name in law_named(law).names]


def rows_of_run(run: Run) -> list[dict[str, Any]]:
    """One row per quantity of a finished run; `scale_sd` is the sd of its log or of itself."""
    noise, convergence = run.provenance["noise"], run.provenance["convergence"]
    common = {
        "state": run.state,
        "reason": convergence["reason"] if run.state != "converged" else "",
        "readings": noise["readings"],
        "misfit": noise["misfit"],
    }
    result = run.result
    common["law_misses"] = next(iter(result.warnings), result.better_law or "")
    reported = {row["parameter"]: row for row in result.to_frame().to_dict("records")}
    rows = []
    usable = run.state != "unusable"
    draws = run.draws if usable else pd.DataFrame()
    for record in run.summary.to_dict("records"):
        name = str(record["parameter"])
        row = reported.get(name, {})
        scale = LOG if run.quantities[name].parameter.logarithmic else LINEAR
        rows.append(
            common
            | {str(k): v for k, v in record.items() if k in SUMMARY_NUMBERS}
            | {
                "kind": PARAMETER,
                "quantity": name,
                "unit": record["unit"],
                "verdict": row.get("verdict", FIXED if record["q05"] == record["q95"] else ""),
                "reported": row.get("interval", ""),
                "reported_reason": row.get("reason", ""),
                "scale": scale,
                "scale_sd": _sd_on_scale(draws[name], scale) if name in draws else math.nan,
            }
        )
    return rows + ([common | row for row in _curve_rows(run, draws)] if usable else [])


def _curve_rows(run: Run, draws: pd.DataFrame) -> list[dict[str, Any]]:
    """Structure tensor and small-strain stiffness, often known if parameters are correlated."""
    posterior = run.posterior()
    thinned = thin_draws(draws)
    after, before = (
        derived_quantities(d, posterior.law, [], [1.0])
        for d in (thinned, prior_material(posterior, thinned))
    )
    rows = []
    for quantity, contraction in zip(after, contractions(before, after), strict=True):
        scale = LOG if quantity.unit else LINEAR
        values = quantity.values
        at = dict(zip(QUANTILES, quantiles(values), strict=True))
        narrow = scale == LINEAR or at["q95"] <= Thresholds().max_ratio * at["q05"]
        known = run.state == "converged" and contraction >= Thresholds().contraction and narrow
        row: dict[str, Any] = {
            "kind": CURVE,
            "quantity": quantity.key,
            "unit": quantity.unit or "1",
        }
        row |= {"verdict": IDENTIFIED if known else NOT_IDENTIFIED, "scale": scale}
        row |= {"mean": values.mean(), "sd": values.std(ddof=1), **at}
        rows.append(row | {"scale_sd": _sd_on_scale(values, scale)})
    return rows


def _sd_on_scale(values: Any, scale: str) -> float:
    """Sd of the logs or of the values themselves; NaN where one is not finite."""
    natural = np.asarray(values, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(natural) if scale == LOG else natural
    return float(moved.std()) if np.isfinite(moved).all() else math.nan


# --- the layers of a donor, and the distances between them ---------------------------------------


MAX_WITHOUT_DONOR = 6
"""Largest number of specimens that are compared if no donor is named."""
USABLE = ("converged", "tentative")


def donor_groups(table: pd.DataFrame) -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Donors with usable specimens of several layers: (donor, labels, layers).

    Where no donor is named at all, a small study is one group.
    """
    usable = table[table["state"].isin(USABLE)].drop_duplicates("specimen")
    usable = usable[usable["layer"] != ""]
    donors = [d for d in dict.fromkeys(usable["donor"]) if d]
    if not (table["donor"] != "").any() and len(usable) <= MAX_WITHOUT_DONOR:
        donors = [""]
    out = []
    for donor in donors:
        members = usable[usable["donor"] == donor]
        if members["layer"].nunique() > 1:
            out.append((donor, tuple(members["specimen"]), tuple(members["layer"])))
    return out


# --- result of a study, as plain tables ----------------------------------------------------------


@dataclass(frozen=True)
class StudyResult:
    """A finished study.

    Attributes
    ----------
    folder : Path
        Holds ``study.csv``, ``study.html`` and, in ``runs``, a run folder of each specimen.
    table : DataFrame
        One row per specimen and quantity, as ``study.csv``.
    distances : DataFrame
        Distances between the layers of each donor.
    notes : list of str
        Obstacles to the comparison of specimens of a donor.
    """

    name: str
    folder: Path
    table: pd.DataFrame
    distances: pd.DataFrame = field(repr=False)
    notes: list[str] = field(default_factory=list)

    @property
    def own_columns(self) -> list[str]:
        """Columns that the study file adds to donor and layer."""
        return [str(c) for c in self.table.columns if c not in STUDY_COLUMNS]

    @cached_property
    def specimens(self) -> pd.DataFrame:
        """One row per specimen: donor, layer, own columns, state, reason, file, folder."""
        columns = ["specimen", "donor", "layer", *self.own_columns]
        columns += ["state", "reason", "file", "folder"]
        return self.table[columns].drop_duplicates("specimen").reset_index(drop=True)

    @cached_property
    def groups(self) -> pd.DataFrame:
        """Summaries across layers, donors and groups; see :func:`group_summaries`."""
        return group_summaries(self.table, self.own_columns)

    @cached_property
    def group_of(self) -> dict[str, str]:
        """The group of each specimen, by the columns that the study states, else its layer."""
        groups = group_names(self.specimens, self.own_columns)
        return dict(zip(self.specimens["specimen"], groups, strict=True))

    @cached_property
    def group_contrasts(self) -> pd.DataFrame:
        """How the groups differ; see :func:`group_contrasts`."""
        return group_contrasts(self.table, self.own_columns)

    @property
    def missed(self) -> dict[str, str]:
        """What the law misses, by specimen, of those that it does not describe."""
        rows = self.table.drop_duplicates("specimen")
        texts = zip(rows["specimen"], rows["law_misses"], strict=True)
        return {name: text for name, text in texts if isinstance(text, str) and text}

    @cached_property
    def contrasts(self) -> pd.DataFrame:
        """Differences between layers within donors; see :func:`layer_contrasts`."""
        return layer_contrasts(self.distances)

    @property
    def states(self) -> dict[str, int]:
        """Number of specimens by state."""
        return {str(k): int(v) for k, v in self.specimens["state"].value_counts().items()}

    @property
    def converged(self) -> bool:
        """True if every specimen has converged."""
        return set(self.states) == {"converged"}

    @property
    def failures(self) -> dict[str, str]:
        """Reasons by specimen, of those that have no run."""
        bad = self.specimens[self.specimens["state"] == FAILED]
        return dict(zip(bad["specimen"], bad["reason"], strict=True))

    def __repr__(self) -> str:
        return f"StudyResult({self.name!r}: {_counts(self.states)})"

    def _repr_html_(self) -> str:
        """States and reported intervals, for notebooks."""
        parameters = self.table[self.table["kind"] == "parameter"]
        wide = parameters.pivot(index="specimen", columns="quantity", values="reported")
        names = list(dict.fromkeys(parameters["quantity"]))
        shown = self.specimens[["specimen", "donor", "layer", "state"]].merge(
            wide[names].reset_index(), on="specimen"
        )
        head = f"<p>{escape(self.name)}: {escape(_counts(self.states))}; reported intervals</p>"
        return head + shown.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep="–")


def _counts(states: dict[str, int]) -> str:
    return ", ".join(f"{n} {state}" for state, n in states.items())


def study_result(
    name: str,
    folder: Path,
    table: pd.DataFrame,
    compared: Mapping[str, tuple[pd.DataFrame, list[str]]],
) -> StudyResult:
    """Result of a study from its table, and distances between layers with notes, by donor."""
    tables = [distances for distances, _ in compared.values() if len(distances)]
    named = [(f"{k}: " if k else "", notes) for k, (_, notes) in compared.items()]
    distances = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    notes = [f"{donor}{note}" for donor, notes in named for note in notes]
    return StudyResult(name, folder, table, distances, notes)
