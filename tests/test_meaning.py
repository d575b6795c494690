"""One specimen written in many ways is read to the same numbers, or refused with its cause."""

import csv
import io
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes import Protocol, Specimen
from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.conversion import convert
from biaxbayes.machines.outcome import Conversion, OpenQuestions

WAYS = 200
EDGE, THICKNESS = 10.0, 1.2
GAUGE = EDGE * np.array([1.02, 1.05])
RATIOS = {"1:1": (1.0, 1.0), "1:0.5": (1.0, 0.5), "0.5:1": (0.5, 1.0)}
HEADER = {
    "edge_x_mm": EDGE, "edge_y_mm": EDGE, "thickness_mm": THICKNESS, "geometry": "unloaded",
}  # fmt: skip


def protocol(x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Stretches and forces (N) of a stiffening sheet, 25 rows from rest to the peak."""
    t = np.linspace(0.0, 1.0, 25)
    stretch = 1.0 + 0.2 * np.outer(t, [x, y])
    e = stretch - 1.0
    energy = np.exp(9.0 * e[:, 0] ** 2 + 5.0 * e[:, 1] ** 2 + 4.0 * e[:, 0] * e[:, 1])
    force = 0.03 + 0.6 * (e @ np.array([[2.0, 0.4], [0.4, 1.4]])) * energy[:, None]
    return stretch, force


TRUE = {name: protocol(*ratio) for name, ratio in RATIOS.items()}


def two_cycles(curve: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Up and down twice, without the rest row at the end."""
    return np.concatenate([curve, back[-2::-1], curve[1:], back[-2:0:-1]])


@dataclass
class Way:
    """A file with its options, and whether anything is open in it."""

    names: list[str] = field(default_factory=list)
    columns: list[np.ndarray] = field(default_factory=list)
    mapped: dict[str, str] = field(default_factory=dict)
    options: dict = field(default_factory=dict)
    refusals: list[str] = field(default_factory=list)
    """Words, one of which a refusal has to hold; none where the file leaves nothing open."""


STRAINS = {
    "stretch": lambda s: s,
    "engineering": lambda s: s - 1.0,
    "green": lambda s: 0.5 * (s**2 - 1.0),
    "log": np.log,
    "almansi": lambda s: 0.5 * (1.0 - s**-2),
}
NAMED = {
    "stretch": ["lambda_{}", "Stretch {}", "stretch_ratio_{}"],
    "engineering": ["Eng. strain {}", "engineering_{}", "nominalStrain{}"],
    "green": ["Green strain {}{}", "E{} (Green)", "green-lagrange_{}"],
    "log": ["E{}_true", "e{} (Hencky)", "log strain {}", "Ln{} ln"],
    "almansi": ["Almansi {}", "euler-almansi_{}"],
}
OPEN = ["E{}{}", "Lagrange strain {}", "strain_{}", "eps {}"]
SCALES = {
    "": 1.0, " [-]": 1.0, " (mm/mm)": 1.0, " [%]": 100.0, "_%": 100.0, " (‰)": 1e3, " [µε]": 1e6,
}  # fmt: skip
FORCES = {
    "N": 1.0, "mN": 1e3, "gf": 1 / 9.80665e-3, "kgf": 1 / 9.80665, "lbf": 1 / 4.4482216152605,
    "g": 1 / 9.80665e-3, "dyn": 1e5, "uN": 1e6, "kg": 1 / 9.80665,
}  # fmt: skip
STRESSES = {
    "kPa": 1.0, "MPa": 1e-3, "Pa": 1e3, "N/m^2": 1e3, "psi": 1 / 6.894757293168,
    "kgf/cm2": 1 / 98.0665, "dyn/cm²": 1e4, "mmHg": 1 / 0.133322387415, "N mm-2": 1e-3,
    "gf/mm2": 1 / 9.80665, "kg/cm^2": 1 / 98.0665,
}  # fmt: skip


FORMULAS = {
    "stretch": "{}",
    "engineering": "1 + {}",
    "green": "sqrt(1 + 2 * {})",
    "log": "exp({})",
    "almansi": "1 / sqrt(1 - 2 * {})",
}


def deformation(rng: np.random.Generator, way: Way, stretch: np.ndarray) -> None:
    """Columns of stretches, strains, displacements or distances."""
    kind = str(rng.choice([*STRAINS, *STRAINS, "moved", "apart", "open"]))
    scale = str(rng.choice(list(SCALES)))
    name = str(rng.choice(NAMED.get(kind, OPEN)))
    if kind in ("moved", "apart"):
        unit, factor = [("mm", 1.0), ("um", 1e3), ("cm", 0.1), ("inch", 1 / 25.4)][rng.integers(4)]
        scale = f" [{unit}]"
        words = {
            "moved": ["Grip displacement {}", "crosshead {}", "Weg {}", "Position {}"],
            "apart": ["Marker distance {}", "gauge length {}", "Position {}"],
        }[kind]
        name = str(rng.choice(words))
        values = (stretch - (kind == "moved")) * GAUGE * factor
        formula = "{0} / first({0})"
        if kind == "moved":
            formula = "1 + {} / LENGTH"
            if rng.random() < 0.2:
                values = values + 0.3 * GAUGE * factor
                formula = "1 + ({0} - first({0})) / LENGTH"
        lengths = [f"{g * factor:.17g}" for g in GAUGE]
    else:
        kind = str(rng.choice(list(STRAINS))) if kind == "open" else kind
        values = STRAINS[kind](stretch) * SCALES[scale]
        formula, lengths = FORMULAS[kind], ["", ""]
        if SCALES[scale] != 1.0:
            formula = formula.replace("{}", f"({{}} / {SCALES[scale]:g})")
    bare = rng.random() < 0.3
    if bare and not (kind == "stretch" and name in NAMED["stretch"] and SCALES[scale] == 1.0):
        way.refusals.append("follow from it")
    numbered = bool(rng.integers(2))
    for k, axis in enumerate("xy"):
        letters = str(k + 1) if numbered else axis.upper()
        full = name.format(*[letters] * 2) + scale
        way.names.append(full)
        way.columns.append(values[:, k])
        said = formula.format(f"{{{full}}}").replace("LENGTH", lengths[k])
        way.mapped[f"stretch_{axis}"] = full if bare else said


def loads(rng: np.random.Generator, way: Way, stretch: np.ndarray, force: np.ndarray) -> None:
    """Columns of forces or stresses, in any unit and sign."""
    pair = str(rng.choice(["force", "piola", "cauchy"]))
    area = EDGE * THICKNESS
    piola = force / area * 1e3
    values = {"force": force, "piola": piola, "cauchy": piola * stretch}[pair]
    units = FORCES if pair == "force" else STRESSES
    unit = str(rng.choice(list(units)))
    values = values * units[unit]
    form = str(rng.choice(["{} [u]", "{}, u", "{} (u)", "{}_u", "{}"]))
    words = {"force": "Load", "piola": "P", "cauchy": "Cauchy stress"}[pair]
    negative = rng.random() < 0.2
    turned = negative and rng.random() < 0.5  # an expression is taken as it is said
    if pair != "force" and rng.random() < 0.1:
        words = {"piola": "Cauchy stress", "cauchy": "First Piola stress"}[pair]
        way.refusals += [] if turned else ["suggests a"]
    if negative and not turned:
        way.refusals.append("falls by")
    given = ""
    if "u" not in form.replace("{}", "") and not turned:
        if rng.random() < 0.5:
            given = f":{unit}"
        else:
            way.refusals.append("is not known")
    for k, axis in enumerate("xy"):
        full = form.replace("u", unit).format(f"{words} {axis.upper()}")
        way.names.append(full)
        way.columns.append(-values[:, k] if negative else values[:, k])
        suffix = "N" if pair == "force" else "kPa"
        way.mapped[f"{pair}_{axis}_{suffix}"] = f"-{{{full}}}:{unit}" if turned else full + given


def written(rng: np.random.Generator, folder: Path, number: int) -> tuple[Path, Way]:
    """A file, and the way in which it was written."""
    way = Way()
    how = str(rng.choice(["column", "record"]))
    curves = list(TRUE.values())
    if how == "record":  # two cycles of each ratio in one record, up and down
        curves = [(two_cycles(s, s), two_cycles(f, f[0] + 0.9 * (f - f[0]))) for s, f in curves]
    stretch, force = (np.concatenate(part) for part in zip(*curves, strict=True))
    counts = [len(s) for s, _ in curves]
    deformation(rng, way, stretch)
    loads(rng, way, stretch, force)
    labels = np.repeat(list(TRUE), counts)
    cells: list[list[object]] = [c.tolist() for c in way.columns]
    names = list(way.names)
    for extra, values in (
        ("Comment", ["slipped" if i == 9 else "" for i in range(len(labels))]),
        ("Clock", [f"10:{i // 60:02d}:{i % 60:02d}" for i in range(len(labels))]),
        ("Temperature [C]", [37.0 + 0.001 * i for i in range(len(labels))]),
        ("Time [ms]", [20.0 * i for i in range(len(labels))]),
    ):
        if rng.random() < 0.3:
            names.append(extra)
            cells.append(values)
            way.mapped |= {"time_s": extra} if extra == "Time [ms]" else {}
    if how == "column":
        names.append("Path")
        cells.append(labels.tolist())
        way.mapped["protocol"] = "Path"
    order = rng.permutation(len(names))
    names = [names[i] for i in order]
    rows = [list(row) for row in zip(*[cells[i] for i in order], strict=True)]
    heads = [[], [["Specimen", "A-12"], ["Thickness", "1.2"]], [["made by hand"]]]
    preamble = heads[rng.integers(3)]
    path = folder / f"way{number}.csv"
    forms = [(",", "."), (";", ","), ("\t", "."), ("\t", ","), (";", ".")]
    separator, decimal = forms[rng.integers(5)]
    out = io.StringIO()
    table = csv.writer(out, delimiter=separator, lineterminator=str(rng.choice(["\n", "\r\n"])))
    padding = [""] * (len(names) - 2) if rng.random() < 0.5 else []
    table.writerows([*row, *padding][: len(names)] for row in preamble)
    table.writerow(names)
    for row in rows:
        table.writerow([repr(v).replace(".", decimal) if isinstance(v, float) else v for v in row])
    path.write_text(out.getvalue(), str(rng.choice(["utf-8", "utf-8-sig", "utf-16"])))
    return path, way


def read(path: Path, way: Way) -> Conversion:
    answers = {"protocols_by": "ratio", "cycles": "last", "branch": "loading"}
    if "protocol" in way.mapped:
        answers = {}
    options = answers | way.options
    text = ",".join(f"{target}={column}" for target, column in way.mapped.items())
    return convert([path], Choice("generic", (text,), **options), header=HEADER)


def is_the_specimen(result: Conversion, way: Way) -> bool:
    """Whether the numbers are those of the specimen."""
    protocols = result.specimen.protocols
    if len(protocols) != len(TRUE):
        return False
    for p, (stretch, force) in zip(protocols, TRUE.values(), strict=True):
        measured = np.column_stack([p.stretch_x, p.stretch_y])
        measured = measured / measured[0]
        load = result.specimen.load(p)
        if result.specimen.loads != "force":
            load = load * EDGE * THICKNESS * 1e-3
        if len(load) != len(force) or not np.allclose(measured, stretch, rtol=0, atol=1e-9):
            return False
        if not np.allclose(load, force, rtol=1e-7, atol=1e-12):
            return False
        if "time_s" in way.mapped and not np.allclose(np.diff(p.time_s), 0.02):
            return False
    return True


@pytest.mark.long
def test_one_specimen_written_in_many_ways(tmp_path):
    outcomes: Counter[str] = Counter()
    wrong = []
    for number in range(WAYS):
        path, way = written(np.random.default_rng([7, number]), tmp_path, number)
        try:
            result = read(path, way)
        except InputError as refusal:
            message = str(refusal)
            outcomes["refused"] += 1
            if not any(words in message for words in way.refusals) or not refusal.remedy:
                wrong.append(f"{number} {way.refusals}: {message}")
            assert message.isprintable()
            continue
        outcomes["read"] += 1
        if way.refusals or not is_the_specimen(result, way):
            wrong.append(f"{number}: read to another, {way.mapped} {way.options} {way.refusals}")
    assert not wrong, "\n".join(wrong)
    assert outcomes["read"] > WAYS // 3 and outcomes["refused"] > WAYS // 6


@pytest.mark.parametrize(
    "name",
    [
        "Green strain [%] {}", "% Green strain {}", "{} percent Green", "E{} [%] (Green)",
        "Green%{}", "strainPercent_{} green", "pct Green-Lagrange {}",
    ],
)  # fmt: skip
def test_per_cent_anywhere_in_a_name_is_per_cent(tmp_path, name):
    """With small strains: 2 % read as a strain of 2 would be a stretch of 2.2, a possible one."""
    stretch, force = next(iter(TRUE.values()))
    small = 1.0 + 0.1 * (stretch - 1.0)
    path = tmp_path / "a.csv"
    names = [name.format(axis) for axis in "XY"]
    table = pd.DataFrame(np.column_stack([50.0 * (small**2 - 1.0), force]))
    table.to_csv(path, index=False, header=[*names, "Force [mN] X", "Force [mN] Y"])
    forces = ["Force [mN] X", "Force [mN] Y"]
    with pytest.raises(OpenQuestions) as asked:
        converted(path, targets([*names, *forces]))
    formula = "sqrt(1 + 2 * {} * 0.01)"
    said = of_strain(formula, [*names, *forces])
    assert f"columns=stretch_x={said[0]}" in asked.value.choices
    result = converted(path, targets(said))
    assert_is(result, small, 1e-3 * force)


# --- names and units that leave something open ----------------------------------------------------

STRETCH, FORCE = TRUE["1:1"]
GREEN = 0.5 * (STRETCH**2 - 1.0)


def converted(path: Path, columns, *more: str, header=(), **options) -> Conversion:
    text = ",".join(f"{target}={column}" for target, column in columns.items())
    choice = Choice("generic", (text, *more), **options)
    return convert([path], choice, header={**HEADER, **dict(header)})


def targets(names: list[str]) -> dict[str, str]:
    return dict(zip(("stretch_x", "stretch_y", "force_x_N", "force_y_N"), names, strict=True))


def of_strain(formula: str, names: list[str]) -> list[str]:
    """Stretches of two columns, and the others as they are."""
    return [*(formula.format(f"{{{name}}}") for name in names[:2]), *names[2:]]


def file_of(folder: Path, names: list[str], *pairs: np.ndarray, units: str = "") -> Path:
    """A CSV of pairs of columns, with a row of units below the names where there is one."""
    path = folder / "a.csv"
    rows = "".join(",".join(map(repr, row)) + "\n" for row in np.column_stack(pairs).tolist())
    path.write_text(",".join(names) + "\n" + (f"{units}\n" if units else "") + rows)
    return path


def assert_is(result: Conversion, stretch: np.ndarray, force: np.ndarray) -> None:
    (p,) = result.specimen.protocols
    np.testing.assert_allclose(p.stretch, stretch, rtol=1e-12)
    np.testing.assert_allclose(result.specimen.load(p), force, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("lambda_{}^2", STRETCH**2, "starts at 1: how does stretch_x follow"),
        ("λ{}²", STRETCH**2, "starts at 1: how does stretch_x follow"),
        ("stretch squared {}", STRETCH**2, "starts at 1: how does stretch_x follow"),
        ("1/lambda_{}", 1.0 / STRETCH, "starts at 1: how does stretch_x follow"),
        ("Green x100 {}", 10.0 * GREEN, "starts at 0: how does stretch_x follow"),
        ("Eng. strain rate {}", STRETCH - 1.0, "starts at 0: how does stretch_x follow"),
        ("true stretch {}", STRETCH - 1.0, "starts at 0: how does stretch_x follow"),
        ("Green {}", STRETCH, "starts at 1: how does stretch_x follow"),
        ("lambda_{}", STRETCH - 1.0, "starts at 0: how does stretch_x follow"),
    ],
)
def test_what_is_not_plainly_the_strain_is_not_taken_for_it(tmp_path, name, values, says):
    columns = [*(name.format(axis) for axis in "xy"), "Fx_N", "Fy_N"]
    path = file_of(tmp_path, [c.partition(":")[0] for c in columns], values, FORCE)
    with pytest.raises(InputError, match=says):
        converted(path, targets(columns))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Load {} [N] (lbf)", "has two units, lbf and N"),
        ("F{}_mN [N]", "has two units, N and mN"),
        ("Load*1000 {} [N]", "suggests a multiple"),
        ("Load/10 {} [N]", "suggests a multiple"),
        ("Load {} [1e-3 N]", "'1e-3 N' of .* is not a known unit"),
        ("Load 10 N {} (V)", "'V' of .* is not a known unit"),
    ],
)
def test_a_force_with_two_units_or_a_factor_is_refused(tmp_path, name, words):
    names = [name.format(axis) for axis in "xy"]
    path = file_of(tmp_path, ["lx", "ly", *names], STRETCH, FORCE)
    columns = dict(zip(("force_x_N", "force_y_N"), names, strict=True))
    with pytest.raises(InputError, match=words):
        converted(path, {"stretch_x": "lx", "stretch_y": "ly", **columns})
    given = {target: f"{column}:N" for target, column in columns.items()}
    result = converted(path, {"stretch_x": "lx", "stretch_y": "ly", **given})
    assert_is(result, STRETCH, FORCE)


