"""Figures of predictions, measured: size, fonts, what is drawn where."""

import numpy as np
import pandas as pd
import pytest

from biaxbayes.figures.prediction import inflation_figure, stress_figure
from biaxbayes.prediction.bands import BANDS
from biaxbayes.prediction.stress import BEYOND, INSIDE


def stress_table(x=None, y=None, stress="cauchy") -> pd.DataFrame:
    x = np.linspace(1.0, 1.3, 13) if x is None else np.asarray(x)
    y = x if y is None else np.asarray(y)
    table = pd.DataFrame({"stretch_x": x, "stretch_y": y})
    for axis, scale in (("x", 100.0), ("y", 60.0)):
        middle = scale * (np.linspace(0.0, 0.3, len(x)))
        for band, shift in zip(BANDS, (0, -1, 1, -3, 3), strict=True):
            table[f"{stress}_{axis}_kPa_{band}"] = middle + shift
    table["extrapolation"] = np.where(x > 1.2 + 1e-9, BEYOND, INSIDE)
    return table


def tube_table(by: str) -> pd.DataFrame:
    n = 9
    d, p = np.linspace(20.0, 24.0, n), np.linspace(0.0, 16.0, n)
    table = {"pressure_kPa": p} if by == "pressure" else {"outer_diameter_mm": d}
    name, middle = ("outer_diameter_mm", d) if by == "pressure" else ("pressure_kPa", p)
    for band, shift in zip(BANDS, (0.0, -0.2, 0.2, -0.5, 0.5), strict=True):
        table[f"{name}_{band}"] = middle + shift
    return pd.DataFrame({**table, "extrapolation": [INSIDE] * 4 + [BEYOND] * 5})


def drawn(ax, style):
    return [
        line.get_xydata()
        for line in ax.lines
        if line.get_linestyle() == style and len(line.get_xdata())
    ]


@pytest.mark.parametrize("width", [85.0, 180.0])
def test_print_size_fonts_and_units(width):
    figure = stress_figure(stress_table(), width_mm=width, directions=("circumferential", "axial"))
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(width)
    assert len(figure.axes) == (3 if width < 120 else 4)
    figure.draw_without_rendering()
    box = figure.bbox
    for ax in figure.axes:
        legend = ax.get_legend()
        texts = [ax.xaxis.label, *ax.get_xticklabels(), *(legend.get_texts() if legend else ())]
        assert all(7.0 <= text.get_fontsize() <= 9.0 for text in texts)
        for text in texts:
            extent = text.get_window_extent()
            assert extent.x0 >= box.x0 - 1 and extent.x1 <= box.x1 + 1  # nothing cut off
    assert "kPa" in figure.axes[0].get_ylabel()
    assert "total stretch" in figure.axes[-1].get_xlabel()
    assert "less median" in " ".join(ax.get_ylabel() for ax in figure.axes)


def test_extrapolation_is_dashed_and_the_rest_is_not():
    ax = stress_figure(stress_table()).axes[0]
    solid, dashed = drawn(ax, "-"), drawn(ax, "--")
    assert len(solid) == len(dashed) == 2
    for line in solid:
        assert line[:, 0].max() <= 1.225 + 1e-9  # up to the first state beyond
        assert line[:, 0].min() == 1.0
    for line in dashed:
        assert line[:, 0].min() > 1.2 and line[:, 0].max() == pytest.approx(1.3)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["x", "y", "credible, 90 %", "predictive, 90 %", "not tested"]


def test_a_path_that_turns_back_is_drawn_by_its_rows():
    there_and_back = [1.0, 1.1, 1.2, 1.1, 1.0]
    ax = stress_figure(stress_table(there_and_back), reference="measured").axes[-1]
    assert "row" in ax.get_xlabel()
    ax = stress_figure(stress_table([1.0, 1.05, 1.1], [1.0, 1.1, 1.2]), reference="measured").axes[
        -1
    ]
    assert ax.get_xlabel() == "measured stretch in y"


def test_bands_are_seen_below_and_readings_stand_on_the_path():
    table = stress_table()
    at = np.array([1.05, 1.1, 1.2])
    read = pd.DataFrame({"stretch_x": at, "stretch_y": at})
    for k, axis in enumerate("xy"):
        read[f"cauchy_{axis}_kPa"] = 10.0 * (1 + k) * at
        read[f"cauchy_{axis}_kPa_residual"] = [0.5, -0.5, 1.0 + k]
    for width, strips in ((85.0, (1, 2)), (180.0, (2, 3))):
        figure = stress_figure(table, measured=read, width_mm=width)
        for k, strip in enumerate(strips):
            ends = [p.get_extents() for c in figure.axes[strip].collections for p in c.get_paths()]
            tall = [e.height for e in ends]
            assert tall == pytest.approx([6.0, 2.0])  # predictive and credible band
            low, high = figure.axes[strip].get_ylim()
            assert min(tall) > 0.2 * (high - low)
            points = [ln for ln in figure.axes[strip].lines if ln.get_linestyle() == "None"]
            np.testing.assert_allclose(points[0].get_xdata(), at)
            np.testing.assert_allclose(points[0].get_ydata(), [0.5, -0.5, 1.0 + k])
        labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
        assert "measured" in labels


@pytest.mark.parametrize("by", ["pressure", "diameter"])
def test_inflation_has_both_units_of_pressure_and_bands_that_are_seen(by):
    figure = inflation_figure(tube_table(by))
    ax, strip = figure.axes
    figure.draw_without_rendering()
    low, high = ax.get_ylim()
    (right,) = (ax if by == "diameter" else strip).child_axes
    assert right.get_ylabel() == "pressure (mmHg)"
    assert right.get_ylim() == pytest.approx((low * 7.500617, high * 7.500617))
    (solid,), (dashed,) = drawn(ax, "-"), drawn(ax, "--")
    assert solid[0] == pytest.approx([20.0, 0.0]) and dashed[-1] == pytest.approx([24.0, 16.0])
    ends = [p.get_extents() for c in strip.collections for p in c.get_paths()]
    wide = [e.height if by == "diameter" else e.width for e in ends]
    assert wide == pytest.approx([1.0, 0.4])  # predictive and credible band
    low, high = strip.get_ylim() if by == "diameter" else strip.get_xlim()
    assert min(wide) > 0.2 * (high - low)
