"""Machine exports: the specimen that they were made from comes back, or one line says why not."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest

import commands
from biaxbayes import read_specimen
from biaxbayes.errors import InputError
from biaxbayes.specimens.check import check_specimen
from virtual_biotester import EDGE_MM, THICKNESS_MM, biotester_export
from workbooks import read_tables, xlsx

DIMENSIONS = [
    "--edge-x-mm", str(EDGE_MM), "--edge-y-mm", str(EDGE_MM),
    "--thickness-mm", str(THICKNESS_MM), "--geometry", "unloaded",
]  # fmt: skip

REST = 10
"""Rows at rest before each cycle but the first."""


def run(arguments: list[object], capsys) -> tuple[int, str, str]:
    return commands.run(capsys, "convert", *arguments, "--overwrite")


def biotester(path: Path, out: Path, capsys, *more: object) -> tuple[int, str, str]:
    for answer, value in (("--cycles", "last"), ("--branch", "loading")):
        more = more if answer in more else (*more, answer, value)
    return run([path, "--machine", "biotester", "--out", out, *DIMENSIONS, *more], capsys)


def written(folder: Path, text: str, name: str = "raw.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def made(folder: Path, export, capsys, *more: object):
    """The specimen of a BioTester export, and what convert prints."""
    out = folder / "specimen.csv"
    code, text, err = biotester(written(folder, export.text()), out, capsys, *more)
    assert code == 0, err
    return read_specimen(out), text


# --- BioTester --------------------------------------------------------------------------------


def test_the_specimen_that_an_export_was_made_from_comes_back(tmp_path, capsys):
    export = biotester_export(cycles=6)
    specimen, text = made(tmp_path, export, capsys, "--load-noise-N", 0.0006, "--layer", "media")
    (p,) = specimen.protocols
    # The last cycle's loading branch with the rest before it, not its hold, recovery, or an
    # earlier, stiffer cycle.
    assert p.rows == len(export.stretch) + REST and p.rest_rows >= REST
    # Four points of 0.02 px on 120 px: a scatter of about 0.02 / 240 = 8e-5 of the stretch.
    assert np.abs(p.stretch[REST:] - export.stretch).max() < 5e-4
    force = specimen.load(p)[REST:] - export.force_N
    assert np.abs(force).max() < 5 * 0.0006
    assert abs(force.std() - 0.0006) < 0.0001
    assert (specimen.load_noise, specimen.layer, specimen.geometry) == (0.0006, "media", "unloaded")
    assert (specimen.metadata["cycle"], specimen.metadata["branch"]) == ("6 of 6", "loading")
    reading, sd = specimen.mounting_readings(shared=False)
    np.testing.assert_array_less(np.abs(reading[0] - export.force_N[0]), 4 * sd[0])
    assert "cycle 6 of 6" in text and "4 tracked points" in text
    assert not [f for f in check_specimen(specimen) if f.severity == "warning"]


def test_rake_distance_overstates_what_the_tissue_does_and_serves_without_points(tmp_path, capsys):
    export = biotester_export()
    specimen, _ = made(tmp_path, export, capsys, "--stretch-from", "rake")
    wanted = 1.0 + (export.stretch - 1.0) / 0.9
    # The file rounds to 1 um of 8 mm.
    assert np.abs(specimen.protocols[0].stretch[REST:] - wanted).max() < 3e-4
    _, text = made(tmp_path, biotester_export(tracked=False), capsys)
    assert "from the rakes" in text
    out = tmp_path / "specimen.csv"
    code, _, err = biotester(tmp_path / "raw.csv", out, capsys, "--stretch-from", "tracked")
    assert code == 2 and "no tracked points" in err
    code, _, err = biotester(tmp_path / "raw.csv", out, capsys, "--test", "tube")
    assert code == 2 and "a BioTester tests no tubes" in err


@pytest.mark.parametrize("cycle", [1, 3])
def test_a_numbered_cycle(cycle, tmp_path, capsys):
    export = biotester_export(cycles=5)
    specimen, _ = made(tmp_path, export, capsys, "--cycles", cycle)
    softened = export.force_N * (1.0 + 0.3 * (5 - cycle) / 5)
    load = specimen.load(specimen.protocols[0])[-len(softened) :]
    np.testing.assert_allclose(load, softened, atol=5 * 0.0006)


def test_unloading_is_reversed(tmp_path, capsys):
    export = biotester_export()
    specimen, _ = made(tmp_path, export, capsys, "--branch", "unloading")
    (p,) = specimen.protocols
    assert np.abs(p.stretch_x - export.stretch[:, 0]).max() < 5e-4
    assert p.load_x[30] < export.force_N[30, 0]
    assert "branch" in {f.code for f in check_specimen(specimen) if f.severity == "warning"}
    specimen, _ = made(tmp_path, export, capsys, "--branch", "both")
    assert specimen.protocols[0].rows == 120 + REST
    assert {"unloading", "branch"} <= {f.code for f in check_specimen(specimen)}


def test_sets_and_files_become_protocols(tmp_path, capsys):
    first = biotester_export(name="Precondition", cycles=3)
    second = biotester_export(name="1:1", cycles=2, seed=1)
    third = biotester_export(name="1:0.5", cycles=2, ratio=(1.0, 0.5), seed=2)
    joined = first.text() + "".join(e.text().split("\n", 1)[1] for e in (second, third))
    path, out = written(tmp_path, joined), tmp_path / "specimen.csv"
    for sets, message in (((), "--set 1:0.5"), (("--set", "2:1"), "no set '2:1'")):
        code, _, err = biotester(path, out, capsys, *sets)
        assert code == 2 and message in err and not out.exists()
    assert biotester(path, out, capsys, "--set", "1:0.5")[0] == 0
    assert (
        np.abs(read_specimen(out).protocols[0].stretch_y[REST:] - third.stretch[:, 1]).max() < 5e-4
    )
    assert biotester(path, out, capsys, "--set", "1:1", "--set", "1:0.5")[0] == 0
    assert [p.name for p in read_specimen(out).protocols] == ["1:1", "1:0.5"]
    other = written(tmp_path, third.text().replace("1:0.5,", "1:1,"), "half.csv")
    arguments = [path, other, "--machine", "biotester", "--out", out, *DIMENSIONS, "--set", "1:1"]
    arguments += ["--cycles", "last", "--branch", "loading", "--protocol-names"]
    assert run([*arguments, "a, b"], capsys)[0] == 0
    assert [p.name for p in read_specimen(out).protocols] == ["a", "b"]
    code, _, err = run([*arguments, "a,b,c"], capsys)
    assert code == 2 and "3 protocol names for 2 protocols" in err
    # sets of two files are not parts of one table
    path.write_text(second.text().replace("XForce_mN", "Cell 1 (mN)"))
    other.write_text(third.text().replace("1:0.5,", "1:1,").replace("YForce_mN", "Cell 2 (mN)"))
    columns = "force_x_N=Cell 1 (mN),force_y_N=Cell 2 (mN)"
    code, _, err = run([*arguments[:-1], "--columns", columns], capsys)
    assert code == 2 and "no column 'Cell 2 (mN)'" in err and "join" not in err


def test_shear_of_tracked_points_is_carried_along_and_a_turn_is_not(tmp_path, capsys):
    specimen, _ = made(tmp_path, biotester_export(shear=0.4), capsys)
    assert specimen.metadata["largest_shear"] == pytest.approx(0.4 * 0.16, rel=0.02)
    (shear,) = (f for f in check_specimen(specimen) if f.code == "shear")
    assert shear.severity == "warning" and "0.064" in shear.message
    export = biotester_export()
    for number, cells in enumerate(export.rows):
        points = np.array(cells[9:], dtype=float).reshape(4, 2)
        angle = np.radians(8.0) * number / len(export.rows)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        cells[9:] = [f"{v:.3f}" for v in (points @ turn.T).ravel()]
    specimen, _ = made(tmp_path, export, capsys)
    assert np.abs(specimen.protocols[0].stretch[REST:] - export.stretch).max() < 1e-3


def test_points_tracked_in_some_rows_only(tmp_path, capsys):
    export = biotester_export()
    for cells in export.rows[1::2]:
        cells[9:] = [""] * 8
    specimen, text = made(tmp_path, export, capsys)
    assert specimen.protocols[0].rows == 30 + REST // 2 and "points not tracked" in text


def test_workbook_without_calamine_names_the_extra(tmp_path, capsys, monkeypatch):
    path = tmp_path / "raw.xlsx"
    path.write_bytes(xlsx({"a": [["F11"], [1.0]]}))
    (tmp_path / "python_calamine.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code, _, err = biotester(path, tmp_path / "a.csv", capsys)
    assert code == 2 and "pip install 'biaxbayes[tables]'" in err


GOOD = biotester_export(cycles=2).text()
LINES = GOOD.splitlines()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (GOOD.replace("YForce_mN", "XForce_N"), "XForce_mN and XForce_N are ambiguous"),
        (GOOD.replace("Cycle", "Phase"), "no column 'Cycle'"),
        (GOOD.replace("2-Hold", "holding"), "'holding' is not a phase"),
        (GOOD.replace("Stretch", "Pull"), "phases are hold, preload, pull"),
        (GOOD.replace("XForce_mN", "XForce_N"), "column XForce"),
        ("\n".join([*LINES[:-1], LINES[-1][:40]]), f"row {len(LINES)}"),
        ("\n".join(LINES[1:]), "no line of column names"),
        ("some words\nmore words\n", "no table"),
        ("", "is empty"),
    ],
)
def test_refused_exports(text, says, tmp_path, capsys):
    out = tmp_path / "specimen.csv"
    code, printed, err = biotester(written(tmp_path, text), out, capsys)
    assert code == 2 and printed == "" and err.count("\n") == 1
    assert str(tmp_path / "raw.csv") in err and says in err and not out.exists()


def test_an_export_with_one_force_may_be_of_a_strip(tmp_path, capsys):
    path = written(tmp_path, GOOD.replace("XForce_mN", "XLoad_mN"))
    code, _, err = biotester(path, tmp_path / "specimen.csv", capsys)
    assert code == 2 and "--test 'strip y'" in err and "columns are SetName" in err


def test_refused_options(tmp_path, capsys):
    path, out = written(tmp_path, GOOD), tmp_path / "specimen.csv"
    for more, says in (
        (["--cycles", "7"], "no cycle 7 of Test1; cycles are 1, 2"),
        (["--cycles", "first"], "--cycles 'first'"),
        (["--load-noise-kPa", "1"], "--load-noise-kPa"),
        (["--thickness-sd-mm", "-1"], "thickness_sd_mm"),
        (["--sheet", "A"], "has no sheets"),
    ):
        code, _, err = biotester(path, out, capsys, *more)
        assert code == 2 and says in err and err.count("\n") == 1
    words = [path, "--machine", "biotester", "--out", out, "--cycles", 2, "--branch", "loading"]
    for arguments, says in (
        (words, "--thickness-mm MM"),
        ([path, *words, *DIMENSIONS], "given twice"),
        ([path, "--machine", "generic", "--out", out, "--set", "all"], "--machine biotester"),
        ([*words[:4], path, *words[5:], *DIMENSIONS], "would be overwritten"),
    ):
        code, _, err = run(arguments, capsys)
        assert code == 2 and says in err
    assert path.read_text() == GOOD and not out.exists()


# --- generic ----------------------------------------------------------------------------------


def generic_text(stretch, load, names, more=None) -> str:
    columns = [*np.asarray(stretch).T, *np.asarray(load).T, *([] if more is None else more)]
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(names)
    table.writerows(zip(*(c.tolist() for c in columns), strict=True))
    return out.getvalue()


T = np.linspace(0.0, 1.0, 41)
STRETCH = np.column_stack([1.0 + 0.2 * T, 1.0 + 0.15 * T])
PIOLA = np.column_stack([2.0 + 60.0 * T**2, 1.0 + 40.0 * T**3])


def generic(folder: Path, text: str, columns: str | None, capsys, *more: object):
    path, out = written(folder, text), folder / "specimen.csv"
    mapped = [] if columns is None else ["--columns", columns]
    code, printed, err = run([path, "--machine", "generic", "--out", out, *mapped, *more], capsys)
    return code, printed + err, (read_specimen(out) if code == 0 else None)


TARGETS = "stretch_x={},stretch_y={},piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"


@pytest.mark.parametrize(
    ("target", "name", "says"),
    [
        ("piola", "Cauchy stress {} [kPa]", "cauchy_x_kPa"),
        ("piola", "sigma_{} [kPa]", "Cauchy"),
        ("piola", "S11 {} [kPa]", "second Piola-Kirchhoff"),
        ("cauchy", "T11 {} [kPa]", "membrane tension"),
        ("piola", "True stress {} (kPa)", "cauchy_x_kPa"),
        ("cauchy", "P11 {} kPa", "piola_x_kPa"),
        ("piola", "tau_{} [kPa]", "Kirchhoff (or shear)"),
        ("cauchy", "Engineering stress {} [kPa]", "piola_x_kPa"),
        ("piola", "PK2 {} [kPa]", "second Piola-Kirchhoff"),
        ("piola", "2PK {} [kPa]", "second Piola-Kirchhoff"),
        ("piola", "Piola-Kirchhoff II {} [kPa]", "second Piola-Kirchhoff"),
        ("piola", "Membrane stress {} [N/m]", "membrane tension"),
        ("piola", "P {} [foo]", "'foo' of 'P X [foo]'"),
    ],
)
def test_a_stress_of_another_kind_or_unit_is_refused(target, name, says, tmp_path, capsys):
    x, y = name.format("X"), name.format("Y")
    text = generic_text(STRETCH, PIOLA, ["F11", "F22", x, y])
    columns = f"stretch_x=F11,stretch_y=F22,{target}_x_kPa={x},{target}_y_kPa={y}"
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and says in printed
    if "[kPa]" in name:  # an expression is taken as it is said
        columns = columns.replace(x, f"{{{x}}}:kPa").replace(y, f"{{{y}}}:kPa")
        assert generic(tmp_path, text, columns, capsys)[0] == 0


@pytest.mark.parametrize("prefix", ["Axis", "Position(8800 (0,1):"])
def test_names_with_colons_and_commas_need_no_marks(prefix, tmp_path, capsys):
    names = [f"{prefix}Digital {axis} disp) (mm)" for axis in "XY"]
    names += [f"Load(8800 (0,{i}):Load) (N)" for i in (1, 2)]
    text = generic_text(10.0 * (STRETCH - 1.0), PIOLA * 0.012, names)
    targets = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")
    said = [f"1 + {{{name}}} / 10" for name in names[:2]] + names[2:]
    columns = ",".join(f"{t}={n}" for t, n in zip(targets, said, strict=True))
    code, printed, specimen = generic(tmp_path, text, columns, capsys, *DIMENSIONS)
    assert code == 0, printed
    np.testing.assert_allclose(specimen.protocols[0].load_y, PIOLA[:, 1] * 0.012, rtol=1e-12)
    code, printed, _ = generic(tmp_path, text, None, capsys, *DIMENSIONS)
    assert code == 2 and f"--columns 'stretch_x=1 + {{{names[0]}}} / LENGTH_MM'" in printed


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("stretch_x=F13", "columns are F11, F22, P_kPa, Q_kPa, P, F11"),
        ("stretch_x=F11,stretch_y=F22", "column 'F11' is ambiguous: columns 1 and 6"),
        ("stretch_x=E,stretch_y=F22", "'E' starts at 0: how does stretch_x follow"),
        ("stretch_x=F22,stretch_y={E} + 1", "no column for piola_x_kPa"),
        ("stretch_x=F22,stretch_y={E} + 1,piola_x_kPa=P", "the unit of 'P'"),
        ("stretch_x=F22,stretch_y={E} + 1,piola_x_kPa=P_kPa,force_y_N=P:N", "more than one"),
        ("stretch_x=F22,stretch_y={E} + 1,force_x_N=P_kPa", "'P_kPa' is in kPa"),
        ("stretch_x=F22,stretch_y=F22,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa", "used for both"),
        ("stretch_1=F22", "did you mean stretch_"),
        ("F22", "'F22' is not of the form"),
    ],
)
def test_refused_columns(columns, says, tmp_path, capsys):
    more = [PIOLA[:, 0], STRETCH[:, 0], STRETCH[:, 0] - 1.0]
    text = generic_text(STRETCH, PIOLA, ["F11", "F22", "P_kPa", "Q_kPa", "P", "F11", "E"], more)
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and says in printed


def test_mixed_decimals_and_binary_are_refused(tmp_path):
    mixed = written(tmp_path, "a;b;c\n1,5;2.5;3\n1,6;2.6;3\n1,7;2.7;3\n")
    with pytest.raises(InputError, match="mixes decimal commas"):
        read_tables(mixed)
    with pytest.raises(InputError, match="is binary"):
        read_tables(written(tmp_path, "a,b\n1,\0\n", "b.csv"))


def test_exports_of_absurd_size_are_refused_before_they_are_cut_up(tmp_path):
    path = written(tmp_path, "a,b\n" * 600_000)
    with pytest.raises(InputError, match="has more than 500,000 lines"):
        read_tables(path)
    path.write_bytes(b"," * 65_000_000)
    with pytest.raises(InputError, match="larger than 64 MB"):
        read_tables(path)