@pytest.mark.parametrize(
    ("units", "scale", "words"),
    [
        ("%,%,mN,mN", (100.0, 1e3), ""),
        ("mm/m,mm/m,N,N", (1e3, 1.0), ""),
        ("ppm,ppm,kN,kN", (1e6, 1e-3), ""),
        ("-,-,lbs,V", (1.0, 1.0), "'V' of 'Load Y' is not a known unit"),
        ("-,-,mN,gf", (1.0, 1.0), "has two units"),
    ],
)
def test_a_row_of_units_counts_as_the_names_do(tmp_path, units, scale, words):
    """With small strains, which stay possible if a factor is missed."""
    small = 1.0 + 0.1 * (STRETCH - 1.0)
    suffix = " [N]" if words == "has two units" else ""
    names = ["Green X", "Green Y", f"Load X{suffix}", f"Load Y{suffix}"]
    values = scale[0] * 0.5 * (small**2 - 1.0), scale[1] * FORCE
    path = file_of(tmp_path, names, *values, units=units)
    columns = targets(of_strain(f"sqrt(1 + 2 * {{}} / {scale[0]:g})", names))
    if words:
        with pytest.raises(InputError, match=words):
            converted(path, columns)
        return
    assert_is(converted(path, columns), small, FORCE)
    with pytest.raises(OpenQuestions) as asked:
        converted(path, targets(names))
    assert f"columns=stretch_x=sqrt(1 + 2 * {{Green X}} * {1 / scale[0]:g})" in asked.value.choices


