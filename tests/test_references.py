"""What stretches are relative to: a wrong reference of a computed record is a wrong parameter."""

from dataclasses import replace

import numpy as np
import pytest

from biaxbayes import Protocol, Specimen, check_specimen, read_specimen, sample, write_specimen
from biaxbayes.errors import InputError
from biaxbayes.experiments import BIAXIAL
from biaxbayes.fitting.fit import fit, fit_all
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.specimens.protocol import rest_rows

MATERIAL = GOH(12.0, 60.0, 6.0, 41.0, 0.12)
MOUNTING = np.array([1.03, 1.04])
EDGES = np.array([10.0, 12.0, 0.8])  # x, y, thickness in mm, unloaded
ENDS = {"equal": (1.16, 1.15), "more x": (1.17, 1.06), "more y": (1.05, 1.17)}
CONTRACTING = {"equal": (1.16, 1.15), "x pulls": (1.17, 0.985), "y pulls": (0.98, 1.17)}
"""In a test of stress ratios the direction of less stress contracts."""


def record(starts, ends=ENDS, pair="force", geometry="unloaded", state=(1.0, 1.0), rows=60):
    """Stretches as the file holds them, loads, protocol by protocol; ``state``: mounted, there."""
    out = {}
    for (name, end), start in zip(ends.items(), starts, strict=True):
        path = np.linspace(0.0, 1.0, rows)[:, None]
        stretch = (1.0 - path) * start + path * np.array(end)  # relative to the mounted state
        total = stretch * MOUNTING
        piola = np.column_stack(MATERIAL.cauchy(*total.T)) / total  # of the unloaded section
        section = EDGES[[1, 0]] * EDGES[2] * 1e-3
        mounted = section / MOUNTING  # N per kPa over the mounted section
        load = piola * section
        if pair != "force":  # over the section that was measured
            load = load / (mounted if geometry == "mounted" else section)
        if pair == "cauchy":
            load = load * stretch * state
        out[name] = stretch * state, load
    return out


def header(pair, geometry, **keys):
    x, y, thickness = EDGES
    if geometry == "mounted":
        x, y, thickness = x * MOUNTING[0], y * MOUNTING[1], thickness / MOUNTING.prod()
    size = {"edge_x_mm": x, "edge_y_mm": y, "thickness_mm": thickness} if pair == "force" else {}
    return {"geometry": geometry, **{k: float(v) for k, v in size.items()}, **keys}


