"""The posterior of a run to explore: draws in a box, their curves, and other priors.

In the address, ``low C1`` and ``high C1`` are the ends of a range, ``prior C1 sd_log`` is a number
of another prior; draws are weighted by the ratio of the densities of the priors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from bokeh.embed import json_item
from bokeh.layouts import gridplot
from bokeh.models import BoxSelectTool, Range1d

from biaxbayes.app.figures import GREY, empty_panel
from biaxbayes.app.server import Page
from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.figures.bands import bands_figure
from biaxbayes.figures.quantities import axis_span, corner_columns
from biaxbayes.figures.style import colour, figure_bytes, print_style
from biaxbayes.model.priors import FAMILIES, PRIOR_NUMBERS, Prior
from biaxbayes.options import CONTENT
from biaxbayes.parameters import unit_text
from biaxbayes.prediction.percentiles import tails
from biaxbayes.report_table import interval_texts
from biaxbayes.reports.page import Picture, embedded
from biaxbayes.runs.run import Run
from biaxbayes.verbs.inputs import usable_run

MAX_DRAWS = 1500
"""Draws on the page."""
LEAST_EFFECTIVE = 200
"""Effective draws (Kish) below which another prior is refused."""
BINS = 24
PANEL = 112
LEVELS = (0.5, *tails(CONTENT))


@dataclass(frozen=True)
class Explored:
    """Draws of a run, with the answers of the page."""

    run: Run
    answers: dict[str, str]

    @cached_property
    def draws(self) -> pd.DataFrame:
        """The draws on the page, evenly chosen."""
        draws = self.run.draws
        return draws.iloc[evenly_chosen(len(draws), MAX_DRAWS)].reset_index(drop=True)

    @cached_property
    def columns(self) -> dict[str, tuple[Any, np.ndarray]]:
        """Text and values of each axis by the name of the parameter."""
        columns = corner_columns(self.draws, self.run.quantities)
        if not columns:
            raise InputError("this run has no posterior to explore", file=self.run.path)
        return columns

    def number(self, name: str, default: float) -> float:
        """A number of the address."""
        try:
            return float(str(self.answers.get(name, default)).replace(",", "."))
        except ValueError:
            raise InputError(f"{name!r} must be a number") from None

    @cached_property
    def inside(self) -> np.ndarray:
        """Draws in all ranges, (draws,)."""
        inside = np.ones(len(self.draws), dtype=bool)
        for name, (_, values) in self.columns.items():
            inside &= values >= self.number(f"low {name}", -np.inf)
            inside &= values <= self.number(f"high {name}", np.inf)
        return inside

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """Priors that can be changed, by the name of the quantity."""
        return {
            name: prior
            for name, prior in self.run.posterior().priors.items()
            if isinstance(prior, Prior) and name in self.draws and np.ptp(self.draws[name]) > 0.0
        }

    @cached_property
    def prior_weights(self) -> np.ndarray:
        """Ratio of the other priors to those of the run, (draws,), the largest one."""
        log = np.zeros(len(self.draws))
        for name, prior in self.priors.items():
            values = {k: self.number(f"prior {name} {k}", v) for k, v in prior_numbers(prior)}
            if list(values.items()) == prior_numbers(prior):
                continue
            try:
                other = Prior.from_numbers(prior.family, *values.values())
            except ValueError as error:
                raise InputError(f"prior of {name}: {error}") from None
            x = self.draws[name].to_numpy()
            log += other.log_density(x) - prior.log_density(x)
            log[(x < other.low) | (x > other.high)] = -np.inf
        return np.exp(log - log.max()) if np.isfinite(log.max()) else np.zeros(len(log))

    @cached_property
    def effective(self) -> float:
        """Effective number of draws with the other priors: (sum w)^2 / sum w^2 (Kish)."""
        w = self.prior_weights
        return float(w.sum() ** 2 / (w @ w)) if w.any() else 0.0

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights of the draws that are shown, (draws,)."""
        enough = self.effective >= LEAST_EFFECTIVE
        prior = self.prior_weights if enough else np.ones(len(self.draws))
        chosen = prior * self.inside
        return chosen if chosen.any() else prior

    def table(self) -> list[tuple[str, str, str, str, str]]:
        """Name, unit, all draws, those that are shown, and the shift of the median in sd."""
        rows = []
        everything = corner_columns(self.run.draws, self.run.quantities)
        for name, (text, values) in self.columns.items():
            before = np.quantile(everything[name][1], LEVELS)
            now = np.quantile(values, LEVELS, weights=self.weights, method="inverted_cdf")
            log = np.log if text.parameter.logarithmic and (values > 0.0).all() else np.asarray
            shift = (log(now[0]) - log(before[0])) / np.std(log(values))
            texts = (interval_texts(q[0], q[1], q[2], text.parameter) for q in (before, now))
            shown = (f"{median} ({low} to {high})" for median, low, high in texts)
            rows.append((name, text.unit, *shown, f"{round(shift, 1) + 0.0:+.1f}"))
        return rows

    def corner(self) -> Any:
        """Pairs and histograms; a box in a pair gives the ranges of its parameters."""
        spans = {name: axis_span(text, values) for name, (text, values) in self.columns.items()}
        ranges = {name: Range1d(span.low, span.high) for name, span in spans.items()}
        kinds: Any = {name: "log" if span.log else "linear" for name, span in spans.items()}
        names, shown = list(spans), self.weights > 0.0
        grid: list[list[Any]] = [[None] * len(names) for _ in names]
        with print_style():
            hue = colour(2)
        for i, j in np.argwhere(np.tri(len(names))).tolist():
            x, y = names[j], names[i]
            look = {"width": PANEL + 55 * (j == 0), "height": PANEL + 60 * (i == len(names) - 1),
                    "x_range": ranges[x], "x_axis_type": kinds[x], "min_border": 6}  # fmt: skip
            if i == j:
                panel = empty_panel(**look, tools=[])
                edges = spans[x].back(np.linspace(0.0, 1.0, BINS + 1))
                for weights, bar in (
                    (self.weights / self.weights.sum(), {"color": hue}),
                    (np.full(len(shown), 1.0 / len(shown)), {"fill_alpha": 0, "line_color": GREY}),
                ):
                    top = np.histogram(self.columns[x][1], edges, weights=weights)[0]
                    panel.quad(left=edges[:-1], right=edges[1:], bottom=0, top=top, **bar)
            else:
                look |= {"y_range": ranges[y], "y_axis_type": kinds[y], "name": f"{x} {y}"}
                panel = empty_panel(**look, tools=[BoxSelectTool()])
                for of, hue_of in ((~shown, GREY), (shown, hue)):
                    at = [self.columns[n][1][of] for n in (x, y)]
                    panel.scatter(*at, size=3, color=hue_of, alpha=0.5)
            panel.xaxis.visible, panel.yaxis.visible = i == len(names) - 1, j == 0 and i > 0
            for axis, name in ((panel.xaxis, x), (panel.yaxis, y)):
                unit = self.columns[name][0].unit
                axis.axis_label = name.replace("_stretch", "\nstretch") + f" ({unit})" * bool(unit)
            panel.xaxis.major_label_orientation = 0.8
            panel.axis.major_label_text_font_size = panel.axis.axis_label_text_font_size = "10px"
            panel.xaxis.ticker.desired_num_ticks = panel.yaxis.ticker.desired_num_ticks = 3
            grid[i][j] = panel
        return json_item(gridplot(grid, toolbar_location=None))

    def curves(self) -> list[Picture]:
        """Bands of these draws over the readings, of each piece."""
        posterior, share = self.run.posterior(), self.weights / self.weights.sum()
        rows = np.random.default_rng(1).choice(np.arange(len(self.draws)), MAX_DRAWS, p=share)
        drawn = self.draws.iloc[rows].reset_index(drop=True)
        figures = (bands_figure(posterior, drawn, piece=i) for i in range(len(posterior.pieces)))
        return [embedded(figure_bytes(figure, "png")) for figure in figures]


def prior_numbers(prior: Prior) -> list[tuple[str, float]]:
    """The two numbers of a prior by their keys."""
    table: dict[str, Any] = prior.as_table()
    return [(key, table[key]) for key in FAMILIES[prior.family]]


async def explore(page: Page) -> None:
    """Show the draws of a run."""
    (path,) = page.files("name")
    answers = {name: page.get_argument(name) for name in page.request.arguments}
    answers = {name: text for name, text in answers.items() if text and name != "name"}

    def explored() -> dict[str, Any]:
        found = Explored(usable_run(path), answers)
        priors = []
        for name, prior in found.priors.items():
            unit = unit_text(found.run.quantities[name].unit)
            for key, value in prior_numbers(prior):
                words = PRIOR_NUMBERS.get(key, key)
                words += f" ({unit})" * bool(unit and not key.endswith("_log"))
                priors.append((name, key, words, value))
        return {
            "run": found, "table": found.table(), "corner": found.corner(),
            "curves": found.curves(), "priors": priors, "least": LEAST_EFFECTIVE,
        }  # fmt: skip

    shown = await page.off_loop(explored)
    page.show("explore.html.jinja", name=page.get_argument("name"), answers=answers, **shown)
