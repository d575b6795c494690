"""Which parameters the data determine, at a glance: prior, posterior and verdict, row by row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from biaxbayes.figures.quantities import axis_text
from biaxbayes.figures.style import MM, PAGE_MM, blank_figure, print_style
from biaxbayes.identifiability.identify import Identifiability, ParameterVerdict
from biaxbayes.identifiability.verdict_names import (
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
    ONE_SIDED,
    PRIOR,
)
from biaxbayes.model.priors import Prior
from biaxbayes.parameters import Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito, from known to unknown; the word stands in the box, colour is only an aid.
VERDICT_COLOURS = {
    IDENTIFIED: "#009E73",
    ONE_SIDED: "#56B4E9",
    COMBINATION: "#E69F00",
    PRIOR: "#D55E00",
    NOT_IDENTIFIED: "#CC79A7",
    NO_VERDICT: "#999999",
    FIXED: "#DDDDDD",
}
HEAD_MM, FOOT_MM = 7.0, 2.0
SMALL = 7.0  # points
PRIOR_GREY, POSTERIOR = "0.82", "#0072B2"
MOST_ROWS = 16


@dataclass(frozen=True)
class _Columns:
    """Where the parts of a row stand, mm."""

    row: float
    densities: tuple[float, float]
    contraction: tuple[float, float] | None
    verdict: float
    aside: float
    stacked: bool

    @classmethod
    def of(cls, width_mm: float) -> _Columns:
        """One line a row on a page; in one column the words stand below the verdict."""
        if width_mm < 120.0:
            return cls(15.0, (17.0, 0.53 * width_mm), None, 0.6 * width_mm, 0.6 * width_mm, True)
        left, bar, words = 24.0, 0.43 * width_mm, 0.58 * width_mm
        return cls(11.5, (left, bar - 6.0), (bar, words - 13.0), words, words + 33.0, False)


def identifiability_figure(
    found: Identifiability,
    *,
    width_mm: float = PAGE_MM,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Prior and posterior of every parameter, how much the data tell, and the verdict.

    Parameters
    ----------
    found : Identifiability
    width_mm : float
    style : mapping, optional
        From :func:`biaxbayes.figures.style.read_style`.

    Returns
    -------
    matplotlib.figure.Figure
        The first 16 parameters.
    """
    rows = found.parameters[:MOST_ROWS]
    columns = _Columns.of(width_mm)
    known = {p.name: p.scale.quantity for p in found.parameters}
    with print_style(style):
        height = HEAD_MM + columns.row * len(rows) + FOOT_MM
        figure = blank_figure(width_mm * MM, height * MM)
        _heads(figure, columns)
        for i, row in enumerate(rows):
            bottom = height - HEAD_MM - columns.row * (i + 1)
            _row(figure, row, columns, bottom, known)
    return figure


def _text(figure: Figure, x: float, y: float, text: str, **how: Any) -> None:
    """Text with its left end at a place in mm."""
    width, height = (side / MM for side in figure.get_size_inches())
    drawn: dict[str, Any] = {"va": "center", "ha": "left", "fontsize": SMALL}
    figure.text(x / width, y / height, text, **(drawn | how))


def _axes(figure: Figure, left: float, right: float, bottom: float, tall: float) -> Axes:
    width, height = (side / MM for side in figure.get_size_inches())
    return figure.add_axes((left / width, bottom / height, (right - left) / width, tall / height))


def _heads(figure: Figure, columns: _Columns) -> None:
    y = figure.get_size_inches()[1] / MM - 0.45 * HEAD_MM
    short = columns.stacked
    heads: dict[float, str] = {
        1.0: "" if short else "parameter",
        columns.densities[0]: "prior, posterior" if short else "prior (grey), posterior (blue)",
        columns.verdict: "verdict, 90 %" if short else "verdict, 90 % interval",
    }
    if columns.contraction is not None:
        heads[columns.contraction[0]] = "contraction"
    for x, text in heads.items():
        _text(figure, x, y, text, color="0.35")


def _row(
    figure: Figure,
    row: ParameterVerdict,
    columns: _Columns,
    bottom: float,
    known: Mapping[str, Quantity],
) -> None:
    tall = columns.row
    middle = bottom + 0.55 * tall
    _text(figure, 1.0, middle, axis_text(row.scale.quantity).label, fontsize=8.0)
    if row.evidence is not None:
        _densities(
            _axes(figure, *columns.densities, bottom + 0.36 * tall, 0.58 * tall), row, columns
        )
        if columns.contraction is not None:
            _contraction(figure, columns.contraction, bottom, tall, row.evidence.contraction)
    colour = VERDICT_COLOURS[row.verdict]
    dark = row.verdict in (IDENTIFIED, PRIOR, NO_VERDICT)
    _text(
        figure,
        columns.verdict + 1.0,
        bottom + 0.8 * tall if columns.stacked else middle,
        row.verdict,
        color="white" if dark else "black",
        bbox={"boxstyle": "round,pad=0.3", "facecolor": colour, "edgecolor": "none"},
    )
    aside = bottom + 0.38 * tall if columns.stacked else middle
    _text(figure, columns.aside, aside, _aside(row, known, short=columns.stacked))


