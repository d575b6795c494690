"""The verb plot, on a run sampled here."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from biaxbayes.figures.corner import corner_figure
from biaxbayes.figures.identifiability import identifiability_figure
from biaxbayes.figures.profile import profile_figure
from biaxbayes.options import PLOTS
from biaxbayes.profiles.profile import profiles
from biaxbayes.runs.run import open_run
from commands import exit_code, refused
from readable import assert_readable

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def run(media_run, tmp_path_factory):
    return Path(shutil.copytree(media_run.path, tmp_path_factory.mktemp("plot") / "media.run"))


@pytest.mark.parametrize("figure", [name for name in PLOTS if name not in ("corner", "profile")])
def test_each_figure_in_the_run_folder(run, figure, capsys):
    assert exit_code("plot", run, "--figure", figure, "--format", "svg", "--width-mm", 85) == 0
    written = Path(capsys.readouterr().out.strip())
    assert written.parent == run and written.suffix == ".svg"
    head = written.read_text(encoding="utf-8")[:1500]
    points = float(head.split('width="')[1].split("pt")[0])
    assert points == pytest.approx(85.0 / 25.4 * 72.0, abs=0.01)


@pytest.mark.long
def test_verdicts_are_readable(run):
    opened = open_run(run)
    verdicts = opened.analyse()[1]
    for width in (85.0, 180.0):
        figure = identifiability_figure(verdicts, opened.result.reported, width_mm=width)
        assert_readable(figure, width)


@pytest.mark.long
def test_profiles_are_readable(small_run):
    result = profiles(small_run.posterior(), ["k1", "C1"])
    for width in (85.0, 180.0):
        assert_readable(profile_figure(result, width_mm=width), width)
    # a curve that reaches the end of a range is drawn whole, its axis on the right with a line
    k1 = result[0]
    kappa = np.linspace(0.0, 0.1, len(k1.table))
    figure = profile_figure([replace(k1, table=k1.table.assign(kappa=kappa))], width_mm=180.0)
    (right,) = [ax for ax in figure.axes if ax.yaxis.get_label_position() == "right"]
    assert right.get_ylim()[0] <= 0.0 and right.spines["right"].get_visible()


def test_corner_with_truth_comparison_and_style(run, tmp_path, capsys):
    style = tmp_path / "journal.mplstyle"
    style.write_text("axes.prop_cycle: cycler('color', ['123456', '654321'])\n")
    out = tmp_path / "figure3"
    arguments = ("--truth", DATA / "truth.json", "--compare", run, "--style", style, "--out", out)
    assert exit_code("plot", run, *arguments, "--format", "svg") == 0
    assert capsys.readouterr().out.strip() == f"{out}.svg"
    drawn = Path(f"{out}.svg").read_text(encoding="utf-8")
    assert "#123456" in drawn and "#654321" in drawn and "#0072b2" not in drawn


def test_corner_of_named_parameters_fits_a_narrow_figure(run, tmp_path):
    out, names = tmp_path / "three.svg", ("kappa", "alpha", "k1")
    arguments = [a for name in names for a in ("--parameter", name)]
    assert exit_code("plot", run, *arguments, "--width-mm", 60, "--out", out) == 0
    figure = corner_figure(open_run(run).draws, parameters=names, width_mm=60.0)
    assert len(figure.axes) == 3 * 4 // 2
    assert_readable(figure, 60.0)


def test_what_cannot_be_drawn_is_refused_in_one_line(run, tmp_path, capsys):
    wrong = tmp_path / "truth.json"
    wrong.write_text(json.dumps({"somebody else": {"material": {}}}))
    cases = [
        ((run, "--figure", "trace", "--truth", wrong), "does not go with --figure trace"),
        ((run, "--figure", "bands", "--compare", run), "does not go with --figure bands"),
        ((run, "--figure", "profile", "--width-mm", 85), "5 profiles do not fit one column"),
        ((run, "--figure", "bands", "--parameter", "C1"), "does not go with --figure bands"),
        ((run, "--parameter", "beta"), "'beta' does not vary in this run"),
        ((run, "--width-mm", 60), "7 quantities do not fit a width of 60 mm"),
        ((run, "--figure", "trace", "--parameter", "beta"), "unknown quantity 'beta'"),
        ((run, "--figure", "profile", "--parameter", "beta"), "beta"),
        ((run, "--truth", wrong), "no entry for specimen 'donor2-media'"),
        ((run, "--out", tmp_path / "a.png", "--format", "pdf"), "--format pdf does not go"),
        ((run, "--style", tmp_path / "absent"), "the style cannot be read"),
        ((run, "--out", tmp_path / "a.tiff"), "a.tiff: cannot draw a figure as '.tiff'; use"),
        ((tmp_path / "absent",), "does not exist"),
        ((run, "--out", tmp_path / "no" / "folder" / "a.pdf"), "no"),
    ]
    for arguments, text in cases:
        assert text in refused(capsys, "plot", *arguments)
    assert not list(tmp_path.glob("a.*"))
