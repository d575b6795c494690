"""What a run folder holds besides the draws: figures, verdicts, profiles, report."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.executors.beside import Beside, Standby
from biaxbayes.figures.style import figure_bytes, own_garbage, return_memory
from biaxbayes.identifiability.determined import determined, mounting_stated
from biaxbayes.identifiability.held_edges import EDGES, HeldEdge, held_edges, held_from, held_table
from biaxbayes.identifiability.identify import (
    Identifiability,
    ParameterVerdict,
    fits_of_laws,
    identify_draws,
)
from biaxbayes.identifiability.marginals import BOUND_TAIL, PRIOR_TAIL
from biaxbayes.identifiability.mounting_stretch.law_range import LAW_FITS, LawRange, law_range
from biaxbayes.identifiability.profile.profile import FLAT, THRESHOLD, Profile
from biaxbayes.identifiability.sloppiness import Sloppiness, sloppiness
from biaxbayes.model.posterior import Posterior
from biaxbayes.runs.archive import flatten
from biaxbayes.runs.said import IDENTIFIED, write_said
from biaxbayes.sampling.sampler import Draws
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text, read_csv, write_csv

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Identified",
    "identified",
    "interval_table",
    "profiles_as_json",
    "thresholds_record",
    "verdicts_as_json",
    "write_identifiability",
    "write_identifiability_products",
    "write_products",
    "write_profiles",
]


# --- identifiability.csv: verdicts with their evidence; the thresholds they depend on -------------


DIGITS = 6


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
    """Write ``law-fits.csv``: least squares of every law; nothing where there are none.

    All digits are kept: what is stated is read off them again.

    Parameters
    ----------
    found : Identifiability
    posterior : Posterior
    folder : Path
    """
    if found.fits is not None:
        write_csv(folder / LAW_FITS, found.fits.to_frame(_mounts(posterior)))


def kept_law_fits(folder: Path, posterior: Posterior) -> LawRange | None:
    """The fits that ``law-fits.csv`` of a run keeps; None where it does not keep them all.

    Parameters
    ----------
    folder : Path
    posterior : Posterior
    """
    try:
        table = read_csv(folder / LAW_FITS)
        return law_range(table, posterior.specimen, _mounts(posterior))
    except (OSError, InputError, KeyError):  # of an earlier version
        return None


def write_held_edges(found: Identifiability, folder: Path) -> None:
    """Write ``edges.csv``: intervals with a parameter held at an end; nothing where none is open.

    Parameters
    ----------
    found : Identifiability
    folder : Path
    """
    if found.held:
        write_csv(folder / EDGES, held_table(found.held), digits=10)


def _held_edges(
    found: Identifiability, posterior: Posterior, kept: Path | None
) -> tuple[HeldEdge, ...]:
    """Those that a run keeps, or else new ones."""
    open_edges = found.open_edges()
    if open_edges and kept is not None:
        with contextlib.suppress(OSError, InputError, KeyError):
            return held_from(read_csv(kept / EDGES), posterior.quantities)
    return held_edges(posterior, open_edges)


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
        told.append({**{str(k): _plain_profile(v) for k, v in row.items()}, "curve": curve})
    return json.dumps(told, indent=2, allow_nan=False, ensure_ascii=False)


def _plain_profile(value: object) -> object:
    return value if not isinstance(value, float) or math.isfinite(value) else None


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


def identified(
    posterior: Posterior, draws: pd.DataFrame, state: str, *, kept: Path | None = None
) -> Identified:
    """Judge the draws of a run.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        Natural quantities, ``log_likelihood`` and ``lp``, one row a draw.
    state : {"converged", "tentative", "unusable"}
    kept : Path, optional
        Folder of the run, where the fits of laws need not be made again.
    """
    fits = kept_law_fits(kept, posterior) if kept is not None else None
    if fits is None and state == "converged":
        fits = fits_of_laws(posterior)
    verdicts = identify_draws(posterior, draws, state, fits=fits)
    verdicts = verdicts.with_held(_held_edges(verdicts, posterior, kept))
    return _with_curves(verdicts, posterior, draws)


def _with_curves(
    verdicts: Identifiability, posterior: Posterior, draws: pd.DataFrame
) -> Identified:
    """Verdicts with what the curves determine, of converged draws."""
    if verdicts.state != "converged":
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


def write_identifiability_products(
    folder: Path,
    posterior: Posterior,
    draws: pd.DataFrame,
    state: str,
    *,
    figure: bool = True,
    kept: Path | None = None,
) -> Identified:
    """Judge the draws of a run and write what was found into its folder.

    Writes ``identifiability.csv``, with converged draws ``determined.csv`` and
    ``same-curves.csv``, and ``identifiability.pdf``.

    Parameters
    ----------
    folder : Path
    posterior, draws, state, kept
        As in :func:`identified`.
    figure : bool
        Whether to draw the figure, which takes matplotlib.

    Returns
    -------
    Identified

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    found = identified(posterior, draws, state, kept=kept)
    _write_tables(found, posterior, folder)
    if figure:
        from biaxbayes.figures.run.identifiability import identifiability_figure
        from biaxbayes.figures.style import save_figure

        save_figure(identifiability_figure(found.verdicts), folder / "identifiability.pdf")
    return found


