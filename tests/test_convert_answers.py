"""What an export leaves open is asked; with the answers it is read to the values it was made of."""

import csv
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
import commands
from biaxbayes import GOH
from biaxbayes.errors import InputError
from biaxbayes.machines.outcome import OpenQuestions
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.specimens.check import check_specimen
from virtual_biotester import biotester_export
from workbooks import xlsx

SIZE = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
RATIOS = {"1:1": (1.0, 1.0), "1:0.5": (1.0, 0.5), "0.5:1": (0.5, 1.0)}
SOFT, STIFF = GOH(12.0, 60.0, 8.0, 40.0, 0.15), GOH(30.0, 20.0, 8.0, 40.0, 0.15)
NOISE_N = 0.0005
NAMES = ("lambda_x", "lambda_y", "Fx [N]", "Fy [N]")
TARGETS = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")


def made(ratio=(1.0, 1.0), rows: int = 60, material: GOH = SOFT) -> np.ndarray:
    """Stretches and noisy forces of a loading branch, (rows, 4)."""
    test = virtual_test(
        material, mounting_stretch=(1.02, 1.015), measured_stretch=1.18, ratio=ratio,
        increments=rows - 1, edge_x_mm=10.0, edge_y_mm=10.0, thickness_mm=1.2,
    )  # fmt: skip
    table = np.hstack([test.measured, test.force_N])
    table[:, 2:] += NOISE_N * np.random.default_rng(1).standard_normal((rows, 2))
    return table


def written(folder: Path, columns: dict[str, object], name: str = "raw.csv") -> Path:
    path = folder / name
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*(list(values) for values in columns.values()), strict=True))
    return path


def table_of(rows: np.ndarray) -> dict[str, object]:
    return dict(zip(NAMES, rows.T, strict=True))


def mapped(names=NAMES, *more: str) -> str:
    return ",".join([f"{t}={n}" for t, n in zip(TARGETS, names, strict=True)] + list(more))


def read(path: Path | list[Path], columns: str | None = None, **options):
    header = SIZE | options.pop("header", {})
    return biaxbayes.convert(
        path, machine="generic", columns=columns or mapped(), header=header, **options
    )


def asked(path: Path | list[Path], columns: str | None = None, **options) -> OpenQuestions:
    with pytest.raises(OpenQuestions) as question:
        read(path, columns, **options)
    assert str(question.value).isprintable()
    assert question.value.choices
    return question.value


def is_made_of(result, *tables: np.ndarray) -> bool:
    """Whether the protocols have exactly these rows."""
    protocols = result.specimen.protocols
    return len(protocols) == len(tables) and all(
        np.allclose(np.hstack([p.stretch, p.recorded_load]), table, rtol=1e-9)
        for p, table in zip(protocols, tables, strict=True)
    )


# --- account, picture and recipe ------------------------------------------------------------------


def cycled(folder: Path, name: str = "raw.csv") -> tuple[Path, np.ndarray]:
    """Two cycles up and down in one table, and the rows of the last rise."""
    up = made()
    back = up[::-1] * [1, 1, 0.9, 0.9]
    rows = np.concatenate([up * [1, 1, 1.2, 1.2], back, up, back])
    return written(folder, table_of(rows), name), up


def test_every_row_is_in_the_account(tmp_path):
    path, up = cycled(tmp_path)
    result = read(path, cycles="last", branch="loading")
    told = result.account
    assert "240 rows read" in told and "kept" in told and "cycle 2 of 2" in told
    counts = [int(line.split()[2]) for line in told.splitlines() if line.startswith("  left")]
    (record,) = result.records
    kept = np.concatenate([r.rows for r in result.recordings])
    assert (record.reasons[kept] == "").all() and (np.delete(record.reasons, kept) != "").all()
    assert sum(counts) + kept.size == 240
    assert result.specimen.protocols[0].rows in (60, 61)
    assert np.allclose(result.specimen.protocols[0].stretch[-60:], up[:, :2])


