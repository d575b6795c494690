"""A study as plain tables: who its specimens are, what their runs say, what it found."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.calibration.simulated_specimen import prior_value
from biaxbayes.comparison.distance import contractions, prior_material
from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.identifiability.determined import derived_quantities, some_draws
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.runs.run import COLUMNS as SUMMARY
from biaxbayes.runs.run import Run
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.studies.groups import DETERMINED, group_summaries, layer_contrasts
from biaxbayes.studies.study_file import Study, StudySpecimen
from biaxbayes.text_files import read_csv

__all__ = [
    "COLUMNS",
    "CURVE",
    "FAILED",
    "INTERRUPTED",
    "MOST_WITHOUT_DONOR",
    "PARAMETER",
    "RUNS",
    "Entry",
    "LayersFound",
    "StudyResult",
    "Tried",
    "donor_groups",
    "read_entries",
    "result_of",
    "rows_of_run",
    "rows_without_run",
    "study_table",
]

FAILED, INTERRUPTED = "failed", "interrupted"


# --- the specimens of a study as they were read: who they are, and what their runs depend on -----


RUNS = "runs"


@dataclass(frozen=True)
class Entry:
    """A specimen of the study as it was read.

    Attributes
    ----------
    entry : StudySpecimen
    slug : str
        Name of its run folder.
    specimen : Specimen or None
    problem : str
        Why it could not be read.
    fingerprint : str
        Of everything its run depends on.
    """

    entry: StudySpecimen
    slug: str
    specimen: Specimen | None = None
    problem: str = ""
    fingerprint: str = ""

    @property
    def folder(self) -> str:
        """Run folder, relative to the study's."""
        return f"{RUNS}/{self.slug}"

    @property
    def donor(self) -> str:
        """Donor, by the study file or the header of the specimen."""
        stated = self.specimen.metadata.get("donor", "") if self.specimen else ""
        return self.entry.donor or str(stated)

    @property
    def layer(self) -> str:
        """Layer, likewise."""
        return self.entry.layer or (self.specimen.layer if self.specimen else None) or ""


def read_entries(study: Study) -> list[Entry]:
    """Read the specimens; one that cannot be read is kept with its problem."""
    out = []
    slugs: set[str] = set()
    for entry in study.specimens:
        slug = stem = _slug(entry.label)
        number = 1
        while slug.casefold() in slugs:
            number += 1
            slug = f"{stem}-{number}"
        slugs.add(slug.casefold())
        try:
            specimen = read_specimen(entry.file)
            if entry.mounting_force is not None:
                if not specimen.is_tared:
                    raise InputError("has a mounting force of its own", file=entry.file)
                specimen = specimen.with_mounting_force(*entry.mounting_force)
        except BiaxbayesError as error:
            out.append(Entry(entry, slug, problem=str(error)))
            continue
        out.append(Entry(entry, slug, specimen, "", _fingerprint(study, entry, specimen)))
    return out


