"""What the data of a run determine, as it is written and said: tables, a figure, lines, JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from biaxbayes.identifiability.determined import FARTHEST, determined, mounting_stated
from biaxbayes.identifiability.held_edges import EDGES, held_edges, held_table
from biaxbayes.identifiability.identify import (
    Identifiability,
    ParameterVerdict,
    fits_of_laws,
    identify_draws,
)
from biaxbayes.identifiability.marginals import BOUND_TAIL, PRIOR_TAIL
from biaxbayes.identifiability.mounting_stretch.law_range import LAW_FITS
from biaxbayes.identifiability.profile.profile import FLAT, THRESHOLD, Profile
from biaxbayes.identifiability.sloppiness import Sloppiness, sloppiness
from biaxbayes.model.posterior import Posterior
from biaxbayes.text_files import atomic_write_text, write_csv

# --- identifiability.csv: verdicts with their evidence; the thresholds they depend on -------------


DIGITS = 8
"""Of the tables: more than anything is told with, so that what is read again is rounded alike."""


def write_identifiability(found: Identifiability, path: Path) -> None:
    """Write the table, whole or not at all.

    Parameters
    ----------
    found : Identifiability
    path : Path

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_csv(path, found.to_frame(), digits=DIGITS)


def thresholds_record(found: Identifiability) -> dict[str, Any]:
    """What the verdicts depend on, for the provenance of a run.

    Parameters
    ----------
    found : Identifiability
    """
    return {
        "draws": found.draws,
        "state": found.state,
        "thresholds": dict(found.limits()),
        "near_an_edge": f"{found.law.nearness}; a bound in the priors within {BOUND_TAIL:g} of the "
        f"prior's mass; a prior without bounds ends at its outer {PRIOR_TAIL:g}",
        "better_law": found.better_law,
    }


def write_law_fits(found: Identifiability, posterior: Posterior, folder: Path) -> None:
    """Write ``law-fits.csv``: least squares of every law; nothing where there are none."""
    if found.fits is not None:
        write_csv(folder / LAW_FITS, found.fits.to_frame(_mounts(posterior)))


def write_held_edges(found: Identifiability, folder: Path) -> None:
    """Write ``edges.csv``: intervals with a parameter held at an end; nothing where none is open.

    Parameters
    ----------
    found : Identifiability
    folder : Path
    """
    if found.held:
        write_csv(folder / EDGES, held_table(found.held), digits=10)


def _mounts(posterior: Posterior) -> Sequence[str]:
    """Labels of the mounted states that the laws place."""
    return posterior.mounts if posterior.settings.infers_mounting else ()


def verdicts_as_json(
    found: Identifiability,
    determined: pd.DataFrame | None = None,
    directions: Sloppiness | None = None,
) -> str:
    """The same as JSON: state, thresholds, one object a parameter without empty fields.

    Parameters
    ----------
    found : Identifiability
    determined : DataFrame, optional
        From :func:`biaxbayes.identifiability.determined.determined`.
    directions : Sloppiness, optional
    """
    told: dict[str, object] = {
        "state": found.state,
        "draws": found.draws,
        "thresholds": dict(found.limits()),
        "parameters": [
            {key: _plain(value) for key, value in row.record().items()} for row in found.parameters
        ],
    }
    if determined is not None:
        told["determined"] = [
            {str(key): _plain(value) for key, value in row.items()}
            for row in determined.to_dict("records")
        ]
    if directions is not None:
        told["directions"] = [
            {"spread": d.spread, "loadings": d.loadings, "in_words": d.words}
            for d in directions.directions
        ]
        told["same_curves"] = {
            "in_words": directions.words,
            "change_kPa": directions.path.change_kPa,
            "materials": directions.path.to_frame().to_dict("list"),
        }
    return json.dumps(told, indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: object) -> object:
    """JSON knows no infinity."""
    return value if not isinstance(value, float) or math.isfinite(value) else None


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
    told = []
    for row, profile in zip(interval_table(profiles).to_dict("records"), profiles, strict=True):
        curve = {str(k): v for k, v in profile.table.to_dict("list").items()}
        told.append({**{str(k): _plain(v) for k, v in row.items()}, "curve": curve})
    return json.dumps(told, indent=2, allow_nan=False, ensure_ascii=False)


# --- what a run folder says about what its data determine: tables, a figure, sentences -----------