def test_a_picture_and_a_recipe_are_beside_the_file(tmp_path, capsys):
    path, _ = cycled(tmp_path)
    words = ["convert", path, "--machine", "generic", "--columns", mapped()]
    words += [w for key, value in SIZE.items() for w in (f"--{key.replace('_', '-')}", value)]
    out = tmp_path / "specimen.csv"
    code, _, err = commands.run(capsys, *words, "--out", out)
    assert code == 2 and "--cycles last" in err
    assert list(tmp_path.iterdir()) == [path]  # without an answer nothing is written
    words += ["--cycles", "last", "--branch", "loading", "--out", out]
    out.write_text("mine\n")
    assert "exists already" in commands.refused(capsys, *words)
    assert out.read_text() == "mine\n"
    assert commands.run(capsys, *words, "--overwrite")[0] == 0
    assert (tmp_path / "specimen-record.png").read_bytes().startswith(b"\x89PNG")
    recipe = tmp_path / "specimen-recipe.toml"
    # another specimen of the lab: the same answers, its own dimensions
    next_one, _ = cycled(tmp_path, "next.csv")
    words = ["convert", next_one, "--recipe", recipe, "--edge-x-mm", 9, "--edge-y-mm", 9]
    words += ["--thickness-mm", 1.1, "--out", tmp_path / "next-specimen.csv"]
    code, _, err = commands.run(capsys, *words)
    assert code == 0, err
    again = biaxbayes.read_specimen(tmp_path / "next-specimen.csv")
    assert again.edge_x_mm == 9.0 and again.geometry == "unloaded"
    assert np.all(again.protocols[0].stretch == biaxbayes.read_specimen(out).protocols[0].stretch)


def test_a_file_that_does_not_fit_a_recipe_is_refused(tmp_path):
    path, _ = cycled(tmp_path)
    out = tmp_path / "specimen.csv"
    read(path, cycles="last", branch="loading", out=out)
    recipe = tmp_path / "specimen-recipe.toml"
    both = np.concatenate([made(), made()[::-1], made((1.0, 0.5)), made((1.0, 0.5))[::-1]])
    other = written(tmp_path, table_of(both), "other.csv")
    with pytest.raises(OpenQuestions, match="stretch ratios"):
        biaxbayes.convert(other, recipe=recipe, header=SIZE)
    with pytest.raises(InputError, match="does not fit the recipe"):
        biaxbayes.convert(other, recipe=recipe, protocols_by="ratio", header=SIZE)
    renamed = written(tmp_path, dict(zip("abcd", made().T, strict=True)), "renamed.csv")
    with pytest.raises(InputError, match="no column 'lambda_x'"):
        biaxbayes.convert(renamed, recipe=recipe, header=SIZE)
    recipe.write_text("colour = 3\n" + recipe.read_text())
    with pytest.raises(InputError, match="no option 'colour'"):
        biaxbayes.convert(path, recipe=recipe, header=SIZE)


# --- columns --------------------------------------------------------------------------------------

GAUGE = np.array([10.2, 10.15])
OPPOSITE = {
    "numbered": ("Axial {} Displacement (mm)", ("1", "3", "2", "4"), 1),
    "letters and numbers": ("{} Disp [mm]", ("X1", "X2", "Y1", "Y2"), 1),
    "sides": ("Displacement {}, mm", ("left", "right", "top", "bottom"), 1),
    "positions": ("Pos. {} [mm]", ("left", "right", "lower", "upper"), -1),
}


