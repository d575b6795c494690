"""The correction for hooks against the finite-element sheet, and the grips of a specimen file."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Circle

import biaxbayes
from biaxbayes.errors import InputError, Interrupted
from biaxbayes.fem.sheet import Sheet
from biaxbayes.fem.sheet_tester import Hooks, SheetTester
from biaxbayes.figures.mounting import grips_figure, sketch_figure
from biaxbayes.fitting.fit import fit
from biaxbayes.grips.correction import correct_for_grips
from biaxbayes.grips.hooks import stated_hooks
from biaxbayes.laws.goh import GOH
from biaxbayes.runs import checkpoint
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from biaxbayes.verbs import sample as sampling
from readable import assert_readable

DATA = Path(__file__).parents[1] / "data"
MATERIAL = GOH(14.0, 140.0, 11.9, 38.4, 0.21)
MOUNTING = (1.02, 1.015)
HOOKS = Hooks(4, 1.2, 0.8)
KEYS = {"grips": "hooks 4", "grip_inset_mm": 1.2, "grip_width_mm": 1.6}


def fitted(specimen):
    return fit(specimen, "constrained")


def hooked(stretch_from="markers", loads="force"):
    """A noise-free test on four hooks, two protocols, and the loads that a uniform test reads."""
    sheet = Sheet(16.0, 14.0, elements=20)
    grips = HOOKS.on(sheet)
    mounted = SheetTester(MATERIAL, sheet, grips, thickness_mm=0.9).mount(MOUNTING)
    tester = SheetTester(MATERIAL, sheet, grips, thickness_mm=0.9, control=stretch_from)
    area = np.array([14.0, 16.0]) * 0.9e-3
    divisor = area if loads == "piola" else np.ones(2)
    protocols, uniform = [], []
    for name, top in (("a", (1.15, 1.14)), ("b", (1.16, 1.05))):
        test = tester.stretch_to(mounted, top, increments=20)
        grip = test.grip / test.grip[0]
        centre = test.measured
        measured = grip if stretch_from == "grips" else centre
        load = test.force_N / divisor
        protocols.append(Protocol(name, *measured.T, *load.T))
        piola = np.column_stack(MATERIAL.piola(*test.total.T)) * area / divisor
        uniform.append((centre, piola))
    keys = KEYS | ({"stretch_from": "grips"} if stretch_from == "grips" else {})
    return Specimen(
        "sheet", tuple(protocols), loads, "unloaded", 16.0, 14.0, 0.9, 1e-4, metadata=keys
    ), uniform


@pytest.mark.parametrize(
    ("stretch_from", "loads"),
    [
        ("grips", "force"),
        pytest.param("markers", "force", marks=pytest.mark.long),
        pytest.param("markers", "piola", marks=pytest.mark.long),
    ],
)
def test_the_corrected_loads_are_those_of_a_uniform_test(stretch_from, loads):
    specimen, uniform = hooked(stretch_from, loads)
    correction = correct_for_grips(specimen, fitted)
    for p, (centre, load) in zip(correction.specimen.protocols, uniform, strict=True):
        # uncorrected, the loads are 10 % off
        np.testing.assert_allclose(p.load_x, load[:, 0], rtol=4e-3)
        np.testing.assert_allclose(p.load_y, load[:, 1], rtol=4e-3)
        np.testing.assert_allclose(np.column_stack([p.stretch_x, p.stretch_y]), centre, rtol=5e-4)
    material, lm = correction.fit.material, correction.fit.mounting_stretch[0]
    np.testing.assert_allclose(material.values, MATERIAL.values, rtol=0.03)
    np.testing.assert_allclose(lm, MOUNTING, atol=5e-4)
    assert correction.range.min() > 0.8 and correction.range.max() < 0.95
    assert correction.mesh_difference < 0.01
    assert correction.specimen.load_noise == pytest.approx(1e-4 / correction.range.mean(), rel=0.02)


@pytest.mark.long
def test_grips_survive_a_file_and_a_corrected_one_is_not_corrected_again(tmp_path):
    specimen, _ = hooked()
    correction = correct_for_grips(specimen, fitted)
    for name, one in (("measured", specimen), ("corrected", correction.specimen)):
        write_specimen(one, tmp_path / f"{name}.csv")
        assert read_specimen(tmp_path / f"{name}.csv") == one
    assert specimen.needs_grip_correction
    assert not correction.specimen.needs_grip_correction
    result = biaxbayes.fit(tmp_path / "measured.csv", "constrained")
    again = biaxbayes.fit(tmp_path / "corrected.csv", "constrained")
    np.testing.assert_allclose(result.material.values, again.material.values, rtol=1e-6)


def test_what_does_not_correct_refuses_the_file():
    specimen, _ = hooked()
    for verb in (biaxbayes.Posterior, lambda data: biaxbayes.profile(data, ["C1"])):
        with pytest.raises(InputError, match="not corrected for the grips"):
            verb(specimen)
    for verb in (biaxbayes.sample, lambda data, law: biaxbayes.fit(data, "constrained", law=law)):
        with pytest.raises(InputError, match="does not know the law hgo"):
            verb(specimen, law="hgo")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grips": "clamps"}, "must be of the form 'hooks 5'"),
        ({"grip_inset_mm": None}, "needs grip_inset_mm"),
        ({"grip_width_mm": 3.0}, "reach over an edge"),
        ({"grip_spacing_mm": 1.0}, "overlap at a spacing of 1 mm"),
        ({"grip_spacing_mm": 6.0}, "do not fit on 14 mm"),
    ],
)
def test_impossible_grips_are_refused(change, message):
    specimen, _ = hooked()
    keys = {k: v for k, v in (KEYS | change).items() if v is not None}
    with pytest.raises(InputError, match=message):
        stated_hooks(replace(specimen, metadata=keys))


def notes_of_check(specimen, **options):
    checked = biaxbayes.check(specimen, fit=False, **options)
    return [f.message for f in checked.findings if f.code == "grips"]


def test_check_names_the_hooks_or_what_ignoring_them_costs():
    specimen, _ = hooked()
    (note,) = notes_of_check(specimen)
    assert "4 hooks per edge, 1.2 mm inside it" in note
    (note,) = notes_of_check(replace(specimen, metadata={}))
    assert notes_of_check(replace(specimen, metadata={"grips": "none"})) == []


def test_check_draws_a_sketch_to_scale(tmp_path):
    specimen, _ = hooked()
    ax = sketch_figure(specimen).axes[0]
    assert ax.get_aspect() == 1.0
    places = {tuple(np.round(p.center, 6)) for p in ax.patches if isinstance(p, Circle)}
    # 4 hooks on each of 4 edges, 1.2 mm inside 16 x 14 mm, at distances of a fifth of the edge
    assert len(places) == 16 and {(6.8, 1.4), (-6.8, 4.2), (1.6, 5.8), (4.8, -5.8)} <= places
    notes_of_check(specimen, sketch=tmp_path / "sketch.png")
    assert (tmp_path / "sketch.png").stat().st_size > 5000
    with pytest.raises(InputError, match="the header states none"):
        notes_of_check(replace(specimen, metadata={}), sketch=tmp_path / "none.png")


@pytest.mark.parametrize("protocols", [1, 2, 6])
def test_the_figure_of_the_ratios_is_readable(protocols):
    """The sketch is on the left, and the panels beside it fill the page to the right."""
    measured = read_specimen(DATA / "hooked-weisbecker.csv")
    specimen = replace(measured, metadata={"grips": "hooks 5", "grip_inset_mm": 1.5})
    stretch = np.linspace(1.0, 1.2, 5)
    curves = {"force_ratio_x": 0.9, "force_ratio_y": 0.8}
    curves |= {"sd_log_force_ratio_x": 0.01, "sd_log_force_ratio_y": 0.02}
    columns = {"stretch_x": stretch, "stretch_y": stretch, **curves}
    tables = [pd.DataFrame({"protocol": str(i), **columns}) for i in range(protocols)]
    figure = grips_figure(specimen, pd.concat(tables))
    figure.draw_without_rendering()  # the ticks are those of the final layout
    assert_readable(figure, 180.0)
    sketch, *panels = (ax.get_tightbbox() for ax in figure.axes)
    assert len(panels) == protocols
    assert sketch.x1 < min(box.x0 for box in panels)
    assert max(box.x1 for box in panels) > 0.95 * figure.bbox.x1


@pytest.mark.long
def test_stated_dimensions_of_the_mounted_state_give_the_same_ratios():
    specimen, _ = hooked()
    mounted = replace(
        specimen,
        geometry="mounted",
        edge_x_mm=16.0 * MOUNTING[0],
        edge_y_mm=14.0 * MOUNTING[1],
        thickness_mm=0.9 / (MOUNTING[0] * MOUNTING[1]),
    )
    ratios = [correct_for_grips(s, fitted).ratios[0].force for s in (specimen, mounted)]
    np.testing.assert_allclose(*ratios, rtol=2e-4)


@pytest.mark.long
def test_a_run_keeps_the_ratios_and_opens_with_the_same_numbers(tmp_path):
    measured = read_specimen(DATA / "hooked-weisbecker.csv")
    keys = {"grips": "hooks 5", "grip_inset_mm": 1.5}
    specimen = replace(measured, metadata=keys)
    options = {"noise": "independent", "ess": 400, "workers": 1, "progress": False}
    run = biaxbayes.sample(specimen, out=tmp_path / "run", **options)
    table = pd.read_csv(tmp_path / "run" / "grips.csv")
    rows = run.specimen.protocols[0]
    np.testing.assert_allclose(
        rows.load_x * table.force_ratio_x, measured.protocols[0].load_x, rtol=1e-6
    )
    assert table.sd_log_force_ratio_x.max() < 0.005
    truth = {"C1": 14.0, "k1": 140.0, "k2": 11.9, "alpha": 38.4, "kappa": 0.21}
    truth |= {"mounting_stretch_x": 1.02, "mounting_stretch_y": 1.02}
    for name, value in truth.items():
        assert run.result[name].low < value < run.result[name].high, name
    assert biaxbayes.open_run(tmp_path / "run").posterior().specimen == run.specimen


@pytest.fixture
def file(tmp_path):
    """Every fourth row of a shipped specimen on hooks, with the keys."""
    measured = read_specimen(DATA / "hooked-weisbecker.csv")
    (p,) = measured.protocols
    rows = slice(0, None, 4)
    curves = (p.stretch_x[rows], p.stretch_y[rows], p.load_x[rows], p.load_y[rows])
    keys = {"grips": "hooks 5", "grip_inset_mm": 1.5}
    specimen = replace(measured, protocols=(Protocol(p.name, *curves),), metadata=keys)
    write_specimen(specimen, tmp_path / "a.csv")
    return tmp_path / "a.csv"


@pytest.mark.long
def test_a_run_with_hooks_resumes_to_the_same_draws(file, tmp_path, monkeypatch):
    monkeypatch.setattr(sampling, "Plan", partial(Plan, walkers=32, first_block=16))
    options = {"ess": 2000, "workers": 1, "progress": False}
    whole = biaxbayes.sample(file, out=tmp_path / "whole", **options)
    saved = []
    save = checkpoint.save

    def counted(*arguments):
        save(*arguments)
        saved.append(arguments)

    monkeypatch.setattr(checkpoint, "save", counted)
    with pytest.raises(Interrupted, match="interrupted after"):
        biaxbayes.sample(file, out=tmp_path / "run", stop=lambda: len(saved) >= 2, **options)
    resumed = biaxbayes.sample(file, out=tmp_path / "run", resume=True, **options)
    pd.testing.assert_frame_equal(resumed.draws, whole.draws)
    for name in ("grips.csv", "specimen.csv"):
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.long
def test_batch_and_compare_work_on_corrected_loads(file, tmp_path):
    biaxbayes.batch([file], out=tmp_path / "study", workers=1, ess=200, progress=False)
    (grips,) = (tmp_path / "study").rglob("grips.csv")
    run = biaxbayes.open_run(grips.parent)
    assert run.specimen.metadata["grip_correction"] == "applied"
    options = {"ess": 200, "workers": 1, "progress": False, "labels": ("batch", "compare")}
    biaxbayes.compare([run, file], out=tmp_path / "compare", **options)
    again = biaxbayes.open_run(tmp_path / "compare" / "a-posterior")
    pd.testing.assert_frame_equal(again.draws, run.draws)
