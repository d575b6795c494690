"""The files in ``data/`` are what the script makes, and carry the conditions of the paper."""

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

import make_examples
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.tables.table import ALL_SHEETS, read_tables
from make_specimens import make

ROOT = Path(__file__).parents[1]
NAMES = [
    "donor1",
    "donor2",
    "donor2-intima",
    "donor2-media",
    "donor2-adventitia",
    "hooked-media",
    "hooked-weisbecker",
]
# thickness in mm and largest experimental stretch, Table 2
TABLE2 = {
    "donor1": (1.93, 1.15),
    "donor2": (1.35, 1.15),
    "donor2-intima": (0.27, 1.05),
    "donor2-media": (0.88, 1.20),
    "donor2-adventitia": (0.54, 1.15),
}


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