def test_a_displacement_or_a_distance_is_said_by_an_expression(tmp_path):
    names = ["Distance X [mm]", "Distance Y [mm]", "Fx_N", "Fy_N"]
    path = file_of(tmp_path, names, STRETCH * GAUGE, FORCE)
    with pytest.raises(OpenQuestions) as asked:
        converted(path, targets(names))
    answers = [q.default.value for q in asked.value.questions]
    assert answers[0] == "stretch_x={Distance X [mm]} / first({Distance X [mm]})"
    assert_is(converted(path, targets(names), *answers), STRETCH, FORCE)
    names = ["Disp X [mm]", "Disp Y [mm]", "Fx_N", "Fy_N"]
    path = file_of(tmp_path, names, (STRETCH - 1.0) * GAUGE, FORCE)
    with pytest.raises(OpenQuestions) as asked:
        converted(path, targets(names))
    assert "columns=stretch_x=1 + {Disp X [mm]} / LENGTH_MM" in asked.value.choices
    said = [f"stretch_{a}=1 + {{Disp {a.upper()} [mm]}} / {g}" for a, g in zip("xy", GAUGE)]
    assert_is(converted(path, targets(names), *said), STRETCH, FORCE)
    path = file_of(tmp_path, names, (1.0 - STRETCH) * GAUGE, FORCE)
    with pytest.raises(OpenQuestions) as asked:
        converted(path, targets(names), *said)
    turned = f"columns=stretch_x=2 - (1 + {{Disp X [mm]}} / {GAUGE[0]})"
    assert turned in asked.value.choices
    again = [f"{answer[:10]}2 - ({answer[10:]})" for answer in said]
    assert_is(converted(path, targets(names), *again), STRETCH, FORCE)


