"""Virtual specimens and the shipped files: what is written, and the statistics of their errors."""

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

import make_examples
from biaxbayes.fem.sheet_tester import Hooks
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from biaxbayes.mechanics.mounting import mounting_stretches
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from biaxbayes.specimens.truth import write_truth
from biaxbayes.specimens.virtual_specimen import (
    Dimensions,
    Machine,
    virtual_specimen,
)
from biaxbayes.tables.layout import ALL_SHEETS
from make_specimens import make
from workbooks import read_tables

TABLE2 = {
    "donor1": (1.93, 1.15),
    "donor2": (1.35, 1.15),
    "donor2-intima": (0.27, 1.05),
    "donor2-media": (0.88, 1.20),
    "donor2-adventitia": (0.54, 1.15),
}


MEDIA = MATERIALS["donor2-media"].material
BOX = Dimensions(20.0, 15.0, 0.88)
TEST = {"name": "t", "mounting_stretch": (1.02, 1.01), "measured_stretch": 1.2, "dimensions": BOX}


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("pair", ["force", "piola", "cauchy"])
def test_the_mounting_reading_leads_back_to_the_mounting_stretch(pair, geometry):
    # The root-finder knows nothing of how the record was made.
    machine = Machine(loads=pair, geometry=geometry)
    specimen, truth = virtual_specimen(MEDIA, **TEST, machine=machine, seed=1)
    reading = specimen.mounting_reading(specimen.protocols[0]) / specimen.area
    found = mounting_stretches(MEDIA, *reading, geometry=geometry)
    np.testing.assert_allclose(found, [1.02, 1.01], rtol=1e-9)
    assert truth.mounting_force_y == pytest.approx(specimen.protocols[0].load_y[0], rel=1e-9)


def test_cauchy_and_piola_files_of_the_mounted_geometry_are_what_a_lab_computes():
    machine = Machine(loads="cauchy", geometry="mounted")
    specimen, _ = virtual_specimen(MEDIA, **TEST, machine=machine, seed=1)
    force, _ = virtual_specimen(MEDIA, **TEST, seed=1)
    p, f = specimen.protocols[0], force.protocols[0]
    edge_y, thickness = 15.0 * 1.01, 0.88 / (1.02 * 1.01)
    assert specimen.edge_y_mm == pytest.approx(edge_y)
    assert specimen.thickness_mm == pytest.approx(thickness)
    expected = f.load_x / (edge_y * thickness * 1e-3) * f.stretch_x
    np.testing.assert_allclose(p.load_x, expected, rtol=1e-12)


def test_errors_have_the_given_size():
    residuals, first = [], []
    for seed in range(40):
        machine = Machine(noise_N=0.0006, misfit=0.02)
        noisy, _ = virtual_specimen(MEDIA, **TEST, machine=machine, seed=seed)
        only_misfit, truth = virtual_specimen(
            MEDIA, **TEST, machine=Machine(misfit=0.02), seed=seed
        )
        clean, _ = virtual_specimen(MEDIA, **TEST, seed=seed)
        a, b, c = (s.protocols[0].load_x for s in (noisy, only_misfit, clean))
        residuals.append(a - b)
        first.append(b / c - 1.0)
        assert truth.disturbed_mounting_force["1"][0] == pytest.approx(b[0], rel=1e-9)
    assert np.std(residuals) == pytest.approx(0.0006, rel=0.05)
    misfit = np.array(first)
    assert np.std(misfit) == pytest.approx(0.02, rel=0.2)
    # exp(-lag^2 / (2 length^2)) at a lag of one length, 25 of 100 increments
    lagged = np.mean(misfit[:, :-25] * misfit[:, 25:]) / np.mean(misfit**2)
    assert lagged == pytest.approx(np.exp(-0.5), abs=0.12)


def test_same_seed_same_bytes_and_the_file_reads_back(tmp_path):
    machine = Machine(noise_N=0.0006, misfit=0.02)
    ratios = ((1.0, 1.0), (1.0, 0.5), (2.0, 4.0))
    for name in "ab":
        specimen, truth = virtual_specimen(
            MEDIA, **TEST, ratios=ratios, machine=machine, seed=7, labels={"layer": "media"}
        )
        write_specimen(specimen, tmp_path / f"{name}.csv")
        write_truth([truth], tmp_path / f"{name}.json")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert read_specimen(tmp_path / "a.csv") == specimen
    assert [p.name for p in specimen.protocols] == ["1:1", "1:0.5", "2:4"]
    assert specimen.protocols[2].stretch_x[-1] == pytest.approx(1.1)
    assert specimen.protocols[2].stretch_y[-1] == pytest.approx(1.2)
    stored = json.loads((tmp_path / "a.json").read_text())["t"]
    assert stored["material"]["k1_kPa"] == 12.47
    assert stored["seed"] == 7


