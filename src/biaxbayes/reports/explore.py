"""explore.html: a posterior in one's hands, on one page that opens anywhere.

Draws are brushed in any pair of parameters, held near one value of one parameter, or reweighted to
other priors; the curves of those draws stand beside them. Everything on the page is a number of
this package, packed with the draws; what the page computes itself are percentiles and importance
weights (``explore_numbers.js``), and BokehJS, which the bokeh package brings, draws it.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from biaxbayes.errors import InputError
from biaxbayes.figures.labels import round_values
from biaxbayes.figures.quantities import corner_columns
from biaxbayes.figures.run.bands import LOADS, abscissa, residual_unit, shown_protocols
from biaxbayes.figures.run.corner import axis_span
from biaxbayes.figures.style import CREDIBLE, PAGE_MM, colour, print_style
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import FAMILIES, Prior
from biaxbayes.parameters import STRETCH, Quantities, Quantity
from biaxbayes.prediction.bands import DrawnCurves, curves_of_draws, evenly_chosen, tails
from biaxbayes.reports.page import EXPLORE, NAME, page_template
from biaxbayes.reports.parameters import PRIOR_NUMBERS, prior_in_words
from biaxbayes.reports.words import as_html, cut
from biaxbayes.text_files import atomic_write_text

__all__ = [
    "LEAST_EFFECTIVE",
    "can_be_explored",
    "explore_page",
    "thinned_draws",
    "write_explore",
]

LEAST_EFFECTIVE = 200
"""Effective draws (Kish) below which other priors are refused: few draws carry all the weight."""
PROBABILITY = 0.9
"""Content of the bands, as in the report."""
FEWEST, MOST = 500, 1000
"""Draws on the page."""
NUMBERS = 220_000
"""Loads on the page, over draws, protocols, directions and states: 1.2 MB."""
STATES, MOST_STATES = 130, 41
"""States of all protocols together, and of one."""
PANELS_MM = 155.0
"""Width of all panels side by side, for the labels of their axes."""


@dataclass(frozen=True)
class Axis:
    """A quantity with panels of its own.

    Attributes
    ----------
    name : str
        As in ``summary.csv``, without a mounted state.
    symbol, unit, words : str
        As on the other pages; the symbol as HTML.
    ticks : list of (float, str)
        Round values: where on the axis, in percent, and how written.
    """

    name: str
    symbol: Markup
    unit: str
    words: str
    ticks: list[tuple[float, str]]


@dataclass(frozen=True)
class PriorControl:
    """A prior that the page lets one change.

    Attributes
    ----------
    symbol : Markup
        Of the quantities that have it.
    words, stated : str
        What they are, and the prior of the run in words.
    numbers : list of str
        What its two numbers are called.
    """

    symbol: Markup
    words: str
    stated: str
    numbers: list[str]


def can_be_explored(known: Quantities, draws: pd.DataFrame) -> bool:
    """Whether something of a run varies that the page has panels for.

    Parameters
    ----------
    known : Quantities
        What each column of the draws is.
    draws : DataFrame
    """
    return len(corner_columns(draws, known)) > 0


def thinned_draws(posterior: Posterior, draws: pd.DataFrame) -> pd.DataFrame:
    """The draws that the page holds, evenly chosen: as many as its size allows.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        One row a draw, columns as in ``summary.csv``.
    """
    columns = sum(2 * min(p.rows, _most_states(posterior)) for p in _shown(posterior))
    count = int(np.clip(NUMBERS // max(columns, 1), FEWEST, MOST))
    return draws.iloc[evenly_chosen(len(draws), count)].reset_index(drop=True)


def write_explore(folder: Path, posterior: Posterior, draws: pd.DataFrame, state: str) -> Path:
    """Write the page into a run folder, where it points to the report; the path of the page.

    Parameters
    ----------
    folder : Path
    posterior, draws, state
        As in :func:`explore_page`.
    """
    path = folder / EXPLORE
    atomic_write_text(path, explore_page(posterior, draws, state, report=NAME))
    return path


def explore_page(posterior: Posterior, draws: pd.DataFrame, state: str, *, report: str = "") -> str:
    """The page as HTML: its scripts and its data inside, no network.

    Parameters
    ----------
    posterior : Posterior
    draws : DataFrame
        All draws of the run, one row each, columns as in ``summary.csv``.
    state : {"converged", "tentative"}
        Of the run.
    report : str
        The report to point to, where it stands beside the page.

    Raises
    ------
    InputError
        If there is no posterior to explore.
    """
    if state == "unusable" or not can_be_explored(posterior.quantities, draws):
        raise InputError(
            "this run holds no posterior to explore",
            remedy="sample until it converges, with something free",
        )
    few = thinned_draws(posterior, draws)
    axes, axis_data = _axes(posterior, few)
    controls, prior_data = _priors(posterior, few)
    names = list(dict.fromkeys(n for d in (*axis_data, *prior_data) for n in d["columns"]))
    with print_style():
        hues = {"x": colour("x"), "y": colour("y"), "shown": colour("third")}
    specimen = posterior.specimen
    data = {
        "draws": len(few),
        "least": LEAST_EFFECTIVE,
        "levels": [0.5, *tails(PROBABILITY)],
        "values": {n: _packed(few[n].to_numpy(dtype=float), "<f8") for n in names},
        "axes": axis_data,
        "priors": prior_data,
        "hues": hues,
        "opacity": CREDIBLE,
        **_curves(posterior, few),
    }
    library, script = _library(), _script()
    return page_template("explore.html.jinja").render(
        name=cut(specimen.name),
        law=posterior.law.title,
        report=report,
        state=state,
        draws=len(few),
        total=len(draws),
        least=LEAST_EFFECTIVE,
        probability=PROBABILITY,
        axes=axes,
        controls=controls,
        protocols=[cut(p.name, 60) for p in _shown(posterior)],
        all_protocols=len(specimen.protocols),
        directions=[("x", specimen.axis_x), ("y", specimen.axis_y)],
        load=LOADS[specimen.stress_pair].replace("\n", " "),
        hues=hues,
        data=data,
        library=Markup(library),
        script=Markup(script),
        hashes=[_hash(library), _hash(script)],
    )


# --- what stands on the page ---------------------------------------------------------------------


def _shown(posterior: Posterior) -> tuple[Any, ...]:
    """Protocols that have a panel, as many as in the figure of the bands."""
    specimen = posterior.specimen
    return specimen.protocols[: shown_protocols(specimen, PAGE_MM)]


def _most_states(posterior: Posterior) -> int:
    """States of a curve, so that those of all protocols fit the page."""
    return min(MOST_STATES, STATES // len(_shown(posterior)))


def _axes(posterior: Posterior, draws: pd.DataFrame) -> tuple[list[Axis], list[dict[str, Any]]]:
    """Quantities of the corner: what the template and what the script need of each."""
    known: Quantities = posterior.quantities
    shown, data = [], []
    columns = corner_columns(draws, known)
    for name, (text, values) in columns.items():
        states = [q for q in known.of_parameter(name) if q.name in draws]
        parameter = states[0].parameter
        axis = axis_span(text, values)
        width = PANELS_MM / len(columns)
        ticks, labels = round_values(axis.low, axis.high, log=axis.log, length_mm=width)
        places = 100.0 * axis.forward(ticks)
        plain = [t if "$" not in t else f"{v:g}" for v, t in zip(ticks, labels, strict=True)]
        symbol = as_html(Quantity(parameter))
        shown.append(
            Axis(
                name,
                Markup("mean {}").format(symbol) if len(states) > 1 else symbol,
                text.unit,
                parameter.words,
                [(round(float(p), 2), t) for p, t in zip(places, plain, strict=True)],
            )
        )
        data.append(
            {
                "name": name,
                "unit": text.unit,
                "columns": [q.name for q in states],
                "low": axis.low,
                "high": axis.high,
                "log": axis.log,
                "ratio": parameter.logarithmic and bool((values > 0.0).all()),
            }
        )
    return shown, data


def _priors(
    posterior: Posterior, draws: pd.DataFrame
) -> tuple[list[PriorControl], list[dict[str, Any]]]:
    """Priors of what varies; equal ones of mounting stretches are one."""
    groups: dict[tuple[Any, ...], list[Quantity]] = {}
    for name, prior in posterior.priors.items():
        if isinstance(prior, Prior) and name in draws and np.ptp(draws[name]) > 0.0:
            q = posterior.quantities[name]
            mounted = q.parameter.kind == STRETCH
            groups.setdefault((prior, "" if mounted else name), []).append(q)
    controls, data = [], []
    ranked = sorted(groups.items(), key=lambda g: g[1][0].parameter.kind != STRETCH)
    for (prior, _), members in ranked:  # the mounting stretches first: they are what one asks about
        symbols = list(dict.fromkeys(as_html(Quantity(q.parameter)) for q in members))
        words = list(dict.fromkeys(q.parameter.words for q in members))
        first = members[0].parameter
        controls.append(
            PriorControl(
                Markup(", ").join(symbols),
                " and ".join(words),
                prior_in_words(prior.as_table(), members[0].unit),
                [PRIOR_NUMBERS.get(k, k) for k in FAMILIES[prior.family]],
            )
        )
        flat = prior.family in ("uniform", "loguniform")
        data.append(
            {
                "columns": [q.name for q in members],
                "unit": first.unit_symbol(members[0].load_unit),
                "family": prior.family,
                "stated": [prior.low, prior.high] if flat else [prior.location, prior.scale],
            }
        )
    return controls, data


KINDS = ("load", "cauchy")
"""What the curves are: loads as measured, or Cauchy stress."""


def _curves(posterior: Posterior, draws: pd.DataFrame) -> dict[str, Any]:
    """Loads of every draw at measured states, and what makes Cauchy stresses of them."""
    specimen, shown = posterior.specimen, len(_shown(posterior))
    found = curves_of_draws(
        specimen, draws, settings=posterior.settings, max_rows=_most_states(posterior)
    )[:shown]
    cauchy_file = specimen.stress_pair == "cauchy"
    tables: dict[str, list[pd.DataFrame]] = {kind: [] for kind in KINDS}
    protocols, loads = [], []
    for curves in found:
        nominal = curves.stretch if cauchy_file else np.ones_like(curves.stretch)
        # s = l g (f - o); g and o of one draw, the median of all
        g, o = np.median(curves.kPa_per_load, axis=0), np.median(curves.offset, axis=0)
        median = np.median(curves.load, axis=0)
        for kind in KINDS:
            moved = [
                v if kind == "load" else curves.stretch * g * (v / nominal - o)
                for v in (median, curves.measured)
            ]
            tables[kind].append(_table(curves, *moved))
        test = {str(a): part for a, part in tables["load"][-1].groupby("direction")}
        places, label = abscissa(test)
        order = {a: np.argsort(x, kind="stable") for a, x in places.items()}
        loads += [curves.load[:, order[a], k].T.ravel() for k, a in enumerate("xy")]
        protocols.append(
            {
                "name": curves.protocol,
                "label": label,
                "axes": [
                    {
                        "rows": curves.rows[order[a]].tolist(),
                        "place": places[a][order[a]].tolist(),
                        "stretch": curves.stretch[order[a], k].tolist(),
                        "measured": curves.measured[order[a], k].tolist(),
                        "kPa_per_load": _packed(curves.kPa_per_load[:, k], "<f8"),
                        "offset": _packed(curves.offset[:, k], "<f8")
                        if curves.offset.any()
                        else "",
                    }
                    for k, a in enumerate("xy")
                ],
            }
        )
    units = {"load": specimen.unit, "cauchy": "kPa"}
    finer = {kind: residual_unit(pd.concat(tables[kind]), units[kind]) for kind in KINDS}
    return {
        "protocols": protocols,
        "loads": _packed(np.concatenate(loads), "<f4"),
        "cauchyFile": cauchy_file,
        "names": {
            "load": LOADS[specimen.stress_pair].replace("\n", " "),
            "cauchy": LOADS["cauchy"],
        },
        "residuals": {kind: {"factor": f, "unit": unit} for kind, (f, unit) in finer.items()},
    }


def _table(curves: DrawnCurves, median: np.ndarray, measured: np.ndarray) -> pd.DataFrame:
    """Both directions of a protocol, one below the other."""
    columns: Sequence[dict[str, Any]] = [
        {
            "direction": axis,
            "row": curves.rows,
            "stretch": curves.stretch[:, k],
            "measured": measured[:, k],
            "median": median[:, k],
        }
        for k, axis in enumerate("xy")
    ]
    return pd.concat([pd.DataFrame(c) for c in columns], ignore_index=True)


def _packed(values: np.ndarray, kind: str) -> str:
    """Numbers as the bytes of a typed array, in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


# --- the scripts of the page ---------------------------------------------------------------------


@cache
def _library() -> str:
    """BokehJS from the installed package, which is not imported: that takes a second."""
    found = importlib.util.find_spec("bokeh")
    if found is None or found.origin is None:
        raise InputError("the page to explore needs bokeh", remedy="pip install bokeh")
    folder = Path(found.origin).parent / "server" / "static" / "js"
    return _inline("".join(_read(folder / f"{n}.min.js") for n in ("bokeh", "bokeh-api")))


@cache
def _script() -> str:
    """The page's own script: its numbers, then what it shows."""
    here = Path(__file__).parent
    return _inline("".join(_read(here / f"{n}.js") for n in ("explore_numbers", "explore")))


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8").replace("\r\n", "\n") + "\n"


def _inline(text: str) -> str:
    """A script that a page can hold: nothing in it may end the element."""
    if "</script" in text.lower() or "<!--" in text:
        raise InputError(
            "this version of bokeh cannot be put into a page", remedy="install another"
        )
    return f"\n{text}"


def _hash(script: str) -> str:
    """What a Content-Security-Policy knows a script by."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