@dataclass(frozen=True)
class Identified:
    """What was found.

    Attributes
    ----------
    verdicts : Identifiability
    determined : DataFrame or None
        None where the chains have not converged.
    directions : Sloppiness or None
        None there too, and where no material parameter is free or some are tied.
    """

    verdicts: Identifiability
    determined: pd.DataFrame | None
    directions: Sloppiness | None

    def __repr__(self) -> str:
        told = ", ".join(f"{p.name}: {p.verdict}" for p in self.verdicts.parameters)
        return f"Identified({told})"

    def __getitem__(self, name: str) -> ParameterVerdict:
        """The verdict on a parameter."""
        return self.verdicts[name]

    @property
    def parameters(self) -> tuple[ParameterVerdict, ...]:
        """The verdicts, one a parameter."""
        return self.verdicts.parameters

    @property
    def state(self) -> str:
        """State of the run that the draws are from."""
        return self.verdicts.state

    def to_frame(self) -> pd.DataFrame:
        """One row a parameter, as in ``identifiability.csv``."""
        return self.verdicts.to_frame()

    def _repr_html_(self) -> str:
        """The verdicts, for notebooks."""
        return self.verdicts._repr_html_()

    def in_words(self) -> list[str]:
        """Sentences: a verdict a parameter, then the best and the least known combination."""
        lines = self.verdicts.in_words()
        return lines + (self.directions.in_words() if self.directions else [])


def identified(posterior: Posterior, draws: pd.DataFrame, state: str) -> Identified:
    """Judge the draws of a run.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        Natural quantities, ``log_likelihood`` and ``lp``, one row a draw.
    state : {"converged", "tentative", "unusable"}
    """
    fits = fits_of_laws(posterior) if state == "converged" else None
    verdicts = identify_draws(posterior, draws, state, fits=fits)
    verdicts = verdicts.with_held(held_edges(posterior, verdicts.open_edges()))
    if state != "converged":
        return Identified(verdicts, None, None)
    table = determined(
        draws,
        posterior.specimen,
        posterior.law,
        refits=verdicts.refits(),
        values=verdicts.values(),
        mounting_known=mounting_stated(posterior.settings.priors),
    )
    return Identified(verdicts, table, sloppiness(posterior, draws))


def write_tables(found: Identified, posterior: Posterior, folder: Path) -> None:
    """Every table of what was found."""
    write_identifiability(found.verdicts, folder / "identifiability.csv")
    write_law_fits(found.verdicts, posterior, folder)
    write_held_edges(found.verdicts, folder)
    if found.determined is not None:
        write_csv(folder / "determined.csv", found.determined, digits=DIGITS)
    if found.directions is not None:
        write_csv(folder / "same-curves.csv", found.directions.path.to_frame(), digits=DIGITS)


# --- the same in lines and as JSON ---------------------------------------------------------------


SHOWN = ("Hx", "Hy", "Hz", "small-strain stiffness xx", "small-strain stiffness yy")


def terminal_lines(result: Identified) -> list[str]:
    """The verdicts as lines to read, with what the curves determine."""
    lines = result.verdicts.in_words()
    if result.determined is not None:
        directions = result.directions.in_words() if result.directions else []
        words = [*_determined_words(result.determined), *directions]
        lines = [*lines, "", "what the curves themselves say:", *(f"  {line}" for line in words)]
    return lines


def as_json(result: Identified) -> str:
    """State, thresholds, one object per parameter, and what the curves determine."""
    return verdicts_as_json(result.verdicts, result.determined, result.directions)


def _determined_words(table: pd.DataFrame) -> list[str]:
    """A few quantities, and the stress at the end of the first test."""
    stress = table[table["quantity"].isin(("Cauchy stress x", "Cauchy stress y"))]
    shown = [*table[table["quantity"].isin(SHOWN)].itertuples(), *list(stress.itertuples())[2:4]]
    lines = []
    for row in shown:
        where = f" at {row.stretch_x:g}, {row.stretch_y:g}" if "stress" in str(row.quantity) else ""
        numbers = f"{row.median:.3g} ({row.low_90:.3g} to {row.high_90:.3g})"
        line = f"{row.quantity}{where} {numbers} {row.unit}".rstrip()
        ends = [float(str(v)) for v in (row.tissue_low_90, row.tissue_high_90)]
        if not math.isnan(ends[0]):  # the interval to state: with the error of the model
            line += f"; of the tissue {ends[0]:.3g} to {ends[1]:.3g}"
        elif str(row.quantity).startswith("Cauchy stress"):
            line += f"; of the tissue not stated, the mounting stretch may be {FARTHEST:g} or more"
        lines.append(line)
    return lines
