"""A study in a folder: its file, done once, continued, and never stopped by one specimen."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import quick_posteriors
from biaxbayes.cluster import Cluster
from biaxbayes.errors import InputError, Interrupted, RunError
from biaxbayes.laws.goh import GOH
from biaxbayes.model.priors import Prior
from biaxbayes.parallel import Processes
from biaxbayes.runs.run import open_run
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.studies.study_file import DEFAULT_OPTIONS, read_study
from biaxbayes.studies.study_result import SpecimenOutcome
from biaxbayes.tasks import Executor, Outcome
from biaxbayes.verbs import batch as batch_module
from biaxbayes.verbs.batch import SpecimenTask, run_study, sample_specimen
from commands import refused, run

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
    return run_study(study, tmp_path_factory.mktemp("done") / "study")


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
    (reason,) = result.failures.values()
    assert "broken.csv" in reason and "\n" not in reason and not result.converged
    pytest.importorskip("pyarrow")
    parquet = pd.read_parquet(result.folder / "study.parquet")
    assert list(parquet.columns) == list(table.columns)
    np.testing.assert_allclose(
        parquet["q50"].astype(float).to_numpy(), table["q50"].to_numpy(), rtol=1e-7
    )


def test_specimens_are_compared_at_stretches_that_all_of_them_reached(result):
    table = result.table
    own = table[table["quantity"].str.startswith("stiffness_x at")]
    stretches = sorted({float(q.split(" at ")[1]) for q in own["quantity"]})
    assert len(stretches) == 3 and stretches[0] == 1.0
    assert stretches[1] - 1.0 == pytest.approx((stretches[2] - 1.0) / 2.0, abs=1e-3)
    converged = set(table.loc[table["state"] == "converged", "specimen"])
    for q in (
        f"{stem}_{axis} at {stretches[2]:g}" for stem in ("cauchy", "stiffness") for axis in "xy"
    ):
        part = table[table["quantity"] == q]
        assert set(part["specimen"]) == converged and (part["q05"] < part["q95"]).all()
    assert set(result.groups["group"]) == {"media", "intima", "D <i>1</i>", "all"}


def test_a_repeat_writes_the_same_files_without_sampling_again(result, study):
    def files(*patterns):
        return sorted(path for p in patterns for path in result.folder.glob(p))

    before = {path: path.stat().st_mtime_ns for path in files("runs/*/posterior.nc")}
    tables = {path: path.read_bytes() for path in files("study*.csv", "study.html")}
    assert len(before) == 2 and len(tables) > 2
    (result.folder / "study.csv").unlink()
    (result.folder / "study.html").write_text("changed")
    again = run_study(study, result.folder)
    pd.testing.assert_frame_equal(again.table, result.table)
    assert {path: path.read_bytes() for path in files("study*.csv", "study.html")} == tables
    assert {path: path.stat().st_mtime_ns for path in files("runs/*/posterior.nc")} == before


def test_other_options_or_data_are_sampled_again(result, study, monkeypatch, tmp_path):
    folder = shutil.copytree(result.folder, tmp_path / "study")
    seen: list[SpecimenTask] = []

    def note(task):
        seen.append(task)
        return SpecimenOutcome("failed", "not tried", [])

    monkeypatch.setattr(batch_module, "sample_specimen", note)
    first, broken, last = study.specimens
    run_study(replace(study, specimens=(replace(first, seed=2), broken, last)), folder)
    assert {t.folder.name: t.finished for t in seen} == {"media": False, "intima": True}
    seen.clear()
    # Fingerprints of before must not come back with the options of before.
    assert len(json.loads((folder / "study.json").read_text())["done"]) == 1
    run_study(replace(study, ess=70.0), folder)
    assert not any(t.finished for t in seen)


@pytest.mark.long
def test_an_interrupted_study_continues_to_the_same_numbers(result, study, tmp_path):
    first = replace(study, specimens=study.specimens[:1])
    arguments = []

    class Stopped(Executor):
        """Asked to stop while its task is under way."""

        def run(self, function, tasks, *, stop=lambda: False):
            if function is not sample_specimen:
                return
            [task] = tasks
            outcome = function(replace(task, running=_GoneLater()))
            arguments.append(True)
            assert stop()
            yield Outcome(0, outcome)

    with pytest.raises(Interrupted, match=r"0 of 1 specimens.*the same command"):
        run_study(first, tmp_path / "study", Stopped(), stop=lambda: bool(arguments))
    assert (tmp_path / "study" / "runs" / "media" / "checkpoint.npz").is_file()
    assert not (tmp_path / "study" / "runs" / "media" / "summary.csv").exists()
    run_study(first, tmp_path / "study")
    ours, whole = (
        p / "runs" / "media" / "summary.csv" for p in (tmp_path / "study", result.folder)
    )
    assert ours.read_bytes() == whole.read_bytes()


class Replaced(Executor):
    """What becomes of each task is given."""

    def __init__(self, outcome):
        self.outcome = outcome

    def run(self, function, tasks, *, stop=lambda: False):
        for index, task in enumerate(tasks):
            yield Outcome(index, *self.outcome(task))


class _GoneLater:
    """A file that is there when a task begins, and then is not."""

    calls = 0

    def exists(self):
        self.calls += 1
        return self.calls <= 2


@pytest.mark.long
def test_processes_and_a_cluster_write_the_same_bytes(study, scheduler, tmp_path):
    one, found = replace(study, specimens=study.specimens[:1]), []
    for executor in (Processes(2), Cluster(scheduler)):
        folder = tmp_path / type(executor).__name__
        assert not run_study(one, folder, executor).failures
        written = [*sorted(folder.glob("study*.csv")), folder / "runs" / "media" / "summary.csv"]
        found.append({path.name: path.read_bytes() for path in written})
    assert found[0] == found[1] and len(found[0]) > 2


def test_a_worker_that_is_lost_costs_one_specimen(study, tmp_path):
    losing = Replaced(lambda task: (None, "its worker process died 3 times"))
    outcome = run_study(study, tmp_path / "study", losing)
    assert outcome.states == {"failed": 3}
    assert sum("died 3 times" in reason for reason in outcome.failures.values()) == 2
    assert (tmp_path / "study" / "study.html").is_file()
    assert not (tmp_path / "study" / "study-specimens.png").exists()


def test_a_folder_that_a_worker_does_not_see_is_named(study, tmp_path):
    gone = tmp_path / "not" / "mounted"
    away = Replaced(lambda task: (sample_specimen(replace(task, running=gone)),))
    with pytest.raises(RunError, match="does not see the study folder"):
        run_study(study, tmp_path / "study", away)


def test_a_foreign_folder_is_left_alone(study, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(RunError, match="is not a study folder"):
        run_study(study, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["study.toml", "--noise", "correlated"], "--noise is for CSV files"),
        (["study.toml", "--ess", "100"], "under ess"),
        (["study.toml", "media.csv"], "a study file cannot be combined"),
        (["none.toml"], "no such file"),
        (["media.csv", "none.csv"], "no such file"),
        (["media.csv", "--mounting-force", "1", "1"], "belongs to one specimen"),
        (["media.csv", "--workers", "0"], "--workers must be at least 1"),
        (["media.csv", "--workers", "2", "--scheduler", "tcp://x:1"], "either"),
        (["media.csv", "--ess", "1"], "--ess must be"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(study, words, message, monkeypatch, capsys):
    monkeypatch.chdir(study.specimens[0].file.parent)
    assert message in refused(capsys, "batch", *words)


def test_the_command_ends_with_3_and_names_the_failures(result, study, monkeypatch, capsys):
    monkeypatch.chdir(study.specimens[0].file.parent)
    words = ("broken.csv", "--workers", 1, "--out", result.folder.parent / "b")
    code, out, err = run(capsys, "batch", *words)
    assert code == 3 and "1 specimen: 1 failed" in out
    assert err.count("\n") == 1 and "broken" in err


# --- study files ---

WHOLE = """
name = "three"
seed = 7
ess = 300
max_steps = 4000

