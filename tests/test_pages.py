"""All pages, of made-up results and in a real browser: what is reported, escaped, readable."""

import re
import shutil
from dataclasses import replace

import pytest

import biaxbayes
import browser
from biaxbayes.comparison.compare import ComparedRun, compare
from biaxbayes.comparison.law_weights import weigh_laws
from biaxbayes.figures.comparisons import law_misfit_figure, law_mounting_figure
from biaxbayes.identifiability.reported import Reported
from biaxbayes.reports.comparison import write_comparison
from biaxbayes.reports.laws import laws_page
from biaxbayes.reports.study_page import write_study
from biaxbayes.studies.study_result import StudyResult
from made_up import SOFT, STIFF, predicted, table
from quick_posteriors import sampled, specimen

REASON = "laws that describe the record equally well differ above it: goh, fung"


def write_a_study(folder) -> None:
    rows = table(9)
    stretches = rows["quantity"] == "mounting_stretch_x"
    rows["reported"] = rows["reported"].astype(object)
    rows.loc[stretches, "reported"] = "above 1.0123"
    write_study(StudyResult("a study", folder, rows))


def write_a_comparison(folder) -> None:
    members = []
    for label, material in (("soft", SOFT), ("<b>media</b>", STIFF)):
        run = sampled(specimen(material, increments=10), ess=60.0)
        row = Reported(
            run.target.quantities["mounting_stretch_x"],
            1.02,
            1.0123,
            1.03,
            "bounded",
            REASON,
            "low",
        )
        members.append(ComparedRun(label, run.target, run.draws, "converged", (row,)))
    write_comparison(compare(members), folder)


def write_weighed_laws(folder) -> None:
    record, predictions = predicted()
    record = replace(record, name="<script>alert(1)</script>")
    compared = replace(
        weigh_laws(record, predictions, ["goh", "hgo"]),
        left_out={"fung": "1:1: <img src=x onerror=alert(1)>"},
    )
    misfit, mounting = law_misfit_figure(compared), law_mounting_figure(compared)
    figures = {"law-misfit": misfit, "law-mounting": mounting}
    (folder / "laws.html").write_text(laws_page(compared, figures), encoding="utf-8")


def write_hostile_report(folder, run) -> None:
    shutil.copytree(run.path, folder, dirs_exist_ok=True)
    biaxbayes.report(folder)


MADE_UP = {
    "laws.html": write_weighed_laws,
    "study.html": write_a_study,
    "compare.html": write_a_comparison,
}


RUN_PAGES = ("report.html",)


@pytest.fixture(scope="module", params=[*MADE_UP, "population.html", *RUN_PAGES])
def page(request, tmp_path_factory):
    if request.param == "population.html":
        return request.getfixturevalue("population").folder / request.param
    folder = tmp_path_factory.mktemp("pages")
    if request.param in MADE_UP:
        MADE_UP[request.param](folder)
    else:
        write_hostile_report(folder, request.getfixturevalue("hostile_run"))
    return folder / request.param


def test_heads_that_lead_to_the_words_are_explained_there(page):
    html = page.read_text(encoding="utf-8")
    words = html.partition('id="words"')[2]
    terms = [term.lower() for term in re.findall(r"<dt>(.*?)</dt>", words)]
    heads = set(re.findall(r'<th scope="col"[^>]*><a href="#words">(.*?)</a>', html))
    assert heads or page.name in RUN_PAGES
    for head in heads:
        plain = head.partition(" (")[0].lower()  # without its unit
        assert any(plain in term for term in terms), head


def test_a_population_has_a_results_paragraph_and_latex(population):
    folder, groups = population.folder, population.groups
    html, latex = (
        (folder / f"population.{kind}").read_text(encoding="utf-8") for kind in ("html", "tex")
    )
    said = re.search(r"% Results: (.*)", latex).group(1)
    assert latex.count(r" \\") == len(groups) + 1
    assert said[:60] in html.replace("&lt;", "<")
    for name in re.findall(r"([\w-]+\.(?:csv|tex|nc)): ", html.partition('id="files"')[2]):
        assert (folder / name).is_file(), name


@pytest.fixture(scope="module")
def tab(chromium, page):
    """The page in a tab, the addresses that it asks for, and its errors."""
    return browser.opened(chromium, page)


@pytest.fixture
def shown(tab):
    return tab[0]


def test_opens_without_errors_and_without_the_network(shown, tab, page):
    _, addresses, errors = tab
    others = [u for u in addresses if not u.startswith(("data:", "about:", "blob:"))]
    assert {u.rsplit("/", 1)[-1] for u in others} == {page.name}
    assert errors == []
    images = shown.evaluate(
        "[...document.images].map(i => [i.complete, i.naturalWidth, i.clientWidth, i.alt.length])"
    )
    assert images
    for complete, natural, width, alt in images:
        assert complete and natural > 300 and width > 200 and alt > 20


def test_hostile_names_stay_text(shown, page):
    assert shown.evaluate("document.querySelectorAll('b[onclick], img[onerror]').length") == 0
    if page.name in RUN_PAGES:
        assert shown.evaluate("document.title").startswith("<script>document.title='broken'")


GOES_ON = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth)"


def test_readable_at_any_width(shown, page):
    """Nothing sticks out; a wide table or figure is shaded, says so, and moves by the keyboard."""
    for width in (320, 390, 768, 1280):
        shown.set_viewport_size({"width": width, "height": 800})
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        right = "Math.max(...[...document.querySelectorAll('h1, h2, h3, p, li, dt, dd, nav')]"
        assert shown.evaluate(f"{right}.map(e => e.getBoundingClientRect().right))") <= width
        if page.name not in RUN_PAGES and width == 1280:
            assert shown.evaluate(f"{GOES_ON}.map(e => e.getAttribute('aria-label'))") == []
        figures = shown.evaluate(
            "[...document.querySelectorAll('figure')].map(f => "
            "[f.querySelector('.scroll').scrollWidth > f.querySelector('.scroll').clientWidth, "
            "getComputedStyle(f.querySelector('figcaption'), '::before').content])"
        )
        assert figures
        if width in (390, 1280):
            for goes_on, hint in figures:
                assert goes_on == ("goes on to the right" in hint) == (width == 390)
        if width == 390 and page.name not in RUN_PAGES:
            shades = f"{GOES_ON}.map(e => getComputedStyle(e).backgroundImage)"
            assert all("linear-gradient" in s for s in shown.evaluate(shades))
            assert shown.evaluate(f"{GOES_ON}.every(e => e.tabIndex === 0)")


@browser.needs_axe
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_accessible(chromium, page, scheme):
    result = browser.audit(chromium, page, scheme)
    assert result["passes"] > 20
    assert result["violations"] == []
