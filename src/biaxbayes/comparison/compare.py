"""Comparison of runs: quantities that each determines, and distances between them.

A difference in a parameter that one of the runs does not determine is not a difference between
tissues. Stresses, stiffness and structure tensor are compared as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import contractions, distance, equibiaxial_steps, prior_material
from biaxbayes.derived.determined import (
    Derived,
    derived_quantities,
    largest_equibiaxial,
    thin_draws,
)
from biaxbayes.errors import InputError
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.marginals import parameter_scales
from biaxbayes.identifiability.reported import Reported, report_frame, report_table
from biaxbayes.identifiability.verdict import BOUNDED, IDENTIFIED, Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import prior_text
from biaxbayes.parameters import MATERIAL

OPTIONS = {
    "law": "the material law is",
    "mounting": "the mounting force enters as",
    "noise": "the errors are",
    "toe": "the largest error of the toe is",
    "mounting_stretch": "the mounted state is",
    "fibre_switch": "fibres drop out in compression:",
}


def differing_settings(runs: Sequence[tuple[str, Posterior]]) -> list[str]:
    """One sentence for each difference, not of tissue, between runs with labels."""
    notes = []
    for option, words in OPTIONS.items():
        values = {label: getattr(p.settings, option) for label, p in runs}
        if len(set(values.values())) > 1:
            if option == "law":  # of which the setting may be the text of a file
                values = {label: p.law.name for label, p in runs}
            notes.append(f"different options: {words} {_each(values)}")
    for name in {q.parameter.name: None for _, p in runs for q in p.quantities.assessed()}:
        priors = {label: _prior_text(p, name) for label, p in runs}
        if len({text for text in priors.values() if text}) > 1:
            notes.append(f"different priors of {name}: {_each(priors)}")
    for axis in "xy":
        axes = {label: getattr(p.specimen, f"axis_{axis}") for label, p in runs}
        if len(set(axes.values())) > 1:
            notes.append(f"axis {axis} is not the same direction: {_each(axes)}")
    geometry = {label: p.specimen.geometry for label, p in runs}
    if len(set(geometry.values())) > 1:
        notes.append(f"dimensions and stresses refer to different states: {_each(geometry)}")
    for (label, first), (other, second) in combinations(runs, 2):
        if first.specimen.protocols == second.specimen.protocols:
            notes.append(
                f"{label} and {other} are the same measurements: their differences are those "
                "of the settings, and their draws are not independent evidence"
            )
    return notes


def _each(values: dict) -> str:
    return ", ".join(f"{'not given' if v is None else v} ({k})" for k, v in values.items())


def _prior_text(posterior: Posterior, name: str) -> str:
    """A prior as text; empty where the run has no such unknown."""
    prior = posterior.priors.get(name)
    if prior is None:
        prior = posterior.priors.get(next((k for k in posterior.priors if k.startswith(name)), ""))
    return "" if prior is None else prior_text(prior)


WARNING = (
    "A difference in a quantity that is not identified in both runs is not a difference between "
    "tissues: other values of it describe the same curves."
)


@dataclass(frozen=True)
class ComparedRun:
    """One run of a comparison."""

    label: str
    posterior: Posterior
    draws: pd.DataFrame
    state: str
    # what the run reports of its parameters; assessed by the draws alone where empty
    reported: Sequence[Reported] = ()


@dataclass(frozen=True)
class Comparison:
    """Runs with what they report, their common quantities and the distances between them.

    Attributes
    ----------
    reported : tuple of sequence of Reported
        What each run reports.
    derived : tuple of list of Derived
        The same quantities of every run.
    identified : tuple of dict
        For each run, whether it identifies or bounds a quantity, by its key.
    distances : DataFrame
        One row per pair of runs and quantity.
    stretches : list of float
        Total equibiaxial stretches that all runs reached.
    notes : list of str
        Differences between the runs that are not of tissue.
    """

    members: tuple[ComparedRun, ...]
    reported: tuple[Sequence[Reported], ...]
    derived: tuple[list[Derived], ...]
    identified: tuple[dict[str, bool], ...]
    distances: pd.DataFrame
    stretches: list[float]
    notes: list[str] = field(default_factory=list)

    @property
    def labels(self) -> list[str]:
        """Labels of the runs."""
        return [m.label for m in self.members]

    @property
    def converged(self) -> bool:
        """True if all runs have converged."""
        return all(m.state == "converged" for m in self.members)

    def matrix(self) -> pd.DataFrame:
        """Reports of all runs, one row per run and parameter."""
        tables = []
        for member, rows in zip(self.members, self.reported, strict=True):
            table = report_frame(rows)
            table.insert(0, "run", member.label)
            tables.append(table)
        return pd.concat(tables, ignore_index=True)

    def __repr__(self) -> str:
        runs = ", ".join(f"{m.label!r} {m.state}" for m in self.members)
        return f"Comparison({runs}; stresses at {len(self.stretches)} stretches)"

    def _repr_html_(self) -> str:
        """What each run reports, for notebooks."""
        tables = zip(self.labels, self.reported, strict=True)
        return "".join(report_table(rows, label).html() for label, rows in tables)


def compare(members: Sequence[ComparedRun], *, thresholds: Thresholds | None = None) -> Comparison:
    """Compare runs of different layers, specimens or settings.

    Parameters
    ----------
    members : sequence of ComparedRun
        Two or more, with different labels.
    thresholds : Thresholds, optional
        Of the verdicts. A derived quantity counts as identified where the data shrink the variance
        of its logarithm (of the structure tensor itself) by at least ``contraction``.

    Raises
    ------
    InputError
        If there are fewer than two runs, or one has unusable draws.
    """
    if len(members) < 2:
        raise InputError("a comparison needs two runs or more")
    labels = [m.label for m in members]
    if len(set(labels)) < len(labels):
        raise InputError("two runs have the same label", remedy="give `labels`, one for each")
    for member in members:
        if member.state == "unusable":
            raise InputError(
                f"the chains of {member.label} have not converged, so its draws say nothing",
                remedy="sample it longer, or leave it out",
            )
    chosen = thresholds or Thresholds()
    reported = tuple(
        m.reported or identify_draws(m.posterior, m.draws, m.state, thresholds=chosen).reported
        for m in members
    )
    # evenly up to the largest that every run reached
    stretches = equibiaxial_steps(
        min(largest_equibiaxial(m.draws, m.posterior.specimen) for m in members)
    )
    derived, identified = [], []
    for m, rows in zip(members, reported, strict=True):
        prior, own = (
            derived_quantities(draws, m.posterior.law, stretches, (1.0, stretches[-1]))
            for draws in (prior_material(m.posterior, m.draws), thin_draws(m.draws))
        )
        derived.append(own)
        known = {r.name: r.verdict in (IDENTIFIED, BOUNDED) for r in rows}
        for quantity, contraction in zip(own, contractions(prior, own), strict=True):
            known[quantity.key] = m.state == "converged" and contraction >= chosen.contraction
        identified.append(known)
    quantities = [[*_parameters(m), *own] for m, own in zip(members, derived, strict=True)]
    pairs = combinations(zip(labels, quantities, identified, strict=True), 2)
    distances = [row for first, second in pairs for row in _distances(first, second)]
    return Comparison(
        tuple(members),
        reported,
        tuple(derived),
        tuple(identified),
        pd.DataFrame(distances),
        stretches,
        differing_settings([(m.label, m.posterior) for m in members]),
    )


def run_labels(specimens: Sequence[Any], folders: Sequence[str]) -> list[str]:
    """Labels for runs: the layers if they differ, else the specimens, else the folders' names."""
    layers = [s.layer for s in specimens]
    names = [s.name for s in specimens]
    for chosen in (layers, names, list(folders)):
        if all(chosen) and len(set(chosen)) == len(chosen):
            return [str(c) for c in chosen]
    return [f"{name} ({i})" for i, name in enumerate(names, start=1)]


