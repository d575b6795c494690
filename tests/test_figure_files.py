"""Labels and marks of figures are where matplotlib puts them, and files depend on nothing else."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from biaxbayes.figures import style
from biaxbayes.figures.labels import few_ticks
from biaxbayes.figures.run import corner
from biaxbayes.figures.run.trace import trace_figure
from biaxbayes.figures.style import figure_bytes

RANDOM = np.random.default_rng(3)
DRAWS = pd.DataFrame(
    {
        "C1": RANDOM.gamma(9.0, 0.3, 2000),
        "k1": RANDOM.lognormal(2.0, 1.5, 2000),
        "mounting_stretch_x": RANDOM.normal(1.004, 0.003, 2000),
    }
)
CHAINS = {name: DRAWS[name].to_numpy().reshape(2, 100, 10) for name in DRAWS}


@pytest.mark.parametrize("width", [180.0, 85.0])
def test_labels_are_kept_where_matplotlib_puts_them(monkeypatch, width):
    figures = [corner.corner_figure(DRAWS, width_mm=width), trace_figure(CHAINS, width_mm=width)]
    kept = [figure_bytes(figure, "png") for figure in figures]

    def align(figure, *rows):
        for row in rows:
            panels = [axis.axes for axis in row]
            (figure.align_xlabels if row[0].axis_name == "x" else figure.align_ylabels)(panels)

    monkeypatch.setattr(style, "keep_labels", align)
    monkeypatch.setattr(corner, "keep_labels", align)
    figures = [corner.corner_figure(DRAWS, width_mm=width), trace_figure(CHAINS, width_mm=width)]
    assert [figure_bytes(figure, "png") for figure in figures] == kept


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"axes.grid": True, "xtick.direction": "in", "ytick.color": "red", "ytick.major.size": 5.0},
        {"xtick.top": True, "ytick.left": False, "axes.axisbelow": False},
    ],
)
def test_marks_of_panels_within_are_ticks(monkeypatch, settings):
    with_marks = figure_bytes(corner.corner_figure(DRAWS, style=settings), "png", settings)

    def ticks(axis, labelled):
        few_ticks(axis, overhang=0.3)
        axis.set_tick_params(labelleft=False, labelbottom=False)

    monkeypatch.setattr(corner, "repeat_ticks", ticks)
    figure = corner.corner_figure(DRAWS, style=settings)
    assert figure_bytes(figure, "png", settings) == with_marks


SMALL = """
import hashlib
from biaxbayes.figures.style import blank_figure, figure_bytes, print_style

def drawn(text):
    with print_style():
        figure = blank_figure(2.0, 1.0)
        figure.text(0.1, 0.5, text)
    return [hashlib.sha256(figure_bytes(figure, kind)).hexdigest() for kind in ("pdf", "png")]
"""


def test_a_file_does_not_tell_what_was_drawn_before_it():
    here: dict = {}
    exec(SMALL, here)
    texts = [r"$\kappa$ of the media, identified", r"$C_1$, $\kappa$ and \N{SNOWMAN} ∑", "x (kPa)"]
    for text in texts:
        here["drawn"](text)
    again = [here["drawn"](text) for text in reversed(texts)]
    for text, files in zip(reversed(texts), again, strict=True):
        code = f"{SMALL}\nprint(*drawn({text!r}))"
        fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
        assert fresh.stdout.decode().split() == files
