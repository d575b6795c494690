"""explore.html in a real browser: brushed, selected by a slider, reweighted."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

import browser
import reported
from biaxbayes.prediction.bands import bands
from biaxbayes.reports.explore import LEAST_EFFECTIVE, thinned_draws

pytestmark = pytest.mark.skipif(not browser.CHROMIUM, reason="no Chromium here")

MEDIANS = "explore.curves.map(c => [[...c.data.median], [...c.data.low], [...c.data.high]])"


def shown_page(run, folder: Path):
    page = browser.Page(folder)
    page.resize(1280, 1400)
    page.open(run.path / "explore.html")
    try:
        for _ in range(300):
            if page.evaluate("Boolean(window.explore?.ready)"):
                break
            time.sleep(0.1)
        yield page
    finally:
        page.close()
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def media(media_run, tmp_path_factory):
    yield from shown_page(media_run, tmp_path_factory.mktemp("media"))


@pytest.fixture(scope="module")
def hostile(hostile_run, tmp_path_factory):
    yield from shown_page(hostile_run, tmp_path_factory.mktemp("hostile"))


@pytest.fixture(autouse=True)
def everything_shown_again(request):
    """Each test begins with all draws and the priors of the run."""
    yield
    for name in {"media", "hostile"} & set(request.fixturenames):
        request.getfixturevalue(name).evaluate(
            "document.getElementById('clear').click();document.getElementById('reset').click(); 1"
        )


def move(page, slider: str, value: int) -> None:
    page.evaluate(
        f"(() => {{ const s = document.getElementById('{slider}'); s.value = {value};"
        "s.dispatchEvent(new Event('input')); })()"
    )


def text(page, name: str) -> str:
    return page.evaluate(f"document.getElementById('{name}').textContent")


def selected(page) -> list[int]:
    return page.evaluate("[...explore.draws.selected.indices]")


def drag_first_pair(page) -> None:
    """Drag a box over the middle of the first pair of the corner, which is 105 pixels wide."""
    top, right, bottom = page.evaluate(
        """(() => { let boxes = [];
        const walk = root => { for (const e of root.querySelectorAll('*')) {
          if (e.matches('.bk-Figure')) boxes.push(e.getBoundingClientRect());
          if (e.shadowRoot) walk(e.shadowRoot); } };
        walk(document.querySelector('.plots')); const b = boxes[1];
        return [b.top, b.right, b.bottom]; })()"""
    )
    first = (right - 100.0, top + 8.0)
    last = (right - 45.0, bottom - 8.0)
    middle = (0.5 * (first[0] + last[0]), 0.5 * (first[1] + last[1]))
    steps = (("mouseMoved", 0, first), ("mousePressed", 1, first), ("mouseMoved", 1, middle),
             ("mouseMoved", 1, last), ("mouseReleased", 0, last))  # fmt: skip
    for kind, buttons, (x, y) in steps:
        button = "none" if kind == "mouseMoved" and not buttons else "left"
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons,
                  clickCount=1)  # fmt: skip
        time.sleep(0.1)


def test_a_box_selects_its_draws_everywhere(media, media_run):
    drag_first_pair(media)
    indices = selected(media)
    few = thinned_draws(media_run.draws)
    assert 0 < len(indices) < len(few)
    inside, outside = few["C1"].iloc[indices], few["C1"].drop(index=indices)
    assert inside.max() < outside.max()
    assert text(media, "status") == f"{len(indices)} of {len(few)} draws are selected."


@pytest.mark.parametrize("which", ["media", "hostile"])
def test_curves_of_selected_draws_are_those_of_bands(which, request):
    page, run = request.getfixturevalue(which), request.getfixturevalue(f"{which}_run")
    move(page, "value", 10)
    few = thinned_draws(run.draws).iloc[sorted(selected(page))].reset_index(drop=True)
    assert len(few) == max(50, round(0.1 * len(thinned_draws(run.draws))))
    assert few["C1"].max() < run.draws["C1"].median()
    curves = page.evaluate(MEDIANS)
    most = len(curves[0][0])
    table = bands(run.specimen, few, settings=run.posterior().settings, max_rows=most,
                  max_draws=len(few))  # fmt: skip
    for number, protocol in enumerate(run.specimen.protocols):
        for k, axis in enumerate("xy"):
            part = table[(table["protocol"] == protocol.name) & (table["direction"] == axis)]
            large = part["credible_q50"].abs().max()
            for values, level in zip(curves[2 * number + k], ("q50", "q05", "q95"), strict=True):
                np.testing.assert_allclose(
                    np.sort(values), np.sort(part[f"credible_{level}"]), atol=1e-6 * large
                )


def test_other_priors_weigh_the_draws(media, media_run):
    few = thinned_draws(media_run.draws)
    move(media, "prior-0-1", -50)  # sd of both mounting stretches times 10^-0.5
    log = np.zeros(len(few))
    for axis in "xy":
        x = few[f"mounting_stretch_{axis}"]
        log += norm.logpdf(x, 1.0, 0.1 * 10.0**-0.5) - norm.logpdf(x, 1.0, 0.1)
    weights = np.exp(log - log.max())
    np.testing.assert_allclose(media.evaluate("[...explore.weights()]"), weights, rtol=1e-9)
    effective = weights.sum() ** 2 / (weights**2).sum()
    assert text(media, "weight") == f"{effective:.0f} effective draws of {len(few)}."


def test_too_few_effective_draws_are_refused_in_words(media):
    move(media, "prior-0-0", -100)
    move(media, "prior-0-1", -100)
    assert text(media, "refused").startswith("Refused: ")
    assert f"fewer than {LEAST_EFFECTIVE}" in text(media, "refused")
    assert set(media.evaluate("[...explore.weights()]")) == {1.0}
    media.evaluate("document.getElementById('reset').click()")
    assert media.evaluate("document.getElementById('refused').hidden") is True


def test_hostile_names_stay_text(hostile):
    titles = hostile.evaluate(
        "[...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Title')"
        ".map(m => m.text?.text).filter(Boolean)"
    )
    assert titles == list(reported.PROTOCOLS)
