"""explore.html: what it holds, against the bands of the same draws, and in a real browser."""

import base64
import gzip
import json
import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

import biaxbayes
import browser
import quick_posteriors as quick
import reported
from biaxbayes.errors import InputError
from biaxbayes.identifiability.reported import quantile_texts
from biaxbayes.laws import LAWS
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.bands import bands
from biaxbayes.prediction.percentiles import evenly_spaced
from biaxbayes.reports.explore import LEAST_EFFECTIVE, explore_page, thinned_draws
from biaxbayes.verbs.report import report_text


def sources(page: str) -> list[dict[str, np.ndarray]]:
    """The numbers of every source of data on a page."""
    result = []

    def walk(node):
        if isinstance(node, dict) and node.get("name") == "ColumnDataSource":
            entries = node["attributes"]["data"]["entries"]
            result.append({name: array(v) for name, v in entries})
        for child in node.values() if isinstance(node, dict) else node:
            if isinstance(child, dict | list):
                walk(child)

    def array(v):
        data = base64.b64decode(v["array"]["data"])
        if data.startswith(b"\x1f\x8b"):  # Bokeh before 3.7 does not compress
            data = gzip.decompress(data)
        return np.frombuffer(data, dtype=v["dtype"]).reshape(v["shape"])

    for text in re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.S):
        walk(json.loads(text))
    return result


def draws_of(page: str) -> dict[str, np.ndarray]:
    return next(s for s in sources(page) if "opacity" in s)


def drawn(posterior: Posterior, count: int = 700) -> pd.DataFrame:
    """Draws about the middle of the priors, which no sampler made."""
    middle = {p.name: np.array([{"uniform": 0.3 * p.high}.get(p.prior[0], p.prior[1])])
              for p in posterior.law.parameters}  # fmt: skip
    middle |= {name: np.array([0.01]) for name in posterior.free if name.startswith("noise")}
    middle |= {q.name: np.array([1.01]) for q in posterior.quantities.of_kind("stretch")}
    at = posterior.coordinates(middle)
    scatter = np.random.default_rng(1).normal(0.0, 0.01, (count, at.shape[1]))
    table = pd.DataFrame(posterior.natural(at + scatter))
    return table[np.isfinite(table["lp"])].reset_index(drop=True)


def assert_has_the_curves(posterior: Posterior, draws: pd.DataFrame, page: str) -> None:
    """The bands on a page are those of ``bands`` of the same draws, at readings that were made."""
    few, specimen = thinned_draws(draws), posterior.specimen
    curves = [s for s in sources(page) if "median_residual" in s]
    assert len(curves) == 2 * len(specimen.protocols)
    loads = draws_of(page)
    for number, protocol in enumerate(specimen.protocols):
        for k, axis in enumerate("xy"):
            curve = curves[2 * number + k]
            most = len(curve["x"])
            table = bands(posterior, few, max_rows=most, max_draws=len(few))
            table = table[(table["protocol"] == protocol.name) & (table["direction"] == axis)]
            large = np.abs(table["credible_q50"]).max()
            for name, level in (("low", "q05"), ("median", "q50"), ("high", "q95")):
                expected = np.sort(table[f"credible_{level}"])
                np.testing.assert_allclose(np.sort(curve[name]), expected, atol=1e-6 * large)
            of_draws = loads[f"load 0 {number} {axis}"]  # of the first piece
            assert of_draws.shape == (len(few), most)
            np.testing.assert_allclose(
                np.median(of_draws, axis=0), curve["median"], atol=1e-6 * large
            )


@pytest.mark.long
@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_law_has_its_page(law):
    posterior = Posterior(quick.small_specimen(), noise="independent", mounting="free", law=law)
    draws = drawn(posterior)
    page = explore_page(posterior, draws, "tentative")
    assert_has_the_curves(posterior, draws, page)
    names = [n.removeprefix("axis ") for n in draws_of(page) if n.startswith("axis ")]
    assert names == [*posterior.law.names, "mounting_stretch_x", "mounting_stretch_y"]
    assert "have not converged" in page


@pytest.fixture(scope="module")
def page(media_run):
    return report_text(media_run, "explore")


def test_curves_of_a_run_with_a_misfit_are_those_of_the_law(media_run, page):
    curve = next(s for s in sources(page) if "median_residual" in s)
    few = thinned_draws(media_run.draws)
    table = bands(media_run.posterior(), few, max_rows=len(curve["x"]), max_draws=len(few))
    law = table["law"][table["direction"] == "x"]
    np.testing.assert_allclose(np.sort(curve["median"]), np.sort(law), rtol=1e-5)


