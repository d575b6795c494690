"""What a user said wrong is named as what it is; what a table has is read as what it is."""

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.machines.outcome import OpenQuestions

SIZE = {"edge_x_mm": 20.0, "edge_y_mm": 20.0, "thickness_mm": 1.2, "geometry": "unloaded"}
T = np.linspace(0.0, 1.0, 30)
X, Y = 1.0 + 0.2 * T, 1.0 + 0.15 * T
FX, FY = 0.02 + 0.03 * np.expm1(2.5 * T), 0.015 + 0.02 * np.expm1(2.5 * T)
DISP = {"Disp X (mm)": 20.0 * (X - 1.0), "Disp Y (mm)": 20.0 * (Y - 1.0)}
LOADS = {"Load X (N)": FX, "Load Y (N)": FY}
STRETCHES = ("stretch_x=1 + {Disp X (mm)} / 20", "stretch_y=1 + {Disp Y (mm)} / 20")
FORCES = ("force_x_N=Load X (N)", "force_y_N=Load Y (N)")
SAID = (*STRETCHES, *FORCES)


def written(folder, columns, *, name="raw.csv", cell="{:.6f}".format, foot="", separator=","):
    """A table of these columns, and its path."""
    rows = [separator.join(c if isinstance(c, str) else cell(c) for c in row)
            for row in zip(*columns.values(), strict=True)]  # fmt: skip
    path = folder / name
    path.write_text("\n".join([separator.join(columns), *rows]) + f"\n{foot}", encoding="utf-8")
    return path


def read(path, columns=SAID, **options):
    options = {"machine": "generic", "header": SIZE} | options
    return biaxbayes.convert(path, columns=columns, **options)


def has_all(result, rows=slice(None), tolerance=1e-5) -> bool:
    (p,) = result.specimen.protocols
    truth = np.column_stack([X, Y, FX, FY])[rows]
    found = np.hstack([p.stretch, p.recorded_load])
    return found.shape == truth.shape and np.allclose(found, truth, atol=tolerance)


def message(path, columns=SAID, **options) -> str:
    with pytest.raises(InputError) as refused:
        read(path, columns, **options)
    return str(refused.value)


