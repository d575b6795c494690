"""The report of a run: its structure, its numbers, and names that try to break it."""

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

import biaxbayes
import quick_posteriors as quick
import reported
from biaxbayes.reports import run_page as report
from biaxbayes.reports.methods import closing_message
from biaxbayes.runs.run import open_run
from commands import exit_code

VOID = {"meta", "link", "img", "br", "hr"}


class Outline(HTMLParser):
    """What a page consists of; elements must be closed in the order they were opened."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text: list[str] = []
        self.headings: list[int] = []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.elements if name == tag]


def outline(text: str) -> Outline:
    parsed = Outline()
    parsed.feed(text)
    parsed.close()
    assert parsed.open == []
    return parsed


@pytest.fixture(scope="module")
def html(hostile_run, tmp_path_factory):
    folder = shutil.copytree(hostile_run.path, tmp_path_factory.mktemp("report") / "hostile")
    return biaxbayes.report(folder).read_text(encoding="utf-8")


def altered(run, tmp_path: Path, change) -> Path:
    """The same run folder with another provenance."""
    folder = tmp_path / "altered"
    shutil.copytree(run.path, folder)
    record = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    change(record)
    (folder / "provenance.json").write_text(json.dumps(record), encoding="utf-8")
    return folder


def test_page_is_whole_and_needs_nothing_else(html):
    page = outline(html)
    assert len(html.encode()) < 5_000_000
    names = {tag for tag, _ in page.elements}
    assert not names & {"script", "iframe", "object", "embed", "form", "base", "svg"}
    for _, attrs in page.elements:
        assert not [key for key in attrs if key.startswith("on")]
        for key in ("src", "srcset", "action", "data", "poster"):
            assert (attrs.get(key) or "data:").startswith("data:")
    assert all((a["href"] or "").startswith("data:") for a in page.all("link"))
    linked = [a["href"] or "" for a in page.all("a")]
    assert all(re.match(r"#|https://doi\.org/10\.", link) for link in linked)
    assert "@import" not in html and "url(" not in html


def test_headings_landmarks_and_tables_speak(html):
    page = outline(html)
    assert page.headings[0] == 1 and page.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(page.headings, page.headings[1:], strict=False))
    for landmark in ("header", "nav", "main", "footer"):
        assert len(page.all(landmark)) == 1
    assert page.all("html")[0]["lang"] == "en"
    assert all(th.get("scope") in ("col", "row") for th in page.all("th"))
    assert len(page.all("caption")) == len(page.all("table")) >= 4
    assert all(len(img.get("alt") or "") > 20 for img in page.all("img"))
    ids = [a["id"] for _, a in page.elements if "id" in a]
    assert len(ids) == len(set(ids))
    targets = [a["href"][1:] for a in page.all("a") if (a["href"] or "").startswith("#")]
    assert set(targets) <= set(ids) and page.all("a")[0]["href"] == "#main"
    labels = [a["aria-labelledby"] for _, a in page.elements if "aria-labelledby" in a]
    assert set(labels) <= set(ids)


def test_no_export_is_read_back(media_run, copied):
    folder = copied(media_run.path)
    page = report.report_page(open_run(folder))
    for path in (*folder.glob("*.csv"), *folder.glob("evidence/*")):
        if path.name != "specimen.csv":
            path.unlink()
    assert report.report_page(open_run(folder)) == page


@pytest.mark.parametrize(
    ("state", "word"), [("unusable", "Not usable"), ("tentative", "Tentative")]
)
def test_a_run_that_did_not_converge_says_so(hostile_run, tmp_path, state, word):
    def change(record):
        record["convergence"] |= {"state": state, "reason": "the ensembles <disagree>"}

    folder = altered(hostile_run, tmp_path, change)
    assert exit_code("report", folder) == 3
    text = "".join(outline((folder / "report.html").read_text(encoding="utf-8")).text)
    assert word in text and "the ensembles <disagree>" in text


@pytest.mark.long
@pytest.mark.parametrize("mounting", ["ignored", "zeroed"])
def test_a_run_that_ignores_the_mounting_says_so(tmp_path, mounting):
    with quick.runs_without_figures():
        run = biaxbayes.sample(
            quick.small_specimen(), out=tmp_path / "run", mounting=mounting, ess=60, workers=1
        )
    text = report.report_page(run)
    assert "mounting stretch was ignored" in " ".join("".join(outline(text).text).split())
    output = f"was not inferred (mounting {mounting}): the parameters carry its error"
    assert output in closing_message(run) and output in "".join(outline(text).text)


def test_latex_keeps_its_cells(hostile_run, tmp_path):
    out = tmp_path / "latex"
    assert exit_code("report", hostile_run.path, "--format", "latex", "--out", out) == 0
    latex = out.read_text(encoding="utf-8")
    body = latex.partition("\\midrule")[2].partition("\\bottomrule")[0].strip().splitlines()
    assert len(body) == len(hostile_run.result.reported)
    assert {len(re.findall(r"(?<!\\)&", row)) for row in body} == {5}
    comment, _, table = latex.partition("\\begin{table}")
    assert all(line.startswith("%") for line in comment.strip().splitlines())
    assert "%" not in re.sub(r"\\%", "", table)
    assert table.count("\\end{table}") == 1


def test_a_protocol_with_a_slash_comes_back_by_its_name(hostile_run):
    stretch = f"mounting_stretch_x[{reported.PROTOCOLS[0]}]"
    assert "/" in stretch
    opened = open_run(hostile_run.path)
    assert stretch in opened.draws and stretch in opened.chains
    row = opened.summary.set_index("parameter").loc[stretch]
    assert float(row["q50"]) == pytest.approx(float(opened.draws[stretch].median()), rel=1e-6)


def test_hostile_names_are_text(html):
    page = outline(html)
    text = "".join(page.text)
    assert "<script>document.title='broken'</script>" in text
    assert "{{ 7*7 }}" in text
    assert reported.LAYER in text
    for name in reported.PROTOCOLS:
        assert name in text
    title = html.partition("<title>")[2].partition("</title>")[0]
    assert "&lt;script&gt;" in title and len(title) < 250


def test_report_is_the_same_twice(hostile_run, html, copied):
    assert biaxbayes.report(copied(hostile_run.path)).read_text(encoding="utf-8") == html
    assert open_run(hostile_run.path).state == "converged"