def _densities(ax: Axes, row: ParameterVerdict, columns: _Columns) -> None:
    assert row.prior and row.posterior and isinstance(row.scale.prior, Prior)
    low, high = _range(row)
    for density, face, line in ((row.prior, PRIOR_GREY, "0.6"), (row.posterior, POSTERIOR, None)):
        height = density.height / density.peak
        ax.fill_between(density.x, height, color=face, alpha=1.0 if line else 0.75, linewidth=0.0)
        ax.plot(density.x, height, color=line or face, linewidth=0.5)
    ax.set_xlim(low, high)
    ax.set_ylim(0.0, 1.08)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ticks = _ticks(row, low, high, 3 if columns.stacked else 5)
    ax.set_xticks([t for t, _ in ticks], [text for _, text in ticks], fontsize=SMALL)
    ax.tick_params(axis="x", length=2.0, pad=1.0)


def _range(row: ParameterVerdict) -> tuple[float, float]:
    """The prior's middle 98 %, widened to hold the posterior."""
    prior, posterior = row.scale.prior, row.posterior
    assert isinstance(prior, Prior) and posterior is not None
    ends = row.scale.of(prior.ppf(np.array([0.01, 0.99])))
    walls = row.scale.walls
    if np.isfinite(walls[1]):
        low, high = (float(v) for v in row.scale.of(np.array(walls)))
        if np.isfinite(low):
            return low, high
    return min(float(ends[0]), posterior.x[0]), max(float(ends[1]), posterior.x[-1])


def _ticks(row: ParameterVerdict, low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Round natural values within the range, few enough to read."""
    if row.scale.logarithmic:
        powers = range(int(np.ceil(low / np.log(10.0))), int(np.floor(high / np.log(10.0))) + 1)
        step = -(-len(powers) // most)
        return [(p * np.log(10.0), f"{10.0**p:g}") for p in powers[::step]]
    if row.scale.parameter.bounded:
        parts = [row.scale.parameter.high * share for share in TICK_SHARES[row.scale.unit]]
        return [(v, _fraction(v)) for v in parts if low <= v <= high]
    from matplotlib.ticker import MaxNLocator

    return [(float(v), f"{v:g}") for v in MaxNLocator(3).tick_values(low, high) if low <= v <= high]


TICK_SHARES = {"deg": (0.0, 1 / 3, 2 / 3, 1.0), "": (0.0, 0.5, 1.0)}
"""Where the range of an angle or a share is marked."""


def _fraction(value: float) -> str:
    """A sixth or a third as such."""
    found = Fraction(value).limit_denominator(6)
    exact = abs(found - value) < 1e-9 and found.denominator > 1
    return str(found) if exact else f"{value:g}"


def _contraction(
    figure: Figure, ends: tuple[float, float], bottom: float, tall: float, contraction: float
) -> None:
    """A bar of the share that the data took from the prior; an axes would take longer than all."""
    from matplotlib.patches import Rectangle

    width, height = (side / MM for side in figure.get_size_inches())
    (left, right), low, high = ends, bottom + 0.46 * tall, bottom + 0.66 * tall
    share = max(contraction, 0.0)
    for part, grey in ((1.0, "0.92"), (share, "0.35")):
        place = (left / width, low / height)
        size = (part * (right - left) / width, (high - low) / height)
        figure.add_artist(Rectangle(place, *size, facecolor=grey, linewidth=0.0))
    text = f"{100.0 * min(share, 0.999):.1f} %" if share > 0.99 else f"{100.0 * share:.0f} %"
    _text(figure, left + 1.06 * (right - left), 0.5 * (low + high), text)


def _aside(row: ParameterVerdict, known: Mapping[str, Quantity], *, short: bool) -> str:
    """What stands beside the verdict: the number a reader wants, or the partners."""
    e = row.evidence
    if e is None or row.verdict == NO_VERDICT:
        return "" if e is None else "the chains have not converged"
    p = row.scale.parameter
    unit = p.unit_symbol()
    unit = f" {unit}" if unit.isalpha() else unit
    interval = f"{p.number(e.low)} to {p.number(e.high)}{unit}"
    if row.stated is not None:
        # what a refit or a verdict says of the law is not said of the tissue
        head = "law:" if short else "within the law"
        return f"{head} {interval}\ntissue: {row.stated.in_words(p)}"
    if row.verdict == COMBINATION:
        names = ", ".join(axis_text(known[name]).symbol for name in row.partners)
        return f"with {names}\n(alone {interval})"
    if row.verdict == NOT_IDENTIFIED and e.refits:
        low, high = (p.number(v) for v in e.refits)
        return f"refits {low} to {high}\n(model {interval})"
    if row.verdict == ONE_SIDED:
        low_open = e.edges[0].support >= e.edges[-1].support
        value = p.number(e.high if low_open else e.low)
        return f"{'below' if low_open else 'above'} {value}{unit} (95 %)"
    return interval
