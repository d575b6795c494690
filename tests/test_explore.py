"""explore.html: what the page holds, against the bands and predictions of the same draws."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
import pandas as pd
import pytest

import biaxbayes
import quick_posteriors as quick
from biaxbayes.api import report_text
from biaxbayes.errors import InputError
from biaxbayes.laws import LAWS
from biaxbayes.model.posterior import Posterior
from biaxbayes.prediction.bands import bands, evenly_spaced
from biaxbayes.prediction.stress import predict_stress
from biaxbayes.reports import explore
from biaxbayes.runs.folder import DERIVED
from test_start import imported

NEAR = 1e-6
"""Of the largest value: loads are on the page with seven digits."""


def held(page: str) -> dict:
    """The data of a page."""
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert text is not None
    return json.loads(text.group(1))


def unpacked(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def loads_of(data: dict) -> list[np.ndarray]:
    """Loads of each protocol and direction, shape (states, draws)."""
    shapes = [len(a["stretch"]) for p in data["protocols"] for a in p["axes"]]
    whole = unpacked(data["loads"], "<f4").astype(float).reshape(sum(shapes), data["draws"])
    return np.split(whole, np.cumsum(shapes)[:-1])


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


def assert_holds_the_curves(posterior: Posterior, draws: pd.DataFrame, page: str) -> None:
    """The loads on a page have the percentiles of ``bands``, as Cauchy stress of ``predict``."""
    few, data, specimen = explore.thinned_draws(posterior, draws), held(page), posterior.specimen
    assert data["draws"] == len(few)
    most = max(len(a["rows"]) for p in data["protocols"] for a in p["axes"])
    whole = bands(specimen, few, settings=posterior.settings, max_rows=most, max_draws=len(few))
    loads = iter(loads_of(data))
    assert [p["name"] for p in data["protocols"]] == [p.name for p in specimen.protocols]
    own = len(posterior.mounts) > 1
    for protocol, source in zip(data["protocols"], specimen.protocols, strict=True):
        for axis, direction in zip(protocol["axes"], "xy", strict=True):
            held_here = next(loads)
            expected = whole[
                (whole["protocol"] == protocol["name"]) & (whole["direction"] == direction)
            ].set_index("row")
            rows = np.array(axis["rows"])
            assert sorted(rows) == evenly_spaced(source.rows, most).tolist()
            expected = expected.loc[rows]
            large = np.abs(expected["credible_q50"]).max()
            for level, name in ((0.05, "q05"), (0.5, "q50"), (0.95, "q95")):
                found = np.quantile(held_here, level, axis=1)
                assert np.abs(found - expected[f"credible_{name}"]).max() <= NEAR * large
            np.testing.assert_allclose(axis["measured"], expected["measured"], rtol=1e-12)
            path = np.column_stack([source.stretch_x, source.stretch_y])[rows]
            table = predict_stress(
                few,
                specimen,
                posterior.law,
                path,
                reference="measured",
                protocol=source.name if own else None,
                stress="cauchy",
            )
            stretch = np.array(axis["stretch"])[:, None]
            nominal = held_here / (stretch if data["cauchyFile"] else 1.0)
            offset = unpacked(axis["offset"], "<f8") if axis["offset"] else 0.0
            cauchy = stretch * unpacked(axis["kPa_per_load"], "<f8") * (nominal - offset)
            for level, name in ((0.05, "credible_low"), (0.5, "median"), (0.95, "credible_high")):
                stated = table[f"cauchy_{direction}_kPa_{name}"].to_numpy()
                found = np.quantile(cauchy, level, axis=1)
                assert np.abs(found - stated).max() <= NEAR * np.abs(stated).max()


@pytest.mark.long
@pytest.mark.parametrize("which", ["media_run", "hostile_run"])
def test_curves_are_those_of_bands_and_predict(which, request):
    run = request.getfixturevalue(which)
    page = (run.path / "explore.html").read_text(encoding="utf-8")
    assert_holds_the_curves(run.posterior(), run.draws, page)


@pytest.mark.long
@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_law_has_its_page(law):
    posterior = Posterior(
        quick.small_specimen(), noise="independent", mounting="free", law=law, beta=1.0
    )
    draws = drawn(posterior)
    page = explore.explore_page(posterior, draws, "tentative")
    assert_holds_the_curves(posterior, draws, page)
    names = [a["name"] for a in held(page)["axes"]]
    assert names == [*posterior.law.names, "mounting_stretch_x", "mounting_stretch_y"]
    assert "have not converged" in page


def test_the_same_run_gives_the_same_bytes_again(media_run):
    written = (media_run.path / "explore.html").read_text(encoding="utf-8")
    again = explore.explore_page(
        media_run.posterior(), media_run.draws, media_run.state, report="report.html"
    )
    assert written == again


def test_offline_and_small(media_run, hostile_run):
    for run in (media_run, hostile_run):
        page = (run.path / "explore.html").read_text(encoding="utf-8")
        assert len(page.encode()) <= 3_000_000
        policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
        assert policy is not None
        rules = dict(rule.strip().split(" ", 1) for rule in policy.group(1).split(";"))
        assert rules["default-src"] == "'none'"
        assert re.fullmatch(r"('sha256-[\w+/=]+' ?){2}", rules["script-src"])
        assert "<script src" not in page and '<link rel="stylesheet"' not in page
        count = held(page)["draws"]
        assert 500 <= count <= 1000
        assert f"{count:,} of the run" in page


def test_no_draw_is_on_the_page_twice(media_run):
    posterior, draws = media_run.posterior(), media_run.draws
    few = explore.thinned_draws(posterior, draws)
    assert not few.duplicated().any()
    assert few.iloc[0].equals(draws.iloc[0]) and few.iloc[-1].equals(draws.iloc[-1])


def test_priors_are_those_of_the_run(media_run):
    page = (media_run.path / "explore.html").read_text(encoding="utf-8")
    stated = {tuple(p["columns"]): (p["family"], p["stated"]) for p in held(page)["priors"]}
    assert stated["mounting_stretch_x", "mounting_stretch_y"] == ("normal", [1.0, 0.1])
    assert stated["alpha",] == ("uniform", [0.0, 90.0])
    free = {name for names in stated for name in names}
    assert free == {name for name in media_run.posterior().priors if name != "noise_growth"}


def test_what_is_fixed_has_neither_panels_nor_a_prior(small_run):
    page = explore.explore_page(small_run.posterior(), small_run.draws, "converged")
    data = held(page)
    assert "kappa" not in [a["name"] for a in data["axes"]]
    assert "kappa" not in [name for p in data["priors"] for name in p["columns"]]


def test_a_run_without_a_posterior_has_no_page(small_run):
    with pytest.raises(InputError, match="no posterior to explore"):
        explore.explore_page(small_run.posterior(), small_run.draws, "unusable")
    constant = pd.concat([small_run.draws.iloc[:1]] * 3, ignore_index=True)
    with pytest.raises(InputError, match="no posterior to explore"):
        explore.explore_page(small_run.posterior(), constant, "converged")


def test_the_report_points_to_it_where_it_is(copied, small_run):
    folder = copied(small_run.path)
    link = '<a href="explore.html">'
    assert link not in report_text(folder)
    (folder / "explore.html").write_text("of another run", encoding="utf-8")
    report = biaxbayes.report(folder)
    assert link in report.read_text(encoding="utf-8")
    page = (folder / "explore.html").read_text(encoding="utf-8")
    assert '<a href="report.html">' in page
    assert biaxbayes.report(folder, "explore").read_text(encoding="utf-8") == page


def test_elsewhere_it_points_to_nothing(small_run, tmp_path):
    path = biaxbayes.report(small_run, "explore", out=tmp_path / "page.html")
    assert "report.html" not in path.read_text(encoding="utf-8")
    assert path.read_text(encoding="utf-8") == report_text(small_run, "explore")


def test_it_goes_with_the_run_that_it_was_made_of():
    assert DERIVED.fullmatch("explore.html")


def test_bokeh_is_read_but_not_imported():
    assert "bokeh" not in imported(
        "import biaxbayes.jobs.products\nfrom biaxbayes.reports import explore\nexplore._library()"
    )


def test_a_script_that_would_end_its_element_is_refused():
    with pytest.raises(InputError, match="version of bokeh"):
        explore._inline("'</SCRIPT>'")