def written(path, rows, pair, keys):
    lines = [f"# {key}: {value}" for key, value in keys.items()]
    lines.append(",".join(("protocol", "stretch_x", "stretch_y", *BIAXIAL.loads[pair].columns)))
    for name, (stretch, load) in rows.items():
        lines += [
            f"{name},{s[0]!r},{s[1]!r},{f[0]!r},{f[1]!r}"
            for s, f in zip(stretch.tolist(), load.tolist(), strict=True)
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


def in_memory(rows, pair, keys):
    protocols = [Protocol(name, *s.T, *f.T) for name, (s, f) in rows.items()]
    return Specimen("array", protocols, pair, **keys)


def assert_true(specimen):
    result = fit(specimen, starts=4)
    assert result.material.values == pytest.approx([12.0, 60.0, 6.0, 41.0, 0.12], rel=1e-4)
    assert result.mounting_stretch[0] == pytest.approx(MOUNTING, abs=1e-5)


APART = [(1.0, 1.0), (1.03, 1.0), (1.0, 1.03)]


@pytest.mark.parametrize("source", ["file", "array"])
@pytest.mark.parametrize(
    ("pair", "geometry", "ends"),
    [
        ("force", "unloaded", ENDS),
        ("piola", "mounted", CONTRACTING),
        ("cauchy", "mounted", ENDS),
        ("cauchy", "unloaded", CONTRACTING),
    ],
)
def test_protocols_of_one_common_reference_keep_it(pair, geometry, ends, source, tmp_path):
    rows, keys = record(APART, ends, pair, geometry), header(pair, geometry, reference="common")
    if source == "file":
        specimen = read_specimen(written(tmp_path / "s.csv", rows, pair, keys))
    else:
        specimen = in_memory(rows, pair, keys)
    assert [p.rest_rows for p in specimen.protocols] == [1, 0, 0]
    assert_true(specimen)
    write_specimen(specimen, tmp_path / "again.csv")
    assert read_specimen(tmp_path / "again.csv").protocols == specimen.protocols
    assert "common-reference" in {f.code for f in check_specimen(specimen)}


@pytest.mark.parametrize(("pair", "geometry"), [("force", "mounted"), ("cauchy", "mounted")])
def test_the_mounted_state_is_given_apart(pair, geometry, tmp_path):
    rows = record(APART, pair=pair, geometry=geometry, state=(1.02, 0.99))
    keys = header(pair, geometry, reference="common", mounted_state_x=1.02, mounted_state_y=0.99)
    specimen = read_specimen(written(tmp_path / "s.csv", rows, pair, keys))
    assert_true(specimen)
    del keys["mounted_state_x"], keys["mounted_state_y"]
    with pytest.raises(InputError, match=r"no protocol has a row at the mounted state.*1\.02, 0"):
        read_specimen(written(tmp_path / "s.csv", rows, pair, keys))
    keys = {"mounted_state_x": 1.02, **header(pair, geometry)}
    written(tmp_path / "s.csv", rows, pair, keys)
    with pytest.raises(InputError, match="row 1: mounted_state_x needs one common reference"):
        read_specimen(tmp_path / "s.csv")


@pytest.mark.parametrize("source", ["file", "array"])
def test_first_rows_that_differ_are_named_until_the_header_says_what_they_are(source, tmp_path):
    rows = record(APART)
    path = written(tmp_path / "s.csv", rows, "force", header("force", "unloaded"))
    specimen = path if source == "file" else in_memory(rows, "force", header("force", "unloaded"))
    (result,) = (f for f in check_specimen(specimen) if f.code == "stretch-drift")
    assert result.severity == "error" and result.protocol is None
    assert "from 1.0000 (equal) to 1.0300" in result.message
    with pytest.raises(InputError, match=r"# reference: common.*# reference: each protocol"):
        sample(specimen, out=tmp_path / "run")
    keys = header("force", "unloaded", reference="each protocol")
    (result,) = (
        f for f in check_specimen(in_memory(rows, "force", keys)) if f.code == "stretch-drift"
    )
    assert result.severity == "warning"


def test_a_common_reference_goes_through_all_fits_and_parts():
    rows = record(APART)
    specimen = in_memory(rows, "force", header("force", "unloaded", reference="common"))
    assert len(fit_all(specimen)) == 5
    alone = specimen.only("more x")
    assert alone.protocols[0].rest_rows == 1 and alone.protocols[0].rows == 61
    others = specimen.with_protocols([p for p in specimen.protocols if p.name != "equal"])
    assert others.mounting_readings(shared=True)[0] == pytest.approx(
        specimen.mounting_readings(shared=True)[0]
    )
    with pytest.raises(InputError, match="does not start at the mounted state"):
        Posterior(specimen, mounting_stretch="per-protocol", mounting="exact")


@pytest.mark.parametrize("pair", ["force", "piola", "cauchy"])
@pytest.mark.parametrize("scale", [(1.05, 1.03), (0.98, 1.0), (1.2, 1.2)])
def test_arrays_are_divided_by_their_value_at_rest_as_a_file_is(pair, scale, tmp_path):
    rows = record([(1.0, 1.0)] * 3, pair=pair, state=scale)
    keys = header(pair, "unloaded")
    array = in_memory(rows, pair, keys)
    file = read_specimen(written(tmp_path / "array.csv", rows, pair, keys))
    assert file.protocols == array.protocols
    assert [p.reference for p in array.protocols] == [pytest.approx(scale)] * 3
    assert_true(array)


# --- what arrays are refused for -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("argument", "row", "value", "words"),
    [
        ("load_x", 7, np.nan, r"protocol 'equal': load_x\[7\] \(row 8\): is nan"),
        ("stretch_y", 0, np.inf, r"protocol 'equal': stretch_y\[0\] \(row 1\): is inf"),
        ("stretch_x", 30, -1.1, r"stretch_x\[30\] \(row 31\): a stretch of -1.1 is out of range"),
        ("load_y", 9, 1e6, r"load_y\[9\] \(row 10\): 1e\+06 means a stress of"),
    ],
)
def test_a_wrong_number_in_an_array_is_named_by_protocol_argument_and_row(
    argument, row, value, words, tmp_path
):
    rows = record(APART[:1] * 3)
    stretch, load = rows["equal"]
    columns = dict(zip(("stretch_x", "stretch_y", "load_x", "load_y"), (*stretch.T, *load.T)))
    columns = {key: column.copy() for key, column in columns.items()}
    columns[argument][row] = value
    with pytest.raises(InputError, match=words):
        wrong = Protocol("equal", **columns)
        specimen = Specimen("s", [wrong], "force", **header("force", "unloaded"))
        sample(specimen, out=tmp_path / "run")


