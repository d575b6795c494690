"""A study as plain tables: specimens, rows of their runs, and summaries."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.derived.determined import derived_quantities, determined, thin_draws
from biaxbayes.identifiability.verdict import FIXED
from biaxbayes.laws import DEFAULT_LAW, law_named
from biaxbayes.model.priors import Prior
from biaxbayes.prediction.percentiles import QUANTILES, quantiles
from biaxbayes.runs.folder import RUNS
from biaxbayes.runs.run import Run
from biaxbayes.studies.groups import (
    LINEAR,
    LOG,
    PRIOR_COLUMNS,
    group_contrasts,
    group_names,
    group_summaries,
)
from biaxbayes.studies.study_file import LoadedSpecimen

FAILED, INTERRUPTED = "failed", "interrupted"
PARAMETER, CURVE = "parameter", "curve"
"""Kinds of row: an unknown of the run, or a derived quantity that shapes the curve."""
STUDY_COLUMNS = (
    *("specimen", "donor", "layer", "file", "folder", "state", "reason", "kind", "quantity"),
    *("unit", "verdict", "reported", "reported_reason"),
    *("mean", "sd", "q05", "q50", "q95", "scale", "scale_sd", "ess_bulk", "ess_tail", "rhat"),
    *PRIOR_COLUMNS,
    *("readings", "misfit", "law_misses"),
)
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
    largest_stretch: float = math.nan  # total, in both directions


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
            "folder": f"{RUNS}/{e.slug}",
            **e.listing.columns,
        }
        rows += [head | row for row in outcomes[e.slug].rows]
    own = [name for e in entries for name in e.listing.columns]
    names = dict.fromkeys([*STUDY_COLUMNS[:3], *own, *STUDY_COLUMNS[3:]])
    return pd.DataFrame(rows, columns=list(names))


def failed_outcome(
    reason: str, notes: Sequence[str] = (), law: str = DEFAULT_LAW
) -> SpecimenOutcome:
    """Outcome of a specimen that could not be sampled: its parameters, without numbers."""
    common = {"state": FAILED, "reason": reason, "kind": PARAMETER}
    rows = [common | {"quantity": name} for name in law_named(law).names]
    return SpecimenOutcome(FAILED, reason, rows, list(notes))


def rows_of_run(run: Run) -> list[dict[str, Any]]:
    """One row per quantity of a finished run.

    `scale_sd` is the sd of its log or of itself, `prior_q05` to `prior_q95` are of its prior where
    that is normal or lognormal.
    """
    common = {
        "state": run.state,
        "reason": run.provenance["convergence"]["reason"] if run.state != "converged" else "",
        "readings": run.provenance["noise"]["readings"],
        "misfit": run.provenance["misfit"]["amplitude"],
        "law_misses": next(iter(run.result.warnings), ""),
    }
    reported = {row["parameter"]: row for row in run.result.to_frame().to_dict("records")}
    rows = []
    usable, priors = run.state != "unusable", run.posterior().priors
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
            | _prior_columns(priors.get(name))
        )
    # structure tensor and small-strain stiffness, often known if parameters are correlated
    curves = derived_quantities(thin_draws(draws), run.law, [], [1.0]) if usable else []
    for quantity in curves:
        scale, values = LOG if quantity.unit else LINEAR, quantity.values
        own = {"kind": CURVE, "quantity": quantity.key, "verdict": "", "scale": scale}
        own |= {"unit": quantity.unit or "1", "mean": values.mean(), "sd": values.std(ddof=1)}
        numbers = dict(zip(QUANTILES, quantiles(values), strict=True))
        rows.append(common | own | numbers | {"scale_sd": _sd_on_scale(values, scale)})
    return rows


def _prior_columns(prior: Any) -> dict[str, float]:
    """Quantiles of a normal or lognormal prior; of others nothing, they hardly pull."""
    if not isinstance(prior, Prior) or prior.family not in ("normal", "lognormal"):
        return {}
    levels = np.array(list(QUANTILES.values()))
    whole = Prior(prior.family, prior.location, prior.scale)
    return dict(zip(PRIOR_COLUMNS, whole.ppf(levels).tolist(), strict=True))


def _sd_on_scale(values: Any, scale: str) -> float:
    """Sd of the logs or of the values themselves; NaN where one is not finite."""
    natural = np.asarray(values, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(natural) if scale == LOG else natural
    return float(moved.std()) if np.isfinite(moved).all() else math.nan


COMMON = {
    "Cauchy stress x": "cauchy_x",
    "Cauchy stress y": "cauchy_y",
    "tangent stiffness xx": "stiffness_x",
    "tangent stiffness yy": "stiffness_y",
}
"""Names in a study of the quantities of :func:`determined`."""


def common_stretches(largest: Sequence[float]) -> list[float]:
    """Total equibiaxial stretches half-way to and at the smallest of the largest stretches."""
    known = [v for v in largest if math.isfinite(v)]
    top = math.floor(1e3 * (min(known) - 1.0) + 1e-9) / 1e3 if known else 0.0
    return [round(1.0 + share * top, 3) for share in (0.5, 1.0)] if top > 0.0 else []


def rows_at_stretches(run: Run, stretches: Sequence[float]) -> list[dict[str, Any]]:
    """Stresses of the tissue and tangent stiffnesses at total equibiaxial stretches."""
    table = determined(run.posterior(), run.draws, stretches=[(v, v) for v in stretches])
    common = {"state": run.state, "kind": CURVE, "verdict": "", "scale": LOG, "unit": "kPa"}
    return [
        common
        | {"quantity": f"{COMMON[r['quantity']]} at {r['stretch_x']:g}"}
        | {"q05": r["low"], "q50": r["median"], "q95": r["high"]}
        for r in table.to_dict("records")
        if r["quantity"] in COMMON
    ]


@dataclass(frozen=True)
class StudyResult:
    """A finished study.

    Attributes
    ----------
    folder : Path
        Holds ``study.csv``, ``study.html`` and, in ``runs``, a run folder of each specimen.
    table : DataFrame
        One row per specimen and quantity, as ``study.csv``.
    notes : list of str
        Why specimens could not be compared at common stretches.
    """

    name: str
    folder: Path
    table: pd.DataFrame
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
