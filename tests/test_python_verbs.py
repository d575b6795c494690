"""The verbs as functions: plain objects, that show themselves in a notebook."""

import inspect
import io
import json
import re
import shutil
import sys
import time
import types
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import biaxbayes
import commands
from biaxbayes.cli import VERBS
from biaxbayes.errors import InputError
from biaxbayes.progress_bar import Pace, Progress, minute_lines, with_progress
from biaxbayes.specimens.specimen_file import write_specimen
from commands import exit_code
from quick_posteriors import runs_of_few_walkers

MEDIA = Path(__file__).parents[1] / "data" / "donor2-media.csv"


@pytest.fixture(scope="module")
def run(small_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "media"
    return biaxbayes.open_run(shutil.copytree(small_run.path, folder))


def shown(thing) -> str:
    line = repr(thing)
    assert line.startswith(type(thing).__name__) and "\n" not in line and len(line) < 320, line
    html = thing._repr_html_()
    assert html.count("<table") >= 1 and html.count("<table") == html.count("</table>")
    return html


def test_results_show_themselves(run, tmp_path):
    assert run.state in shown(run) and "<i>C</i><sub>1</sub>" in shown(run)
    result = biaxbayes.identify(run)
    assert result["C1"].verdict in result._repr_html_()
    for row, line in zip(result.reported, repr(result).splitlines(), strict=False):
        assert line.split()[0] == row.name and row.interval in line and row.verdict in line
    assert "standard" in shown(biaxbayes.fit(run.specimen, "standard"))
    checked = biaxbayes.check(run.specimen, fit=False)
    for line in (repr(MADE), repr(MADE.protocols[0]), repr(checked)):
        assert "\n" not in line and len(line) < 320 and "array(" not in line, line
    other = shutil.copytree(run.path, tmp_path / "other")
    both = biaxbayes.compare([run, other], labels=["a <b>", "c"])
    assert "a &lt;b&gt;" in shown(both) and "<b>" not in shown(both)


def test_predictions_and_cards_come_as_tables(run, tmp_path):
    assert len(biaxbayes.predict(run, stretch=1.1, ratio=(1.0, 0.5), points=5)) == 5
    x = np.array([1.02, 1.04])
    assert len(biaxbayes.predict(run.path, pd.DataFrame({"x": x, "y": x}))) == 2
    strip = biaxbayes.predict(run, stretch=1.1, strip="y", points=5)
    assert (strip["stretch_x"].diff()[1:] < 0.0).all() and "cauchy_y_kPa_median" in strip
    tube = biaxbayes.inflate(run, [5.0, 10.0], radius_mm=8.0, wall_mm=1.0)
    assert tube["pressure_kPa"].tolist() == [5.0, 10.0]
    cards = biaxbayes.export(run, "febio", draws=3, out=tmp_path / "cards")
    assert len(cards) == 3


# --- both ways in: the command line and Python ---------------------------------------------------


def same_files(one: Path, other: Path) -> set[str]:
    """Names of the files that two folders hold, every byte of which must be equal."""
    names = {p.name for p in one.iterdir()}
    assert names == {p.name for p in other.iterdir()} and names
    for name in names:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    return names


@pytest.fixture(scope="module")
def tissue(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("tissue") / "media.csv"
    write_specimen(run.specimen, path)
    return path


BOTH = {
    "predict": (
        ("--stretch", "1.2", "--ratio", "1:0.5", "--points", "7", "--stress", "piola"),
        {"stretch": 1.2, "ratio": (1.0, 0.5), "points": 7, "stress": "piola"},
        {"prediction.csv", "prediction.pdf"},
    ),
    "predict a tube": (
        ("--inflate", "--radius", "8", "--wall", "1", "--pressure", "0:10", "--points", "5"),
        {"pressure_kPa": np.linspace(0.0, 10.0, 5), "radius_mm": 8.0, "wall_mm": 1.0},
        {"inflation.csv", "inflation.pdf"},
    ),
    "design": (
        ("--ratio", "1:0.75", "--rank-by", "C1"),
        {"ratios": ((1.0, 0.75),), "rank_by": "C1"},
        {"design.csv", "design.pdf", "design.png"},
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", BOTH)
def test_both_ways_write_the_same_files(run, tmp_path, name):
    words, given, files = BOTH[name]
    assert exit_code(name.split()[0], run.path, *words, "--out", tmp_path / "cli") in (0, 3)
    verb = biaxbayes.inflate if "tube" in name else getattr(biaxbayes, name)
    assert verb(run, **given, out=tmp_path / "python") is not None
    assert files <= same_files(tmp_path / "cli", tmp_path / "python")


@pytest.mark.long
def test_both_ways_write_the_same_figure_report_and_verdicts(run, tmp_path, capsys):
    for folder in ("cli", "python"):
        (tmp_path / folder).mkdir()
    options = ("--figure", "mounting", "--width-mm", "85", "--format", "svg")
    assert exit_code("plot", run.path, *options, "--out", tmp_path / "cli" / "m") == 0
    out = tmp_path / "python" / "m"
    biaxbayes.plot(run, "mounting", width_mm=85.0, suffix="svg", out=out)
    output = tmp_path / "cli" / "r.tex"
    assert exit_code("report", run.path, "--format", "latex", "--out", output) in (0, 3)
    assert biaxbayes.report(run, "latex", out=tmp_path / "python" / "r.tex").name == "r.tex"
    assert same_files(tmp_path / "cli", tmp_path / "python") == {"m.svg", "r.tex"}
    capsys.readouterr()
    assert exit_code("report", run.path, "--format", "latex", "--out", "-") in (0, 3)
    assert capsys.readouterr().out == output.read_text(encoding="utf-8")
    copy = tmp_path / "copy"
    shutil.copytree(run.path, copy)
    assert exit_code("identify", copy) in (0, 3)
    biaxbayes.identify(run, out=tmp_path / "judged")
    for path in (tmp_path / "judged").rglob("*.*"):
        name = path.relative_to(tmp_path / "judged")
        assert path.read_bytes() == (copy / name).read_bytes(), name


@pytest.mark.long
def test_identify_finds_what_sample_wrote(tmp_path, capsys):
    folder = tmp_path / "run"
    with runs_of_few_walkers():
        biaxbayes.sample(MEDIA, out=folder, ess=500)
    before = {p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in (".csv", ".pdf")}
    assert {"report.csv", "identifiability.pdf"} <= set(before)
    (folder / "report.csv").write_text("changed\n")
    (folder / "identifiability.pdf").unlink()
    first = exit_code("identify", folder), capsys.readouterr().out
    assert {p.name: p.read_bytes() for p in folder.iterdir() if p.name in before} == before
    (folder / "identifiability.pdf").unlink()
    assert (exit_code("identify", folder, "--no-figure"), capsys.readouterr().out) == first
    assert not (folder / "identifiability.pdf").exists()


def test_both_ways_simulate_check_and_fit_the_same(tissue, tmp_path, capsys):
    words = ("--material", "donor2-media", "--seed", "3", "--ratio", "1:0.5", "--noise-N", "0.001")
    for folder in ("cli", "python"):
        (tmp_path / folder).mkdir()
    assert exit_code("simulate", *words, "--out", tmp_path / "cli" / "v.csv") == 0
    how = {"seed": 3, "ratios": [(1.0, 0.5)], "noise_N": 0.001}
    biaxbayes.simulate(tmp_path / "python" / "v.csv", material="donor2-media", **how)
    assert same_files(tmp_path / "cli", tmp_path / "python") == {"v.csv", "v.truth.json"}
    for words, made in (
        (("check", "--no-fit"), biaxbayes.check(tissue, fit=False).record()),
        (
            ("fit", "--method", "linden", "--starts", 2),
            [biaxbayes.fit(tissue, "linden", starts=2).record()],
        ),
    ):
        capsys.readouterr()
        assert exit_code(words[0], tissue, "--json", *words[1:]) == 0
        assert json.loads(capsys.readouterr().out) == made


SAMPLED = {
    "mounting": "guessed", "noise": "loud", "mounting_stretch": "both", "max_rows": 0, "ess": 3,
    "seed": -1, "max_steps": 5, "workers": 0, "mounting_force": (float("nan"), 1.0),
}  # fmt: skip


@pytest.mark.parametrize("name", SAMPLED)
def test_bad_values_are_refused_both_ways(run, tmp_path, capsys, name):
    """By the name of the option on the command line, of the argument in Python."""
    value, tared, out = SAMPLED[name], tmp_path / "tared.csv", tmp_path / "r"
    write_specimen(run.specimen.zeroed(), tared)
    words = value if isinstance(value, tuple) else (value,)
    option = f"--{name.replace('_', '-')}"
    code, _, output = commands.run(capsys, "sample", tared, option, *words, "--out", out)
    with pytest.raises(InputError) as refusal:
        biaxbayes.sample(tared, out=out, **{name: value})
    assert code == 2 and "\n" not in str(refusal.value) and not out.exists()
    if name in ("ess", "seed", "max_steps", "workers", "mounting_force"):
        assert option in output and f"`{name}`" in str(refusal.value) and output.count("\n") == 1


@pytest.mark.parametrize("verb", ["sample", "batch", "compare_laws", "population", "simulate"])
def test_the_help_of_a_verb_lists_its_options(verb):
    function = getattr(biaxbayes, verb)
    words = inspect.getdoc(function)
    assert "**options" not in words
    for name, parameter in inspect.signature(function).parameters.items():
        assert re.search(rf"^(?:\w+, )*{name}(?:, \w+)* : ", words, re.MULTILINE), name
        assert parameter.kind is not parameter.VAR_KEYWORD


def test_a_run_has_its_own_model(run, tmp_path, capsys):
    words = ("--law", "fung", "--out", tmp_path / "out")
    assert "--law does not go" in commands.refused(capsys, "profile", run.path, *words)
    with pytest.raises(InputError, match="`law` does not go with a run"):
        biaxbayes.profile(run, law="fung")
    with pytest.raises(InputError, match="no option 'colour'"):
        biaxbayes.sample(run.specimen, out=tmp_path / "out", colour="red")


@pytest.mark.parametrize(
    ("verb", "arguments", "message"),
    [
        ("design", {"further": 9.0}, "further"),
        ("design", {"kappa_sd": -1.0}, "kappa_sd"),
        ("design", {"rank_by": "luck"}, "rank_by"),
        ("predict", {}, "give either `path`"),
        ("predict", {"stretch": 1.1, "strip": "y", "ratio": (1.0, 0.5)}, "`ratio`"),
        ("predict", {"stretch": [1.1, 1.2]}, "`stretch`"),
        ("predict", {"stretch": 1.1, "probability": 1.0}, "probability"),
        ("predict", {"stretch": 1.1, "points": 1}, "points"),
        ("predict", {"stretch": 20.0}, "not strains"),
        ("predict", {"stretch": 1.1, "suffix": "gif"}, "suffix"),
        ("export", {"to": "febio", "units": "psi"}, "units"),
        ("export", {"to": "febio", "draws": 2, "at": "map"}, "`draws` and `at`"),
        ("export", {"to": "ansys"}, "unknown program"),
        ("plot", {"figure": "pie"}, "unknown figure"),
        ("plot", {"figure": "trace", "truth": {"C1": 1.0}}, "does not go with"),
        ("plot", {"figure": "bands", "truth": {"C1": 1.0}}, "the true values lack k1"),
        ("report", {"kind": "doc"}, "unknown report"),
        # of a wrong kind
        ("report", {"run": 3}, "`run` must be a run or its folder, not int"),
        ("export", {"run": np.ones(3), "to": "abaqus"}, "must be a run or its folder, not ndarray"),
        ("predict", {"stretch": b"x", "anyway": True}, "`stretch` b'x' is not a possible"),
        ("predict", {"path": [["a", "b"]], "anyway": True}, "`path` must be numbers"),
        ("plot", {"style": {"colour": 1}}, "'colour' is not a setting of matplotlib"),
        ("plot", {"width_mm": -1}, "`width_mm` must be a number from 50 to 400"),
        ("plot", {"figure": np.ones(3)}, "`figure` must be a text, not ndarray"),
        ("compare", {"runs": ["a", "b"], "labels": 3}, "`labels` must be a list, not int"),
        ("convert", {"raw": MEDIA, "header": "edge_x_mm=20"}, "`header` must be a mapping, not"),
        ("fit", {"specimen": MEDIA, "initial": [1.0]}, "`initial` must be a material"),
        ("simulate", {"material": "donor2-media", "ratios": (1, 2)}, "`ratios` must be pairs of"),
        ("simulate", {"material": [1]}, "unknown material"),
        ("sample", {"specimen": MEDIA, "resume": np.ones(3)}, "`resume` must be True or False"),
        ("sample", {"specimen": np.ones(3)}, "`specimen` must be a path, not ndarray"),
        ("prepare", {"specimen": MEDIA}, "`specimen` must be a Specimen, not PosixPath"),
        ("sample", {"specimen": MEDIA, "priors": {3: 4}}, "unknown parameter '3'"),
        ("law", {"name": b"x"}, "a law is named by a text, not bytes"),
        ("law", {"name": []}, "a law is named by a text, not list"),
        ("law", {"name": "fung", "c0": b"1"}, "c0 = b'1' is out of range"),
    ],
)
def test_what_a_verb_cannot_do_is_named(run, verb, arguments, message):
    function = getattr(biaxbayes, verb)
    given = {"run": run} if "run" in inspect.signature(function).parameters else {}
    with pytest.raises(InputError, match=message):
        function(**given | arguments)


# --- what somebody types first ---

MADE = biaxbayes.simulate(material="donor2-media", noise_N=0.0006, increments=30)[0]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Replaced:
    """A notebook's display: one output, whose text is replaced."""

    def __init__(self):
        self.texts = []

    def display(self, data, *, raw, display_id):
        assert raw and display_id
        self.update(data, raw=raw)
        return self

    def update(self, data, *, raw):
        self.texts.append(data["text/plain"])


@with_progress
def verb(*, progress=None) -> bool:
    if progress is not None:
        progress(Progress("sampling", 0.5, note="half of it"))
    return progress is not None


def test_long_calls_show_their_progress_where_somebody_watches(monkeypatch):
    assert not verb() and not verb(progress=False)
    output = []
    assert verb(progress=output.append) and output[0].phase == "sampling"
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert verb() and "half of it" in sys.stderr.getvalue()
    assert not verb(progress=False)
    lines, shell = Replaced(), types.SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", lines)
    assert verb()
    assert lines.texts == ["starting", "sampling, 50 %", ""]
    for name in ("sample", "batch", "compare", "calibrate"):
        assert getattr(biaxbayes, name).__wrapped__, name


def test_a_terminal_without_a_live_line_gets_a_line_each_minute(capsys):
    with minute_lines() as show:
        show(Progress("sampling"))
    assert capsys.readouterr().err == ""  # less than a minute
    err = ""
    with minute_lines(every=0.01) as show:
        show(Progress("sampling", 1 / 9, note="sampled again"))
        # nothing is reported any more, and the line is repeated all the same
        deadline = time.monotonic() + 20.0
        while err.count("sampling") < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
            err += capsys.readouterr().err
    assert err.count("sampled again") == 1 and err.count("sampling, 11 %") > 1


def test_the_time_left_is_that_of_the_pace_since_work_could_be_measured(monkeypatch):
    clock = iter([0.0, 60.0, 120.0, 130.0, 200.0])
    monkeypatch.setattr("biaxbayes.progress_bar.time.monotonic", lambda: next(clock))
    pace = Pace()
    assert pace.line(Progress("searching")) == "searching"
    # continued at 40 %: what was done before took none of this time
    assert pace.line(Progress("sampling", 0.4)) == "sampling, 40 %"
    assert pace.line(Progress("sampling", 0.6)) == "sampling, 60 %, about 2 min left"
    assert pace.line(Progress("sampling", 0.9)) == "sampling, 90 %, about 24 s left"
    # the next piece of work begins anew
    assert pace.line(Progress("writing", 0.0)) == "writing, 0 %"


def test_every_verb_is_a_function_and_every_name_is_there():
    for name in biaxbayes.__all__:
        assert getattr(biaxbayes, name) is not None
    for verb in VERBS:
        name = "compare_laws" if verb == "laws" else verb  # biaxbayes.laws is the room of the laws
        if verb != "app":  # a page, for its command alone
            assert callable(getattr(biaxbayes, name))
    with pytest.raises(AttributeError):
        _ = biaxbayes.nothing
