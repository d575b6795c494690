"""The verbs as functions: plain objects, that show themselves in a notebook."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes.cli import VERBS
from biaxbayes.errors import InputError
from biaxbayes.mechanics.goh import GOH

DATA = Path(__file__).parents[1] / "data"
MATERIAL = GOH(C1_kPa=14.0, k1_kPa=60.0, k2=8.0, alpha_deg=38.0, kappa=0.1)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "media"
    with quick_posteriors.runs_without_figures():
        made = quick_posteriors.specimen(MATERIAL, increments=8)
        return biaxbayes.sample(
            made, out=folder, noise="independent", mounting="exact", priors={"kappa": 0.1}, ess=60
        )


def test_every_verb_is_a_function_and_every_name_is_there():
    for name in biaxbayes.__all__:
        assert getattr(biaxbayes, name) is not None
    elsewhere = {"simulate": "virtual_specimen", "check": "check_specimen"}
    for verb in VERBS:
        assert callable(getattr(biaxbayes, elsewhere.get(verb, verb)))
    with pytest.raises(AttributeError):
        _ = biaxbayes.nothing


def shown(thing) -> str:
    html = thing._repr_html_()
    assert html.count("<table") >= 1 and html.count("<table") == html.count("</table>")
    return html


def test_what_is_found_shows_itself(run, tmp_path):
    assert run.state in shown(run) and "<td>C1</td>" in shown(run)
    found = biaxbayes.identify(run)
    assert found["kappa"].verdict in shown(found)
    fitted = biaxbayes.fit(run.specimen, "standard")
    assert "standard" in shown(fitted)
    other = tmp_path / "other"
    shutil.copytree(run.path, other)
    both = biaxbayes.compare([run, other], labels=["a <b>", "c"])
    assert "a &lt;b&gt;" in shown(both) and "<b>" not in shown(both)
    with pytest.raises(InputError, match="labels"):
        biaxbayes.compare([run, other], labels=["a"])


def test_predictions_and_cards_come_as_tables(run, tmp_path):
    bands = biaxbayes.predict(run, stretch=1.1, ratio=(1.0, 0.5), points=5)
    assert isinstance(bands, pd.DataFrame) and len(bands) == 5
    x = np.array([1.02, 1.04])
    path = pd.DataFrame({"x": x, "y": x})
    assert len(biaxbayes.predict(run.path, path)) == 2
    with pytest.raises(InputError, match="either a path"):
        biaxbayes.predict(run)
    tube = biaxbayes.inflate(run, [5.0, 10.0], radius_mm=8.0, wall_mm=1.0)
    assert tube["pressure_kPa"].tolist() == [5.0, 10.0]
    cards = biaxbayes.export(run, "febio", draws=3, out=tmp_path / "cards")
    assert len(cards) == 3 and cards["check_relative_deviation"].max() < 1e-8
    with pytest.raises(InputError, match="no program"):
        biaxbayes.export(run, "ansys")


def test_figures_and_the_report_of_a_run(run):
    assert biaxbayes.plot(run, "corner", width_mm=85.0).axes
    with pytest.raises(InputError, match="no figure"):
        biaxbayes.plot(run, "pie")
    assert biaxbayes.report(run).name == "report.html"


def test_a_ledger_and_a_design(run):
    found = biaxbayes.ledger(run, ess=60.0)
    assert set(found.states) == {"inferred", "ignored", "zeroed"}
    assert "C1" in shown(found)
    assert "information" in shown(biaxbayes.design(run))


def test_a_study_of_files(tmp_path):
    (tmp_path / "broken.csv").write_text("nothing\n1\n")
    with pytest.raises(InputError, match="no option 'nois'"):
        biaxbayes.batch([tmp_path / "broken.csv"], out=tmp_path / "s", nois="x")
    found = biaxbayes.batch([tmp_path / "broken.csv"], out=tmp_path / "study", workers=1)
    assert found.states == {"failed": 1}
    assert "1 failed" in shown(found)