WRONG = {
    "no braces": ("stretch_x=1 + Disp X (mm) / 20", "stand in braces: 1 + {Disp X (mm)} / 20"),
    "brackets": ("stretch_x=1 + [Disp X (mm)] / 20", "stand in braces: 1 + {Disp X (mm)} / 20"),
    "a decimal comma": ("stretch_x=1 + {Disp X (mm)} / 20,5", "write '1 + {Disp X (mm)} / 20.5'"),
    "a bracket": ("stretch_x=1 + {Disp X (mm)} / 20)", "a bracket, a brace or an operand"),
    "a name": (
        "stretch_x=1 + {Disp X (mm)} / gauge",
        "'gauge' is neither a function nor a header key",
    ),
    "a load": ("stretch_x=1 + {Load X (N)} / 20", "is computed from a load alone"),
    "a time": ("stretch_x=1 + {Time (s)} / 20", "is computed from a time alone"),
    "a function": ("stretch_x=1 + Sqrt({Disp X (mm)})", "'Sqrt' is neither a function"),
    "a micrometre": ("stretch_x=1 + {Disp X (µm)} / 20", "no column 'Disp X (µm)'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_in_an_expression_is_named(what, tmp_path):
    wrong, words = WRONG[what]
    path = written(tmp_path, {"Time (s)": T} | DISP | LOADS)
    assert words in message(path, (wrong, *SAID[1:]))


def test_a_micro_sign_is_the_letter_u(tmp_path):
    path = written(tmp_path, {"Disp X (µm)": 20e3 * (X - 1.0), "Y": Y} | LOADS)
    columns = ("stretch_x=1 + {Disp X (um)} / 20000", "stretch_y={Y}", *FORCES)
    assert has_all(read(path, columns))


def test_a_length_far_from_the_first_distance_is_warned_of(tmp_path):
    path = written(tmp_path, {"Mark (px)": 500 + 412 * (X - 1.0), "Y": Y} | LOADS)
    result = read(path, ("stretch_x={Mark (px)} / 412", "stretch_y={Y}", *FORCES))
    (finding,) = (f for f in result.findings if f.code == "re-referenced")
    assert finding.severity == "warning" and "off by up to 0.21" in str(finding)


def test_a_header_key_that_is_asked_for_stops_nothing_else(tmp_path):
    path = written(tmp_path, DISP | {"Load X": FX, "Load Y": FY})
    columns = ("stretch_x=1 + 2 * {Disp X (mm)} / edge_x_mm", STRETCHES[1], "force_x_N=Load X",
               "force_y_N=Load Y")  # fmt: skip
    header = {k: v for k, v in SIZE.items() if k != "edge_x_mm"}
    with pytest.raises(OpenQuestions) as asked:
        read(path, columns, header=header)
    assert {q.option for q in asked.value.questions} == {"edge_x_mm", "columns"}
    assert not asked.value.obstacle


def test_loads_of_the_other_direction_are_asked_about(tmp_path):
    path = written(tmp_path, {"F11": X, "F22": Y, "P11 (kPa)": FX, "P22 (kPa)": FY})
    columns = ("stretch_x=F11", "stretch_y=F22", "piola_x_kPa=P22 (kPa)", "piola_y_kPa=P11 (kPa)")
    assert "'F11' and 'P11 (kPa)' are of one direction" in message(path, columns)
    swapped = "piola_x_kPa=P11 (kPa),piola_y_kPa=P22 (kPa)"
    assert has_all(read(path, (*columns, swapped)))


def test_what_is_assumed_of_one_stress_is_in_no_proposal_for_the_other(tmp_path):
    stresses = {"Sigma11 (kPa)": X * FX, "Sigma22 (kPa)": Y * FY}
    path = written(tmp_path, {"lx": X, "ly": Y} | stresses)
    columns = (
        "stretch_x=lx",
        "stretch_y=ly",
        "piola_x_kPa=Sigma11 (kPa)",
        "piola_y_kPa=Sigma22 (kPa)",
    )
    with pytest.raises(OpenQuestions) as asked:
        read(path, columns, header={})
    for question in asked.value.questions:
        both = next(p for p in question.proposals if p.label == "it is a Cauchy stress")
        p, *_ = read(path, (*columns, both.value), header={}).specimen.protocols
        np.testing.assert_allclose(
            p.recorded_load, np.column_stack([*stresses.values()]), atol=1e-6
        )
    converted = "piola_x_kPa={Sigma11 (kPa)} / ({lx}):kPa"
    with pytest.raises(OpenQuestions) as asked:
        read(path, (*columns, converted), header={})
    assert not any("cauchy" in answer for answer in asked.value.choices)


def test_a_column_of_texts_is_no_stretch_and_no_load(tmp_path):
    path = written(tmp_path, {"Test": ["specimen one"] * 30} | DISP | LOADS)
    assert "no number in column 'Test': 'specimen one' is not" in message(
        path, ("stretch_x=Test", *SAID[1:])
    )


def test_remedies_of_a_table_are_no_lines_of_a_specimen_file(tmp_path):
    path = written(tmp_path, DISP | {"Load X (N)": 1e5 * FX, "Load Y (N)": FY})
    assert "if they are right, state 'stress_limit_kPa: " in message(path)
    path = written(tmp_path, DISP | {"Load X (N)": 0.0 * FX, "Load Y (N)": FY})
    assert "is stated by 'test: strip x'" in message(path)


def test_a_load_that_is_converted_although_it_is_in_the_unit_is_asked_about(tmp_path):
    path = written(tmp_path, DISP | LOADS)
    said = (*SAID, "force_x_N={Load X (N)} / 1000")
    with pytest.raises(OpenQuestions, match="is in N, which gives N already") as asked:
        read(path, said)
    alone, as_it_stands = asked.value.choices
    assert has_all(read(path, (*said, alone.removeprefix("columns="))))
    (p,) = read(path, (*said, as_it_stands.removeprefix("columns="))).specimen.protocols
    np.testing.assert_allclose(p.load_x, FX / 1000, atol=1e-8)


def test_phases_of_a_biotester_are_no_cycles_of_a_table(tmp_path):
    up = DISP | LOADS
    rows = {name: [*v, *v[-2::-1]] for name, v in up.items()}
    path = written(
        tmp_path, {"Cycle": ["1-Rest"] * 3 + ["1-Stretch"] * 27 + ["1-Recover"] * 29} | rows
    )
    with pytest.raises(OpenQuestions, match="has phases of cycles, such as '1-Recover'"):
        read(path, branch="loading")
    assert has_all(read(path, (*SAID, "ignore=Cycle"), branch="loading"))


def test_the_pressure_of_a_bulge_is_no_tension(tmp_path):
    path = written(tmp_path, {"stretch 1": X, "stretch 2": Y, "P (mmHg)": 100 * FX, "R": 22 - T})
    columns = ("stretch_x=stretch 1", "stretch_y=stretch 2", "pole_tension_kPa=P (mmHg)")
    said = message(path, columns, test="bulge", header={"thickness_mm": 0.5})
    assert "'P (mmHg)' is a pressure" in said


# --- tables ---------------------------------------------------------------------------------------

CELLS = {
    "a narrow space": {"cell": lambda v: f"{1e6 * v:,.1f}".replace(",", "\u00a0")},
    "an apostrophe": {"cell": lambda v: f"{1e6 * v:,.1f}".replace(",", "'")},
    "an equals sign": {"cell": lambda v: f'="{1e6 * v:.1f}"', "separator": ";"},
    "quotes": {"cell": lambda v: f"'{1e6 * v:.1f}'"},
    "a footer": {"cell": lambda v: f"{1e6 * v:.1f}", "foot": "Max,3,200000,49000\nEnd of test\n"},
}


@pytest.mark.parametrize("form", CELLS)
def test_numbers_are_read_and_summaries_are_left_out(form, tmp_path):
    columns = (*(f"{t} / 1000000" for t in STRETCHES), "force_x_N={Load X} / 1000000",
               "force_y_N={Load Y} / 1000000")  # fmt: skip
    path = written(tmp_path, DISP | {"Load X": FX, "Load Y": FY}, **CELLS[form])
    assert has_all(read(path, tuple(columns)))


def test_a_summary_is_left_out_by_the_name_of_its_row(tmp_path):
    table = {"Point": [str(k) for k in range(1, 31)]} | DISP | LOADS
    last = ",".join(f"{v[-1]:.6f}" for v in (DISP | LOADS).values())
    assert has_all(read(written(tmp_path, table, foot=f"Max,{last}\nSt. dev.,1,1,0.1,0.1\n")))
    stage = {"Stage": ["min"] * 15 + ["max"] * 15} | DISP | LOADS
    assert has_all(read(written(tmp_path, stage), ("ignore=Stage", *SAID)))


def test_missing_readings_below_the_names_are_no_units(tmp_path):
    first = "NaN,NaN,NaN,NaN\n"
    path = written(tmp_path, {"lx": X, "ly": Y} | LOADS)
    names, rows = path.read_text().split("\n", 1)
    path.write_text(f"{names}\n{first}{rows}")
    assert has_all(read(path, ("stretch_x=lx", "stretch_y=ly", *FORCES)))


def test_marks_of_thousands_stay_in_names_and_remarks(tmp_path):
    remarks = {"Remark": ["", "zoom 1'000"] + [f"frame {k}" for k in range(28)]}
    loads = {"Load X 1'000 (N)": FX, 'Load Y ="2" (N)': FY}
    path = written(tmp_path, DISP | loads | remarks, separator=";")
    assert has_all(
        read(path, (*STRETCHES, *(f"force_{a}_N={name}" for a, name in zip("xy", loads))))
    )


def test_marks_of_thousands_between_columns_of_spaces(tmp_path):
    cells = {"x": X, "y": Y, "fx": FX, "fy": FY}
    path = written(
        tmp_path, cells, separator=" ", cell=lambda v: f"{1e6 * v:,.0f}".replace(",", "\u00a0")
    )
    path.write_text(path.read_text().partition("\n")[2], encoding="utf-8")
    targets = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")
    assert has_all(read(path, tuple(f"{t}={{#{k}}} / 1e6" for k, t in enumerate(targets, start=1))))


def test_a_table_may_have_a_preamble_as_long_as_itself(tmp_path):
    path = written(tmp_path, DISP | LOADS)
    preamble = "".join(f"Key {k}: value {k}\n" for k in range(30))
    path.write_text(preamble + path.read_text())
    assert has_all(read(path))


def test_a_number_far_off_is_no_compression(tmp_path):
    columns = {k: v.copy() for k, v in (DISP | LOADS).items()}
    for curve in columns.values():
        curve[20] = -999.0
    said = message(written(tmp_path, columns))
    assert "jump in 22" in said and "compression" not in said


def test_rows_in_reverse_order_fall_only(tmp_path):
    said = message(written(tmp_path, {k: v[::-1] for k, v in (DISP | LOADS).items()}))
    assert "stretch and load fall only" in said


def test_time_that_runs_backwards_is_named(tmp_path):
    path = written(tmp_path, {"T (s)": 30.0 - T} | DISP | LOADS)
    assert "the time runs backwards in 29 of 30 rows" in message(path, ("time_s=T (s)", *SAID))


def test_the_name_that_is_in_no_protocol_is_the_one_that_is_named(tmp_path):
    names = ("X a", "Y a", "FX a (N)", "FY a (N)", "X b", "Y b", "FX b (N)", "FY b (N)")
    path = written(tmp_path, dict(zip(names, (X, Y, FX, FY) * 2, strict=True)))
    columns = ("stretch_x=X *", "stretch_y=Y *", "force_x_N=FX * (N)", "force_y_N=FZ * (N)")
    assert "no column 'FZ * (N)'" in message(path, columns)


def test_a_protocol_side_by_side_that_lacks_a_column_is_asked_about(tmp_path):
    names = [f"{p} {name}" for p in ("1:1", "1:0.5") for name in ("lx", "ly", "Fx (N)", "Fy (N)")]
    columns = dict(zip(names, [X, Y, FX, FY, X, 1 + (Y - 1) / 2, 2 + FX], strict=False))
    path = written(tmp_path, columns)
    said = ("stretch_x=* lx", "stretch_y=* ly", "force_x_N=* Fx (N)", "force_y_N=* Fy (N)")
    with pytest.raises(OpenQuestions, match="which has no") as asked:
        read(path, said)
    (answer,) = asked.value.choices
    assert has_all(read(path, (*said, answer.removeprefix("columns="))))


def test_a_stretch_that_never_changes_is_no_camera(tmp_path):
    path = written(tmp_path, {"lx": 0 * X + 1, "ly": 0 * Y + 1} | LOADS)
    assert "the stretch never changes" in message(path, ("stretch_x=lx", "stretch_y=ly", *FORCES))


def test_a_specimen_that_is_not_in_the_table_is_named(tmp_path):
    path = written(tmp_path, {"Specimen": ["A"] * 15 + ["B"] * 15} | DISP | LOADS)
    assert "none is named 'C'" in message(path, specimen_by="Specimen", specimen="C")


# --- times ----------------------------------------------------------------------------------------


def test_times_before_all_readings_are_of_the_same_rows(tmp_path):
    times = {"Time (s)": T, "Total time (s)": 5.0 + T**2}
    assert has_all(read(written(tmp_path, times | DISP | LOADS), ("time_s=Time (s)", *SAID)))
    path = written(tmp_path, {"Time (s)": T} | DISP | LOADS | {"Clock (s)": 3.0 * T})
    assert "'Time (s)' and 'Clock (s)' are two times" in message(path)
    assert has_all(read(path, ("ignore=Clock (s)", *SAID)))


def apart(frames, first="t load (s)", second="t video (s)"):
    """Loads in 30 rows, and stretches in 24 with a time of their own."""
    short = [[f"{v:.6f}" for v in c[:24]] + [""] * 6 for c in (frames, X, Y)]
    return {first: 4.0 * T} | LOADS | dict(zip((second, "lx", "ly"), short, strict=True))


JOINED = ("stretch_x=lx", "stretch_y=ly", *FORCES)


def test_times_that_are_exchanged_are_named(tmp_path):
    columns = ("time_s=t video (s)", "stretch_time_s=t load (s)", *JOINED)
    said = message(written(tmp_path, apart(4.0 * T)), columns, join="time")
    assert "'t video (s)' ends in line 25, before what was read at that time" in said


def test_times_of_different_extent_are_asked_about(tmp_path):
    path = written(tmp_path, apart(np.arange(30.0), second="frame"))
    columns = ("time_s=t load (s)", "stretch_time_s=frame", *JOINED)
    assert "are both in the unit that is read?" in message(path, columns, join="time")


def test_a_time_that_ends_before_the_loads_is_not_proposed_for_them(tmp_path):
    """Not even where one of both loads ends with it."""
    columns = apart(4.0 * T)
    columns["Load Y (N)"] = [f"{v:.6f}" for v in FY[:24]] + [""] * 6
    with pytest.raises(OpenQuestions) as asked:
        read(written(tmp_path, columns), ("stretch_time_s=t video (s)", *JOINED), join="time")
    assert "columns=time_s=t load (s)" in asked.value.choices
    assert "columns=time_s=t video (s)" not in asked.value.choices


def test_loads_whose_clock_is_reset_are_joined_one_run_at_a_time(tmp_path):
    runs = {name: np.concatenate([v, v[-2::-1], v[1:]]) for name, v in LOADS.items()}
    clock = {"Time (s)": np.concatenate([T, 1.0 + T[1:], T[1:]])}
    loads = written(tmp_path, clock | runs, name="loads.csv")
    times = np.linspace(0.0, 3.0, 13)
    share = 1.0 - np.abs(times % 2.0 - 1.0)
    stretches = {"lx": 1.0 + 0.2 * share, "ly": 1.0 + 0.15 * share}
    camera = written(tmp_path, {"Time (s)": times} | stretches, name="camera.csv")
    both, columns = [loads, camera], ("time_s=Time (s)", *JOINED)
    assert "the time of the loads does not increase" in message(both, columns, join="time")
    assert has_all(read(both, columns, join="time", rows="2:31"))


def test_columns_that_are_in_two_files_are_asked_about(tmp_path):
    loads = written(tmp_path, {"Time (s)": T} | LOADS, name="loads.csv")
    camera = written(tmp_path, {"Time (s)": T, "lx": X, "ly": Y}, name="camera.csv")
    with pytest.raises(OpenQuestions) as asked:
        read([camera, loads], JOINED)
    assert "join=time" in asked.value.choices
    assert "columns=stretch_time_s=Time (s)" in asked.value.choices
    times = ("time_s=Time (s)", "stretch_time_s=Time (s)")
    assert has_all(read([camera, loads], (*JOINED, *times), join="time"))


def test_frames_are_proposed_as_times_and_all_else_is_asked_at_once(tmp_path):
    loads = written(tmp_path, {"Time (s)": T} | LOADS, name="loads.csv")
    frames = {"Frame": np.arange(30.0), "exx": X - 1.0, "eyy": Y - 1.0}
    camera = written(tmp_path, frames, name="camera.csv")
    with pytest.raises(OpenQuestions) as asked:
        read([loads, camera], ("stretch_x=exx", "stretch_y=eyy", *FORCES), header={})
    choices = asked.value.choices
    assert {"join=time", "columns=stretch_time_s={Frame} * FACTOR", "columns=time_s=Time (s)",
            "columns=stretch_x=1 + {exx}", "geometry=mounted"} <= set(choices)  # fmt: skip
    assert sum("FACTOR" in answer for answer in choices) == 1
    said = ("stretch_x=1 + {exx}", "stretch_y=1 + {eyy}", *FORCES, "time_s=Time (s)")
    said += ("stretch_time_s={Frame} / 29",)
    assert has_all(read([loads, camera], said, join="time"))


def test_an_extensometer_is_no_other_end(tmp_path):
    path = written(tmp_path, {"Extension (mm)": 15 * (X - 1), "Extensometer (mm)": 12 * (X - 1),
                              "Load (N)": FX})  # fmt: skip
    columns = ("stretch_x=1 + {Extension (mm)} / 15", "force_x_N=Load (N)")
    result = read(path, columns, test="strip x")
    np.testing.assert_allclose(result.specimen.protocols[0].stretch_x, X, atol=1e-6)


def test_numbers_of_cells_are_no_directions(tmp_path):
    cells = {"Cell 1 (N)": 1.02 * FX, "Cell 2 (N)": 0.98 * FX}
    cells |= {"Cell 3 (N)": 1.01 * FY, "Cell 4 (N)": 0.99 * FY}
    path = written(tmp_path, DISP | cells)
    said = message(path, (*STRETCHES, "force_x_N=Cell 1 (N)", "force_y_N=Cell 3 (N)"))
    assert "({Cell 1 (N)} + {Cell 2 (N)}) / 2" in said


def test_steps_in_which_the_load_relaxes_are_asked_about(tmp_path):
    stretch, relaxed = np.repeat(X[::3], 6), np.tile(0.8 + 0.2 * np.exp(-np.arange(6) / 2), 10)
    loads = [np.repeat(f[::3], 6) * relaxed for f in (FX, FY)]
    names = ("Disp X (mm)", "Disp Y (mm)", *LOADS)
    steps = dict(zip(names, (20 * (stretch - 1), 15 * (stretch - 1), *loads), strict=True))
    path = written(tmp_path, steps)
    assert "while the load relaxes" in message(path)
    assert read(path, still="last").specimen.protocols[0].rows == 10


# --- what is shown and proposed -------------------------------------------------------------------


def test_the_account_of_two_files_has_the_cells_of_each(tmp_path):
    loads = written(tmp_path, {"Time (s)": T} | LOADS, name="loads.csv")
    camera = written(tmp_path, {"Time (s)": T, "lx": X, "ly": Y}, name="camera.csv")
    times = ("time_s=Time (s)", "stretch_time_s=Time (s)")
    account = read([loads, camera], (*JOINED, *times), join="time").account
    assert f"stretch_x = lx: {X[0]:.6f} {X[1]:.6f} {X[2]:.6f} -> 1" in account


def test_empty_rows_of_a_protocol_that_ends_early_are_no_missing_readings(tmp_path):
    short = [[f"{v:.6f}" for v in c[:20]] + [""] * 10 for c in (X, Y, FX, FY)]
    names = ("lx a", "ly a", "FX a (N)", "FY a (N)", "lx b", "ly b", "FX b (N)", "FY b (N)")
    path = written(tmp_path, dict(zip(names, (X, Y, FX, FY, *short), strict=True)))
    columns = ("stretch_x=lx *", "stretch_y=ly *", "force_x_N=FX * (N)", "force_y_N=FY * (N)")
    result = read(path, columns, repeats="protocols")
    assert [p.rows for p in result.specimen.protocols] == [30, 20]
    assert "no reading" in result.account


def test_an_answer_holds_for_all_protocols_side_by_side(tmp_path):
    names = ("X a", "Y a", "FX a", "FY a", "X b", "Y b", "FX b", "FY b")
    path = written(tmp_path, dict(zip(names, (X, Y, FX, FY) * 2, strict=True)))
    columns = ("stretch_x=X *", "stretch_y=Y *", "force_x_N=FX *", "force_y_N=FY *")
    with pytest.raises(OpenQuestions) as asked:
        read(path, columns)
    answers = ("stretch_x={X *}", "stretch_y={Y *}", "force_x_N=FX *:N", "force_y_N=FY *:N")
    assert {f"columns={answer}" for answer in answers} <= {*asked.value.choices}
    result = read(path, (*columns, *answers), repeats="protocols")
    assert [p.rows for p in result.specimen.protocols] == [30, 30]


def test_of_a_tube_a_diameter_is_asked_for(tmp_path):
    path = written(tmp_path, {"OD (mm)": 2.0 * X, "Length (mm)": 12.0 + 0.0 * T, "P (mmHg)": FX})
    with pytest.raises(OpenQuestions) as asked:
        read(path, (), header={})
    assert {"test=tube", "columns=outer_diameter_mm=OD (mm)"} <= {*asked.value.choices}
    assert not any("stretch_x={OD" in choice for choice in asked.value.choices)


def test_no_proposal_has_a_number_that_nobody_gave(tmp_path):
    with pytest.raises(OpenQuestions) as asked:
        read(written(tmp_path, DISP | LOADS), ("stretch_x=Disp X (mm)", *FORCES))
    values = [choice for choice in asked.value.choices if choice.startswith("columns=stretch_y=")]
    assert "columns=stretch_y=1 + {Disp X (mm)} / LENGTH_MM" in values
    assert not any(value.rstrip(")").endswith(tuple("0123456789")) for value in values)


def test_of_two_actuators_as_well_the_length_is_for_the_user_to_give(tmp_path):
    moves = (*DISP.values(), *DISP.values())
    both_ends = {f"Axial {k} Displacement (mm)": u for k, u in enumerate(moves, 1)}
    with pytest.raises(OpenQuestions) as asked:
        read(written(tmp_path, both_ends | LOADS), ())
    of_x = [choice for choice in asked.value.choices if choice.startswith("columns=stretch_x=1 +")]
    both = "1 + ({Axial 1 Displacement (mm)} + {Axial 3 Displacement (mm)}) / LENGTH_MM"
    assert f"columns=stretch_x={both}" in of_x
    assert all(choice.endswith(("/ LENGTH_MM", "/ edge_x_mm")) for choice in of_x)


def test_units_below_the_names_hold_for_a_column_that_is_named_alone(tmp_path):
    path = tmp_path / "units.csv"
    readings = zip(*DISP.values(), FX, FY, strict=True)
    rows = "".join(f"{u},{v},{f},{g}\n" for u, v, f, g in readings)
    path.write_text(f"X Displacement,Y Displacement,X Force,Y Force\nmm,mm,N,N\n{rows}")
    with pytest.raises(OpenQuestions) as asked:
        read(path, ("stretch_x=X Displacement",))
    assert "'X Displacement' is in mm" in asked.value.problem


def test_both_branches_have_the_ratio_of_their_peak(tmp_path):
    there_and_back = {k: np.append(v, v[-2::-1]) for k, v in (DISP | LOADS).items()}
    with pytest.raises(OpenQuestions) as asked:
        read(written(tmp_path, there_and_back))
    assert "1:0.75" in asked.value.choices["branch=both"]


def test_one_protocol_may_carry_no_load_in_a_direction(tmp_path):
    columns = {"P": ["a"] * 30 + ["b"] * 30, "lx": np.tile(X, 2), "ly": np.append(Y, T * 0 + 1)}
    columns |= {"Load X (N)": np.tile(FX, 2), "Load Y (N)": np.append(FY, 0.0 * T)}
    result = read(written(tmp_path, columns), ("protocol=P", *JOINED))
    assert [p.load_y.any() for p in result.specimen.protocols] == [True, False]
