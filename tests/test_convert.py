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
    # The last cycle's loading branch, not its hold, recovery, or an earlier, stiffer cycle.
    assert p.rows == len(export.stretch)
    # Four points of 0.02 px on 120 px: a scatter of about 0.02 / 240 = 8e-5 of the stretch.
    assert np.abs(p.stretch - export.stretch).max() < 5e-4
    force = specimen.load(p) - export.force_N
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
    assert np.abs(specimen.protocols[0].stretch - wanted).max() < 3e-4
    _, text = made(tmp_path, biotester_export(tracked=False), capsys)
    assert "from the rakes" in text
    out = tmp_path / "specimen.csv"
    code, _, err = biotester(tmp_path / "raw.csv", out, capsys, "--stretch-from", "tracked")
    assert code == 2 and "no tracked points" in err


@pytest.mark.parametrize("cycle", [1, 3])
def test_a_numbered_cycle(cycle, tmp_path, capsys):
    export = biotester_export(cycles=5)
    specimen, _ = made(tmp_path, export, capsys, "--cycles", cycle)
    softened = export.force_N * (1.0 + 0.3 * (5 - cycle) / 5)
    load = specimen.load(specimen.protocols[0])
    np.testing.assert_allclose(load, softened, atol=5 * 0.0006)


def test_unloading_is_reversed(tmp_path, capsys):
    export = biotester_export()
    specimen, _ = made(tmp_path, export, capsys, "--branch", "unloading")
    (p,) = specimen.protocols
    assert np.abs(p.stretch_x - export.stretch[:, 0]).max() < 5e-4
    assert p.load_x[30] < export.force_N[30, 0]
    assert "branch" in {f.code for f in check_specimen(specimen) if f.severity == "warning"}
    specimen, _ = made(tmp_path, export, capsys, "--branch", "both")
    assert specimen.protocols[0].rows == 120
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
    assert np.abs(read_specimen(out).protocols[0].stretch_y - third.stretch[:, 1]).max() < 5e-4
    assert biotester(path, out, capsys, "--set", "1:1", "--set", "1:0.5")[0] == 0
    assert [p.name for p in read_specimen(out).protocols] == ["1:1", "1:0.5"]
    other = written(tmp_path, third.text().replace("1:0.5,", "1:1,"), "half.csv")
    arguments = [path, other, "--machine", "biotester", "--out", out, *DIMENSIONS, "--set", "1:1"]
    arguments += ["--cycles", "last", "--branch", "loading", "--protocol-names"]
    assert run([*arguments, "a, b"], capsys)[0] == 0
    assert [p.name for p in read_specimen(out).protocols] == ["a", "b"]
    code, _, err = run([*arguments, "a,b,c"], capsys)
    assert code == 2 and "3 protocol names for 2 protocols" in err


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
    assert np.abs(specimen.protocols[0].stretch - export.stretch).max() < 1e-3


def test_points_tracked_in_some_rows_only(tmp_path, capsys):
    export = biotester_export()
    for cells in export.rows[1::2]:
        cells[9:] = [""] * 8
    specimen, text = made(tmp_path, export, capsys)
    assert specimen.protocols[0].rows == 30 and "points not tracked" in text


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
    assert run([*words, "--sheet", "1 to 0.5", "--sheet", "1 to 1"], capsys)[0] == 0
    assert [p.name for p in read_specimen(out).protocols] == ["1 to 0.5", "1 to 1"]
    assert run([*words, "--sheet", "all"], capsys)[0] == 0
    protocols = read_specimen(out).protocols
    assert [p.name for p in protocols] == ["1 to 1", "1 to 0.5", "0.5 to 1"]
    assert protocols[2].stretch_y[-1] == pytest.approx(1.4)
    for sheets, message in (
        ([], "more than one sheet"),
        (["1 to 1", "1 to 1"], "1 to 1"),
        (["1 to 1", "Notes"], "'Notes' holds no table"),
        (["C"], "no sheet 'C'"),
    ):
        code, _, err = run([*words, *(w for s in sheets for w in ("--sheet", s))], capsys)
        assert code == 2 and message in err, err
    path.write_bytes(path.read_bytes()[:3000])
    code, _, err = run(words, capsys)
    assert code == 2 and "not a readable workbook" in err


@pytest.mark.parametrize("delimiter", [",", " ", "\t"])
def test_a_table_of_numpy_savetxt_with_its_names_in_a_comment(tmp_path, capsys, delimiter):
    header = delimiter.join(["lambda_x", "lambda_y", "P1_kPa", "P2_kPa"])
    path, out = tmp_path / "saved.txt", tmp_path / "specimen.csv"
    np.savetxt(path, np.hstack([STRETCH, PIOLA]), delimiter=delimiter, header=header)
    columns = "stretch_x=lambda_x,stretch_y=lambda_y,piola_x_kPa=P1_kPa,piola_y_kPa=P2_kPa"
    code, _, err = run([path, "--machine", "generic", "--columns", columns, "--out", out], capsys)
    assert code == 0, err
    result = read_specimen(out).protocols[0]  # the first row is data
    np.testing.assert_allclose(result.stretch_x, STRETCH[:, 0], rtol=1e-12)
    np.testing.assert_allclose(result.load_y, PIOLA[:, 1], rtol=1e-12)


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
        (GOOD.replace("XForce_mN", "XLoad_mN"), "no column 'XForce_mN'"),
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


