"""A study in a folder: done once, continued, and never stopped by one specimen."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import quick_posteriors
from biaxbayes.cli import main
from biaxbayes.comparison import compare as compare_module
from biaxbayes.comparison.compare import distances_between, judged_member
from biaxbayes.errors import Interrupted, RunError
from biaxbayes.executors.executor import InThisProcess, Outcome
from biaxbayes.jobs.batch import study as batch_module
from biaxbayes.jobs.batch import tasks as tasks_module
from biaxbayes.jobs.batch.study import Batch
from biaxbayes.jobs.batch.tasks import LayerTask, SpecimenTask, layers_before, try_specimen
from biaxbayes.laws.goh import GOH
from biaxbayes.runs import said as said_module
from biaxbayes.runs.run import open_run
from biaxbayes.runs.said import IDENTIFIED, IDENTIFIED_TABLES
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.studies import rows as rows_module
from biaxbayes.studies.result import LayersFound, Tried
from biaxbayes.studies.rows import rows_of_run
from biaxbayes.studies.study_file import read_study

LAYERS = ("media", "intima")
MEDIA = GOH(C1_kPa=14.0, k1_kPa=60.0, k2=8.0, alpha_deg=38.0, kappa=0.1)
INTIMA = GOH(C1_kPa=30.0, k1_kPa=120.0, k2=12.0, alpha_deg=55.0, kappa=0.1)
STUDY = """
name = "two layers & <one> failure"
ess = 60
max_steps = 600
options = { noise = "independent", mounting = "exact" }
priors = { kappa = 0.1 }

[[specimen]]
file = "media.csv"
donor = "D <i>1</i>"
layer = "media"

[[specimen]]
file = "broken.csv"
label = "<script>alert(1)</script>"

