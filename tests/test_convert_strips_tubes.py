"""Tables of strips and tubes: the readings that they were made from come back, or it is asked."""

import numpy as np
import pytest

import biaxbayes
import commands
from biaxbayes import read_specimen
from biaxbayes.errors import InputError
from biaxbayes.experiments.tube import MMHG_PER_KPA
from biaxbayes.machines.outcome import OpenQuestions
from plain_posterior import TRUTH, theta_of
from plain_strips import strip
from virtual_tubes import ARTERY, MATERIAL, readings

STRIP = ("--edge-y-mm", "3", "--thickness-mm", "1.2", "--geometry", "unloaded")
TUBE = ("--unloaded-outer-diameter-mm", "8", "--thickness-mm", "0.9")


def table(folder, names, *columns, name="raw.csv"):
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.column_stack(columns))
    path = folder / name
    path.write_text(f"{names}\n{rows}\n")
    return path


def convert(capsys, path, columns, *more):
    out = path.with_name("specimen.csv")
    words = ("--machine", "generic", "--columns", columns, "--out", out, "--overwrite")
    code, text, err = commands.run(capsys, "convert", path, *words, *more)
    return (read_specimen(out) if code == 0 else None), text, err


def there_and_back(curve, cycles=1):
    return np.concatenate([curve, curve[-2::-1], *[curve[1:], curve[-2::-1]] * (cycles - 1)])


def inflated(axial, around=None):
    around = np.linspace(1.0, 1.3, 40) if around is None else around
    stretch = np.column_stack([around, np.full(around.size, axial)])
    return stretch, readings(ARTERY, stretch, MATERIAL)


def test_a_strip_comes_back_from_displacement_and_force(tmp_path, capsys):
    (p,) = strip(0, theta_of(TRUTH)).protocols
    moved, force = there_and_back(20.0 * (p.stretch_x - 1.0)), there_and_back(1e3 * p.load_x)
    path = table(tmp_path, "Time [s],Disp [mm],Load [mN]", np.arange(moved.size), moved, force)
    columns = "stretch_x=1 + {Disp [mm]} / 20,force_x_N=Load [mN]"
    answers = ("--branch", "loading", *STRIP)
    read, text, _ = convert(capsys, path, columns, "--test", "strip x", *answers)
    assert (read.test, read.edge_x_mm, read.edge_y_mm) == ("strip x", None, 3.0)
    np.testing.assert_allclose(read.protocols[0].stretch_x, p.stretch_x, rtol=1e-7)
    np.testing.assert_allclose(read.protocols[0].load_x, p.load_x, atol=1e-9)
    assert np.isnan(read.protocols[0].stretch_y).all()
    assert "mounting force x" in text and " nan" not in text and ", y" not in text
    # the recipe keeps the kind of test
    recipe = path.with_name("specimen-recipe.toml")
    assert 'test = "strip x"' in recipe.read_text()
    again = biaxbayes.convert(
        path, recipe=recipe, edge_y_mm=3.0, thickness_mm=1.2, branch="loading"
    )
    assert again.specimen == read


def test_a_strip_that_narrows_more_than_it_lengthens_has_its_loading_branch(tmp_path, capsys):
    """The sum of both stretches falls: the loading branch follows the direction that is pulled."""
    up = np.linspace(0.0, 1.0, 60)
    length, width = 10.0 + 2.0 * up, 4.0 * (1.0 - 0.3 * up)
    cycles = [there_and_back(c, 3) for c in (length, width, 0.5 * np.expm1(2.0 * up))]
    path = table(tmp_path, "Length [mm],Width [mm],Force [N]", *cycles)
    columns = "stretch_y={Length [mm]} / 10,stretch_x={Width [mm]} / first({Width [mm]})"
    columns += ",force_y_N=Force [N]"
    more = ("--edge-x-mm", "4", "--thickness-mm", "1.2", "--geometry", "unloaded")
    answers = ("--cycles", "last", "--branch", "loading", "--test", "strip y")
    read, text, _ = convert(capsys, path, columns, *more, *answers)
    (p,) = read.protocols
    np.testing.assert_allclose(p.stretch_y, 1.0 + 0.2 * up, rtol=1e-7)
    np.testing.assert_allclose(p.stretch_x, 1.0 - 0.3 * up, rtol=1e-7)
    assert "+0.0% in y, the curve" in text


@pytest.mark.parametrize("axis", ["x", "y"])
def test_columns_of_one_direction_may_be_a_strip(axis, tmp_path, capsys):
    other = "yx"["xy".index(axis)]
    names = f"stretch_{axis},force_{axis}_N"
    path = table(tmp_path, names, np.linspace(1.0, 1.2, 20), np.linspace(0.0, 1.0, 20))
    with pytest.raises(OpenQuestions) as question:
        biaxbayes.convert(path, machine="generic")
    first = question.value.questions[0]
    assert first.text.startswith(f"no column for stretch_{other} and force_{other}_N")
    assert next(iter(first.choices)) == f"test=strip {axis}"
    _, _, err = convert(capsys, path, names.replace("N", f"N=force_{axis}_N").replace(
        f"stretch_{axis},", f"stretch_{axis}=stretch_{axis},"))  # fmt: skip
    assert f"--test 'strip {axis}'" in err and "nothing is written" in err
    with pytest.raises(InputError, match=f"stretch_{other}|no column for force_{other}_N"):
        wide = table(tmp_path, f"{names},stretch_{other}", *np.ones((2, 20)), np.ones(20))
        biaxbayes.convert(wide, machine="generic")


