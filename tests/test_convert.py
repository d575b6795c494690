"""Machine exports: the specimen that they were made from comes back, or one line says why not."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
import commands
from biaxbayes import read_specimen
from biaxbayes.errors import InputError
from biaxbayes.machines.conversion import shear_angle_deg
from biaxbayes.specimens.check import check_specimen
from biaxbayes.tables.table import read_tables
from virtual_biotester import EDGE_MM, THICKNESS_MM, biotester_export
from workbooks import xlsx

DIMENSIONS = [
    "--edge-x-mm", str(EDGE_MM), "--edge-y-mm", str(EDGE_MM),
    "--thickness-mm", str(THICKNESS_MM), "--geometry", "unloaded",
]  # fmt: skip


def run(arguments: list[object], capsys) -> tuple[int, str, str]:
    return commands.run(capsys, "convert", *arguments, "--overwrite")


def biotester(path: Path, out: Path, capsys, *more: object) -> tuple[int, str, str]:
    for answer, value in (("--cycles", "last"), ("--branch", "loading")):
        more = more if answer in more else (*more, answer, value)
    return run([path, "--machine", "biotester", "--out", out, *DIMENSIONS, *more], capsys)


def written(folder: Path, text: str, name: str = "raw.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


# --- BioTester --------------------------------------------------------------------------------


def test_the_specimen_that_an_export_was_made_from_comes_back(tmp_path, capsys):
    export = biotester_export(cycles=6)
    out = tmp_path / "specimen.csv"
    code, text, _ = biotester(
        written(tmp_path, export.text()), out, capsys, "--load-noise-N", 0.0006, "--layer", "media"
    )
    assert code == 0
    specimen = read_specimen(out)
    (p,) = specimen.protocols
    # The last cycle's loading branch, not its hold, recovery, or an earlier, stiffer cycle.
    assert p.rows == len(export.stretch)
    got = np.column_stack([p.stretch_x, p.stretch_y])
    # Four points of 0.02 px on 120 px: a scatter of about 0.02 / 240 = 8e-5 of the stretch.
    assert np.abs(got - export.stretch).max() < 5e-4
    force = specimen.load(p) - export.force_N
    assert np.abs(force).max() < 5 * 0.0006
    assert abs(force.std() - 0.0006) < 0.0001
    assert (specimen.load_noise, specimen.layer, specimen.geometry) == (0.0006, "media", "unloaded")
    assert specimen.metadata["cycle"] == "6 of 6"
    assert specimen.metadata["branch"] == "loading"
    reading, sd = specimen.mounting_readings(shared=False)
    np.testing.assert_array_less(np.abs(reading[0] - export.force_N[0]), 4 * sd[0])
    for words in ("kept", "cycle 6 of 6", "loading", "4 tracked points", "mounting force"):
        assert words in text
    warnings = [f for f in check_specimen(specimen) if f.severity == "warning"]
    assert {f.code for f in warnings} <= {"one-direction"}


def test_rake_distance_overstates_what_the_tissue_does(tmp_path, capsys):
    export = biotester_export()
    out = tmp_path / "specimen.csv"
    path = written(tmp_path, export.text())
    code, text, _ = biotester(path, out, capsys, "--stretch-from", "rake")
    assert code == 0 and "not from the tissue" in text
    (p,) = read_specimen(out).protocols
    wanted = 1.0 + (export.stretch - 1.0) / 0.9
    # The file rounds to 1 um of 8 mm.
    assert np.abs(np.column_stack([p.stretch_x, p.stretch_y]) - wanted).max() < 3e-4


def test_without_tracked_points_the_rake_serves(tmp_path, capsys):
    export = biotester_export(tracked=False)
    out = tmp_path / "specimen.csv"
    code, text, _ = biotester(written(tmp_path, export.text()), out, capsys)
    assert code == 0 and "from the rakes" in text
    code, _, err = biotester(tmp_path / "raw.csv", out, capsys, "--stretch-from", "tracked")
    assert code == 2
    assert "no tracked points" in err and "columns are SetName, Cycle" in err


@pytest.mark.parametrize("cycle", [1, 3])
def test_a_numbered_cycle(cycle, tmp_path, capsys):
    export = biotester_export(cycles=5)
    out = tmp_path / "specimen.csv"
    code, text, _ = biotester(written(tmp_path, export.text()), out, capsys, "--cycles", cycle)
    assert code == 0 and f"cycle {cycle} of 5" in text
    specimen = read_specimen(out)
    softened = 1.0 + 0.3 * (5 - cycle) / 5
    np.testing.assert_allclose(
        specimen.load(specimen.protocols[0]), export.force_N * softened, atol=5 * 0.0006
    )


def test_unloading_is_reversed_with_a_note(tmp_path, capsys):
    export = biotester_export()
    out = tmp_path / "specimen.csv"
    path = written(tmp_path, export.text())
    code, text, _ = biotester(path, out, capsys, "--branch", "unloading")
    assert code == 0 and "reversed" in text
    specimen = read_specimen(out)
    (p,) = specimen.protocols
    assert np.abs(p.stretch_x - export.stretch[:, 0]).max() < 5e-4
    assert p.load_x[30] < export.force_N[30, 0]
    assert "branch" in {f.code for f in check_specimen(specimen) if f.severity == "warning"}
    code, _, _ = biotester(path, out, capsys, "--branch", "both")
    assert code == 0
    specimen = read_specimen(out)
    assert specimen.protocols[0].rows == 120
    assert {"unloading", "branch"} <= {f.code for f in check_specimen(specimen)}


def test_sets_and_files_become_protocols(tmp_path, capsys):
    first = biotester_export(name="Precondition", cycles=3)
    second = biotester_export(name="1:1", cycles=2, seed=1)
    third = biotester_export(name="1:0.5", cycles=2, ratio=(1.0, 0.5), seed=2)
    joined = first.text() + "".join(e.text().split("\n", 1)[1] for e in (second, third))
    path, out = written(tmp_path, joined), tmp_path / "specimen.csv"
    code, text, err = biotester(path, out, capsys)
    assert code == 2 and "holds 3 sets" in err and "--set 1:0.5" in err and not out.exists()
    code, text, _ = biotester(path, out, capsys, "--set", "1:0.5")
    assert code == 0 and "sets left out: Precondition (" in text
    assert np.abs(read_specimen(out).protocols[0].stretch_y - third.stretch[:, 1]).max() < 5e-4
    code, _, _ = biotester(path, out, capsys, "--set", "1:1", "--set", "1:0.5")
    assert code == 0
    assert [p.name for p in read_specimen(out).protocols] == ["1:1", "1:0.5"]
    code, _, err = biotester(path, out, capsys, "--set", "2:1")
    assert code == 2 and "no set '2:1'" in err and "sets are Precondition, 1:1, 1:0.5" in err
    other = written(tmp_path, third.text(), "half.csv")
    arguments = [path, other, "--machine", "biotester", "--out", out, *DIMENSIONS, "--set", "1:1"]
    arguments += ["--cycles", "last", "--branch", "loading"]
    other.write_text(third.text().replace("1:0.5,", "1:1,"))
    code, _, _ = run([*arguments, "--protocol-names", "a, b"], capsys)
    assert code == 0 and [p.name for p in read_specimen(out).protocols] == ["a", "b"]
    code, _, err = run([*arguments, "--protocol-names", "a,b,c"], capsys)
    assert code == 2 and "3 protocol names for 2 protocols" in err


def test_shear_of_tracked_points_is_carried_along(tmp_path, capsys):
    out = tmp_path / "specimen.csv"
    export = biotester_export(shear=0.4)
    code, text, _ = biotester(written(tmp_path, export.text()), out, capsys)
    assert code == 0
    specimen = read_specimen(out)
    assert specimen.metadata["largest_shear"] == pytest.approx(0.4 * 0.16, rel=0.02)
    assert "which the model ignores" in text
    (shear,) = (f for f in check_specimen(specimen) if f.code == "shear")
    assert shear.severity == "warning" and "0.064" in shear.message


def test_a_specimen_that_turns_has_the_stretch_without_the_turn(tmp_path, capsys):
    export = biotester_export()
    for number, cells in enumerate(export.rows):
        points = np.array(cells[9:], dtype=float).reshape(4, 2)
        angle = np.radians(8.0) * number / len(export.rows)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        cells[9:] = [f"{v:.3f}" for v in (points @ turn.T).ravel()]
    out = tmp_path / "specimen.csv"
    code, _, err = biotester(written(tmp_path, export.text()), out, capsys)
    assert code == 0, err
    (p,) = read_specimen(out).protocols
    assert np.abs(p.stretch - export.stretch).max() < 1e-3


def test_points_tracked_in_some_rows_only(tmp_path, capsys):
    export = biotester_export()
    for number, cells in enumerate(export.rows):
        if number % 2:
            cells[9:] = [""] * 8
    out = tmp_path / "specimen.csv"
    code, text, _ = biotester(written(tmp_path, export.text()), out, capsys)
    assert code == 0 and "points not tracked" in text
    assert read_specimen(out).protocols[0].rows == 30


def test_a_sheet_a_protocol_is_one_command(tmp_path, capsys):
    sheets = {
        name: [["F11", "F22", "P11_kPa", "P22_kPa"]]
        + [[1 + t, 1 + ratio * t, 2 + 50 * t, 1 + 40 * ratio * t] for t in np.linspace(0, 0.2, 21)]
        for name, ratio in (("1 to 1", 1.0), ("1 to 0.5", 0.5), ("0.5 to 1", 2.0))
    }
    path, out = tmp_path / "tests.xlsx", tmp_path / "specimen.csv"
    path.write_bytes(xlsx(sheets | {"Notes": [["tested on Monday"]]}))
    mapped = "stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa"
    words = [path, "--machine", "generic", "--columns", mapped, "--out", out]
    code, text, _ = run([*words, "--sheet", "1 to 0.5", "--sheet", "1 to 1"], capsys)
    assert code == 0 and "sheet 1 to 0.5" in text
    assert [p.name for p in read_specimen(out).protocols] == ["1 to 0.5", "1 to 1"]
    assert run([*words, "--sheet", "all"], capsys)[0] == 0
    protocols = read_specimen(out).protocols
    assert [p.name for p in protocols] == ["1 to 1", "1 to 0.5", "0.5 to 1"]
    assert protocols[2].stretch_y[-1] == pytest.approx(1.4)
    for sheets, message in (
        ([], "more than one sheet"),
        (["1 to 1", "1 to 1"], "1 to 1"),
        (["1 to 1", "Notes"], "'Notes' holds no table"),
        (["C"], "no sheet 'C'; sheets are 1 to 1"),
    ):
        code, _, err = run([*words, *(w for s in sheets for w in ("--sheet", s))], capsys)
        assert code == 2 and message in err and (not sheets or err.count("\n") == 1), err
    path.write_bytes(path.read_bytes()[:3000])
    code, _, err = run(words, capsys)
    assert code == 2 and "not a readable workbook" in err


@pytest.mark.parametrize(
    ("delimiter", "names"),
    [(",", ("lambda_x", "lambda_y")), (" ", ("lam1", "lam2")), ("\t", ("Xlam", "Ylam"))],
)
def test_a_table_of_numpy_savetxt_with_its_names_in_a_comment(tmp_path, capsys, delimiter, names):
    header = delimiter.join([*names, "P1_kPa", "P2_kPa"])
    path, out = tmp_path / "saved.txt", tmp_path / "specimen.csv"
    np.savetxt(path, np.hstack([STRETCH, PIOLA]), delimiter=delimiter, header=header)
    columns = f"stretch_x={names[0]},stretch_y={names[1]},piola_x_kPa=P1_kPa,piola_y_kPa=P2_kPa"
    code, _, err = run([path, "--machine", "generic", "--columns", columns, "--out", out], capsys)
    assert code == 0, err
    result = read_specimen(out).protocols[0]
    assert result.rows == len(STRETCH)  # the first row is data
    np.testing.assert_allclose(result.stretch_x, STRETCH[:, 0], rtol=1e-12)
    np.testing.assert_allclose(result.load_y, PIOLA[:, 1], rtol=1e-12)


def test_workbook_without_calamine_names_the_extra(tmp_path, capsys, monkeypatch):
    path = tmp_path / "raw.xlsx"
    path.write_bytes(xlsx({"a": [["F11"], [1.0]]}))
    (tmp_path / "python_calamine.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code, _, err = biotester(path, tmp_path / "a.csv", capsys)
    assert code == 2
    assert "python-calamine is not installed; pip install 'biaxbayes[tables]'" in err


GOOD = biotester_export(cycles=2).text()
LINES = GOOD.splitlines()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            GOOD.replace("XForce_mN", "XLoad_mN"),
            ("no column 'XForce_mN'", "columns are SetName, Cycle"),
        ),
        (GOOD.replace("YForce_mN", "XForce_N"), ("XForce_mN and XForce_N are ambiguous",)),
        (GOOD.replace("Cycle", "Phase"), ("no column 'Cycle'", "--machine generic")),
        (GOOD.replace("2-Hold", "holding"), ("'holding' is not a phase", "column Cycle", "row ")),
        (GOOD.replace("Stretch", "Pull"), ("no Stretch phase", "phases are hold, preload, pull")),
        (GOOD.replace("XForce_mN", "XForce_N"), ("column XForce", "MPa", "in mN")),
        ("\n".join([*LINES[:-1], LINES[-1][:40]]), ("cut off", f"row {len(LINES)}")),
        ("\n".join(LINES[1:]), ("has no line of column names", "row 1")),
        ("some words\nmore words\n", ("holds no table with columns",)),
        ("", ("is empty",)),
    ],
)
def test_refused_exports(text, says, tmp_path, capsys):
    out = tmp_path / "specimen.csv"
    code, printed, err = biotester(written(tmp_path, text), out, capsys)
    assert code == 2 and printed == ""
    assert err.count("\n") == 1
    for words in (str(tmp_path / "raw.csv"), *says):
        assert words in err
    assert not out.exists()


REFUSED_OPTIONS = [
    (["--cycles", "7"], "no cycle 7 of Test1; cycles are 1, 2"),
    (["--cycles", "first"], "--cycles 'first' is not a cycle"),
    (["--columns", "stretch_x=F11"], "--columns is for --machine generic"),
    (["--load-noise-kPa", "1"], "--load-noise-kPa does not fit"),
    (["--thickness-sd-mm", "-1"], "thickness_sd_mm must be a positive number, not '-1'"),
    (["--sheet", "A"], "has no sheets"),
]


def test_refused_options(tmp_path, capsys):
    path, out = written(tmp_path, GOOD), tmp_path / "specimen.csv"
    for more, says in REFUSED_OPTIONS:
        code, _, err = biotester(path, out, capsys, *more)
        assert code == 2 and says in err and err.count("\n") == 1
    words = [path, "--machine", "biotester", "--out", out, "--cycles", 2, "--branch", "loading"]
    code, _, err = run(words, capsys)
    assert code == 2
    assert "forces need edge_x_mm, edge_y_mm, thickness_mm, geometry; give --edge-x-mm" in err
    code, _, err = run([path, *words, *DIMENSIONS], capsys)
    assert code == 2 and "is given twice" in err
    code, _, err = run([path, "--machine", "generic", "--out", out, "--set", "all"], capsys)
    assert code == 2
    assert "--set is for --machine biotester; leave it out" in err
    code, _, err = biotester(path, path, capsys)
    assert code == 2 and "would be overwritten" in err
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
PLAIN = "stretch_x=a,stretch_y=b,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"


def generic(folder: Path, text: str, columns: str | None, capsys, *more: object):
    path, out = written(folder, text), folder / "specimen.csv"
    mapped = [] if columns is None else ["--columns", columns]
    code, printed, err = run([path, "--machine", "generic", "--out", out, *mapped, *more], capsys)
    return code, printed + err, (read_specimen(out) if code == 0 else None)


GREEN, LOG, ALMANSI = 0.5 * (STRETCH**2 - 1.0), np.log(STRETCH), 0.5 * (1.0 - STRETCH**-2)


@pytest.mark.parametrize(
    ("x", "y", "values"),
    [
        ("a:stretch", "b:stretch", STRETCH),
        ("a:engineering", "b:engineering", STRETCH - 1.0),
        ("a:percent", "b:engineering_percent", 100.0 * (STRETCH - 1.0)),
        ("a:stretch_percent", "b:stretch_percent", 100.0 * STRETCH),
        ("a:green", "b:green", GREEN),
        ("a:green_percent", "b:green_percent", 100.0 * GREEN),
        ("a:log", "b:hencky", LOG),
        ("a:almansi", "b:almansi", ALMANSI),
        ("a:almansi_percent", "b:almansi_percent", 100.0 * ALMANSI),
        ("a:mm", "b:mm", 7.0 * STRETCH),
        ("a:um", "b:um", 7000.0 * STRETCH),
        ("a:displacement_mm", "b:displacement_mm", 10.0 * (STRETCH - 1.0)),
        ("a:displacement_um", "b:displacement_um", 1e4 * (STRETCH - 1.0)),
        ("E11 Lagrange %:green", "E22 [%]:green", 100.0 * GREEN),
        ("Green-Lagrange E11", "greenStrainY (mm/mm)", GREEN),
        ("nominal_strain_x [µε]", "nominal_strain_y [µε]", 1e6 * (STRETCH - 1.0)),
    ],
)
def test_kinds_of_strain_as_given_or_by_name(x, y, values, tmp_path, capsys):
    names = [c.partition(":")[0] for c in (x, y)]
    text = generic_text(values, PIOLA, [*names, "P_kPa", "Q_kPa"])
    columns = f"stretch_x={x},stretch_y={y},piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    gauge = ["--gauge-x-mm", 10, "--gauge-y-mm", 10] if "displacement" in x else []
    code, printed, specimen = generic(tmp_path, text, columns, capsys, *DIMENSIONS, *gauge)
    assert code == 0, printed
    (p,) = specimen.protocols
    np.testing.assert_allclose(np.column_stack([p.stretch_x, p.stretch_y]), STRETCH, rtol=1e-12)
    np.testing.assert_array_equal(np.column_stack([p.load_x, p.load_y]), PIOLA)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("E11 Lagrange %", ""),
        ("true stretch", ""),
        ("Green strain XX [%]", ":percent"),
        ("strain_true", ":percent"),
    ],
)
def test_an_ambiguous_kind_of_strain_is_refused(name, kind, tmp_path, capsys):
    text = generic_text(STRETCH - 1.0, PIOLA, [name, f"{name} y", "P_kPa", "Q_kPa"])
    columns = f"stretch_x={name}{kind},stretch_y={name} y,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and printed.count("\n") == 1
    assert "kind" in printed and "green_percent" in printed and "log" in printed


@pytest.mark.parametrize(
    ("names", "values", "says"),
    [
        (["Green [%]", "Green y [%]"], GREEN, "spreadsheets store 20 % as 0.2"),
        (["Green", "Green y"], STRETCH, "starts at 1"),
        (["lambda_x", "lambda_y"], STRETCH - 1.0, "starts at 0"),
    ],
)
def test_values_that_contradict_the_name(names, values, says, tmp_path, capsys):
    text = generic_text(values, PIOLA, [*names, "P_kPa", "Q_kPa"])
    columns = f"stretch_x={names[0]},stretch_y={names[1]},piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and says in printed and printed.count("\n") == 1


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (["Grip displacement X [mm]", "Grip displacement Y [mm]"], 1.0),
        (["crosshead_x_um", "crosshead_y_um"], 1e3),
        (["Weg X, cm", "Weg Y, cm"], 0.1),
        (["Extension 1 (in)", "Extension 2 (in)"], 1 / 25.4),
    ],
)
def test_a_displacement_refers_to_the_gauge_length(names, unit, tmp_path, capsys):
    """Mounted at 1.02 and 1.05, zeroed there: the gauge length is not the unloaded edge."""
    gauge = EDGE_MM * np.array([1.02, 1.05])
    text = generic_text((STRETCH - 1.0) * gauge * unit, PIOLA, [*names, "P_kPa", "Q_kPa"])
    columns = f"stretch_x={names[0]},stretch_y={names[1]},piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    given = ["--gauge-x-mm", gauge[0], "--gauge-y-mm", gauge[1]]
    code, printed, specimen = generic(tmp_path, text, columns, capsys, *DIMENSIONS, *given)
    assert code == 0 and "the stated gauge length" in printed
    (p,) = specimen.protocols
    np.testing.assert_allclose(np.column_stack([p.stretch_x, p.stretch_y]), STRETCH, rtol=1e-12)
    # Without it nothing is assumed: the edge is one of the answers.
    code, printed, _ = generic(tmp_path, text, columns, capsys, *DIMENSIONS)
    assert code == 2 and "needs its length at displacement zero" in printed
    assert "--gauge-x-mm 10" in printed and "too large by the mounting stretch" in printed


def test_a_distance_of_marks_needs_no_gauge_length(tmp_path, capsys):
    names = ["Marker distance X [mm]", "Marker distance Y [mm]"]
    text = generic_text(7.3 * STRETCH, PIOLA, [*names, "P_kPa", "Q_kPa"])
    columns = f"stretch_x={names[0]},stretch_y={names[1]},piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    code, printed, specimen = generic(tmp_path, text, columns, capsys)
    assert code == 0 and "over its first value, 7.3 mm" in printed
    np.testing.assert_allclose(specimen.protocols[0].stretch_y, STRETCH[:, 1], rtol=1e-12)
    code, printed, specimen = generic(
        tmp_path, text, columns, capsys, "--gauge-x-mm", 7.0, "--gauge-y-mm", 7.0
    )
    assert code == 0
    assert specimen.protocols[0].reference == pytest.approx((7.3 / 7.0, 7.3 / 7.0))


def test_a_displacement_that_does_not_start_at_zero_needs_its_origin(tmp_path, capsys):
    moved = 0.5 + 10.0 * (STRETCH - 1.0)  # the first row is 10 mm apart, zero was 9.5 mm
    text = generic_text(moved, PIOLA, ["dispx_mm", "dispy_mm", "P_kPa", "Q_kPa"])
    columns = "stretch_x=dispx_mm,stretch_y=dispy_mm,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    for at, length in (("zero", 9.5), ("start", 10.0)):
        given = ["--gauge-x-mm", length, "--gauge-y-mm", length]
        code, printed, _ = generic(tmp_path, text, columns, capsys, *given)
        assert code == 2 and "starts at 0.5 mm" in printed and "--gauge-at" in printed
        code, _, specimen = generic(tmp_path, text, columns, capsys, *given, "--gauge-at", at)
        assert code == 0
        np.testing.assert_allclose(specimen.protocols[0].stretch_x, STRETCH[:, 0], rtol=1e-12)


@pytest.mark.parametrize(
    ("target", "name", "says"),
    [
        ("piola", "Cauchy stress {} [kPa]", "cauchy_x_kPa"),
        ("piola", "sigma_{} [kPa]", "a Cauchy stress"),
        ("piola", "S11 {} [kPa]", "a second Piola-Kirchhoff stress"),
        ("cauchy", "T11 {} [kPa]", "or a membrane tension"),
        ("piola", "True stress {} (kPa)", "cauchy_x_kPa"),
        ("cauchy", "P11 {} kPa", "piola_x_kPa"),
        ("piola", "tau_{} [kPa]", "a Kirchhoff (or shear) stress"),
        ("cauchy", "Engineering stress {} [kPa]", "piola_x_kPa"),
        ("piola", "PK2 {} [kPa]", "times the stretch"),
        ("piola", "2PK {} [kPa]", "second Piola-Kirchhoff"),
        ("piola", "Piola-Kirchhoff II {} [kPa]", "second Piola-Kirchhoff"),
        ("piola", "Membrane stress {} [N/m]", "membrane tension"),
        ("piola", "P {} [foo]", "'foo' of 'P X [foo]' is not a known unit"),
    ],
)
def test_a_stress_of_another_kind_or_unit_is_refused(target, name, says, tmp_path, capsys):
    x, y = name.format("X"), name.format("Y")
    text = generic_text(STRETCH, PIOLA, ["F11", "F22", x, y])
    columns = f"stretch_x=F11,stretch_y=F22,{target}_x_kPa={x},{target}_y_kPa={y}"
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and says in printed
    if "[kPa]" in name:  # the kind is stated behind a colon
        columns = columns.replace(x, f"{x}:{target}").replace(y, f"{y}:{target}")
        assert generic(tmp_path, text, columns, capsys)[0] == 0


@pytest.mark.parametrize("prefix", ["Axis", "Position(8800 (0,1):"])
def test_names_with_colons_and_commas_need_no_marks(prefix, tmp_path, capsys):
    names = [f"{prefix}Digital {axis} disp) (mm)" for axis in "XY"]
    loads = [f"Load(8800 (0,{i}):Load) (N)" for i in (1, 2)]
    text = generic_text(10.0 * (STRETCH - 1.0), PIOLA * 0.012, [*names, *loads])
    columns = ",".join(
        f"{t}={n}"
        for t, n in zip(
            ("stretch_x", "stretch_y", "force_x_N", "force_y_N"), [*names, *loads], strict=True
        )
    )
    gauge = ["--gauge-x-mm", 10, "--gauge-y-mm", 10]
    code, printed, specimen = generic(tmp_path, text, columns, capsys, *DIMENSIONS, *gauge)
    assert code == 0, printed
    np.testing.assert_allclose(specimen.protocols[0].load_y, PIOLA[:, 1] * 0.012, rtol=1e-12)
    code, printed, _ = generic(tmp_path, text, None, capsys, *DIMENSIONS, *gauge)
    assert code == 2 and f"--columns 'stretch_x={names[0]},stretch_y={names[1]}" in printed


def test_columns_that_speak_for_themselves(tmp_path, capsys):
    text = generic_text(
        STRETCH, PIOLA * 12.0, ["stretch_x", "stretch_y", "force_x_mN", "force_y_mN"]
    )
    code, printed, specimen = generic(tmp_path, text, None, capsys, *DIMENSIONS)
    assert code == 0 and "force_x_N from force_x_mN (mN)" in printed
    np.testing.assert_allclose(specimen.protocols[0].load_x, PIOLA[:, 0] * 0.012)


def test_cycles_detected_from_the_curves(tmp_path, capsys):
    up = np.r_[np.zeros(10), T, T[::-1][1:]]
    path = np.r_[0.7 * up, 0.8 * up, up]
    stretch = np.column_stack([1.0 + 0.2 * path, 1.0 + 0.1 * path])
    load = np.column_stack([2.0 + 60.0 * path**2, 1.0 + 40.0 * path**3])
    text = generic_text(stretch, load, ["a", "b", "P_kPa", "Q_kPa"])
    columns = PLAIN.replace("=a", "=a:stretch").replace("=b", "=b:stretch")
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and "holds several cycles (3)" in printed and "--cycles last" in printed
    answers = ("--cycles", "last", "--branch", "loading")
    code, printed, specimen = generic(tmp_path, text, columns, capsys, *answers)
    assert code == 0 and "cycle 3 of 3" in printed
    (p,) = specimen.protocols
    assert p.load_x[-1] == 62.0 and p.rest_rows >= 10
    code, _, specimen = generic(
        tmp_path, text, columns, capsys, "--cycles", 1, "--branch", "loading"
    )
    assert specimen.protocols[0].load_x[-1] == 2.0 + 60.0 * 0.7**2
    code, printed, _ = generic(
        tmp_path, text, columns, capsys, "--cycles", 4, "--branch", "loading"
    )
    assert code == 2 and "no cycle 4; cycles are 1, 2, 3" in printed
    # The same with a column that numbers them.
    number = np.repeat([5, 6, 9], len(up))
    text = generic_text(stretch, load, ["a", "b", "P_kPa", "Q_kPa", "No"], [number])
    code, printed, specimen = generic(
        tmp_path, text, columns + ",cycle=No", capsys, "--cycles", 6, "--branch", "unloading"
    )
    assert code == 0 and "cycle 6 (2 of 3), reversed unloading" in printed
    assert specimen.protocols[0].load_x.max() == pytest.approx(2.0 + 60.0 * 0.8**2)
    assert specimen.protocols[0].rows == 41


def test_protocol_column_and_time(tmp_path, capsys):
    stretch, load = np.tile(STRETCH, (2, 1)), np.tile(PIOLA, (2, 1))
    more = [np.repeat(["1:1", "1:0.5"], 41), np.arange(82) * 0.5]
    text = generic_text(
        stretch, load, ["F11", "F22", "P_kPa", "Q_kPa", "Protocol", "Time_ms"], more
    )
    columns = "stretch_x=F11,stretch_y=F22,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa,time_s=Time_ms"
    code, printed, specimen = generic(tmp_path, text, columns, capsys)
    assert code == 0 and "protocol from Protocol" in printed
    assert [p.name for p in specimen.protocols] == ["1:1", "1:0.5"]
    np.testing.assert_allclose(specimen.protocols[1].time_s[:2], [0.0205, 0.021])


def test_reference_drift_stays_in_the_file(tmp_path, capsys):
    """The stretch is written as measured, so that the reader can tell the drift."""
    paths = []
    for name, drift in (("a", 1.0), ("b", 1.01)):
        text = generic_text(STRETCH * drift, PIOLA, ["F11", "F22", "P_kPa", "Q_kPa"])
        paths.append(written(tmp_path, text, f"{name}.csv"))
    columns = "stretch_x=F11,stretch_y=F22,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    out = tmp_path / "s.csv"
    words = [*paths, "--machine", "generic", "--columns", columns, "--out", out]
    code, _, err = run(words, capsys)
    assert code == 2 and "same stretch ratio comes back" in err and "--repeats cycles" in err
    assert run([*words, "--repeats", "protocols"], capsys)[0] == 0
    specimen = read_specimen(out)
    assert [p.name for p in specimen.protocols] == ["a", "b"]
    assert specimen.protocols[1].reference == pytest.approx((1.01, 1.01))
    assert "stretch-drift" in {f.code for f in check_specimen(specimen)}


def test_shear_angle_knows_rotation_from_shear():
    angle = 0.05
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    stretch = np.diag([1.2, 1.1])
    np.testing.assert_allclose(shear_angle_deg((rotation @ stretch)[None]), 0.0, atol=1e-12)
    simple = np.array([[1.0, 0.1], [0.0, 1.0]])
    # Simple shear by g turns the y fibre by atan(g).
    np.testing.assert_allclose(shear_angle_deg(simple[None]), np.degrees(np.arctan(0.1)))


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("stretch_x=F13", ("no column 'F13'", "columns are F11, F22, P_kPa, Q_kPa, P, F11")),
        ("stretch_x=F11,stretch_y=F22", ("column 'F11' is ambiguous: columns 1 and 6",)),
        ("stretch_x=E,stretch_y=F22", ("not clear what kind of stretch or strain 'E'", "green")),
        ("stretch_x=F22,stretch_y=E:stretch", ("no column for a force or stress",)),
        (
            "stretch_x=F22,stretch_y=E:stretch,piola_x_kPa=P",
            ("the unit of 'P' is not known", "P:UNIT", "kgf/cm2"),
        ),
        ("stretch_x=F22,stretch_y=E:stretch,piola_x_kPa=P_kPa,force_y_N=P:N", ("more than one",)),
        (
            "stretch_x=F22,stretch_y=E:stretch,force_x_N=P_kPa",
            ("'P_kPa' is in kPa, a stress, but force_x_N",),
        ),
        ("stretch_x=F22,stretch_y=F22,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa", ("used for both",)),
        ("stretch_1=F22", ("unknown target 'stretch_1'", "did you mean stretch_")),
        ("F22", ("'F22' is not of the form stretch_x=F11",)),
    ],
)
def test_refused_columns(columns, says, tmp_path, capsys):
    more = [PIOLA[:, 0], STRETCH[:, 0], STRETCH[:, 0] - 1.0]
    text = generic_text(STRETCH, PIOLA, ["F11", "F22", "P_kPa", "Q_kPa", "P", "F11", "E"], more)
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2
    assert printed.count("\n") == 1
    for words in says:
        assert words in printed


def test_displacements_need_edges(tmp_path, capsys):
    text = generic_text(STRETCH - 1.0, PIOLA, ["xdisp_mm", "ydisp_mm", "P_kPa", "Q_kPa"])
    columns = "stretch_x=xdisp_mm,stretch_y=ydisp_mm,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2
    assert "needs its length at displacement zero" in printed and "--gauge-x-mm" in printed
    text = generic_text(STRETCH - 1.0, PIOLA, ["x_mm", "y_mm", "P_kPa", "Q_kPa"])
    columns = "stretch_x=x_mm,stretch_y=y_mm,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and "stretch_x=x_mm:displacement_mm" in printed


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


def test_header_keys_are_keywords_in_python(tmp_path):
    raw = written(tmp_path, biotester_export().text())
    answers = {"machine": "biotester", "cycles": "last", "branch": "loading"}
    given = {"edge_x_mm": 9.0, "edge_y_mm": 9.5, "thickness_mm": 1.1, "layer": "media"}
    made = biaxbayes.convert(raw, **answers, geometry="unloaded", **given).specimen
    assert {key: getattr(made, key) for key in given} == given
    assert made.name == "raw"
    with pytest.raises(InputError, match="no option 'edge_z_mm'"):
        biaxbayes.convert(raw, **answers, edge_z_mm=20)


@pytest.mark.parametrize(
    ("names", "stem"),
    [
        (("P6_equi.csv", "P6_1-2.csv"), "P6"),
        (("donor1-11.csv", "donor1-12.csv"), "donor1"),
        (("a.csv", "b.csv"), "a"),
    ],
)
def test_several_files_give_the_name_that_they_begin_with(names, stem, tmp_path):
    text = biotester_export().text()
    raws = [written(tmp_path, text, name) for name in names]
    answers = {"machine": "biotester", "cycles": "last", "branch": "loading"}
    answers |= {"repeats": "protocols", "geometry": "unloaded"}
    header = {"edge_x_mm": EDGE_MM, "edge_y_mm": EDGE_MM, "thickness_mm": THICKNESS_MM}
    assert biaxbayes.convert(raws, **answers, header=header).specimen.name == stem
    given = biaxbayes.convert(raws, **answers, header=header | {"specimen": "P7"}).specimen
    assert given.name == "P7"
