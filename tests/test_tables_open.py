"""Every CSV of a run opens anywhere: a line of names, then rows; thresholds in the provenance."""

import csv
import hashlib
import shutil

import pandas as pd
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes.reports.facts import closing_message
from biaxbayes.runs.run import COLUMNS, read_summary, write_summary
from biaxbayes.text_files import read_csv, write_csv
from biaxbayes.verbs.report import report_text


def plain(path) -> list[list[str]]:
    """Rows as a spreadsheet or R sees them, all of one width."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len({len(row) for row in rows}) == 1, path.name
    assert all(name and name.replace("_", "a").isalnum() for name in rows[0]), path.name
    return rows


def test_every_table_of_a_run_and_its_verbs_opens_as_it_is(media_run, tmp_path):
    biaxbayes.identify(media_run, out=tmp_path, figure=False)
    tables = [media_run.path / "summary.csv", media_run.path / "identifiability.csv"]
    tables += sorted(tmp_path.glob("*.csv"))
    assert {"determined.csv", "same-curves.csv"} <= {p.name for p in tables}
    for path in tables:
        assert len(plain(path)) > 1


@pytest.mark.long
def test_every_table_that_a_verb_writes_has_a_plain_header(small_run, tmp_path):
    one, other, out = (tmp_path / name for name in ("one", "other", "out"))
    for folder in (one, other):
        shutil.copytree(small_run.path, folder)
    specimen = one / "specimen.csv"
    with quick_posteriors.runs_without_figures():
        biaxbayes.fit(specimen, "all", starts=1, out=out / "fit")
        biaxbayes.profile(one, ["k1"], out=out / "profile")
        biaxbayes.predict(one, stretch=1.1, out=out / "predict", anyway=True)
        biaxbayes.inflate(one, [5.0], radius_mm=8.0, wall_mm=1.0, out=out / "tube", anyway=True)
        biaxbayes.export(one, "febio", draws=2, out=out / "cards", anyway=True)
        biaxbayes.compare([one, other], labels=["a", "b"], anyway=True, out=out / "compare")
        (tmp_path / "broken.csv").write_text("nothing\n1\n")
        biaxbayes.batch([tmp_path / "broken.csv"], out=out / "study", workers=1)
    written = {p.relative_to(out) for p in out.rglob("*.csv")}
    tables = sorted(p for p in written if p.name != "specimen.csv")
    stems = {"fits", "profile", "profile-intervals", "manifest", "study", "prediction", "inflation"}
    assert stems <= {p.stem for p in tables} and len(tables) >= 9
    for path in tables:
        assert plain(out / path), path


def test_verdicts_stand_in_the_summary_and_thresholds_in_the_provenance(media_run):
    summary = pd.read_csv(media_run.path / "summary.csv").set_index("parameter")
    verdicts = pd.read_csv(media_run.path / "identifiability.csv").set_index("parameter")
    assert (*summary.reset_index().columns,) == COLUMNS
    for name, verdict in verdicts["verdict"].items():
        assert summary.loc[name, "verdict"] == verdict
    assert summary["verdict"].isna().sum() == len(summary) - len(verdicts)
    found = media_run.provenance["identifiability"]
    assert found["thresholds"]["edge_support"] == 0.147 and "kappa" in found["near_an_edge"]


def test_a_folder_with_the_tables_of_before_still_opens(media_run, copied):
    folder = copied(media_run.path)
    path = folder / "identifiability.csv"
    now = path.read_text()
    before = "# identifiability of 400 draws\n#   thresholds: edge_support = 0.147\n" + now
    path.write_text(before)
    pd.testing.assert_frame_equal(read_csv(path), pd.read_csv(media_run.path / path.name))
    assert closing_message(biaxbayes.open_run(folder)) == closing_message(media_run).replace(
        str(media_run.path), str(folder)
    )
    page = report_text(biaxbayes.open_run(folder))
    assert page == report_text(media_run)
    # A summary without verdicts
    provenance = folder / "provenance.json"
    summary = pd.read_csv(folder / "summary.csv").drop(columns="verdict")
    summary.to_csv(folder / "summary.csv", index=False)
    text = provenance.read_text()
    old = media_run.provenance["files"]["summary.csv"]
    new = hashlib.sha256((folder / "summary.csv").read_bytes()).hexdigest()
    provenance.write_text(text.replace(old, new))
    assert biaxbayes.open_run(folder).summary["verdict"].isna().all()


TEXTS = ["=1+1", "+1+1", "-2+3", "@SUM(A1)", "\t=1+1", "'=1+1", "'tis", "plain", "-1.5", "+2e3"]


def test_a_spreadsheet_computes_nothing_and_texts_read_back_as_they_were(tmp_path):
    table = pd.DataFrame({"=label": TEXTS, "value": [-1.5] * len(TEXTS)})
    write_csv(tmp_path / "table.csv", table)
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    for cell in (*head, *(row[0] for row in rows)):
        assert not cell.startswith(("=", "+", "-", "@", "\t")) or float(cell)
    assert [row[0] for row in rows[-2:]] == TEXTS[-2:]  # numbers stay numbers
    assert {row[1] for row in rows} == {"-1.5"}
    back = read_csv(tmp_path / "table.csv", dtype={"'=label": str})
    pd.testing.assert_frame_equal(back, table, check_dtype=False)


def test_a_summary_with_formulas_reads_back_as_it_was(tmp_path):
    row = dict.fromkeys(COLUMNS, -1.5) | {"parameter": "=C1", "unit": "+kPa", "verdict": "@known"}
    write_summary(tmp_path / "summary.csv", pd.DataFrame([row]))
    assert "=C1" in (tmp_path / "summary.csv").read_text()
    assert read_summary(tmp_path / "summary.csv").to_dict("records") == [row]