def test_a_strip_has_no_load_across_it(tmp_path, capsys):
    path = table(tmp_path, "stretch_x,force_x_N,F2", *[np.linspace(1.0, 1.2, 20)] * 3)
    _, _, err = convert(capsys, path, "force_y_N=F2:N", "--test", "strip x")
    assert "force_y_N is not read from a strip x test" in err
    _, _, err = convert(capsys, path, "force_x_N=force_x_N", "--test", "strip x")
    for option in ("--edge-y-mm MM", "--thickness-mm MM", "--geometry unloaded"):
        assert option in err


def test_a_biotester_export_of_one_direction_is_a_strip(tmp_path):
    up = there_and_back(np.linspace(0.0, 1.0, 30))
    phases = ["1-Stretch"] * 30 + ["1-Recover"] * 29
    rows = zip(phases, 8000 + 1600 * up, 10 + 200 * up**2, strict=True)
    path = tmp_path / "raw.csv"
    lines = [f"{phase},{size:.3f},{force:.4f}" for phase, size, force in rows]
    path.write_text("\n".join(["Cycle,XSize_um,XForce_mN", *lines]))
    more = {"edge_y_mm": 3.0, "thickness_mm": 1.2, "geometry": "unloaded", "branch": "loading"}
    with pytest.raises(OpenQuestions) as asked:
        biaxbayes.convert(path, machine="biotester", **more)
    assert list(asked.value.choices) == ["test=strip x"]
    (p,) = biaxbayes.convert(path, machine="biotester", test="strip x", **more).specimen.protocols
    np.testing.assert_allclose(p.stretch_x, 1.0 + 0.2 * up[:30], atol=1e-6)
    gauge = "stretch_x={XSize_um} / 12000"
    with pytest.raises(InputError, match="stretch_x is not read from a column of a BioTester"):
        biaxbayes.convert(path, machine="biotester", test="strip x", columns=gauge, **more)


def test_compression_of_a_biotester_export_is_named(tmp_path):
    up = there_and_back(np.linspace(0.0, 1.0, 30))
    rows = zip(["1-Stretch"] * 30 + ["1-Recover"] * 29, 8000 - 1600 * up, 10 + 200 * up**2)
    lines = [f"{phase},{size:.3f},{size:.3f},-{f:.4f},-{f:.4f}" for phase, size, f in rows]
    path = tmp_path / "raw.csv"
    path.write_text("\n".join(["Cycle,XSize_um,YSize_um,XForce_mN,YForce_mN", *lines]))
    with pytest.raises(OpenQuestions, match="stretch and load in x both fall from the first row"):
        biaxbayes.convert(path, machine="biotester", branch="loading", geometry="unloaded",
                          edge_x_mm=8, edge_y_mm=8, thickness_mm=1)  # fmt: skip


# --- tubes ----------------------------------------------------------------------------------------


def test_a_tube_comes_back_from_a_table_of_other_units(tmp_path, capsys):
    made = [inflated(axial) for axial in (1.2, 1.6)]
    stretch, load = (np.concatenate(parts) for parts in zip(*made, strict=True))
    mmhg, gf = load[:, 0] * MMHG_PER_KPA, load[:, 1] / 9.80665e-3
    which = np.repeat([1, 2], 40)
    names = "step,OD [um],Length [cm],P [mmHg],Axial load [g]"
    path = table(tmp_path, names, which, 8e3 * stretch[:, 0], 3.0 * stretch[:, 1], mmhg, gf)
    columns = (
        "protocol=step,outer_diameter_mm=OD [um],length_mm=Length [cm],pressure_kPa=P [mmHg],"
        "axial_force_N=Axial load [g]"
    )
    _, _, err = convert(capsys, path, columns)
    assert "outer_diameter_mm is read from a tube" in err and "--test tube" in err
    _, _, err = convert(capsys, path, columns, "--test", "tube", *TUBE)
    assert "'Length [cm]' is a length and needs the unloaded_length_mm" in err
    assert "--unloaded-length-mm MM" in err
    more = ("--unloaded-length-mm", "30", "--opening-angle-fung-deg", "70")
    read, text, _ = convert(capsys, path, columns, "--test", "tube", *TUBE, *more)
    assert read.test == "tube" and read.metadata["opening_angle_fung_deg"] == 70.0
    assert [p.name for p in read.protocols] == ["1", "2"]
    got = np.concatenate([np.column_stack([p.stretch, p.recorded_load]) for p in read.protocols])
    # nine digits of the table
    np.testing.assert_allclose(got, np.column_stack([stretch, load]), rtol=1e-7, atol=1e-8)
    assert f"load {load[:40, 0].max():.4g} kPa, {load[:40, 1].max():.4g} N" in text
    assert "reference" not in text and "mounting" not in text and "geometry" not in text
    # a stretch may be computed from a column whose name is known as a length
    said = "stretch_y={Length [cm]} * 10 / unloaded_length_mm"
    columns = columns.replace("length_mm=Length [cm]", said)
    again, _, _ = convert(capsys, path, columns, "--test", "tube", *TUBE, *more)
    np.testing.assert_allclose(again.protocols[1].stretch, read.protocols[1].stretch, rtol=1e-14)


