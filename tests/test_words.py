"""What somebody who is no statistician would ask about a report is explained on its page."""

import re
import shutil

import pytest

from biaxbayes.cli import main
from biaxbayes.laws import LAWS
from biaxbayes.reports.page import write_report
from biaxbayes.reports.words import GLOSSARY, NATS
from biaxbayes.runs.run import open_run
from test_report import Outline

TOLD = {"h2", "h3", "caption", "th", "figcaption"}
PLAIN = frozenset(
    re.findall(
        r"\w+",
        """
        blue each fibre fits grey known left much once reason record remove say share table
        stiffnesses stresses
        about across all alone also and any are at axis be below beside but by can central chains
        citation cite combination cost data determine diagonal direction error errors every
        everything evidence expected first for force from glance has have held how ignoring in
        independent inside its joint largest leave load look material maximum mean meaning
        measured methods minus model mounted narrow new noise number of on one open other others
        over paragraph parameter parameters part parts path peak per pin point points position
        protocol protocols quantity range reading readings report ridge root row rows sample
        settings
        sign size small smaller specimen square state stress stretch stretches test that the
        their them they thickness those through tissue to two under unit unloaded versions what
        whatever which while with within words
        """,
    )
)
"""What needs no explanation in a table of a test, or only as a part of a term of the glossary."""


class Headings(Outline):
    """Words of headings, captions and the heads of rows and columns."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[str] = []

    def handle_data(self, data):
        super().handle_data(data)
        if TOLD & set(self.open):
            self.told.append(data)


def explained(word: str) -> bool:
    """Whether a term of the glossary speaks of a word, in the singular or the plural."""
    terms = " ".join(GLOSSARY).lower()
    return bool(re.search(rf"\b{re.escape(word.rstrip('s'))}", terms))


@pytest.fixture(scope="module")
def html(media_run, tmp_path_factory) -> str:
    folder = shutil.copytree(media_run.path, tmp_path_factory.mktemp("words") / "run")
    return write_report(folder, open_run(folder)).read_text(encoding="utf-8")


def test_what_headings_and_tables_say_is_plain_or_explained(html):
    page = Headings()
    page.feed(html)
    words = {w.lower() for text in page.told for w in re.findall(r"[A-Za-z][\w-]{2,}", text)}
    assert {"verdict", "r-hat", "posterior", "runs", "tangent"} <= words
    unknown = {w for w in words - PLAIN - set(LAWS) if not explained(w)}
    assert not unknown


def test_the_page_explains_every_term_and_the_glossary_is_the_same(html):
    page = html.split('<h2 id="words">')[1]
    text = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    for term, words in GLOSSARY.items():
        assert f"{term} {words}" in text.replace("&#39;", "'").replace("&lt;", "<"), term
        assert len(words) < 130, f"{term}: half a line"


def test_a_paragraph_of_methods_states_the_units_of_its_priors(html):
    told = re.search(r"Priors: (.*?)\. The joint", html)[1].split("; ")
    for name, unit in (("C1", "kPa"), ("k1", "kPa"), ("alpha", "deg"), ("noise_sd", "N")):
        prior = next(t for t in told if t.startswith(f"{name} "))
        assert f" {unit}" in prior, prior
    assert not any("log sd" in t for t in told)


@pytest.mark.long
def test_the_terminal_says_what_a_nat_is(small_run, capsys, tmp_path):
    with pytest.raises(SystemExit):
        main(["design", str(small_run.path), "--out", str(tmp_path), "--quiet"])
    out = capsys.readouterr().out
    assert "nats" in out and NATS in out