def test_a_point_among_decimal_commas_is_refused_in_any_row(tmp_path):
    """A thousands separator far below the rows from which the form of numbers is read."""
    path = tmp_path / "a.csv"
    n = 2500
    rows = [f"1,{i:04d};1,{i:04d};{i};{i},5" for i in range(n - 1)]
    path.write_text("\n".join(["lx;ly;Fx [mN];Fy [mN]", *rows, "1,25;1,25;2.500;2500,5"]) + "\n")
    columns = targets(["lx", "ly", "Fx [mN]", "Fy [mN]"])
    with pytest.raises(InputError, match=rf"row {n + 1}, column Fx .*'2.500' has a decimal point"):
        converted(path, columns)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"edge_x_mm": -10.0}, "edge_x_mm must be a positive number"),
        ({"edge_mm_x": 10.0}, "unknown header key 'edge_mm_x'"),
        ({"mounting_stretch_x": 1.03}, r"of the form '1.03 \+- 0.01'"),
    ],
)
def test_header_values_from_python_are_checked_as_those_of_a_file(tmp_path, header, words):
    path = file_of(tmp_path, ["lx", "ly", "P11 [kPa]", "P22 [kPa]"], STRETCH, FORCE)
    columns = "stretch_x=lx,stretch_y=ly,piola_x_kPa=P11 [kPa],piola_y_kPa=P22 [kPa]"
    with pytest.raises(InputError, match=words):
        biaxbayes.convert(path, machine="generic", columns=columns, header=header)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"edge_y_mm": float("nan")}, "edge_y_mm must be a positive number"),
        ({"thickness_mm": 0.0}, "thickness_mm must be a positive number"),
        ({"thickness_mm": 1200.0}, "thickness_mm of 1200 is out of range"),
        ({"load_noise": -1.0}, "load_noise must be a number from 0"),
        ({"metadata": {"edge_sd": 0.1}}, "unknown metadata key 'edge_sd'"),
        ({"protocols": (STRETCH, FORCE)}, "must be a sequence of at least one Protocol"),
    ],
)
def test_a_specimen_of_arrays_is_checked_as_a_file_is(arguments, words):
    p = Protocol("p", *STRETCH.T, *FORCE.T)
    sound = {"protocols": (p,), "edge_x_mm": EDGE, "edge_y_mm": EDGE, "thickness_mm": THICKNESS}
    with pytest.raises(InputError, match=words):
        Specimen("a", loads="force", **{**sound, **arguments})