def test_no_truth_in_the_specimen_file(tmp_path):
    material, machine = GOH(7.123, 33.457, 5.791, 41.37, 0.1379), Machine(noise_N=0.0006)
    test = TEST | {"mounting_stretch": (1.0237, 1.0151)}
    specimen, _ = virtual_specimen(material, **test, seed=1, machine=machine)
    write_specimen(specimen, tmp_path / "t.csv")
    text = (tmp_path / "t.csv").read_text()
    for secret in ("7.123", "33.457", "5.791", "41.37", "0.1379", "1.0237", "1.0151", "seed"):
        assert secret not in text


def test_hooked_specimen_reports_the_central_stretch_and_the_hook_force():
    pytest.importorskip("skfem")
    specimen, truth = virtual_specimen(
        MEDIA,
        **TEST,
        seed=1,
        increments=5,
        hooks=Hooks(),
        elements=8,
        ratios=((1.0, 1.0), (0.5, 1.0)),
    )
    p, q = specimen.protocols
    np.testing.assert_allclose(p.stretch_x, np.linspace(1.0, 1.2, 6), rtol=1e-9)
    np.testing.assert_allclose(q.stretch_x, np.linspace(1.0, 1.1, 6), rtol=1e-9)
    assert p.load_x[0] == pytest.approx(q.load_x[0])
    assert truth.grips is not None and truth.grips["count"] == 5
    assert truth.mounting_stretch_x == 1.02
    # The hooks carry less than the nominal section times the central stress.
    assert 0.8 * truth.mounting_force_x < p.load_x[0] < 0.97 * truth.mounting_force_x
    assert truth.disturbed_mounting_force["1:1"][0] == pytest.approx(p.load_x[0])


ROOT = Path(__file__).parents[1]
NAMES = ["donor1", "donor2", "donor2-intima", "donor2-media", "donor2-adventitia"]
NAMES += ["hooked-media", "hooked-weisbecker"]
# thickness in mm and largest experimental stretch, Table 2


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    pytest.importorskip("skfem")
    folder = tmp_path_factory.mktemp("data")
    make(folder)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_shipped_files_are_current(made, name):
    shipped, fresh = (read_specimen(f / f"{name}.csv") for f in (ROOT / "data", made))
    a, b = shipped.protocols[0], fresh.protocols[0]
    np.testing.assert_allclose(a.stretch_x, b.stretch_x, rtol=1e-9)
    # Readings are written to a thousandth of the noise; libraries may differ in the last digit.
    for x, y in ((a.load_x, b.load_x), (a.load_y, b.load_y)):
        np.testing.assert_allclose(x, y, atol=2e-6, rtol=1e-8)
    truths = [json.loads((f / "truth.json").read_text())[name] for f in (ROOT / "data", made)]
    for key in ("material", "mounting_stretch_x", "mounting_stretch_y", "seed", "grips"):
        assert truths[0][key] == truths[1][key]


EXAMPLES = ("biotester.csv", "tared.csv", "tensile-machine.csv", "workbook.xlsx")


def cells(path: Path) -> dict[str, tuple[tuple[str, ...], list[list[str]]]]:
    sheets = (ALL_SHEETS,) if path.suffix == ".xlsx" else ()
    tables, _ = read_tables(path, sheets)
    return {name: (t.names, [list(c) for c in t.columns]) for name, t in tables.items()}


def test_examples_are_current_and_the_same_bytes_every_time(tmp_path, monkeypatch):
    make_examples.make(tmp_path / "a")

    class Tomorrow(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(2031, 2, 3, tzinfo=tz)

    monkeypatch.setattr("openpyxl.writer.excel.datetime.datetime", Tomorrow)
    make_examples.make(tmp_path / "b")
    assert sorted(p.name for p in (ROOT / "data" / "examples").iterdir()) == list(EXAMPLES)
    for name in EXAMPLES:
        made = tmp_path / "a" / name
        assert made.read_bytes() == (tmp_path / "b" / name).read_bytes(), name
        assert made.stat().st_size < 70_000
        shipped = cells(ROOT / "data" / "examples" / name)
        assert shipped == cells(made), f"{name}: run python scripts/make_examples.py"
        assert all(len(columns[0]) > 30 for _, columns in shipped.values())


@pytest.mark.parametrize(("name", "thickness", "stretch"), [(n, *v) for n, v in TABLE2.items()])
def test_conditions_of_table2(name, thickness, stretch):
    specimen = read_specimen(ROOT / "data" / f"{name}.csv")
    p = specimen.protocols[0]
    assert p.rows == 101
    assert (specimen.edge_x_mm, specimen.edge_y_mm) == (20.0, 20.0)
    assert specimen.thickness_mm == thickness
    assert p.stretch_x[-1] == p.stretch_y[-1] == stretch
    assert specimen.load_noise == 0.0006
    assert (specimen.axis_x, specimen.axis_y) == ("circumferential", "axial")
