"""Paths that the model misses are named wherever a run is written about."""

import re

import pytest

import biaxbayes
from biaxbayes.mechanics.goh import GOH
from biaxbayes.output.closing import closing_message
from biaxbayes.output.report.page import report_page
from biaxbayes.output.report.tables import latex_table, markdown_table
from model_cases import bent
from quick_posteriors import specimen

TRUTH = GOH(9.0, 20.0, 4.0, 42.0, 0.15)
WRITERS = (closing_message, report_page, markdown_table, latex_table)


@pytest.fixture(scope="module")
def data():
    return specimen(TRUTH, increments=15)


@pytest.fixture(scope="module")
def missed(data, tmp_path_factory):
    name = data.protocols[1].name
    folder = tmp_path_factory.mktemp("missed") / "run"
    return name, biaxbayes.sample(bent(data, name, 0.3), out=folder, ess=100, workers=1)


@pytest.mark.parametrize("write", WRITERS)
def test_the_missed_path_is_named(write, missed):
    name, run = missed
    text = " ".join(write(run).split())
    plain = re.sub(r"<[^>]+>|\\(?=[^a-z])", "", text).replace("&#39;", "'")
    said = re.findall(r"GOH misses the (\S+) protocol by [\d.]+ N root mean square", plain)
    assert name in said
    assert "do not use these parameters for that path" in plain


def test_a_described_specimen_is_not_warned_of(data, tmp_path):
    run = biaxbayes.sample(data, out=tmp_path / "run", ess=60, workers=1)
    for write in WRITERS:
        assert "GOH misses" not in write(run)
