"""Every CSV of a run opens anywhere: a line of names, then rows; thresholds in the provenance."""

import csv
import shutil

import pandas as pd
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes.runs.run import COLUMNS
from biaxbayes.text_files import read_csv, write_csv


def plain(path) -> list[list[str]]:
    """Rows as a spreadsheet or R sees them, all of one width."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len({len(row) for row in rows}) == 1, path.name
    assert all(name and name.replace("_", "a").isalnum() for name in rows[0]), path.name
    return rows


def test_every_table_of_a_run_and_its_verbs_opens_as_it_is(media_run, tmp_path):
    biaxbayes.identify(media_run, out=tmp_path, figure=False)
    tables = [media_run.path / "summary.csv", *sorted(tmp_path.rglob("*.csv"))]
    assert {"report.csv", "determined.csv", "same-curves.csv"} <= {p.name for p in tables}
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


def test_the_summary_is_within_the_law_and_thresholds_are_in_the_result(media_run):
    summary = pd.read_csv(media_run.path / "summary.csv")
    assert (*summary.columns,) == COLUMNS and set(summary["posterior_within"]) == {"GOH"}
    assert media_run.result.thresholds["edge_support"] == 0.147


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