@pytest.mark.parametrize("form", OPPOSITE)
def test_both_of_two_opposite_actuators_count(form, tmp_path):
    name, ends, sign = OPPOSITE[form]
    table = made()
    moved = (table[:, :2] - 1.0) * GAUGE / 2.0
    names = [name.format(end) for end in ends]
    sides = [sign * moved[:, 0], moved[:, 0], sign * moved[:, 1], moved[:, 1]]
    columns = dict(zip(names, sides, strict=True)) | {"Fx [N]": table[:, 2], "Fy [N]": table[:, 3]}
    path = written(tmp_path, columns)
    one = [f"1 + {{{names[k]}}} / {length}" for k, length in ((1, GAUGE[0]), (3, GAUGE[1]))]
    question = asked(path, mapped((*one, *NAMES[2:])))
    both = "+" if sign > 0 else "-"
    said = [
        f"1 + ({{{names[k]}}} {both} {{{names[k - 1]}}}) / {length}"
        for k, length in ((1, GAUGE[0]), (3, GAUGE[1]))
    ]
    assert f"columns=stretch_x={said[0]}" in question.choices
    # the answers are added to the options that were given
    answers = (mapped((*one, *NAMES[2:])), *(f"stretch_{a}={k}" for a, k in zip("xy", said)))
    assert is_made_of(read(path, answers), table)
    assert is_made_of(read(path, mapped((*said, *NAMES[2:]))), table)


SPECIMENS = {
    "by name": ("Specimen", ["A", "B"]),
    "by number": ("Sample no", [1, 2]),
    "by code": ("ID", ["pig 7 a", "pig 7 b"]),
    "in alternating rows": ("Tissue", ["skin", "liver"]),
}


@pytest.mark.parametrize("form", SPECIMENS)
def test_specimens_of_one_table_are_never_mixed(form, tmp_path):
    column, labels = SPECIMENS[form]
    tables = {
        (label, ratio): made(RATIOS[ratio], 40, material)
        for label, material in zip(labels, (SOFT, STIFF), strict=True)
        for ratio in RATIOS
    }
    order = np.arange(240).reshape(2, 120).T.ravel() if "alternating" in form else slice(None)
    specimens, protocols = np.repeat(list(tables), 40, axis=0)[order].T
    rows = table_of(np.concatenate(list(tables.values()))[order])
    path = written(tmp_path, {column: specimens, "Protocol": protocols} | rows)
    assert f"specimen_by={column}" in asked(path).choices or column == "Specimen"
    second = asked(path, specimen_by=column)
    assert list(second.choices) == [f"specimen={label}" for label in labels]
    for label in labels:
        result = read(path, specimen_by=column, header={"specimen": str(label)})
        assert is_made_of(result, *(tables[label, ratio] for ratio in RATIOS))
        assert [p.name for p in result.specimen.protocols] == list(RATIOS)
        assert "120  another specimen:" in result.account


def test_merged_labels_of_specimens_are_asked_about(tmp_path):
    tables = [made(), made(material=STIFF)]
    labels = ["pig 1", *[""] * 59, "pig 2", *[""] * 59]
    path = written(tmp_path, {"Sample": labels} | table_of(np.concatenate(tables)))
    assert "specimen_by=Sample" in asked(path).choices
    assert next(iter(asked(path, specimen_by="Sample").choices)) == "fill_labels=True"
    answers = {"specimen_by": "Sample", "fill_labels": True}
    result = read(path, header={"specimen": "pig 2"}, **answers)
    assert is_made_of(result, tables[1]) and result.specimen.name == "pig 2"


@pytest.mark.parametrize("written_in", [lambda k: k == 0, lambda k: k == 0 or k % 7])
def test_merged_cells_hold_for_those_below(written_in, tmp_path):
    tables = [made(ratio, 40) for ratio in RATIOS.values()]
    rows = table_of(np.concatenate(tables))
    labels = [name if written_in(k) else "" for name in RATIOS for k in range(40)]
    path = written(tmp_path, {"Protocol": labels} | rows)
    assert list(asked(path).choices) == ["fill_labels=True"]
    assert is_made_of(read(path, fill_labels=True), *tables)
    path = written(tmp_path, {"Protocol": [""] * 120} | rows)
    with pytest.raises(InputError):
        read(path)