def test_arrays_that_are_strains_or_of_different_length_are_refused():
    (stretch, load) = record(APART)["equal"]
    with pytest.raises(InputError, match="stretches are ratios near 1, not strains"):
        Protocol("p", *(stretch.T - 1.0), *load.T)
    with pytest.raises(InputError, match=r"load_x: has shape \(59,\), stretch_x has \(60,\)"):
        Protocol("p", *stretch.T, load[1:, 0], load[:, 1])
    with pytest.raises(InputError, match="must be an array of numbers"):
        Protocol("p", *stretch.T, load[:, 0], ["a"] * 60)
    with pytest.raises(InputError, match="geometry 'loaded' is not one of the choices"):
        Specimen("s", [Protocol("p", *stretch.T, *load.T)], "piola", geometry="loaded")


# --- a load that rises while the stretch rests ---------------------------------------------------


def lagging(rows_late, rest, noise=0.0, timed=True):
    """One protocol whose camera is late by some rows."""
    stretch, load = record([(1.0, 1.0)] * 3, rows=150)["equal"]
    stretch = np.concatenate([np.ones((rest + rows_late, 2)), stretch])
    load = np.concatenate([np.repeat(load[:1], rest, axis=0), load])
    load = np.concatenate([load, np.repeat(load[-1:], rows_late, axis=0)])
    rng = np.random.default_rng(5)
    load = load + noise * rng.standard_normal(load.shape)
    time = np.arange(len(load)) * 0.1 if timed else None
    return Protocol("p", *stretch.T, *load.T, time)


@pytest.mark.parametrize(("late", "rest", "noise"), [(10, 5, 0.0), (15, 1, 0.002), (12, 20, 0.002)])
def test_rows_in_which_the_load_rises_are_not_at_rest(late, rest, noise):
    p = lagging(late, rest, noise)
    assert rest_rows(p.stretch_x, p.stretch_y) >= rest + late
    assert p.rest_rows <= rest + 6
    specimen = Specimen("s", [p], "force", **header("force", "unloaded"))
    (lag,) = (f for f in check_specimen(specimen) if f.code == "camera-lag")
    assert "the camera lags behind the load cell" in lag.message and " s) while" in lag.message


def test_a_load_that_rises_as_the_stretch_does_is_no_lag():
    """The stretch creeps by less than a quarter of a step, and the load by what that explains."""
    stretch = np.concatenate([np.linspace(1.0, 1.004, 8), np.linspace(1.02, 1.2, 10)])
    load = 0.1 + 2.0 * (stretch - 1.0)
    p = Protocol("p", stretch, stretch, load, load)
    assert p.rest_rows < 8
    specimen = Specimen("s", [p], "force", **header("force", "unloaded"))
    assert "camera-lag" not in {f.code for f in check_specimen(specimen)}


def test_a_synchronous_record_has_no_lag():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        stretch, load = record([(1.0, 1.0)] * 3, rows=150)["more x"]
        stretch = np.concatenate([np.ones((20, 2)), stretch])
        load = np.concatenate([np.repeat(load[:1], 20, axis=0), load])
        stretch = stretch + rng.normal(0.0, [1e-6, 1e-4, 1e-3][seed % 3], stretch.shape)
        load = load + rng.normal(0.0, 0.002, load.shape)
        p = Protocol("p", *stretch.T, *load.T)
        specimen = Specimen("s", [p], "force", **header("force", "unloaded"))
        assert "camera-lag" not in {f.code for f in check_specimen(specimen)}, seed
        if seed % 3 == 0:
            assert 18 <= p.rest_rows <= 21


# --- clipped, tared, turned ----------------------------------------------------------------------


