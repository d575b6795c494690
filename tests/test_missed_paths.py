"""Paths that the model misses are named wherever a run is written about."""

import os
import re
from pathlib import Path

import pytest

import biaxbayes
from biaxbayes.laws.goh import GOH
from biaxbayes.reports.closing_message import closing_message
from biaxbayes.reports.methods import latex_table
from biaxbayes.reports.page import report_page
from commands import exit_code
from model_cases import bent
from quick_posteriors import runs_without_figures, specimen

TRUTH = GOH(9.0, 20.0, 4.0, 42.0, 0.15)
REAL = os.environ.get("BIAXBAYES_REAL", "")
WRITERS = (closing_message, report_page, latex_table)


@pytest.fixture(scope="module")
def data():
    return specimen(TRUTH, increments=15)


@pytest.fixture(scope="module")
def missed(data, tmp_path_factory):
    name = data.protocols[1].name
    folder = tmp_path_factory.mktemp("missed") / "run"
    with runs_without_figures():
        return name, biaxbayes.sample(
            bent(data, name, 0.2), out=folder, noise="independent", ess=100, workers=1
        )


@pytest.mark.parametrize("write", WRITERS)
def test_the_missed_path_is_named(write, missed):
    name, run = missed
    text = " ".join(write(run).split())
    plain = re.sub(r"<[^>]+>|\\(?=[^a-z])", "", text).replace("&#39;", "'")
    message = re.findall(r"GOH misses the (\S+) protocol by [\d.]+ N root mean square", plain)
    assert name in message
    assert "do not use these parameters for that path" in plain


def test_a_described_specimen_is_not_warned_of(data, tmp_path):
    with runs_without_figures():
        run = biaxbayes.sample(data, out=tmp_path / "run", ess=60, workers=1)
    for write in WRITERS:
        assert "GOH misses the " not in write(run)


@pytest.mark.long
@pytest.mark.real
@pytest.mark.skipif(not REAL, reason="BIAXBAYES_REAL is not set")
def test_a_tared_valve_that_goh_does_not_describe_is_warned_of(tmp_path, capsys):
    """Porcine aortic valve, resampled and tared: both are told, whatever is asked for."""
    raw, made = Path(REAL) / "valve-pymecht" / "biax-data.csv", tmp_path / "valve.csv"
    columns = "stretch_x=lambda_1,stretch_y=lambda_2,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa"
    columns += ",protocol=protocol"
    options = ["--machine", "generic", "--geometry", "unloaded", "--columns", columns]
    assert exit_code("convert", raw, *options, "--out", made) == 0
    capsys.readouterr()
    assert exit_code("check", made) == 0
    message = " ".join(capsys.readouterr().out.split())
    assert "the load cell was tared" in message and "GOH does not describe this specimen" in message
    assert exit_code("fit", made) == 0
    output = capsys.readouterr().err
    assert "a tared load cell" in output and "GOH does not describe this specimen" in output
    assert exit_code("sample", made, "--out", tmp_path / "run") == 2
    assert "tared" in capsys.readouterr().err
    zeroed = ["--mounting", "zeroed", "--ess", 100, "--workers", 1, "--out", tmp_path / "run"]
    assert exit_code("sample", made, *zeroed) == 0
    out = capsys.readouterr().out
    assert "GOH misses the" in out and "do not use these parameters for that path" in out