@pytest.mark.parametrize("names", [("F12", "F21"), ("Fxy", "Fyx"), ("shear 1", "shear 2")])
def test_the_stretch_of_a_known_gradient_is_that_without_the_rotation(names, tmp_path):
    table = made()
    angle = np.radians(np.linspace(0.0, 8.0, len(table)))
    x, y = table[:, :2].T
    columns = {
        "F11": np.cos(angle) * x, "F22": np.cos(angle) * y,
        names[0]: -np.sin(angle) * y, names[1]: np.sin(angle) * x,
        "Fx [N]": table[:, 2], "Fy [N]": table[:, 3],
    }  # fmt: skip
    path = written(tmp_path, columns)
    more = () if names[0].startswith("F") else (f"shear_xy={names[0]}", f"shear_yx={names[1]}")
    result = read(path, mapped(("F11", "F22", *NAMES[2:]), *more))
    assert is_made_of(result, table)
    assert float(result.specimen.metadata["largest_shear_angle_deg"]) < 1e-6


# --- rows -----------------------------------------------------------------------------------------


ALL, STRETCHES = slice(None), slice(2)


def put(rows, columns, change):
    """A fault that changes some cells of a table."""

    def fault(table: np.ndarray) -> np.ndarray:
        wrong = table.copy()
        wrong[rows, columns] = change(wrong[rows, columns])
        return wrong

    return fault


def below(*statistics, shift=0.0):
    """A fault that writes statistics of the columns below them, as programs do."""

    def fault(table: np.ndarray) -> np.ndarray:
        rows = np.array([of(table, axis=0) for of in statistics])
        rows[-1, :2] += shift
        return np.vstack([table, rows])

    return fault


ROWS_APART = {
    "a lost frame": (put(33, STRETCHES, lambda c: 1.0), [33]),
    "a first frame": (lambda t: np.vstack([t[0] * [0.9, 0.9, 1.0, 1.0], t]), [0]),
    "a spike": (put(20, 2, lambda c: 3.0), [20]),
    "two frames": (put(slice(40, 42), STRETCHES, lambda c: 1.4), [40, 41]),
    "a footer": (below(np.mean, np.max), [60, 61]),
    "a footer of three": (below(np.mean, np.min, np.std, shift=1.0), [60, 61, 62]),
    "a footer of sds": (below(np.mean, np.max, np.std, shift=0.3), [60, 61, 62]),
}


def first_rows(question: OpenQuestions) -> str:
    return next(a for a in question.choices if a.startswith("rows=")).removeprefix("rows=")


@pytest.mark.parametrize("name", ROWS_APART)
def test_rows_apart_are_asked_about(name, tmp_path):
    fault, bad = ROWS_APART[name]
    rows = fault(made())
    path = written(tmp_path, table_of(rows))
    question = asked(path)
    assert " jump" in str(question)
    assert is_made_of(read(path, rows=first_rows(question)), np.delete(rows, bad, axis=0))


@pytest.mark.parametrize("lost", [(17, 24, 1.0), (30, 45, 1.01), (20, 26, 0.9)])
def test_tracking_that_is_lost_for_a_while_is_no_cycle(lost, tmp_path):
    first, last, stretch = lost
    table = made()
    rows = put(slice(first, last), STRETCHES, lambda c: stretch)(table)
    path = written(tmp_path, table_of(rows))
    assert str(first + 2) not in first_rows(asked(path)).replace(":", ",").split(",")
    kept = np.delete(table, np.arange(first, last), axis=0)
    assert is_made_of(read(path, rows=f"2:{first + 1},{last + 2}:61"), kept)