[[specimen]]
file = "intima.csv"
donor = "D <i>1</i>"
layer = "intima"
"""


@pytest.fixture(scope="module", autouse=True)
def quick_runs():
    with quick_posteriors.runs_without_figures():
        yield


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("specimens")
    for name, material in (("media", MEDIA), ("intima", INTIMA)):
        data = quick_posteriors.specimen(material, increments=8)
        write_specimen(replace(data, name=name), folder / f"{name}.csv")
    (folder / "broken.csv").write_text("stretch_x,stretch_y\n1,1\n1.1,1.1\n")
    (folder / "study.toml").write_text(STUDY)
    return read_study(folder / "study.toml")


@pytest.fixture(scope="module")
def result(study, tmp_path_factory):
    return Batch(study, tmp_path_factory.mktemp("done") / "study").execute()


@pytest.mark.long
def test_one_failure_stops_nobody_and_is_named(result):
    states = dict(zip(result.specimens["specimen"], result.specimens["state"], strict=True))
    assert states["<script>alert(1)</script>"] == "failed"
    assert set(states.values()) <= {"converged", "tentative", "failed"}
    assert not result.converged
    [reason] = result.failures.values()
    assert "broken.csv" in reason and "\n" not in reason


def test_the_table_says_what_the_runs_say(result):
    table = pd.read_csv(result.folder / "study.csv")
    assert not table.duplicated(["specimen", "quantity"]).any()
    media = table[table["specimen"] == "media"].set_index("quantity")
    run = open_run(result.folder / "runs" / "media")
    assert media.loc["C1", "q50"] == pytest.approx(run.draws["C1"].median(), rel=1e-6)
    assert media.loc["C1", "scale_sd"] == pytest.approx(np.log(run.draws["C1"]).std(ddof=0))
    assert media.loc["kappa", "verdict"] == "fixed"
    # Hx = kappa + (1 - 3 kappa) cos^2 alpha, at the fixed kappa
    Hx = 0.1 + 0.7 * np.cos(np.deg2rad(run.draws["alpha"])) ** 2
    assert media.loc["Hx", "q50"] == pytest.approx(np.median(Hx), rel=1e-3)
    assert set(media["state"]) == {run.state}
    failed = table[table["state"] == "failed"]
    assert list(failed["quantity"]) == ["C1", "k1", "k2", "alpha", "kappa"]
    assert failed["q50"].isna().all() and failed["reason"].str.contains("broken").all()
    pytest.importorskip("pyarrow")
    parquet = pd.read_parquet(result.folder / "study.parquet")
    assert list(parquet.columns) == list(table.columns)
    np.testing.assert_allclose(
        parquet["q50"].astype(float).to_numpy(), table["q50"].to_numpy(), rtol=1e-7
    )


def test_layers_of_a_donor_are_compared(result):
    pair = result.distances[result.distances["quantity"] == "C1"].iloc[0]
    assert (pair.donor, pair.layer_a, pair.layer_b) == ("D <i>1</i>", "media", "intima")
    apart = pair.median_b - pair.median_a
    assert apart == pytest.approx(16.0, abs=8.0)
    assert set(result.groups["group"]) == {"media", "intima", "D <i>1</i>", "all"}


def test_the_page_needs_nothing_and_believes_nobody(result):
    page = (result.folder / "study.html").read_text()
    assert "<script" not in page and "<i>1" not in page and "<one>" not in page
    assert not re.search(r'src="(?!data:)', page)
    links = re.findall(r'href="([^#d][^"]*)"', page)
    assert links == ["runs/media/report.html", "runs/intima/report.html"]
    assert all((result.folder / link).is_file() for link in links)


def test_what_is_finished_is_read_and_not_sampled_again(result, study):
    def archives():
        found = sorted(result.folder.glob("runs/*/posterior.nc"))
        return {path: path.stat().st_mtime_ns for path in found}

    before = archives()
    assert len(before) == 2
    again = Batch(study, result.folder).execute()
    assert archives() == before
    pd.testing.assert_frame_equal(again.table, result.table)


class Nobody(InThisProcess):
    """Workers who must not be asked."""

    def run(self, function, tasks, *, stop=lambda: False):
        assert not tasks
        yield from ()


def test_a_repeat_starts_no_worker_and_writes_nothing_again(result, study):
    def written():
        found = {p.name: p.stat().st_mtime_ns for p in result.folder.glob("study*")}
        return {name: time for name, time in found.items() if name != "study.json"}

    Batch(study, result.folder).execute()
    before = written()
    assert {"study.csv", "study.html", "study-distances.csv"} <= set(before)
    Batch(study, result.folder, Nobody()).execute()
    assert written() == before
    (result.folder / "study.csv").unlink()
    (result.folder / "study.html").write_text("changed")
    Batch(study, result.folder, Nobody()).execute()
    assert set(written()) == set(before)
    assert (result.folder / "study.html").read_text() != "changed"


def test_a_repeat_opens_no_draws_unless_something_has_changed(result, study, monkeypatch):
    opened = []

    def rows(run):
        opened.append(run.path.name)
        return rows_of_run(run)

    monkeypatch.setattr(rows_module, "rows_of_run", rows)
    kept = result.folder / "runs" / "media" / "study-rows.json"
    verdicts = kept.with_name("identifiability.csv")

    def repeated():
        opened.clear()
        again = Batch(study, result.folder, Nobody()).execute()
        pd.testing.assert_frame_equal(again.table, result.table)
        return opened

    assert repeated() == []
    whole = kept.read_text()
    for changed in ("", "{}", whole.replace('"rows"', '"said"')):
        kept.write_text(changed)
        assert repeated() == ["media"] and kept.read_text() == whole
    record = json.loads(whole)
    for rows_in_file in ("none", [1], [{"C1": 1.0}], [{"q50": "3.0"}], [{"state": None}]):
        kept.write_text(json.dumps(record | {"said": {"rows": rows_in_file}}))
        assert repeated() == ["media"] and kept.read_text() == whole
    text = verdicts.read_text()
    try:
        verdicts.write_text(text + "\n")  # no row more
        assert repeated() == ["media"] and repeated() == []
    finally:
        verdicts.write_text(text)


@pytest.fixture
def comparisons(monkeypatch):
    """Labels of the runs whose layers were compared anew."""
    compared = []

    def between(members, verdicts):
        compared.append([m.label for m in members])
        return distances_between(members, verdicts)

    monkeypatch.setattr(compare_module, "distances_between", between)
    return compared


def tables_of(folder):
    """Tables of a study, byte for byte, and its page."""
    found = [*folder.glob("study*.csv"), folder / "study.html"]
    return {path.name: path.read_bytes() for path in found}


def test_a_repeat_compares_nothing_and_says_the_same(result, study, comparisons):
    kept = result.folder / "runs" / "media" / "study-layers.json"
    before = Batch(study, result.folder).execute()
    files = tables_of(result.folder)
    kept.unlink()
    comparisons.clear()
    computed = Batch(study, result.folder).execute()
    assert comparisons == [["media", "intima"]]
    for name in files:  # so that they are written again, of what was kept
        (result.folder / name).unlink()
    again = Batch(study, result.folder).execute()
    assert comparisons == [["media", "intima"]]
    assert tables_of(result.folder) == files
    for found in (computed, again):
        pd.testing.assert_frame_equal(found.distances, before.distances, check_exact=True)
        assert found.notes == before.notes


@pytest.mark.parametrize("label", ["media", "intima"])
@pytest.mark.parametrize("name", ["identifiability.csv", "law-fits.csv", "provenance.json"])
def test_layers_are_compared_anew_when_a_run_is_another(result, study, comparisons, label, name):
    Batch(study, result.folder).execute()
    comparisons.clear()
    path = result.folder / "runs" / label / name
    there = path.read_bytes() if path.is_file() else None
    try:
        path.write_bytes((there or b"#") + b"\n")
        Batch(study, result.folder).execute()
        assert comparisons == [["media", "intima"]]
        Batch(study, result.folder).execute()
        assert len(comparisons) == 1
    finally:
        path.unlink() if there is None else path.write_bytes(there)


@pytest.mark.parametrize("label", ["media", "intima"])
@pytest.mark.parametrize("name", ["posterior.nc", "summary.csv", "specimen.csv", "edges.csv"])
def test_nothing_is_said_again_of_layers_whose_draws_are_others(result, study, label, name):
    Batch(study, result.folder).execute()
    folders = tuple(result.folder / "runs" / label for label in LAYERS)
    task = LayerTask("D", LAYERS, LAYERS, folders)
    assert layers_before(task) is not None
    path = result.folder / "runs" / label / name
    there = path.read_bytes() if path.is_file() else None
    try:
        path.write_bytes((there or b"") + b"1")
        assert layers_before(task) is None
    finally:
        path.unlink() if there is None else path.write_bytes(there)
    assert layers_before(task) is not None


def test_layers_are_compared_anew_by_other_code(result, study, comparisons, monkeypatch):
    Batch(study, result.folder).execute()
    comparisons.clear()
    monkeypatch.setattr(said_module, "_digest_of_code", lambda: "another")
    Batch(study, result.folder).execute()
    Batch(study, result.folder).execute()
    assert comparisons == [["media", "intima"]]


def test_other_donors_and_layers_are_said_of_the_same_comparison(result, study, comparisons):
    Batch(study, result.folder).execute()
    comparisons.clear()
    other = [replace(s, donor="D2", layer=f"{s.layer} 2") for s in study.specimens]
    found = Batch(replace(study, specimens=tuple(other)), result.folder).execute()
    assert comparisons == [] and set(found.distances["donor"]) == {"D2"}
    assert set(found.distances["layer_a"]) == {"media 2"}
    turned = replace(study, specimens=study.specimens[::-1])
    found = Batch(turned, result.folder).execute()
    assert comparisons == [["intima", "media"]] and set(found.distances["run_a"]) == {"intima"}


def changed(record, **said):
    return json.dumps(record | {"said": record["said"] | said})


def test_a_damaged_or_hostile_comparison_is_made_anew(result, study, monkeypatch, tmp_path):
    kept = result.folder / "runs" / "media" / "study-layers.json"
    before = Batch(study, result.folder).execute()
    comparisons = []

    def between(members, verdicts):
        comparisons.append(members)
        drop = ["donor", "layer_a", "layer_b"]
        return before.distances.drop(columns=drop), list(before.notes)

    monkeypatch.setattr(tasks_module, "_members", lambda task: (task.labels, ()))
    monkeypatch.setattr(compare_module, "distances_between", between)
    whole = kept.read_text()
    record = json.loads(whole)
    first, *rest = record["said"]["distances"]
    texts = ["", "{}", "[]", "\0", whole[:-40], "[" * 100_000, whole.replace('"said"', '"of"')]
    rows = ["none", None, [], [1], [[]], [{}], [first | {"more": 1.0}]]
    for column, value in (
        ("run_a", "another"),
        ("quantity", 1.0),
        ("quantity", "\ud800"),
        ("quantity", "C1\n"),
        ("unit", None),
        ("median_a", "3.0"),
        ("median_a", 10**400),
        ("determined_in_both", 1.0),
        ("total_stretch", []),
    ):
        rows.append([first | {column: value}, *rest])
    texts += [changed(record, distances=wrong) for wrong in rows]
    texts += [changed(record, notes=wrong) for wrong in (None, "none", [1], ["\ud800"])]
    texts += [changed(record, labels=wrong) for wrong in (None, [], ["intima", "media"])]
    for count, text in enumerate(texts, start=1):
        kept.write_text(text)
        found = Batch(study, result.folder).execute()
        assert len(comparisons) == count and kept.read_text() == whole, text[:200]
        pd.testing.assert_frame_equal(found.distances, before.distances, check_exact=True)
    elsewhere = tmp_path / "mine.json"
    elsewhere.write_text(whole)
    kept.unlink()
    kept.symlink_to(elsewhere)  # not followed, neither to read nor to write
    Batch(study, result.folder).execute()
    assert len(comparisons) == len(texts) + 1
    assert not kept.is_symlink() and kept.read_text() == whole == elsewhere.read_text()


@pytest.mark.long
def test_verdicts_of_a_comparison_are_those_that_identify_said(result, study, monkeypatch):
    runs = result.folder / "runs"
    judged = []

    def judge(member):
        judged.append(member.label)
        return judged_member(member)

    monkeypatch.setattr(compare_module, "judged_member", judge)
    before = Batch(study, result.folder).execute()

    def compared():
        judged.clear()
        (runs / "media" / "study-layers.json").unlink()
        found = Batch(study, result.folder).execute()
        pd.testing.assert_frame_equal(found.distances, before.distances, check_exact=True)
        return judged

    assert compared() == ["media", "intima"]  # runs without what identify says
    for label in ("media", "intima"):
        table = pd.read_csv(runs / label / "identifiability.csv")
        told = {"parameters": table[["parameter", "verdict"]].to_dict("records")}
        said_module.keep_said(runs / label, IDENTIFIED, IDENTIFIED_TABLES, {"json": told})
    assert compared() == []
    kept = runs / "intima" / "identify.json"
    record = json.loads(kept.read_text())
    told = record["said"]["json"]["parameters"]
    try:
        for wrong in (None, {}, [], [1], [{"parameter": "C1"}], told[1:]):
            kept.write_text(changed(record, json={"parameters": wrong}))
            assert compared() == ["intima"], wrong
    finally:
        for label in ("media", "intima"):
            (runs / label / IDENTIFIED).unlink()
    assert compared() == ["media", "intima"]


def spy(monkeypatch):
    """Tasks that are handed out, each ending as if its run folder had gone."""
    seen: list[SpecimenTask] = []

    def note(task):
        seen.append(task)
        return Tried("failed", "not tried", [])

    monkeypatch.setattr(tasks_module, "try_specimen", note)
    return seen


def test_other_options_or_data_are_sampled_again(result, study, monkeypatch):
    seen = spy(monkeypatch)
    first, broken, last = study.specimens
    changed = replace(study, specimens=(replace(first, seed=2), broken, last))
    record = (result.folder / "study.json").read_text()
    try:
        Batch(changed, result.folder).execute()
        assert {t.source: t.finished for t in seen} == {"media.csv": False, "intima.csv": True}
        seen.clear()
        # Fingerprints of before must not come back with the options of before.
        assert len(json.loads((result.folder / "study.json").read_text())["done"]) == 1
        Batch(replace(study, ess=70.0), result.folder).execute()
        assert not any(t.finished for t in seen)
    finally:
        (result.folder / "study.json").write_text(record)


def test_an_interrupted_study_continues_to_the_same_numbers(result, study, tmp_path):
    first = replace(study, specimens=study.specimens[:1])
    asked = []

    class Stopped(InThisProcess):
        """Asked to stop while its task is under way."""

        def run(self, function, tasks, *, stop=lambda: False):
            [task] = tasks
            found = function(replace(task, going=_GoneLater()))
            asked.append(True)
            assert stop()
            yield Outcome(0, found)

    with pytest.raises(Interrupted, match=r"0 of 1 specimens.*the same command"):
        Batch(first, tmp_path / "study", Stopped()).execute(stop=lambda: bool(asked))
    assert (tmp_path / "study" / "runs" / "media" / "checkpoint.npz").is_file()
    assert not (tmp_path / "study" / "runs" / "media" / "summary.csv").exists()
    Batch(first, tmp_path / "study").execute()
    ours, whole = (
        p / "runs" / "media" / "summary.csv" for p in (tmp_path / "study", result.folder)
    )
    assert ours.read_bytes() == whole.read_bytes()


class _GoneLater:
    """A file that is there when a task begins, and then is not."""

    asked = 0

    def exists(self):
        self.asked += 1
        return self.asked <= 2


class Noting(InThisProcess):
    """Workers that note what they do."""

    def __init__(self):
        self.did = []

    def get_ready(self):
        self.did.append("get ready")

    def run(self, function, tasks, *, stop=lambda: False):
        for outcome in super().run(function, tasks, stop=stop):
            self.did.append(type(tasks[outcome.index]).__name__)
            yield outcome


def test_workers_compare_and_draw_behind_the_specimens_and_write(
    result, study, monkeypatch, tmp_path
):
    rows = {f"{name}.csv": rows_of_run(open_run(result.folder / "runs" / name)) for name in LAYERS}
    saved = {source: Tried(r[0]["state"], r[0]["reason"], r) for source, r in rows.items()}
    monkeypatch.setattr(tasks_module, "try_specimen", lambda task: saved[task.source])
    Batch(study, result.folder).execute()  # what other tests changed
    workers = Noting()
    found = Batch(study, tmp_path / "study", workers).execute()
    specimens, behind = ["SpecimenTask"] * 2, ["LayerTask", "FigureTask", "WritingTask"]
    assert workers.did == ["get ready", *specimens, *behind]
    pd.testing.assert_frame_equal(found.table, result.table)
    pictures = {p.name: p.read_bytes() for p in (tmp_path / "study").glob("study-specimens.*")}
    assert len(pictures) == 2
    for name, content in pictures.items():  # as they are drawn in this process
        assert (result.folder / name).read_bytes() == content


def test_a_stop_when_all_is_sampled_costs_no_comparison(result, study, tmp_path, monkeypatch):
    class Stopped(Noting):
        def run(self, function, tasks, *, stop=lambda: False):
            for outcome in super().run(function, tasks):
                yield outcome
                if len(self.did) == 3:
                    return

    compared = []

    def compare(task):
        compared.append(task.labels)
        return LayersFound(task.donor, result.distances, [])

    rows = {f"{name}.csv": rows_of_run(open_run(result.folder / "runs" / name)) for name in LAYERS}
    monkeypatch.setattr(
        tasks_module, "try_specimen", lambda task: Tried("converged", "", rows[task.source])
    )
    monkeypatch.setattr(batch_module, "compare_layers", compare)
    found = Batch(study, tmp_path / "study", Stopped()).execute(stop=lambda: True)
    assert compared == [("media", "intima")]
    pd.testing.assert_frame_equal(found.distances, result.distances)
    assert (tmp_path / "study" / "study.html").is_file()


def test_a_worker_that_is_lost_costs_one_specimen(study, tmp_path):
    class Losing(InThisProcess):
        def run(self, function, tasks, *, stop=lambda: False):
            for index, _ in enumerate(tasks):
                yield Outcome(index, None, "its worker process died 3 times")

    found = Batch(study, tmp_path / "study", Losing()).execute()
    assert found.states == {"failed": 3}
    assert sum("died 3 times" in reason for reason in found.failures.values()) == 2
    assert (tmp_path / "study" / "study.html").is_file()
    assert not (tmp_path / "study" / "study-specimens.png").exists()


def test_a_folder_that_a_worker_does_not_see_is_said(study, tmp_path):
    class Elsewhere(InThisProcess):
        def run(self, function, tasks, *, stop=lambda: False):
            for index, task in enumerate(tasks):
                gone = tmp_path / "not" / "mounted"
                yield Outcome(index, try_specimen(replace(task, going=gone)))

    with pytest.raises(RunError, match="does not see the study folder"):
        Batch(study, tmp_path / "study", Elsewhere()).execute()


def test_a_foreign_folder_is_left_alone(study, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(RunError, match="not a study's"):
        Batch(study, tmp_path).execute()
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["study.toml", "--noise", "effective"], "--noise is for CSV files"),
        (["study.toml", "--ess", "100"], "under ess"),
        (["study.toml", "media.csv"], "a study file stands alone"),
        (["none.toml"], "no such file"),
        (["media.csv", "none.csv"], "no such file"),
        (["media.csv", "--mounting-force", "1", "1"], "of one specimen"),
        (["media.csv", "--workers", "0"], "--workers must be at least 1"),
        (["media.csv", "--workers", "2", "--scheduler", "tcp://x:1"], "both"),
        (["media.csv", "--ess", "1"], "--ess must be"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(study, words, said, monkeypatch, capsys):
    monkeypatch.chdir(study.specimens[0].file.parent)
    with pytest.raises(SystemExit) as ended:
        main(["batch", *words])
    assert ended.value.code == 2
    told = capsys.readouterr().err.strip()
    assert said in told and "\n" not in told


def test_the_command_ends_with_3_and_names_the_failures(result, study, monkeypatch, capsys):
    monkeypatch.chdir(study.specimens[0].file.parent)
    with pytest.raises(SystemExit) as ended:
        main(["batch", "broken.csv", "--workers", "1", "--out", str(result.folder.parent / "b")])
    assert ended.value.code == 3
    out, err = capsys.readouterr()
    assert "1 specimens: 1 failed" in out
    assert err.count("\n") == 1 and "broken" in err
