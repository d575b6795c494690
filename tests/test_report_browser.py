"""report.html in a real browser: no errors, no requests, readable at any width, accessible."""

from __future__ import annotations

import shutil

import pytest

import browser
import reported
from biaxbayes.reports.page import write_report
from biaxbayes.runs.run import open_run

pytestmark = pytest.mark.skipif(not browser.CHROMIUM, reason="no Chromium here")


@pytest.fixture(scope="module")
def page(hostile_run, tmp_path_factory):
    folder = shutil.copytree(hostile_run.path, tmp_path_factory.mktemp("report") / "hostile")
    path = write_report(folder, open_run(folder))
    with browser.shown(path, tmp_path_factory.mktemp("profile")) as shown:
        yield shown


def test_loads_without_errors_and_without_the_network(page):
    urls = [e["request"]["url"] for e in page.seen("Network.requestWillBeSent")]
    asked = [u for u in urls if not u.startswith(("file:", "data:", "about:"))]
    assert any(u.endswith("report.html") for u in urls)
    assert asked == []
    assert [u for u in urls if u.startswith("file:") and not u.endswith("report.html")] == []
    assert page.seen("Runtime.exceptionThrown") == []
    assert page.seen("Runtime.consoleAPICalled") == []
    assert [e["entry"]["text"] for e in page.seen("Log.entryAdded")] == []
    assert page.seen("Page.javascriptDialogOpening") == []


def test_figures_are_shown(page):
    shown = page.evaluate(
        "[...document.images].map(i => [i.complete, i.naturalWidth, i.clientWidth, i.alt.length])"
    )
    assert len(shown) >= 3
    for complete, natural, width, alt in shown:
        assert complete and natural > 300 and width > 200 and alt > 20


def test_hostile_names_stay_text(page):
    assert page.evaluate("document.title").startswith("<script>document.title='broken'")
    assert (
        page.evaluate("document.querySelectorAll('script, b[onclick], img[onerror]').length") == 0
    )
    heading = page.evaluate("document.querySelector('h1').textContent")
    assert heading.startswith("<script>") and len(heading) <= 120
    assert "{{ 7*7 }}" in heading
    rows = page.evaluate("[...document.querySelectorAll('th.name')].map(t => t.textContent)")
    assert reported.PROTOCOLS[0] in rows


@pytest.mark.parametrize("width", [320, 390, 768, 1280])
def test_nothing_sticks_out(page, width):
    page.resize(width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert (
        page.evaluate(
            "Math.max(...[...document.querySelectorAll('h1, h2, p, li, dd, nav')]"
            ".map(e => e.getBoundingClientRect().right))"
        )
        <= width
    )


@pytest.mark.parametrize("width", [390, 1280])
def test_a_figure_that_goes_on_says_so(page, width):
    page.resize(width)
    found = page.evaluate(
        "[...document.querySelectorAll('figure')].map(f => "
        "[f.querySelector('.scroll').scrollWidth > f.querySelector('.scroll').clientWidth, "
        "getComputedStyle(f.querySelector('figcaption'), '::before').content])"
    )
    assert len(found) >= 3
    for goes_on, hint in found:
        assert goes_on == ("goes on to the right" in hint) == (width < 600)


def test_dark_where_the_reader_wants_it(page):
    grounds = []
    for scheme in ("light", "dark"):
        page.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": scheme}],
        )
        grounds.append(page.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert grounds == ["rgb(255, 255, 255)", "rgb(20, 24, 29)"]


def test_keyboard_reaches_the_results(page):
    page.evaluate("document.activeElement.blur()")
    press = {"key": "Tab", "code": "Tab", "windowsVirtualKeyCode": 9}
    page.call("Input.dispatchKeyEvent", type="keyDown", **press)
    page.call("Input.dispatchKeyEvent", type="keyUp", **press)
    assert page.evaluate("document.activeElement.className") == "skip"
    assert page.evaluate("document.activeElement.getBoundingClientRect().left") >= 0


def test_prints_on_few_pages_without_navigation(page):
    page.call("Emulation.setEmulatedMedia", media="print")
    try:
        assert page.evaluate("getComputedStyle(document.querySelector('nav')).display") == "none"
        wide = page.evaluate("[...document.querySelectorAll('table, img')].map(e => e.clientWidth)")
        assert max(wide) > 0
    finally:
        page.call("Emulation.setEmulatedMedia", media="")


@browser.needs_axe
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_accessible(page, scheme):
    found = page.audit(scheme)
    assert found["passes"] > 20
    assert found["violations"] == []
