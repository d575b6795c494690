"""Where the table of a file is, what belongs together in it, and where its cycles are cut."""

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.machines.outcome import OpenQuestions

SIZE = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
NAMES = ["lambda_x", "lambda_y", "Fx [N]", "Fy [N]"]
COLUMNS = "stretch_x=lambda_x,stretch_y=lambda_y,force_x_N=Fx [N],force_y_N=Fy [N]"
T = np.linspace(0.0, 1.0, 30)
STRETCH = 1.0 + np.outer(T, [0.2, 0.15])


def force_at(stretch):
    return 0.01 + 0.4 * np.expm1(5.0 * (stretch - 1.0).sum(axis=1))[:, None] * [1.0, 0.7]


FORCE = force_at(STRETCH)


def written(folder, columns, names=NAMES, *, name="raw.csv", pre="", units="", change=None):
    cells = [[c if isinstance(c, str) else f"{c:.9g}" for c in row] for row in zip(*columns)]
    rows = [",".join(row) for row in cells]
    rows = rows if change is None else change(rows)
    path = folder / name
    path.write_text("\n".join([*([pre] if pre else []), ",".join(names), *([units] * bool(units)),
                               *rows]) + "\n")  # fmt: skip
    return path


def read(path, columns=COLUMNS, **options):
    return biaxbayes.convert(path, machine="generic", columns=columns, header=SIZE, **options)


def is_made_of(result, stretch=STRETCH, force=FORCE) -> bool:
    (p,) = result.specimen.protocols
    return (
        p.rows == len(stretch)
        and np.allclose(p.stretch, stretch, atol=1e-7)
        and np.allclose(p.recorded_load, force, atol=1e-7)
    )


