"""What somebody who is no statistician would ask about a report is explained on its page."""

import re
import shutil

import pytest

from biaxbayes.cli import main
from biaxbayes.reports.page import write_report
from biaxbayes.reports.words import GLOSSARY, NATS
from biaxbayes.runs.run import open_run


@pytest.fixture(scope="module")
def html(media_run, tmp_path_factory) -> str:
    folder = shutil.copytree(media_run.path, tmp_path_factory.mktemp("words") / "run")
    return write_report(folder, open_run(folder)).read_text(encoding="utf-8")


def test_the_page_explains_every_term_and_the_glossary_is_the_same(html):
    page = html.split('<h2 id="words">')[1]
    text = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    for term, words in GLOSSARY.items():
        assert f"{term} {words}" in text.replace("&#39;", "'").replace("&lt;", "<"), term
        assert len(words) < 130, f"{term}: half a line"


def test_a_paragraph_of_methods_states_the_units_of_its_priors(html):
    priors = re.search(r"Priors: (.*?)\. The joint", html)[1].split("; ")
    for name, unit in (("C1", "kPa"), ("k1", "kPa"), ("alpha", "deg"), ("noise_sd", "N")):
        prior = next(t for t in priors if t.startswith(f"{name} "))
        assert f" {unit}" in prior, prior
    assert not any("log sd" in t for t in priors)


@pytest.mark.long
def test_the_terminal_says_what_a_nat_is(small_run, capsys, tmp_path):
    with pytest.raises(SystemExit):
        main(["design", str(small_run.path), "--out", str(tmp_path), "--quiet"])
    out = capsys.readouterr().out
    assert "nats" in out and NATS in out