def noisy(seed=0, noise=0.004, ends=ENDS):
    rng = np.random.default_rng(seed)
    rows = record([(1.0, 1.0)] * 3, ends, rows=120)
    return {n: (s, f + noise * rng.standard_normal(f.shape)) for n, (s, f) in rows.items()}


def codes(rows):
    result = check_specimen(in_memory(rows, "force", header("force", "unloaded")))
    return {f.code: f for f in result}


@pytest.mark.parametrize("shift", [0.078, 0.1, 0.3])
def test_forces_clipped_at_zero_are_named(shift):
    clipped = {n: (s, np.maximum(f - shift, 0.0)) for n, (s, f) in noisy().items()}
    result = codes(clipped)["clipped"]
    assert "clipped before export" in result.message and "exactly 0 N" in result.message
    assert "clipped" not in codes(noisy())
    coarse = {n: (s, np.round(f, 2)) for n, (s, f) in noisy(noise=0.01).items()}
    assert "clipped" not in codes(coarse)


@pytest.mark.parametrize("digits", [None, 4, 5])
@pytest.mark.parametrize("rest", [1, 12])
@pytest.mark.parametrize("by", ["first row", "rows at rest"])
def test_forces_tared_before_export_are_recognised(digits, rest, by, tmp_path):
    rows = {}
    rng = np.random.default_rng(3)
    for name, (s, f) in record([(1.0, 1.0)] * 3, rows=80).items():
        s = np.concatenate([np.ones((rest - 1, 2)), s])
        f = np.concatenate([np.repeat(f[:1], rest - 1, axis=0), f])
        f = f + 0.004 * rng.standard_normal(f.shape)
        f = f - (f[0] if by == "first row" else f[:rest].mean(axis=0))
        rows[name] = s, f if digits is None else np.round(f, digits)
    specimen = in_memory(rows, "force", header("force", "unloaded"))
    assert specimen.is_tared
    assert "tared" in {f.code for f in check_specimen(specimen)}
    with pytest.raises(InputError, match="tared"):
        sample(specimen, out=tmp_path / "run")
    assert not in_memory(noisy(), "force", header("force", "unloaded")).is_tared


@pytest.mark.parametrize("turned", [(-1, 1), (1, -1), (-1, -1)])
def test_a_load_cell_that_counts_tension_negative_is_named_with_its_column(turned):
    rows = {n: (s, f * turned) for n, (s, f) in noisy().items()}
    result = check_specimen(in_memory(rows, "force", header("force", "unloaded")))
    signs = [f for f in result if f.code == "sign"]
    columns = [
        c for c, sign in zip(BIAXIAL.loads["force"].columns, turned, strict=True) if sign < 0
    ]
    assert len(signs) == len(columns)
    for finding, column in zip(signs, columns, strict=True):
        assert finding.severity == "error"
        assert f"multiply the column {column} by -1" in finding.message


def test_a_cauchy_record_whose_nominal_stress_is_zero_at_rest_is_tared():
    """Rows at rest whose stretches scatter: the mean of the stresses as written is not zero."""
    rng = np.random.default_rng(5)
    rows = {
        name: (s + 1e-3 * rng.standard_normal(s.shape), f)
        for name, (s, f) in record([(1.0, 1.0)] * 3, pair="cauchy").items()
    }
    specimen = in_memory(rows, "cauchy", header("cauchy", "unloaded"))
    protocols = tuple(replace(p, rest_rows=3) for p in specimen.protocols)
    specimen = replace(specimen, protocols=protocols)
    assert specimen.zeroed().is_tared and not specimen.is_tared


def test_the_free_direction_of_a_strip_is_not_called_tared():
    """A pair of strips with the transverse stretches measured is taken as two protocols."""
    along = np.linspace(1.0, 1.2, 30)
    zero, load = np.zeros(30), 0.02 + 0.3 * (along - 1.0) ** 2
    strips = (
        Protocol("strip x", along, along**-0.6, load, zero),
        Protocol("strip y", along**-0.6, along, zero, load),
    )
    pair = Specimen("strips", strips, "force", "unloaded", 10.0, 10.0, 1.0, load_noise=0.001)
    assert not pair.is_tared
    assert "tared" not in {f.code for f in check_specimen(pair)}
    per_strip = Posterior(pair, mounting_stretch="per-protocol", noise="independent")
    assert {"mounting_force_x[strip x]", "mounting_force_y[strip x]"} <= set(per_strip.free)