def slower_camera(table: np.ndarray, noise: float = 0.0) -> np.ndarray:
    held = table.copy()
    held[:, :2] = table[(np.arange(len(table)) // 10) * 10, :2]
    held[:, :2] += noise * np.random.default_rng(1).standard_normal((len(held), 2))
    return held


def relaxing(table: np.ndarray) -> np.ndarray:
    """Ten steps, each held while the load relaxes by a fifth."""
    steps = np.repeat(table[30::60], 30, axis=0)
    steps[:, 2:] *= np.tile(1.0 - 0.2 * (1.0 - np.exp(-np.arange(30) / 8.0)), 10)[:, None]
    return np.vstack([table[:1], steps])


STILL = {
    "a slower camera": slower_camera,
    "with noise": lambda table: slower_camera(table, 2e-5),
    "coarse": put(ALL, STRETCHES, lambda c: c.round(2)),
    "frozen": put(slice(300, None), STRETCHES, lambda c: c[0]),
    "frozen for a while": put(slice(200, 350), STRETCHES, lambda c: c[0]),
    "relaxing": relaxing,
}


@pytest.mark.parametrize(
    ("name", "per_N"), [*((name, 1.0) for name in STILL), ("frozen for a while", 0.02)]
)
def test_a_stretch_that_stands_still_is_asked_about(name, per_N, tmp_path):
    truth = made(rows=600) * [1, 1, per_N, per_N]
    path = written(tmp_path, table_of(STILL[name](truth)))
    question = asked(path)
    assert "stands still" in str(question) and "still=first" in question.choices
    result = read(path, still="last" if name == "relaxing" else "first")
    (p,) = result.specimen.protocols
    load = np.interp(p.stretch_x, truth[:, 0], truth[:, 2])
    if name == "relaxing":
        load *= 1.0 - 0.2 * (1.0 - np.exp(-29 / 8.0))
        load[0] = truth[0, 2]
    # a coarse stretch is off by half its last digit
    assert np.abs(p.load_x - load).max() < (0.08 if name == "coarse" else 5 * NOISE_N)
    assert "repeats the stretch of another row" in result.account


def saturated(columns, at: float, noise: float = 0.0):
    rng = np.random.default_rng(5)
    return put(ALL, columns, lambda c: np.minimum(c, at) + noise * rng.standard_normal(c.shape))


def creeping(table: np.ndarray) -> np.ndarray:
    """The load is held at its peak and the stretch goes on."""
    crept = table[-1] + np.outer(1 - np.exp(-np.arange(1, 30) / 9.0), [0.02, 0.02, 0, 0])
    return np.vstack([table[:-1], crept])


LOST_LOADS = [
    (put(slice(45, None), 2, lambda c: 0.6 * c), "falls"),
    (put(slice(22, None), slice(2, 4), lambda c: 0.8 * c), "falls at once behind line 23"),
    (put(slice(40, None), 3, lambda c: c * np.linspace(1.0, 0.3, 20)), "falls"),
    (put(slice(40, None), 2, lambda c: 1.6 * c), "rises at once"),
    (saturated(slice(2, 4), 0.6), "stays at 0.6"),
    (saturated(slice(2, 4), 0.6, 5e-4), "load in x stays at 0."),
    (saturated(3, 0.5), "load in y stays at 0.5"),
    (creeping, "creep"),
]


@pytest.mark.parametrize(("fault", "words"), LOST_LOADS)
def test_loads_that_do_not_follow_the_stretch_are_asked_about(fault, words, tmp_path):
    table = made()
    path = written(tmp_path, table_of(fault(table)))
    question = asked(path)
    assert words in str(question)
    (p,) = read(path, rows=first_rows(question)).specimen.protocols
    assert np.allclose(p.load_x, table[: p.rows, 2], atol=3e-3)
    assert read(path, rows="all").specimen.protocols[0].rows >= 60


def test_a_load_that_falls_with_the_stretch_is_not_lost(tmp_path):
    up = made()
    rows = np.concatenate([up[:40], up[30:40][::-1], up[30:]])
    assert up[39, 2] - up[30, 2] > 0.12 * np.ptp(up[:, 2])
    assert is_made_of(read(written(tmp_path, table_of(rows))), rows)


@pytest.mark.parametrize("late", [3, 6, 10])
def test_a_load_that_is_recorded_late_is_named(late, tmp_path):
    up = made()
    rows = np.concatenate([up, up[::-1] * [1, 1, 0.9, 0.9]] * 2)
    rows[late:, 2:] = rows[:-late, 2:]
    path = written(tmp_path, table_of(rows))
    question = asked(path, cycles="last", branch="loading")
    assert "recorded late" in str(question) and f"for {late} rows" in str(question)


def test_a_record_begins_with_its_rest_that_settles(tmp_path):
    """The stretch falls there by less than a fiftieth of the rise."""
    up = made()
    rest = np.repeat(up[:1], 8, axis=0) + np.outer(np.linspace(0.003, 0.0, 8), [1, 1, 0, 0])
    (p,) = read(written(tmp_path, table_of(np.concatenate([rest, up])))).specimen.protocols
    assert p.rows == 68


# --- cycles in a column, in files and in sheets ---------------------------------------------------


def test_a_count_that_changes_at_the_peaks(tmp_path):
    up = made()
    cycles = [up * [1, 1, f, f] for f in (1.25, 1.05, 1.0)]
    rows = np.concatenate([part for c in cycles for part in (c, c[::-1] * [1, 1, 0.85, 0.85])])
    count = np.repeat([5, 6, 8, 9], [60, 120, 120, 60])
    path = written(tmp_path, {"Total Cycle Count": count.tolist()} | table_of(rows))
    question = asked(path)
    assert "columns=cycle=Total Cycle Count" in question.choices
    columns = mapped(NAMES, "cycle=Total Cycle Count")
    assert "cycles=8" in asked(path, columns).choices
    for answers in ({"columns": columns}, {"columns": mapped(NAMES, "ignore=Total Cycle Count")}):
        result = read(path, cycles="last", branch="loading", **answers)
        (p,) = result.specimen.protocols
        assert p.rows in (60, 61) and np.allclose(p.recorded_load[-59:], up[-59:, 2:])


@pytest.mark.parametrize("several", ["files", "sheets"])
def test_preconditioning_in_several_files_or_sheets(several, tmp_path):
    """The reference drifts by 1 % in between: the stretch is written as it was measured."""
    tables = {f"cycle{k}": made() * [1, 1, f, f] for k, f in enumerate((1.3, 1.1, 1.0), start=1)}
    recorded = tables | {"cycle2": tables["cycle2"] * [1.01, 1.01, 1, 1]}
    if several == "files":
        paths: object = [written(tmp_path, table_of(t), f"{k}.csv") for k, t in recorded.items()]
        more = {}
    else:
        paths, more = tmp_path / "cycles.xlsx", {"sheets": "all"}
        paths.write_bytes(xlsx({k: [list(NAMES), *t.tolist()] for k, t in recorded.items()}))
    question = asked(paths, **more)
    assert "same stretch ratio comes back" in str(question)
    assert list(question.choices) == ["repeats=protocols", "repeats=cycles"]
    three = read(paths, repeats="protocols", **more)
    assert is_made_of(three, *tables.values())
    assert three.specimen.protocols[1].reference == pytest.approx((1.01, 1.01))
    assert "stretch-drift" in {f.code for f in check_specimen(three.specimen)}
    assert "cycles=last" in asked(paths, repeats="cycles", **more).choices
    assert is_made_of(read(paths, repeats="cycles", cycles="last", **more), tables["cycle3"])
    assert is_made_of(read(paths, repeats="cycles", cycles="2", **more), tables["cycle2"])


def test_protocols_below_each_other_are_separated_by_their_ratio_if_asked(tmp_path):
    tables = [made(ratio, 40) for ratio in RATIOS.values()]
    path = written(tmp_path, table_of(np.concatenate(tables)))
    question = asked(path)
    assert question.choices["protocols_by=ratio"] == "1:1: cycle 1; 1:0.5: cycle 2; 0.5:1: cycle 3"
    result = read(path, protocols_by="ratio")
    assert is_made_of(result, *tables)
    assert [p.name for p in result.specimen.protocols] == list(RATIOS)


def test_protocols_that_start_at_different_stretches_need_their_reference(tmp_path):
    start, other = made(), made((1.0, 0.5))
    other[:, 0] *= 1.04
    rows = np.concatenate([start, other])
    path = written(tmp_path, {"Protocol": ["a"] * 60 + ["b"] * 60} | table_of(rows))
    assert list(asked(path).choices) == ["reference=each protocol", "reference=common"]
    each = read(path, header={"reference": "each protocol"}).specimen
    assert each.protocols[1].stretch_x[0] == 1.0
    common = read(path, header={"reference": "common"}).specimen
    assert [p.rest_rows > 0 for p in common.protocols] == [True, False]


def test_rows_before_the_rise_are_left_out(tmp_path):
    table = made()
    path = written(tmp_path, table_of(np.vstack([[table[25]] * 4, table])))
    result = read(path)
    assert is_made_of(result, table)
    assert "4  rest or a smaller loop, in no cycle:" in result.account


def test_a_loading_branch_below_its_start_is_refused(tmp_path):
    lines = biotester_export(cycles=2).text().splitlines()
    falling = [k for k, line in enumerate(lines) if ",1-Recover" in line][:20]
    for k in falling:
        lines[k] = lines[k].replace("1-Recover", "2-Stretch")
    path = tmp_path / "raw.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="of the state that it starts from; give the lines"):
        biaxbayes.convert(path, machine="biotester", cycles=2, branch="loading", header=SIZE)


def test_rows_apart_in_a_cycled_record_are_asked_about(tmp_path):
    up = made()
    rows = np.concatenate([up, up[::-1], up, up[::-1]])
    rows[150, :2] = 1.0
    path = written(tmp_path, table_of(rows))
    question = asked(path, cycles="last", branch="loading")
    answer = next(iter(question.choices)).removeprefix("rows=")
    assert answer == "2:151,153:241"
    result = read(path, cycles="last", branch="loading", rows=answer)
    assert result.specimen.protocols[0].rows in (59, 60)


def test_creep_between_rises_is_asked_about(tmp_path):
    """The load is held six times, and the stretch goes on by a thirtieth of its way."""
    table = made(rows=72)
    parts = []
    for rise in np.split(table, 6):
        held = np.repeat(rise[-1:], 20, axis=0)
        held[:, :2] += np.outer(1.0 - np.exp(-np.arange(20) / 6.0), [0.006, 0.006])
        parts += [rise, held]
    path = written(tmp_path, table_of(np.concatenate(parts)))
    assert "creep" in str(asked(path)) and "rows=all" in asked(path).choices


# --- what 'check' finds ---------------------------------------------------------------------------


def test_what_check_finds_is_said_before_a_file_is_written(tmp_path, capsys):
    table = made()
    table[:, 2] -= table[0, 2]  # tared in x
    path, out = written(tmp_path, table_of(table)), tmp_path / "specimen.csv"
    words = ["--machine", "generic", "--columns", mapped(), "--out", out]
    words += [w for k, v in SIZE.items() for w in (f"--{k.replace('_', '-')}", v)]
    code, told, err = commands.run(capsys, "convert", path, *words)
    assert code == 0, err
    found = [str(f) for f in check_specimen(out) if f.severity != "note"]
    assert found and all(told.index(text) < told.index(f"specimen: {out}") for text in found)


def test_an_error_of_check_is_asked_about_and_nothing_is_written(tmp_path):
    """Forces below the preload of 0.1 N are lost."""
    table = made()
    table = np.vstack([table[:1]] * 6 + [table])
    table[:, 2:] += 1e-3 * np.random.default_rng(1).standard_normal((len(table), 2))
    table[:, 2:] = np.maximum(table[:, 2:] - table[3, 2:] - 0.1, 0.0)
    path, out = written(tmp_path, table_of(table)), tmp_path / "specimen.csv"
    question = asked(path, out=out)
    assert "clipped before export" in str(question) and not out.exists()
    assert list(question.choices) == ["rows=LINES", "rows=all"]
    assert "clipped" in {f.code for f in read(path, rows="all").findings}
