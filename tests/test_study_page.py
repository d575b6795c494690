"""The page and figure of a study: many specimens, hostile names, any width, accessible."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from biaxbayes.figures.study import study_figure
from biaxbayes.reports.study_page import write_study
from biaxbayes.studies.result import COLUMNS, StudyResult, donor_groups

LAYERS = ("intima", "media", "<b>adventitia</b>")
QUANTITIES = {
    "C1": ("kPa", 10.0, "log"),
    "k1": ("kPa", 50.0, "log"),
    "k2": ("1", 12.0, "log"),
    "alpha": ("deg", 40.0, "linear"),
    "kappa": ("1", 0.15, "linear"),
    "mounting_stretch_x": ("1", 1.02, "linear"),
    "noise_sd": ("N", 0.002, "log"),
    "Hx": ("1", 0.4, "linear"),
    "stiffness_x at 1": ("kPa", 60.0, "log"),
}
VERDICTS = ("identified", "only in combination", "bounded", "not identified", "fixed")


def table(count: int) -> pd.DataFrame:
    rng = np.random.default_rng(3)
    rows = []
    for n in range(count):
        head = {
            "specimen": f"<img src=x onerror=alert(1)> {n}" if n == 1 else f"specimen {n}",
            "donor": f"D{n // 3} $x_1$ \N{RIGHT-TO-LEFT OVERRIDE}",
            "layer": LAYERS[n % 3],
            "file": f"s{n}.csv",
            "folder": f"runs/s{n}",
            "state": "tentative" if n == 4 else "converged",
            "reason": "",
        }
        if n == 2:
            failed = {"state": "failed", "reason": "s2.csv: is no table & <worse>"}
            rows.append(head | failed | {"kind": "parameter", "quantity": "C1"})
            continue
        for k, (name, (unit, middle, scale)) in enumerate(QUANTITIES.items()):
            low, median, high = np.sort(middle * np.exp(rng.normal(0.0, 0.2, 3)))
            curve = name in ("Hx", "stiffness_x at 1")
            verdict = "" if name == "noise_sd" else VERDICTS[(n + k) % len(VERDICTS)]
            rows.append(
                head
                | {"kind": "curve" if curve else "parameter", "quantity": name, "unit": unit}
                | {"verdict": "identified" if curve else verdict, "scale": scale}
                | {"q05": low, "q50": median, "q95": high, "scale_sd": 0.1}
            )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def distances(count: int) -> pd.DataFrame:
    rows = []
    for donor in range(count // 3):
        for quantity, kind in (("C1", "parameter"), ("Hx", "structure tensor")):
            rows.append(
                {"donor": f"D{donor}", "layer_a": LAYERS[0], "layer_b": LAYERS[2], "kind": kind}
                | {"quantity": quantity, "unit": "kPa", "total_stretch": np.nan}
                | {"difference_q05": 1.0, "difference_q50": 2.0 + donor, "difference_q95": 9.0}
                | {"identified_in_both": donor != 1}
            )
    return pd.DataFrame(rows)


@pytest.fixture(scope="module", params=[9, 40])
def result(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    found = StudyResult(
        "Study <script>document.title='broken'</script>",
        folder,
        table(request.param),
        distances(request.param),
        ["D1: different priors of kappa: <i>fixed</i>"],
    )
    write_study(found)
    return found


def test_donors_with_several_layers_are_groups():
    groups = donor_groups(table(9))
    assert [len(labels) for _, labels, _ in groups] == [2, 3, 3]
    alone = table(9).assign(donor="")
    assert donor_groups(alone) == []  # too many to compare all with all
    few = table(6).assign(donor="")
    [(donor, labels, _)] = donor_groups(few)
    assert donor == "" and len(labels) == 5


@pytest.mark.long
def test_the_figure_fits_a_page_and_nothing_overlaps(result):
    figure = study_figure(result.table)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    width, height = figure.get_size_inches() * 25.4
    assert width == pytest.approx(180.0) and height < 260.0
    renderer = canvas.get_renderer()
    page = figure.bbox
    for axes in figure.axes:
        box = axes.get_tightbbox(renderer)
        assert box.x0 >= -1 and box.x1 <= page.x1 + 1 and box.y0 >= -1 and box.y1 <= page.y1 + 1
        labels = [t.get_window_extent(renderer) for t in axes.get_yticklabels() if t.get_text()]
        for above, below in pairwise(labels):
            assert not above.overlaps(below) or abs(above.y0 - below.y0) > 0.6 * above.height


def test_the_page_counts_what_is_reliable(result):
    page = (result.folder / "study.html").read_text(encoding="utf-8")
    total = len(result.specimens)
    assert f"{total - 2} of {total} specimens have converged" in page
    assert "is no table &amp; &lt;worse&gt;" in page
    assert "<script" not in page and "<img src=x" not in page
    assert len(page) < 5_000_000
