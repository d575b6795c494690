"""What makes figures quick to draw changes neither how they look nor the bytes of their files."""

import numpy as np
import pandas as pd
import pytest

from biaxbayes.figures import style
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