OfRun = tuple[str, list[Derived], dict[str, bool]]  # label, quantities, which it identifies


def _distances(first: OfRun, second: OfRun) -> list[dict[str, Any]]:
    rows = []
    others = {q.key: q for q in second[1]}
    for a in first[1]:
        if (b := others.get(a.key)) is None:
            continue  # of another law
        known_a, known_b = (known.get(a.key, False) for *_, known in (first, second))
        rows.append(
            {
                "run_a": first[0],
                "run_b": second[0],
                "kind": a.kind,
                "quantity": a.name,
                "unit": a.unit,
                "total_stretch": a.stretch,
                "identified_in_a": known_a,
                "identified_in_b": known_b,
                "median_a": float(np.median(a.values)),
                "median_b": float(np.median(b.values)),
                **distance(a.values, b.values),
                "identified_in_both": known_a and known_b,
            }
        )
    return rows


def _parameters(m: ComparedRun) -> list[Derived]:
    """The parameters of a run; a mounting stretch is a state of the test, not of the tissue."""
    return [
        Derived("parameter", s.name, s.unit, None, m.draws[s.name].to_numpy(dtype=float))
        for s in parameter_scales(m.posterior.priors, m.posterior.quantities, m.draws)
        if s.parameter.kind == MATERIAL
    ]
