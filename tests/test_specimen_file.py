"""Specimen files: written and read back equal, re-referenced once, and safe against any bytes."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import biaxbayes
from biaxbayes import Protocol, Specimen, read_specimen, write_specimen
from biaxbayes.errors import InputError
from biaxbayes.specimens.keys import measured_stretch
from biaxbayes.specimens.protocol import rest_rows
from biaxbayes.specimens.specimen_file import specimen_text
from biaxbayes.specimens.table import read_stretches


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def noisy_protocol(seed: int, name: str = "1", count: int = 40, rest: int = 5) -> Protocol:
    """A stiffening path with rows at rest, noise in everything, and a reference off one."""
    rng = np.random.default_rng(seed)
    path = np.concatenate([np.zeros(rest), np.linspace(0.0, 1.0, count)])
    stretch = np.column_stack([1.003 + 0.2 * path, 0.996 + 0.1 * path])
    stretch += rng.normal(0.0, 1e-5, stretch.shape)
    load = np.column_stack([3.0 + 40.0 * path**2, 2.0 + 25.0 * path**3])
    load += rng.normal(0.0, 0.05, load.shape)
    return Protocol(name, *stretch.T, *load.T, np.arange(path.size) * 0.1, rest)


@pytest.mark.parametrize("pair", ["force", "piola", "cauchy"])
@pytest.mark.parametrize("seed", range(5))
def test_what_was_read_is_written_and_read_back_equal(pair, seed, tmp_path):
    names = ("1:1, slow", 'the "second"', "drüben_3")
    recorded = [noisy_protocol(seed + i, name) for i, name in enumerate(names)]
    known = {"mounting_stretch_x": "1.03 +- 0.01", "edge_sd_mm": 0.1, "cycle": "10"}
    raw = Specimen(
        "A12 rechts", recorded, pair, "mounted", 20.1, 1 / 3 * 50, 1.35, np.float64(0.1) / 3,
        layer="µ: media", axis_x="circumferential", metadata=known,
    )  # fmt: skip
    # A re-referenced record: its mean at rest is one only up to rounding.
    (tmp_path / "raw.csv").write_text(specimen_text(raw, recorded), encoding="utf-8")
    first = read_specimen(tmp_path / "raw.csv")
    assert len(first.notes) == 3 and first == raw
    assert first.protocols[0].reference == pytest.approx((1.003, 0.996), abs=1e-4)
    write_specimen(first, tmp_path / "again.csv")
    second = read_specimen(tmp_path / "again.csv")
    assert second == first
    assert second.notes == ()
    assert second.metadata == raw.metadata
    assert pickle.loads(pickle.dumps(second)) == second


@pytest.mark.long
@given(
    name=st.text(min_size=1, max_size=30),
    layer=st.text(max_size=30),
    labels=st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=4),
    values=st.lists(
        st.floats(-400.0, 400.0, allow_subnormal=False), min_size=4, max_size=4, unique=True
    ),
)
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_name_and_any_double_survive(name, layer, labels, values, tmp_path):
    protocols = tuple(
        Protocol(label, [1.0, 1.1], [1.0, 1.2], values[:2], [values[2], values[3] + 1.0])
        for label in labels
    )
    specimen = Specimen(name, protocols, "piola", layer=layer)
    path = tmp_path / "a.csv"
    try:
        write_specimen(specimen, path)
    except InputError as refusal:
        printable = ("".join(c if c.isprintable() else " " for c in x) for x in labels)
        clean = [" ".join(text.split()) for text in printable]
        assert "" in clean or len(set(clean)) < len(clean), refusal
        return
    try:
        read = read_specimen(path)
    except InputError as refusal:
        # Loads may be equal or too small for a test; a name must never be the reason.
        assert "column piola" in str(refusal)
        return
    write_specimen(read, path)
    assert read_specimen(path) == read
    for mine, theirs in zip(read.protocols, protocols, strict=True):
        np.testing.assert_array_equal(mine.load_x, theirs.load_x)
        np.testing.assert_array_equal(mine.load_y, theirs.load_y)


def test_line_breaks_and_control_characters_do_not_reach_the_file(tmp_path):
    p = Protocol("a\nb", [1.0, 1.1], [1.0, 1.1], [0.1, 1.0], [0.1, 2.0])
    specimen = Specimen("x\n# thickness_mm: 9\r", (p,), "piola", layer="\x1b[31mred")
    write_specimen(specimen, tmp_path / "a.csv")
    read = read_specimen(tmp_path / "a.csv")
    assert read.name == "x # thickness_mm: 9"
    assert read.thickness_mm is None
    assert read.layer == "[31mred"
    assert read.protocols[0].name == "a b"


def test_rest_rows_of_the_object_are_written_where_they_cannot_be_detected(tmp_path):
    stretch = np.linspace(1.0, 1.1, 11)
    one = Protocol("a", stretch, stretch, stretch, 2 * stretch, None, 1)
    write_specimen(Specimen("x", (one,), "piola"), tmp_path / "a.csv")
    assert "rest_rows" not in (tmp_path / "a.csv").read_text()
    own = stretch / stretch[:3].mean()
    three = Protocol("b", own, own, stretch, 2 * stretch, None, 3)
    write_specimen(Specimen("x", (one, three), "piola"), tmp_path / "b.csv")
    assert "# rest_rows: 1, 3\n" in (tmp_path / "b.csv").read_text()
    assert [p.rest_rows for p in read_specimen(tmp_path / "b.csv").protocols] == [1, 3]


@given(
    seed=st.integers(0, 2**32 - 1),
    scale=st.floats(0.7, 1.4),
    rest=st.integers(1, 30),
    noise=st.sampled_from([0.0, 1e-7, 1e-5, 1e-4]),
)
@settings(max_examples=100, deadline=None)
def test_referencing_twice_changes_nothing(seed, scale, rest, noise):
    rng = np.random.default_rng(seed)
    path = np.concatenate([np.zeros(rest), np.linspace(0.0, 1.0, 60)])
    stretch = scale * (1.0 + np.outer(path, [0.2, 0.1])) + rng.normal(0.0, noise, (rest + 60, 2))
    load = rng.normal(10.0, 1.0, stretch.shape)
    recorded = Protocol("a", *stretch.T, *load.T, rest_rows=rest)
    once = Specimen("s", (recorded,), "cauchy")
    (p,) = once.protocols
    assert p.stretch_x[:rest].mean() == pytest.approx(1.0, abs=1e-12)
    again = Protocol("a", p.stretch_x, p.stretch_y, p.load_x, p.load_y, rest_rows=rest)
    assert Specimen("s", (again,), "cauchy") == once


def test_rest_rows_detected_in_a_noisy_record():
    rng = np.random.default_rng(0)
    path = np.concatenate([np.zeros(25), np.linspace(0.0, 0.2, 100)[1:]])
    for noise in (0.0, 1e-6, 1e-5, 1e-4):
        stretch = 1.0 + path + rng.normal(0.0, noise, path.size)
        assert abs(rest_rows(stretch, stretch) - 25) <= 1
    assert rest_rows(1.0 + np.linspace(0, 0.2, 50), 1.0 + np.linspace(0, 0.1, 50)) == 1


@pytest.mark.parametrize(
    ("text", "value"),
    [("1.03 +- 0.01", (1.03, 0.01)), ("1.03±0.01", (1.03, 0.01)), (" 1 +-1e-3", (1.0, 1e-3))],
)
def test_stretch_from_an_image(text, value):
    assert measured_stretch(text) == value


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("# a\u2028b\nstretch_x,stretch_y\n1,1\n1.1,x\n", "row 4, column stretch_y: 'x' is not"),
        ('stretch_x,stretch_y\n1,1\n1.1,"1.1\n1.2,1\n', "row 3: not a row of a CSV: a quotation"),
        ("stretch_x,stretch_y\n1,1\n1_0e-1,1\n", "row 3, column stretch_x: '1_0e-1' is not a "),
        ("stretch_x,stretch\n1,1\n", "row 1, column stretch_y: missing column"),
        ("stretch_x,stretch_y\n1,1\n1.1\n", "row 3: 1 cell for 2 columns"),
        ("stretch_x,stretch_y\n1,110\n", "not strains or per cent"),
        ("stretch_x,stretch_y\n", "has no rows"),
    ],
)
def test_a_wrong_path_of_stretches_is_named_with_its_row(text, says, tmp_path):
    with pytest.raises(InputError) as refusal:
        read_stretches(write(tmp_path / "a.csv", text))
    assert says in str(refusal.value)


GAPS = {
    "some rows lost": lambda n: np.random.default_rng(2).random(n) < 0.7,
    "every third lost": lambda n: np.arange(n) % 3 != 1,
    "a run lost": lambda n: (np.arange(n) < 8) | (np.arange(n) > 22),
}


@pytest.mark.parametrize("gap", GAPS)
def test_lost_rows_are_neither_noise_nor_rest(gap):
    full = biaxbayes.simulate(
        material="donor2-media", ratios=((1, 1), (1, 0.5)), increments=60, noise_N=5e-4
    )[0]
    full = replace(full, load_noise=None)

    def lost(p: Protocol) -> Protocol:
        kept = GAPS[gap](p.rows)
        kept[0] = True
        return Protocol(p.name, *(curve[kept] for curve in (*p.stretch.T, *p.recorded_load.T)))

    specimen = replace(full, protocols=tuple(map(lost, full.protocols)))
    assert specimen.noise_sd == pytest.approx(5e-4, rel=0.4)
    assert full.noise_sd == pytest.approx(5e-4, rel=0.3)
    assert [p.rest_rows for p in specimen.protocols] == [p.rest_rows for p in full.protocols]


def test_masked_readings_are_refused():
    stretch = np.linspace(1.0, 1.2, 12)
    masked = np.ma.masked_greater(stretch, 1.15)
    for columns in ([masked, *[stretch] * 3], [*[stretch] * 3, masked]):
        with pytest.raises(InputError, match="is masked in 3 rows; leave out masked rows"):
            Protocol("p", *columns)
    assert Protocol("p", *[np.ma.array(stretch)] * 4).rows == 12  # nothing is masked


def test_writer_refuses_what_the_reader_would(tmp_path):
    p = Protocol("a", [1.0, 1.1], [1.0, 1.1], [0.1, 1.0], [0.1, 2.0])
    with pytest.raises(InputError, match="duplicated"):
        write_specimen(Specimen("x", (p, p), "piola"), tmp_path / "a.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_path_of_stretches_is_read_by_its_names(tmp_path):
    text = 'step,stretch_y,stretch_x\n1,1,1\n# 5", "as marked\n\n2,1.2,1.1\n'
    assert read_stretches(write(tmp_path / "a.csv", text)).tolist() == [[1.0, 1.0], [1.1, 1.2]]


def test_the_ends_of_the_range_are_stretches(tmp_path):
    """In a path as in a record; beyond them neither is read."""
    path = write(tmp_path / "a.csv", "stretch_x,stretch_y\n1,1\n0.2,5\n")
    assert read_stretches(path).tolist() == [[1.0, 1.0], [0.2, 5.0]]
    assert Protocol("p", [1.0, 0.2], [1.0, 5.0], [0.0, 1.0], [0.0, 1.0]).rows == 2
    with pytest.raises(InputError, match=r"5\.01 is not a stretch"):
        read_stretches(write(tmp_path / "b.csv", "stretch_x,stretch_y\n1,1\n0.2,5.01\n"))
