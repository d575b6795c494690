"""The figures of a run, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.findings.identifiability import identify
from biaxbayes.findings.profile import profiles
from biaxbayes.mechanics.goh import PARAMETERS
from biaxbayes.output.figures.bands import bands_figure
from biaxbayes.output.figures.corner import corner_figure
from biaxbayes.output.figures.identifiability import identifiability_figure
from biaxbayes.output.figures.mounting import mounting_figure
from biaxbayes.output.figures.profile import profile_figure
from biaxbayes.output.figures.trace import trace_figure
from biaxbayes.output.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["run_figure"]

MOST_IN_COLUMN = 3


def run_figure(run: Run, kind: str, **how: Any) -> Figure:
    """Draw a figure of a run.

    Parameters
    ----------
    run : Run
    kind : {"corner", "bands", "identifiability", "mounting", "trace", "profile"}
    **how
        Of the figure: ``width_mm`` and ``style`` of all, ``truth``, ``compare`` and ``names``
        where the figure takes them.

    Raises
    ------
    InputError
        If there is no such figure.
    """
    if kind not in _FIGURES:
        raise InputError(f"no figure {kind[:40]!r}", remedy=f"choose {', '.join(_FIGURES)}")
    return _FIGURES[kind](run, {"width_mm": 180.0, "style": None, **how})


def _corner(run: Run, how: dict[str, Any]) -> Figure:
    return corner_figure(run.draws, **how)


def _bands(run: Run, how: dict[str, Any]) -> Figure:
    return bands_figure(run.specimen, run.draws, settings=run.posterior().settings, **how)


def _mounting(run: Run, how: dict[str, Any]) -> Figure:
    return mounting_figure(run.specimen, run.draws, **how)


def _trace(run: Run, how: dict[str, Any]) -> Figure:
    summary = run.summary
    rhat = dict(zip(summary["parameter"], summary["rhat"], strict=True))
    return trace_figure(run.chains, unit=run.specimen.unit, rhat=rhat, **how)


def _identifiability(run: Run, how: dict[str, Any]) -> Figure:
    return identifiability_figure(identify(run), **how)


def _profile(run: Run, how: dict[str, Any]) -> Figure:
    posterior = run.posterior()
    names = how.pop("names", None) or [n for n in PARAMETERS if n in posterior.free]
    if how["width_mm"] < 120.0 and len(names) > MOST_IN_COLUMN:
        raise InputError(
            f"{len(names)} profiles do not fit one column of a page",
            remedy=f"name up to {MOST_IN_COLUMN} with --parameter, or ask for --width-mm 180",
        )
    return profile_figure(profiles(posterior, names), **how)


_FIGURES = {
    "corner": _corner,
    "bands": _bands,
    "identifiability": _identifiability,
    "mounting": _mounting,
    "trace": _trace,
    "profile": _profile,
}