def test_a_given_unit_that_contradicts_the_name_is_recorded(tmp_path):
    names = ["lx", "ly", "Load X [N]", "Load Y [N]"]
    path = file_of(tmp_path, names, STRETCH, 1e3 * FORCE)
    result = converted(path, targets([*names[:2], *(f"{name}:mN" for name in names[2:])]))
    assert_is(result, STRETCH, FORCE)
    text = str(result.specimen.metadata["conversion"])
    assert "force_y_N is read in mN, as given; 'Load Y [N]' says N" in text


def test_units_of_x_and_y_may_differ(tmp_path):
    moved = (STRETCH - 1.0) * GAUGE * [1.0, 1e3]
    names = ["Disp X [mm]", "Disp Y [um]", "Load X [mN]", "Load Y [gf]"]
    force = FORCE * [1e3, 1 / 9.80665e-3]
    path = file_of(tmp_path, names, moved, force)
    said = [f"1 + {{Disp X [mm]}} / {GAUGE[0]}", f"1 + {{Disp Y [um]}} / 1e3 / {GAUGE[1]}"]
    assert_is(converted(path, targets([*said, *names[2:]])), STRETCH, FORCE)


def test_fractions_below_a_per_cent_sign_in_one_direction_are_seen(tmp_path):
    names = ["Green X [%]", "Green Y", "Fx_N", "Fy_N"]
    path = file_of(tmp_path, names, GREEN, FORCE)
    columns = targets(of_strain("sqrt(1 + 2 * {} / 100)", names))
    with pytest.raises(InputError, match=r"change by 0.22% only if 'Green X \[%\]'"):
        converted(path, columns)