def _write_tables(found: Identified, posterior: Posterior, folder: Path) -> None:
    """Every table of what was found."""
    write_identifiability(found.verdicts, folder / "identifiability.csv")
    write_law_fits(found.verdicts, posterior, folder)
    write_held_edges(found.verdicts, folder)
    if found.determined is not None:
        write_csv(folder / "determined.csv", found.determined, digits=DIGITS)
    if found.directions is not None:
        write_csv(folder / "same-curves.csv", found.directions.path.to_frame(), digits=DIGITS)


# --- what a run folder holds besides the draws: figures, verdicts, report ------------------------


FORMATS = ("pdf", "png")

Task = tuple[str, tuple[Any, ...]]
"""What is drawn, by the stem of its files, and what of."""

_drawing: ContextVar[Standby[Task, dict[str, bytes]] | None] = ContextVar("drawing", default=None)


@contextlib.contextmanager
def drawing_beside(workers: int) -> Iterator[None]:
    """Have a process get ready to draw the figures of a run that is sampled within.

    It imports matplotlib, which this process then never holds.

    Parameters
    ----------
    workers : int
        Processors that may be used; with one the figures are drawn here.
    """
    with Standby(_ready, _drawn, workers) as process:
        token = _drawing.set(process)
        try:
            yield
        finally:
            _drawing.reset(token)


def write_products(
    folder: Path,
    posterior: Posterior,
    draws: Draws,
    laws: Beside[LawRange | None],
    *,
    workers: int = 1,
) -> Identifiability:
    """Write the products of a run into its folder; the verdicts.

    What ``identify`` says of the run is kept for it. Unusable draws get the traces that show why,
    and no figure of a posterior that is none. With two ``workers`` the figures are drawn beside the
    verdicts, the corner, which takes as long as the others, beside these, and the ``laws`` were
    fitted beside the sampling.
    """
    from biaxbayes.jobs.identified import said_of

    state = draws.convergence.state
    table = pd.DataFrame({name: flatten(v).ravel() for name, v in draws.quantities.items()})
    known = posterior.quantities
    return_memory()
    with contextlib.ExitStack() as stack:
        drawing = _drawing.get() or stack.enter_context(Standby(_ready, _drawn, workers))
        if state != "unusable":  # the largest figure first
            drawing.begin(("corner", (table, known)))
            drawing.begin(("stress-bands", (posterior.specimen, table, posterior.settings)))
            drawing.begin(("explore", (posterior, table, state)))
        if state != "converged":
            drawing.begin(("trace", (draws.quantities, posterior.specimen.unit, known)))
        fits = laws.result() if state == "converged" else None
        found = identify_draws(posterior, table, state, fits=fits)
        found = found.with_held(held_edges(posterior, found.open_edges()))
        if state != "unusable":
            drawing.begin(("identifiability", (found,)))
        judged = _with_curves(found, posterior, table)
        _write_tables(judged, posterior, folder)
        if state != "unusable":  # what identify says of the run is known now
            write_said(folder, IDENTIFIED, said_of(judged))
        for files in drawing.results():
            for name, content in files.items():
                atomic_write_bytes(folder / name, content)
    return found


def _ready() -> None:
    """Import what all figures need."""
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_pdf  # noqa: F401

    import biaxbayes.figures.run.bands
    import biaxbayes.figures.run.corner
    import biaxbayes.figures.run.identifiability
    import biaxbayes.reports.explore  # noqa: F401


def _drawn(task: Task) -> dict[str, bytes]:
    """The files of a task, by their names."""
    stem, of = task
    if stem == "explore":
        from biaxbayes.reports.explore import EXPLORE, can_be_explored, explore_page
        from biaxbayes.reports.page import NAME

        posterior, table, state = of
        if not can_be_explored(posterior.quantities, table):
            return {}
        return {EXPLORE: explore_page(posterior, table, state, report=NAME).encode()}
    with own_garbage():
        figure = _figure(stem, *of)
        pictures = {f"{stem}.{suffix}": figure_bytes(figure, suffix) for suffix in FORMATS}
        del figure
    return pictures


def _figure(stem: str, *of: Any) -> Figure:
    """The figure with this stem of a run."""
    if stem == "corner":
        from biaxbayes.figures.run.corner import corner_figure

        return corner_figure(of[0], known=of[1])
    if stem == "stress-bands":
        from biaxbayes.figures.run.bands import bands_figure

        return bands_figure(of[0], of[1], settings=of[2])
    if stem == "trace":
        from biaxbayes.figures.run.trace import trace_figure

        return trace_figure(of[0], unit=of[1], known=of[2])
    from biaxbayes.figures.run.identifiability import identifiability_figure

    return identifiability_figure(*of)