def test_a_tube_is_cut_by_its_pressure(tmp_path, capsys):
    """Below the stretch in place the axial force falls while the tube is inflated."""
    stretch, load = inflated(1.05)
    assert np.ptp(load[:, 1]) > 0.05 and load[-1, 1] < load[0, 1]
    curves = [there_and_back(c, 2) for c in (*stretch.T, *load.T)]
    names = "outer_diameter_mm,stretch_z,pressure_kPa,axial_force_N"
    path = table(tmp_path, names, 8.0 * curves[0], *curves[1:])
    header = {"unloaded_outer_diameter_mm": 8.0, "thickness_mm": 0.9}
    with pytest.raises(OpenQuestions) as question:
        biaxbayes.convert(path, machine="generic")
    assert next(iter(question.value.choices)) == "test=tube"
    made = biaxbayes.convert(
        path, machine="generic", test="tube", cycles="last", branch="loading", **header
    )
    (p,) = made.specimen.protocols
    np.testing.assert_allclose(p.recorded_load, load, rtol=1e-6, atol=1e-8)


def test_a_tube_pulled_at_constant_pressure_is_cut_by_its_length(tmp_path):
    up = np.linspace(0.0, 1.0, 50)
    rng = np.random.default_rng(1)
    length, diameter = 1.2 + 0.4 * up, 9.0 - 0.4 * up
    force = 0.2 * np.expm1(2.0 * up)
    pressure = 13.0 + 0.02 * rng.normal(size=2 * up.size - 1)
    names = "stretch_z,outer_diameter_mm,pressure_kPa,axial_force_N"
    path = table(
        tmp_path, names, *map(there_and_back, (length, diameter)), pressure, there_and_back(force)
    )
    header = {"unloaded_outer_diameter_mm": 8.0, "thickness_mm": 0.9}
    made = biaxbayes.convert(path, machine="generic", test="tube", branch="loading", **header)
    (p,) = made.specimen.protocols
    np.testing.assert_allclose(p.stretch_y, length, rtol=1e-7)


def test_what_a_tube_does_not_have_is_refused(tmp_path):
    stretch, load = inflated(1.2)
    names = "outer_diameter_mm,stretch_z,pressure_kPa"
    path = table(tmp_path, names, 8.0 * stretch[:, 0], stretch[:, 1], load[:, 0])
    for more, says in (
        ({}, "needs the unloaded_outer_diameter_mm"),
        ({"unloaded_outer_diameter_mm": 8.0}, "readings of a tube need thickness_mm"),
        ({"columns": "force_x_N=pressure_kPa:N"}, "force_x_N is not read from a tube test"),
        ({"columns": "stretch_x=stretch_z"}, "both give stretch_x"),
    ):
        with pytest.raises(InputError, match=says):
            biaxbayes.convert(path, machine="generic", test="tube", **more)


def test_a_bulge_comes_back_from_pressure_and_radius(tmp_path, capsys):
    rise = np.linspace(0.0, 1.0, 25)
    stretch = 1.0 + np.outer(rise, [0.2, 0.18])
    pressure, radius = 1.0 + 80.0 * rise**2, 30.0 - 18.0 * rise
    path = table(tmp_path, "lambda_x,lambda_y,P (mmHg),R (mm)", *stretch.T, pressure, radius)
    stretches = "stretch_x=lambda_x,stretch_y=lambda_y"
    specimen, _, err = convert(capsys, path, stretches)
    assert specimen is None and "--test bulge" in err
    specimen, _, err = convert(capsys, path, stretches, "--test", "bulge")
    assert specimen is None and "no column for pole_tension_kPa" in err
    formula = "{P (mmHg)} * {R (mm)} / (2 * thickness_mm):mmHg"
    columns = f"{stretches},pole_tension_kPa={formula}"
    specimen, _, err = convert(capsys, path, columns)
    assert specimen is None and "pole_tension_kPa is read from a bulge" in err
    specimen, _, err = convert(capsys, path, columns, "--test", "bulge")
    assert specimen is None and "needs thickness_mm" in err
    wall = ("--test", "bulge", "--thickness-mm", 0.5)
    specimen, _, err = convert(capsys, path, columns, *wall)
    assert specimen is not None, err
    assert specimen.test == "bulge"
    (p,) = specimen.protocols
    # Laplace: p rho / (2 T), 1 mmHg = 0.133322 kPa
    np.testing.assert_allclose(p.load_x, 0.133322387 * pressure * radius, rtol=1e-7)
    np.testing.assert_allclose(p.stretch, stretch, rtol=1e-8)