[options]
noise = "independent"
max_rows = 80

[priors]
kappa = 0.2

[[specimen]]
file = "a.csv"

[[specimen]]
file = "sub/b.csv"
label = "second one"
donor = "D2"
layer = "media"
seed = 8
mounting_force = [0.015, 0]
options = { mounting = "zeroed", fibre_switch = true }

[specimen.priors]
kappa = 0.0
alpha = { distribution = "normal", mean = 41, sd = 3 }
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "sub").mkdir()
    for name in ("a.csv", "sub/b.csv"):
        (tmp_path / name).write_text("not read here\n")
    return tmp_path


def written(folder, text):
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_specimens_take_what_is_common_and_replace_what_is_their_own(folder):
    study = read_study(written(folder, WHOLE))
    assert (study.name, study.ess, study.max_steps) == ("three", 300.0, 4000)
    first, second = study.specimens
    assert first.file == folder / "a.csv"
    assert (first.label, first.donor, first.layer, first.seed) == ("a", None, None, 7)
    own = {"noise": "independent", "max_rows": 80, "priors": {"kappa": 0.2}}
    assert first.options == {**DEFAULT_OPTIONS, **own}
    told = (second.label, second.donor, second.layer, second.seed)
    assert told == ("second one", "D2", "media", 8)
    assert second.mounting_force == (0.015, 0.0)
    assert second.options["mounting"] == "zeroed" and second.options["fibre_switch"] is True
    assert second.options["noise"] == "independent"
    assert second.options["priors"]["kappa"] == 0.0
    assert isinstance(second.options["priors"]["alpha"], Prior)


A = '[[specimen]]\nfile = "a.csv"\n'
BAD = {
    "": "is empty; write its settings",
    "# nothing": "lists no specimen",
    "x =": "not valid TOML",
    "specimen = [3]": "specimen 1: is not a table",
    "sede = 3\n" + A: "'sede' is not a key of a study",
    "seed = -1\n" + A: "seed must be a whole number from 0",
    "ess = true\n" + A: "ess must be a number",
    'options = "x"\n' + A: "options must be a table",
    "[options]\nnoise = 'misfitt'\n" + A: "options: noise must be one of correlated,",
    "[options]\nnois = 'correlated'\n" + A: "'nois' is not a key of options",
    "[options]\nfibre_switch = 1\n" + A: "options: fibre_switch must be true or false",
    "[priors]\nkapa = 0.1\n" + A: "priors: unknown parameter 'kapa'",
    "[[specimen]]\n": "specimen 1: file must be the path",
    '[[specimen]]\nfile = "\\u0000"\n': "specimen 1: file must be the path",
    A + '[[specimen]]\nfile = "c.csv"\n': "specimen 2: file: no such file: ",
    A + A: "specimen 2: label 'a' is that of specimen 1",
    A + 'lable = "x"\n': "'lable' is not a key of specimen 1",
    A + 'layer = "  "\n': "specimen 1: layer must be text",
    A + "mounting_force = 3\n": "specimen 1: mounting_force must be two numbers",
    A + "priors = { alpha = 'x' }\n": "specimen 1: priors: alpha cannot be tied",
}


@pytest.mark.parametrize("text", BAD)
def test_what_cannot_be_used_is_one_line_with_file_and_key(folder, text):
    with pytest.raises(InputError) as raised:
        read_study(written(folder, text))
    message = str(raised.value)
    assert "\n" not in message and "study.toml" in message and BAD[text] in message