BOTH = [*STRETCH.T, *FORCE.T]
HEAD = ",".join(NAMES)
PLACES = {
    "results on top": {"pre": "Thickness,Width,Length,Area\n1.1,9,9,11\n1.2,9,9,12\n1.1,9,9,8\n"},
    "a long table on top": {"pre": "\n".join(f"p{k},{k},{k},{k}" for k in range(60))},
    "a range below": {"units": "5.0 mm,5.0 mm,10.0 N,10.0 N"},
    "one-cell lines": {"change": lambda r: [*r[:9], "# pause", "note", *r[9:]]},
    "comments behind": {"change": lambda r: [f"{row},slipped" if k == 7 else row
                                             for k, row in enumerate(r)]},
    "a footer of words": {"change": lambda r: [*r, "Mean,,,", "End of test"]},
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_the_table_is_below_the_line_of_all_names(place, tmp_path):
    assert is_made_of(read(written(tmp_path, BOTH, **PLACES[place])))


def test_lines_are_those_of_an_editor(tmp_path):
    path = written(tmp_path, BOTH)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\r\n"))
    assert "--rows 2:31;" in read(path).account


@pytest.mark.parametrize("word", ["#DIV/0!", "OVLD"])
def test_words_in_place_of_a_reading_are_named_and_dropped_if_asked(word, tmp_path):
    def change(rows):
        return [f"{r.rpartition(',')[0]},{word}" if k == 12 else r for k, r in enumerate(rows)]

    path = written(tmp_path, BOTH, change=change)
    with pytest.raises(OpenQuestions, match=f"{word}' in line 14"):
        read(path)
    kept = np.delete(np.arange(30), 12)
    assert is_made_of(read(path, drop_missing=True), STRETCH[kept], FORCE[kept])


def test_numbers_with_units_and_marks_between_thousands(tmp_path):
    cells = [*STRETCH.T, *([f"{v:.8f} N" for v in column] for column in FORCE.T)]
    path = written(tmp_path, cells, ["lambda_x", "lambda_y", "Fx", "Fy"])
    assert is_made_of(read(path, COLUMNS.replace(" [N]", "")))
    cells = [*STRETCH.T, *([f'"{v:,.6f}"' for v in 1e4 * column] for column in FORCE.T)]
    path = written(tmp_path, cells, [*NAMES[:2], "Fx [mN]", "Fy [mN]"])
    assert is_made_of(read(path, COLUMNS.replace("[N]", "[mN]")), force=10.0 * FORCE)


def test_names_that_are_repeated_begin_blocks(tmp_path):
    path = written(tmp_path, BOTH, change=lambda rows: [*rows, HEAD, *rows])
    with pytest.raises(OpenQuestions) as asked:
        read(path)
    assert "blocks=protocols" in asked.value.choices
    assert is_made_of(read(path, blocks="cycles", cycles="last"))
    assert [p.rows for p in read(path, blocks="protocols").specimen.protocols] == [30, 30]


def test_protocols_side_by_side_are_read_in_one_command(tmp_path):
    names = [f"{name} {p}" for p in ("1:1", "1:0.5") for name in NAMES]
    other = 1.0 + np.outer(T, [0.2, 0.075])
    path = written(tmp_path, [*BOTH, *other.T, *force_at(other).T], names)
    said = "stretch_x=lambda_x *,stretch_y={lambda_y *},force_x_N=Fx [N] *,force_y_N=Fy [N] *"
    first, second = read(path, said).specimen.protocols
    assert (first.name, second.name) == ("1:1", "1:0.5")
    np.testing.assert_allclose(second.stretch, other, atol=1e-7)
    np.testing.assert_allclose(first.recorded_load, FORCE, atol=1e-7)


# --- columns of their own time or length ----------------------------------------------------------

VIDEO = 1.0 + np.outer(np.linspace(0.0, 1.0, 8), [0.2, 0.15])
JOINED = COLUMNS + ",time_s=Time load (s),stretch_time_s=Time video (s)"


def padded(values):
    return [*(f"{v:.9g}" for v in values), *[""] * (30 - len(values))]


def test_columns_of_their_own_time_are_joined_by_it_and_never_by_row(tmp_path):
    names = ["Time load (s)", *NAMES[2:], "Time video (s)", *NAMES[:2]]
    video = [padded(c) for c in (np.linspace(0.0, 1.0, 8), *VIDEO.T)]
    path = written(tmp_path, [T, *FORCE.T, *video], names)
    for options in ({}, {"drop_missing": True}):
        with pytest.raises(OpenQuestions) as asked:
            read(path, **options)
        assert "join=time" in asked.value.choices
        assert "columns=stretch_time_s=Time video (s)" in asked.value.choices
    assert is_made_of(read(path, JOINED, join="time"))


def test_two_files_are_joined_by_time(tmp_path):
    machine = written(tmp_path, [T, *FORCE.T], ["Time (s)", *NAMES[2:]], name="machine.csv")
    times = np.linspace(0.0, 1.0, 8)
    camera = written(tmp_path, [times, *VIDEO.T], ["Time (s)", *NAMES[:2]], name="camera.csv")
    said = COLUMNS + ",time_s=Time (s)"
    assert is_made_of(read([machine, camera], said, join="time"))
    camera = written(tmp_path, [times + 5, *VIDEO.T], ["Time (s)", *NAMES[:2]], name="camera.csv")
    with pytest.raises(InputError, match="do not overlap"):
        read([machine, camera], said, join="time")


@pytest.mark.parametrize("count", [4, 5])
def test_five_complete_rows_are_enough_to_join(count, tmp_path):
    machine = written(tmp_path, [T, *FORCE.T], ["Time (s)", *NAMES[2:]], name="machine.csv")
    times = np.linspace(0.0, 1.0, count)
    video = 1.0 + np.outer(times, [0.2, 0.1])
    camera = written(tmp_path, [times, *video.T], ["Time (s)", *NAMES[:2]], name="camera.csv")
    said = COLUMNS + ",time_s=Time (s)"
    if count == 5:
        assert read([machine, camera], said, join="time").specimen.protocols[0].stretch_x.size > 5
    else:
        with pytest.raises(InputError, match="4 rows have all of"):
            read([machine, camera], said, join="time")


def test_digitised_curves_of_one_ratio_are_joined_by_stretch(tmp_path):
    names = [NAMES[0], NAMES[2], NAMES[1], NAMES[3]]
    few = np.linspace(0, 29, 15).astype(int)
    columns = [STRETCH[:, 0], FORCE[:, 0], padded(STRETCH[few, 1]), padded(FORCE[few, 1])]
    path = written(tmp_path, columns, names)
    with pytest.raises(OpenQuestions) as asked:
        read(path)
    assert "join=stretch" in asked.value.choices
    (p,) = read(path, join="stretch").specimen.protocols
    np.testing.assert_allclose(p.stretch, STRETCH, atol=1e-7)
    np.testing.assert_allclose(p.load_x, FORCE[:, 0], atol=1e-7)
    assert np.abs(p.load_y - FORCE[:, 1]).max() < 0.02


# --- cuts -----------------------------------------------------------------------------------------

FORMS = {
    "sine": lambda p: 0.5 * (1.0 - np.cos(2.0 * np.pi * p)),
    "triangle": lambda p: 1.0 - np.abs(2.0 * (p % 1.0) - 1.0),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("rows", [12, 16, 40, 80])
@pytest.mark.parametrize("kind", ["plain", "noise", "growing", "unfinished", "rest"])
def test_cycles_of_few_rows_begin_at_their_valley(form, rows, kind, tmp_path):
    phase = np.arange(3 * rows + 1) / rows
    amplitude = [0.5, 0.75, 1.0] if kind == "growing" else [1.0] * 3
    t = FORMS[form](phase) * np.array(amplitude)[np.minimum(phase.astype(int), 2)]
    start, peak, rest = 2 * rows, 2 * rows + rows // 2, np.zeros(8)
    if kind == "unfinished":
        t = t[: peak + rows // 4]
    if kind == "rest":
        t, start, peak = np.concatenate([rest, t[:start], rest, t[start:]]), start + 16, peak + 16
    stretch = 1.0 + np.outer(t, [0.2, 0.15])
    force = force_at(stretch) * np.where(np.diff(t, prepend=-1.0) >= 0.0, 1.0, 0.9)[:, None]
    if kind == "noise":
        rng = np.random.default_rng(rows)
        stretch += 2e-4 * rng.standard_normal(stretch.shape)
        force += 2e-3 * force.max() * rng.standard_normal(force.shape)
    path = written(tmp_path, [*stretch.T, *force.T])
    result = read(path, cycles="last", branch="loading")
    (taken,) = result.recordings
    near = max(2, rows // 40)
    first = start - 8 if kind == "rest" else start
    assert first - near <= taken.rows[0] <= start + near and abs(taken.rows[-1] - peak) <= near
    assert np.abs(np.array(result.specimen.protocols[0].reference) - stretch[start]).max() < 2e-3


def test_a_peak_whose_load_has_fallen_already_belongs_to_the_fall(tmp_path):
    """Hysteresis of a fifth from the row of the peak on."""
    half = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 25))
    stretch = 1.0 + np.outer(np.concatenate([half, half[-2::-1]]), [0.2, 0.2])
    force = force_at(stretch)
    force[24:] *= 0.8
    path = written(tmp_path, [*stretch.T, *force.T])
    (p,) = read(path, branch="loading").specimen.protocols
    assert p.rows == 24
    np.testing.assert_allclose(p.recorded_load, force[:24], rtol=1e-8)


def test_a_rise_that_the_record_ends_in_is_asked_about(tmp_path):
    t = np.concatenate([FORMS["triangle"](np.arange(81) / 40), np.linspace(0.05, 0.6, 12)])
    stretch = 1.0 + np.outer(t, [0.2, 0.15])
    path = written(tmp_path, [*stretch.T, *force_at(stretch).T])
    with pytest.raises(OpenQuestions) as asked:
        read(path, cycles="last", branch="loading")
    assert list(asked.value.choices) == ["cycles=2", "cycles=3"]


@pytest.mark.parametrize("toe", [1.0, 1.5])
def test_small_loops_before_a_ramp_are_no_part_of_it(toe, tmp_path):
    loops = np.tile(np.concatenate([np.linspace(0, 0.14, 8), np.linspace(0.12, 0.02, 6)]), 5)
    t = np.concatenate([loops, np.linspace(0.0, 1.0, 30)])
    stretch = 1.0 + np.outer(t, [0.2, 0.2])
    loads = force_at(stretch) ** toe
    (p,) = read(written(tmp_path, [*stretch.T, *loads.T])).specimen.protocols
    assert p.rows == 30


def test_levels_of_the_other_direction_are_protocols(tmp_path):
    up = np.concatenate([T, T[::-1]])
    parts = [np.column_stack([1 + 0.18 * up, np.full(60, y)]) for y in (1.0, 1.05, 1.1)]
    stretch = np.concatenate(parts)
    path = written(tmp_path, [*stretch.T, *force_at(stretch).T])
    with pytest.raises(OpenQuestions) as asked:
        read(path)
    assert next(iter(asked.value.choices)) == "protocols_by=level"
    header = {**SIZE, "reference": "common"}
    result = biaxbayes.convert(
        path, machine="generic", columns=COLUMNS, header=header, protocols_by="level",
        branch="loading",
    )  # fmt: skip
    assert [p.name for p in result.specimen.protocols] == ["x at y 1", "x at y 1.05", "x at y 1.1"]


def test_time_that_steps_back_is_a_cut(tmp_path):
    stretch = 1.0 + np.outer(np.concatenate([0.8 * T, T]), [0.2, 0.15])
    path = written(
        tmp_path, [np.tile(T, 2), *stretch.T, *force_at(stretch).T], ["Time (s)", *NAMES]
    )
    assert is_made_of(read(path, cycles="last"))


def test_columns_of_one_name_are_read_and_proposed_by_position(tmp_path):
    """Two samples side by side, with the letter of typesetters, and stresses without a unit."""
    names = ["𝜆x", "𝜆y", "Pxx", "Pyy"] * 2
    path = written(tmp_path, [*STRETCH.T, *FORCE.T, *STRETCH.T, *FORCE.T], names)
    columns = "stretch_x=#5,stretch_y=#6,piola_x_kPa=#7,piola_y_kPa=#8"
    with pytest.raises(OpenQuestions) as asked:
        read(path, columns)
    assert "columns=piola_x_kPa=#7:kPa" in asked.value.choices
    units = columns.replace("#7", "#7:kPa").replace("#8", "#8:kPa")
    assert is_made_of(read(path, units))


def test_the_position_of_a_crosshead_is_no_other_end(tmp_path):
    disp = 20.0 * (STRETCH - 1.0)
    names = ["Disp X (mm)", "Disp Y (mm)", "Fx (N)", "Fy (N)", "Crosshead (mm)"]
    path = written(tmp_path, [*disp.T, *FORCE.T, disp[:, 0] - 794.0], names)
    said = "stretch_x=1 + {Disp X (mm)} / 20,stretch_y=1 + {Disp Y (mm)} / 20"
    assert is_made_of(read(path, f"{said},force_x_N=Fx (N),force_y_N=Fy (N)"))
