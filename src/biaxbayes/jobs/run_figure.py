"""The figures of a run, by name, and the known values drawn beside them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.figures.run.bands import bands_figure
from biaxbayes.figures.run.corner import corner_figure
from biaxbayes.figures.run.identifiability import identifiability_figure
from biaxbayes.figures.run.mounting import mounting_figure
from biaxbayes.figures.run.profile import profile_figure
from biaxbayes.figures.run.trace import trace_figure
from biaxbayes.identifiability.identify import identify
from biaxbayes.identifiability.profile import profiles
from biaxbayes.laws import all_parameters
from biaxbayes.parameters import mounting_names
from biaxbayes.runs.run import Run
from biaxbayes.text_files import read_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["read_truth", "run_figure"]


# --- known values of a virtual specimen, read to be drawn beside what was inferred ---------------


MOUNTING = (*mounting_names("stretch"), *mounting_names("force"))


def read_truth(path: Path | str, specimen: str) -> dict[str, float]:
    """Known values by the names of ``summary.csv``.

    Parameters
    ----------
    path : path-like
        JSON: what :func:`biaxbayes.specimens.virtual_specimen.write_truth` writes, an entry of it,
        or one flat object such as ``{"C1": 2.98, "kappa": 0.0}``.
    specimen : str
        Name of the specimen whose entry is wanted, where there are several.

    Returns
    -------
    dict of str to float

    Raises
    ------
    InputError
        If the file cannot be read or has no such entry.
    """
    path = Path(path)
    text = read_text(path)
    try:
        held = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON ({error})", file=path) from None
    if not isinstance(held, dict) or not held:
        raise InputError("is no JSON object of known values", file=path, remedy=_REMEDY)
    if "material" not in held and all(isinstance(v, dict) for v in held.values()):
        if specimen not in held:
            raise InputError(f"has no entry for specimen {specimen!r}", file=path)
        held = held[specimen]
    if isinstance(held.get("material"), dict):
        material = held["material"]
        stated = {p.name: p.label for p in all_parameters()}
        found = {name: material[key] for name, key in stated.items() if key in material}
        found |= {name: held[name] for name in MOUNTING if name in held}
    else:
        found = held
    return {str(name): _number(value, str(name), path) for name, value in found.items()}


_REMEDY = 'write values by the names of summary.csv, such as {"C1": 2.98, "kappa": 0.0}'


def _number(value: Any, name: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{name[:60]} is not a finite number", file=path, remedy=_REMEDY)
    return float(value)


# --- the figures of a run, by name ---------------------------------------------------------------


MOST_IN_COLUMN = 3


def run_figure(run: Run, kind: str, **how: Any) -> Figure:
    """Draw a figure of a run.

    Parameters
    ----------
    run : Run
    kind : {"corner", "bands", "identifiability", "mounting", "trace", "profile"}
    **how
        Of the figure: ``width_mm`` and ``style`` of all, ``truth``, ``compare``, ``names`` and
        ``parameters`` where the figure takes them.

    Raises
    ------
    InputError
        If there is no such figure.
    """
    if kind not in _FIGURES:
        raise InputError(f"no figure {kind[:40]!r}", remedy=f"choose {', '.join(_FIGURES)}")
    return _FIGURES[kind](run, {"width_mm": 180.0, "style": None, **how})


def _corner(run: Run, how: dict[str, Any]) -> Figure:
    return corner_figure(run.draws, known=run.quantities, **how)


def _bands(run: Run, how: dict[str, Any]) -> Figure:
    return bands_figure(run.specimen, run.draws, settings=run.posterior().settings, **how)


def _mounting(run: Run, how: dict[str, Any]) -> Figure:
    return mounting_figure(run.specimen, run.draws, **how)


def _trace(run: Run, how: dict[str, Any]) -> Figure:
    summary = run.summary
    rhat = dict(zip(summary["parameter"], summary["rhat"], strict=True))
    return trace_figure(run.chains, unit=run.specimen.unit, rhat=rhat, known=run.quantities, **how)


def _identifiability(run: Run, how: dict[str, Any]) -> Figure:
    return identifiability_figure(identify(run), **how)


def _profile(run: Run, how: dict[str, Any]) -> Figure:
    posterior = run.posterior()
    names = how.pop("names", None) or [n for n in posterior.law.names if n in posterior.free]
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