def test_refused_options(tmp_path, capsys):
    path, out = written(tmp_path, GOOD), tmp_path / "specimen.csv"
    for more, says in (
        (["--cycles", "7"], "no cycle 7 of Test1; cycles are 1, 2"),
        (["--cycles", "first"], "--cycles 'first'"),
        (["--columns", "stretch_x=F11"], "--columns is for --machine generic"),
        (["--load-noise-kPa", "1"], "--load-noise-kPa"),
        (["--thickness-sd-mm", "-1"], "thickness_sd_mm"),
        (["--sheet", "A"], "has no sheets"),
    ):
        code, _, err = biotester(path, out, capsys, *more)
        assert code == 2 and says in err and err.count("\n") == 1
    words = [path, "--machine", "biotester", "--out", out, "--cycles", 2, "--branch", "loading"]
    for arguments, says in (
        (words, "forces need edge_x_mm, edge_y_mm, thickness_mm, geometry; give --edge-x-mm"),
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


GREEN, LOG, ALMANSI = 0.5 * (STRETCH**2 - 1.0), np.log(STRETCH), 0.5 * (1.0 - STRETCH**-2)
TARGETS = "stretch_x={},stretch_y={},piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"


def assert_stretch(specimen) -> None:
    np.testing.assert_allclose(specimen.protocols[0].stretch, STRETCH, rtol=1e-12)


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
    gauge = ["--gauge-x-mm", 10, "--gauge-y-mm", 10] if "displacement" in x else []
    given = TARGETS.format(x, y)
    code, printed, specimen = generic(tmp_path, text, given, capsys, *DIMENSIONS, *gauge)
    assert code == 0, printed
    assert_stretch(specimen)
    np.testing.assert_array_equal(specimen.protocols[0].recorded_load, PIOLA)


@pytest.mark.parametrize(
    ("name", "kind", "values", "says"),
    [
        ("E11 Lagrange %", "", STRETCH - 1.0, "kind"),
        ("true stretch", "", STRETCH - 1.0, "kind"),
        ("Green strain XX [%]", ":percent", STRETCH - 1.0, "kind"),
        ("strain_true", ":percent", STRETCH - 1.0, "kind"),
        ("Green [%]", "", GREEN, "spreadsheets store 20 % as 0.2"),
        ("Green", "", STRETCH, "starts at 1"),
        ("lambda_x", "", STRETCH - 1.0, "starts at 0"),
    ],
)
def test_strains_that_are_ambiguous_or_contradict_their_name(
    name, kind, values, says, tmp_path, capsys
):
    text = generic_text(values, PIOLA, [name, f"{name} y", "P_kPa", "Q_kPa"])
    given = TARGETS.format(name + kind, f"{name} y")
    code, printed, _ = generic(tmp_path, text, given, capsys)
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
    words = (tmp_path, text, TARGETS.format(*names), capsys, *DIMENSIONS)
    given = ["--gauge-x-mm", gauge[0], "--gauge-y-mm", gauge[1]]
    code, printed, specimen = generic(*words, *given)
    assert code == 0, printed
    assert_stretch(specimen)
    # Without it nothing is assumed: the edge is one of the answers.
    code, printed, _ = generic(*words)
    assert code == 2 and "--gauge-x-mm 10" in printed


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
    if "[kPa]" in name:  # the kind is stated behind a colon
        columns = columns.replace(x, f"{x}:{target}").replace(y, f"{y}:{target}")
        assert generic(tmp_path, text, columns, capsys)[0] == 0


@pytest.mark.parametrize("prefix", ["Axis", "Position(8800 (0,1):"])
def test_names_with_colons_and_commas_need_no_marks(prefix, tmp_path, capsys):
    names = [f"{prefix}Digital {axis} disp) (mm)" for axis in "XY"]
    names += [f"Load(8800 (0,{i}):Load) (N)" for i in (1, 2)]
    text = generic_text(10.0 * (STRETCH - 1.0), PIOLA * 0.012, names)
    targets = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")
    columns = ",".join(f"{t}={n}" for t, n in zip(targets, names, strict=True))
    gauge = ["--gauge-x-mm", 10, "--gauge-y-mm", 10]
    code, printed, specimen = generic(tmp_path, text, columns, capsys, *DIMENSIONS, *gauge)
    assert code == 0, printed
    np.testing.assert_allclose(specimen.protocols[0].load_y, PIOLA[:, 1] * 0.012, rtol=1e-12)
    code, printed, _ = generic(tmp_path, text, None, capsys, *DIMENSIONS, *gauge)
    assert code == 2 and f"--columns 'stretch_x={names[0]},stretch_y={names[1]}" in printed


def test_cycles_detected_from_the_curves(tmp_path, capsys):
    up = np.r_[np.zeros(10), T, T[::-1][1:]]
    path = np.r_[0.7 * up, 0.8 * up, up]
    stretch = np.column_stack([1.0 + 0.2 * path, 1.0 + 0.1 * path])
    load = np.column_stack([2.0 + 60.0 * path**2, 1.0 + 40.0 * path**3])
    text, columns = (
        generic_text(stretch, load, ["a", "b", "P_kPa", "Q_kPa"]),
        TARGETS.format("a:stretch", "b:stretch"),
    )
    words = (tmp_path, text, columns, capsys)
    code, printed, _ = generic(*words)
    assert code == 2 and "several cycles (3)" in printed and "--cycles last" in printed
    (p,) = generic(*words, "--cycles", "last", "--branch", "loading")[2].protocols
    assert p.load_x[-1] == 62.0 and p.rest_rows >= 10
    (p,) = generic(*words, "--cycles", 1, "--branch", "loading")[2].protocols
    assert p.load_x[-1] == 2.0 + 60.0 * 0.7**2
    code, printed, _ = generic(*words, "--cycles", 4, "--branch", "loading")
    assert code == 2 and "no cycle 4; cycles are 1, 2, 3" in printed
    # The same with a column that numbers them.
    number = np.repeat([5, 6, 9], len(up))
    text = generic_text(stretch, load, ["a", "b", "P_kPa", "Q_kPa", "No"], [number])
    words = (tmp_path, text, columns + ",cycle=No", capsys)
    (p,) = generic(*words, "--cycles", 6, "--branch", "unloading")[2].protocols
    assert p.load_x.max() == pytest.approx(2.0 + 60.0 * 0.8**2) and p.rows == 41


def test_protocol_column_and_time(tmp_path, capsys):
    stretch, load = np.tile(STRETCH, (2, 1)), np.tile(PIOLA, (2, 1))
    more = [np.repeat(["1:1", "1:0.5"], 41), np.arange(82) * 0.5]
    names = ["F11", "F22", "P_kPa", "Q_kPa", "Protocol", "Time_ms"]
    text = generic_text(stretch, load, names, more)
    columns = TARGETS.format("F11", "F22") + ",time_s=Time_ms"
    specimen = generic(tmp_path, text, columns, capsys)[2]
    assert [p.name for p in specimen.protocols] == ["1:1", "1:0.5"]
    np.testing.assert_allclose(specimen.protocols[1].time_s[:2], [0.0205, 0.021])


def test_reference_drift_stays_in_the_file(tmp_path, capsys):
    """The stretch is written as measured, so that the reader can tell the drift."""
    paths, out = [], tmp_path / "s.csv"
    for name, drift in (("a", 1.0), ("b", 1.01)):
        text = generic_text(STRETCH * drift, PIOLA, ["F11", "F22", "P_kPa", "Q_kPa"])
        paths.append(written(tmp_path, text, f"{name}.csv"))
    columns = TARGETS.format("F11", "F22")
    words = [*paths, "--machine", "generic", "--columns", columns, "--out", out]
    code, _, err = run(words, capsys)
    assert code == 2 and "--repeats cycles" in err
    assert run([*words, "--repeats", "protocols"], capsys)[0] == 0
    specimen = read_specimen(out)
    assert [p.name for p in specimen.protocols] == ["a", "b"]
    assert specimen.protocols[1].reference == pytest.approx((1.01, 1.01))
    assert "stretch-drift" in {f.code for f in check_specimen(specimen)}


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("stretch_x=F13", "columns are F11, F22, P_kPa, Q_kPa, P, F11"),
        ("stretch_x=F11,stretch_y=F22", "column 'F11' is ambiguous: columns 1 and 6"),
        ("stretch_x=E,stretch_y=F22", "kind of stretch or strain 'E'"),
        ("stretch_x=F22,stretch_y=E:stretch", "no column for a force or stress"),
        ("stretch_x=F22,stretch_y=E:stretch,piola_x_kPa=P", "the unit of 'P'"),
        ("stretch_x=F22,stretch_y=E:stretch,piola_x_kPa=P_kPa,force_y_N=P:N", "more than one"),
        ("stretch_x=F22,stretch_y=E:stretch,force_x_N=P_kPa", "'P_kPa' is in kPa"),
        ("stretch_x=F22,stretch_y=F22,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa", "used for both"),
        ("stretch_1=F22", "did you mean stretch_"),
        ("F22", "'F22' is not of the form"),
    ],
)
def test_refused_columns(columns, says, tmp_path, capsys):
    more = [PIOLA[:, 0], STRETCH[:, 0], STRETCH[:, 0] - 1.0]
    text = generic_text(STRETCH, PIOLA, ["F11", "F22", "P_kPa", "Q_kPa", "P", "F11", "E"], more)
    code, printed, _ = generic(tmp_path, text, columns, capsys)
    assert code == 2 and printed.count("\n") == 1 and says in printed


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