def test_what_is_fixed_has_neither_panels_nor_a_prior(small_run):
    page = explore_page(small_run.posterior(), small_run.draws, "converged")
    assert not {"kappa", "axis kappa"} & set(draws_of(page))
    assert "fibre dispersion" not in page
    with pytest.raises(InputError, match="has no posterior to explore"):
        explore_page(small_run.posterior(), small_run.draws, "unusable")


def test_the_report_points_to_it_where_it_is(copied, small_run, tmp_path):
    folder = copied(small_run.path)
    link = '<a href="explore.html">'
    assert link not in report_text(folder)
    (folder / "explore.html").write_text("of another run", encoding="utf-8")
    assert link in biaxbayes.report(folder).read_text(encoding="utf-8")
    page = biaxbayes.report(folder, "explore").read_text(encoding="utf-8")
    assert '<a href="report.html">' in page
    elsewhere = biaxbayes.report(small_run, "explore", out=tmp_path / "page.html")
    assert 'href="report.html"' not in elsewhere.read_text(encoding="utf-8")


MEDIANS = "explore.curves.map(c => [[...c.data.median], [...c.data.low], [...c.data.high]])"


def ready(chromium, run, folder):
    explored = biaxbayes.report(run, "explore", out=folder / "explore.html")
    page, *_ = browser.opened(chromium, explored, viewport={"width": 1280, "height": 1400})
    page.wait_for_function("Boolean(window.explore?.ready)")
    return page


@pytest.fixture(scope="module")
def media(chromium, media_run, tmp_path_factory):
    return ready(chromium, media_run, tmp_path_factory.mktemp("media"))


@pytest.fixture(scope="module")
def hostile(chromium, hostile_run, tmp_path_factory):
    return ready(chromium, hostile_run, tmp_path_factory.mktemp("hostile"))


@pytest.fixture(autouse=True)
def everything_shown_again(request):
    """Each test begins with all draws and the priors of the run."""
    yield
    for name in {"media", "hostile"} & set(request.fixturenames):
        request.getfixturevalue(name).evaluate(
            "document.getElementById('clear').click(); document.getElementById('reset').click()"
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
    page.mouse.move(right - 100.0, top + 8.0)
    page.mouse.down()
    page.mouse.move(right - 45.0, bottom - 8.0, steps=2)
    page.mouse.up()
    page.wait_for_function("explore.draws.selected.indices.length > 0")


def test_a_box_selects_its_draws_everywhere(media, media_run):
    drag_first_pair(media)
    indices = selected(media)
    few = thinned_draws(media_run.draws)
    assert 0 < len(indices) < len(few)
    inside, outside = few["C1"].iloc[indices], few["C1"].drop(index=indices)
    assert inside.max() < outside.max()
    assert text(media, "status") == f"{len(indices)} of {len(few)} draws are selected."


@pytest.mark.parametrize("which", ["media", "hostile"])
def test_curves_of_selected_draws_are_percentiles_of_the_law(which, request):
    page, run = request.getfixturevalue(which), request.getfixturevalue(f"{which}_run")
    move(page, "value", 10)
    few = thinned_draws(run.draws).iloc[sorted(selected(page))].reset_index(drop=True)
    assert len(few) == max(50, round(0.1 * len(thinned_draws(run.draws))))
    assert few["C1"].max() < run.draws["C1"].median()
    shown = page.evaluate(MEDIANS)
    posterior = run.posterior()
    for number, protocol in enumerate(run.specimen.protocols):
        rows = evenly_spaced(protocol.rows, len(shown[2 * number][0]))
        load = posterior.forward.load(few, protocol.stretch[rows], protocol.name)
        load += posterior.forward.offset(few)
        for k in range(2):
            expected = np.quantile(load[:, :, k], (0.5, 0.05, 0.95), axis=0)
            for values, level in zip(shown[2 * number + k], expected, strict=True):
                large = np.abs(expected[0]).max()
                np.testing.assert_allclose(np.sort(values), np.sort(level), atol=1e-6 * large)


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


def test_the_page_gives_the_numbers_of_the_report(media_run, page):
    table = page.partition('<tbody id="moved">')[2].partition("</tbody>")[0]
    cells = re.findall(r'</th><td class="n">([^<]+)</td>', table)
    rows = media_run.result.reported
    assert len(cells) == len(rows)
    for cell, row in zip(cells, rows, strict=True):
        parameter = media_run.quantities[row.name].parameter
        median, low, high = quantile_texts(row.median, row.low, row.high, parameter)
        assert cell == f"{median} ({low} to {high})"


def test_hostile_names_stay_text(hostile):
    titles = hostile.evaluate(
        "[...Bokeh.documents[0]._all_models.values()].filter(m => m.type === 'Title')"
        ".map(m => m.text?.text).filter(Boolean)"
    )
    assert titles == list(reported.PROTOCOLS)
