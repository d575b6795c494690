"""explore.html: what the page holds, against the bands of the same draws and the report."""

from __future__ import annotations

import base64
import gzip
import json
import re

import numpy as np
import pandas as pd
import pytest

import biaxbayes
import quick_posteriors as quick
from biaxbayes.errors import InputError
from biaxbayes.laws import LAWS
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.bands import bands
from biaxbayes.reports.explore import explore_page, thinned_draws
from biaxbayes.verbs.report import report_text


def sources(page: str) -> list[dict[str, np.ndarray]]:
    """The numbers of every source of data on a page."""
    found = []

    def walk(node):
        if isinstance(node, dict) and node.get("name") == "ColumnDataSource":
            entries = node["attributes"]["data"]["entries"]
            found.append({name: array(v) for name, v in entries})
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
    return found


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
            table = bands(specimen, few, settings=posterior.settings, max_rows=most,
                          max_draws=len(few))  # fmt: skip
            table = table[(table["protocol"] == protocol.name) & (table["direction"] == axis)]
            large = np.abs(table["credible_q50"]).max()
            for name, level in (("low", "q05"), ("median", "q50"), ("high", "q95")):
                expected = np.sort(table[f"credible_{level}"])
                np.testing.assert_allclose(np.sort(curve[name]), expected, atol=1e-6 * large)
            of_draws = loads[f"load {number} {axis}"]
            assert of_draws.shape == (len(few), most)
            np.testing.assert_allclose(
                np.median(of_draws, axis=0), curve["median"], atol=1e-6 * large
            )


@pytest.mark.long
@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_law_has_its_page(law):
    posterior = Posterior(
        quick.small_specimen(), noise="independent", mounting="free", law=law, beta=1.0
    )
    draws = drawn(posterior)
    page = explore_page(posterior, draws, "tentative")
    assert_has_the_curves(posterior, draws, page)
    names = [n.removeprefix("axis ") for n in draws_of(page) if n.startswith("axis ")]
    assert names == [*posterior.law.names, "mounting_stretch_x", "mounting_stretch_y"]
    assert "have not converged" in page


def test_the_page_gives_the_numbers_of_the_report_and_of_all_draws(media_run):
    page = (media_run.path / "explore.html").read_text(encoding="utf-8")
    table = page.partition('<tbody id="moved">')[2].partition("</tbody>")[0]
    cells = re.findall(r'</th><td class="n">([^<]*)</td><td class="n">([^<]+)</td>', table)
    assert [reported for reported, _ in cells] == [r.interval for r in media_run.result.rows]
    summary = media_run.summary[["q50", "q05", "q95"]][: len(cells)]
    numbers = [[float(x) for x in re.findall(r"[\d.]+", cell)] for _, cell in cells]
    width = (summary["q95"] - summary["q05"]).to_numpy()[:, None]
    assert (np.abs(np.array(numbers) - summary.to_numpy()) < 0.06 * width).all()


def test_offline_and_small(media_run, hostile_run):
    for run in (media_run, hostile_run):
        page = (run.path / "explore.html").read_text(encoding="utf-8")
        assert len(page.encode()) <= 4_000_000
        assert "Content-Security-Policy\" content=\"default-src 'none'" in page
        assert "<script src" not in page and '<link rel="stylesheet"' not in page
        assert 500 <= len(draws_of(page)["opacity"]) <= 1000


def test_priors_are_those_of_the_run(media_run):
    page = (media_run.path / "explore.html").read_text(encoding="utf-8")
    legends = re.findall(r"<legend>(.*?)</legend>", page)
    assert "the run: normal (mean 1, sd 0.1" in legends[0] and legends[0].count("λ") == 2
    assert any("fibre angle" in text and "uniform from 0 to 90" in text for text in legends)


def test_what_is_fixed_has_neither_panels_nor_a_prior(small_run):
    page = explore_page(small_run.posterior(), small_run.draws, "converged")
    assert not {"kappa", "axis kappa"} & set(draws_of(page))
    assert "fibre dispersion" not in page


def test_a_run_without_a_posterior_has_no_page(small_run):
    with pytest.raises(InputError, match="has no posterior to explore"):
        explore_page(small_run.posterior(), small_run.draws, "unusable")
    constant = pd.concat([small_run.draws.iloc[:1]] * 3, ignore_index=True)
    with pytest.raises(InputError, match="has no posterior to explore"):
        explore_page(small_run.posterior(), constant, "converged")


def test_the_report_points_to_it_where_it_is(copied, small_run, tmp_path):
    folder = copied(small_run.path)
    link = '<a href="explore.html">'
    assert link not in report_text(folder)
    (folder / "explore.html").write_text("of another run", encoding="utf-8")
    report = biaxbayes.report(folder)
    assert link in report.read_text(encoding="utf-8")
    page = (folder / "explore.html").read_text(encoding="utf-8")
    assert '<a href="report.html">' in page
    elsewhere = biaxbayes.report(small_run, "explore", out=tmp_path / "page.html")
    assert 'href="report.html"' not in elsewhere.read_text(encoding="utf-8")