def _slug(label: str) -> str:
    """A folder's name that every file system takes."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", label).strip(".-")[:60] or "specimen"


def _fingerprint(study: Study, entry: StudySpecimen, specimen: Specimen) -> str:
    """Everything that the run of a specimen depends on."""
    options = dict(entry.options)
    options["priors"] = {k: prior_value(v) for k, v in dict(options.get("priors", {})).items()}
    content = {
        "specimen": specimen_digest(specimen),
        "options": options,
        "seed": entry.seed,
        "ess": study.ess,
        "max_steps": study.max_steps,
        "biaxbayes": biaxbayes.__version__,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


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


# --- rows of the study table: what one run says ---------------------------------------------------


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


def rows_of_run(run: Run) -> list[dict[str, Any]]:
    """One row a quantity of a finished run.

    ``scale_sd`` is the posterior standard deviation on the scale on which specimens are averaged:
    of the natural logarithm for stiffnesses and exponents, as it is for everything else. It is
    empty, as every number is, where the chains are unusable. What is stated of a mounting stretch
    of the tissue is that of the run.
    """
    noise, convergence = run.provenance["noise"], run.provenance["convergence"]
    common = {
        "state": run.state,
        "reason": convergence["reason"] if run.state != "converged" else "",
        "readings": noise["readings"],
        "effective_readings": noise["effective_readings"] or noise["readings"],
        "beta": noise["beta"],
    }
    verdicts, stated = _verdicts(run), run.stated
    rows = []
    usable = run.state != "unusable"
    draws = run.draws if usable else pd.DataFrame()
    for record in run.summary.to_dict("records"):
        name = str(record["parameter"])
        found = verdicts.get(name, {})
        scale = LOG if run.quantities[name].parameter.logarithmic else LINEAR
        rows.append(
            common
            | {str(k): v for k, v in record.items() if k in SUMMARY[2:]}
            | {
                "kind": PARAMETER,
                "quantity": name,
                "unit": record["unit"],
                "verdict": found.get("verdict", ""),
                "contraction": found.get("contraction", math.nan),
                "scale": scale,
                "scale_sd": _spread(draws[name], scale) if name in draws else math.nan,
            }
            | ({f"stated_{k}": v for k, v in vars(stated[name]).items()} if name in stated else {})
        )
    return rows + ([common | row for row in _curve_rows(run, draws)] if usable else [])


def are_rows(found: object) -> bool:
    """Whether this could have come from :func:`rows_of_run`; it was read from a file."""
    kinds = {name: str if name in TEXTS else (int, float) for name in COLUMNS[5:]}
    return isinstance(found, list) and all(
        isinstance(row, dict)
        and all(isinstance(value, kinds.get(name, ())) for name, value in row.items())
        for row in found
    )


def rows_without_run(state: str, reason: str, law: str = DEFAULT_LAW) -> list[dict[str, Any]]:
    """Rows of a specimen that could not be sampled: its parameters, without numbers."""
    common = {"state": state, "reason": reason, "kind": PARAMETER}
    return [common | {"quantity": name} for name in law_named(law).names]


def _curve_rows(run: Run, draws: pd.DataFrame) -> list[dict[str, Any]]:
    """Structure tensor and small-strain stiffness: often known where parameters trade."""
    posterior = run.posterior()
    few = some_draws(draws)
    found, before = (
        derived_quantities(d, posterior.law, [], [1.0])
        for d in (few, prior_material(posterior, few))
    )
    rows = []
    for quantity, share in zip(found, contractions(before, found), strict=True):
        scale = LOG if quantity.unit else LINEAR
        known = run.state == "converged" and share >= Thresholds().contraction
        q05, q50, q95 = np.quantile(quantity.values, [0.05, 0.5, 0.95])
        rows.append(
            {
                "kind": CURVE,
                "quantity": quantity.key,
                "unit": quantity.unit or "1",
                "verdict": DETERMINED if known else NOT_DETERMINED,
                "contraction": share,
                "mean": quantity.values.mean(),
                "sd": quantity.values.std(ddof=1),
                "q05": q05,
                "q50": q50,
                "q95": q95,
                "scale": scale,
                "scale_sd": _spread(quantity.values, scale),
            }
        )
    return rows


def _spread(values: pd.Series | np.ndarray, scale: str) -> float:
    natural = np.asarray(values, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(natural) if scale == LOG else natural
    return float(moved.std()) if np.isfinite(moved).all() else math.nan


def _verdicts(run: Run) -> dict[str, dict[str, Any]]:
    path = run.path / "identifiability.csv"
    try:
        table = read_csv(path)
        return {
            str(r["parameter"]): {
                "verdict": str(r["verdict"]),
                "contraction": float(r.get("contraction", math.nan)),
            }
            for r in table.to_dict("records")
        }
    except (OSError, ValueError, KeyError):
        return {}


# --- what a study found, as plain tables ---------------------------------------------------------


MOST_WITHOUT_DONOR = 6
"""Specimens that are compared with one another where no donor is named."""
USABLE = ("converged", "tentative")


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
