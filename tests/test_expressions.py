"""Arithmetic over columns: what it gives, what is refused, and that nothing else runs."""

import re

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.machines.outcome import OpenQuestions
from biaxbayes.tables.expressions import evaluated
from biaxbayes.tables.preview import preview

A, B = np.linspace(0.0, 4.0, 9), np.linspace(2.0, 3.0, 9)
COLUMNS = {"Disp X (mm)": A, "Cell 1, N": B}
CONSTANTS = {"edge_x_mm": 20.0}


def value(text: str, rows=slice(None)) -> np.ndarray:
    return evaluated(text, COLUMNS, CONSTANTS, np.arange(9)[rows])


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("1 + {Disp X (mm)} / 20.6", 1 + A / 20.6),
        ("1+{ Disp X (mm) }/edge_x_mm", 1 + A / 20.0),
        ("-{Cell 1, N}", -B),
        ("({Disp X (mm)} + {Cell 1, N}) / 2", (A + B) / 2),
        ("sqrt(1 + 2*{Disp X (mm)})", np.sqrt(1 + 2 * A)),
        ("exp({Disp X (mm)}) ** -1", np.exp(-A)),
        ("{Cell 1, N} / first({Cell 1, N})", B / 2.0),
        ("1.4", np.full(9, 1.4)),
        ("2**-{Disp X (mm)}**2", 2.0 ** -(A**2)),
    ],
)
def test_expressions_are_computed(text, wanted):
    np.testing.assert_allclose(value(text), wanted, rtol=1e-15)


def test_the_first_value_is_that_of_the_rows_that_are_read():
    np.testing.assert_allclose(value("first({Cell 1, N})", slice(4, None)), B[4])


HOSTILE = [
    "__import__('os').system('true')", "{Cell 1, N}.tofile('x')", "{Cell 1, N}.__class__",
    "().__class__.__bases__[0]", "[1, 2]", "{Cell 1, N}[0]", "'a' * 9", "lambda: 1", "open('x')",
    "eval('1')", "(x := 1)", "1 if 1 else 2", "1 < 2", "True", "f'{1}'", "a = 1", "1; 2",
    "import os",
    "sqrt", "sqrt.__call__(4)", "sqrt(x=1)", "sqrt(*{Cell 1, N})", "max(1)",
    "9 ** 9 ** 9 ** 9 / unknown",
    "{Cell 1, N} ^ 2", "1,4", "1 + ", "(" * 900 + ")" * 900, "1" * 2000, "~1", "not 1", "{}",
    "1e999 * 'a'", "yield 1", "await x", "{Cell 1, N} @ {Cell 1, N}", "1_0j", "print(1)",
]  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_but_arithmetic_runs(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError):
        value(text)
    assert list(tmp_path.iterdir()) == []


def test_a_power_is_proposed_for_a_caret():
    with pytest.raises(InputError, match=r"a power is written with \*\*"):
        value("{Cell 1, N}^2")


def table(folder, names, *columns):
    path = folder / "raw.csv"
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.column_stack(columns))
    path.write_text(f"{names}\n{rows}\n")
    return path


T = np.linspace(0.0, 1.0, 30)
SIZE = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}


def test_all_that_a_file_leaves_open_is_asked_at_once_and_its_answers_convert_it(tmp_path):
    up = np.concatenate([T, T[::-1], T, T[::-1]])
    names = "Disp X (mm),Disp Y (mm),Load X,Load Y (mN)"
    path = table(tmp_path, names, 2 * up, 1.5 * up, 8 + 300 * up**2, 6 + 200 * up**2)
    with pytest.raises(OpenQuestions) as asked:
        biaxbayes.convert(path, machine="generic")
    questions = asked.value.questions
    targets = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")
    assert {q.target for q in questions} == {*targets, ""}
    assert [q.option for q in questions][-4:] == [*list(SIZE)[:1], *list(SIZE)[1:]]
    assert {"cycles", "branch"} <= {q.option for q in questions}
    assert all(q.proposals and q.text.isprintable() for q in questions)
    unit = next(q for q in questions if q.target == "force_x_N")
    assert unit.default is None  # nothing tells N from mN
    assert any(p.value == "force_x_N=Load X:mN" and "0.308 N" in p.label for p in unit.proposals)
    (recording,) = asked.value.provisional.recordings
    assert recording.rows.size in (30, 31)  # the last of two cycles
    moved = next(p for p in questions[0].proposals if p.blank == "LENGTH_MM")
    answers = (
        moved.value.replace("LENGTH_MM", "10"),
        "stretch_y=1 + {Disp Y (mm)} / 10,force_x_N=Load X:mN,force_y_N=Load Y (mN)",
    )
    result = biaxbayes.convert(
        path, machine="generic", columns=answers, cycles="last", branch="loading", **SIZE
    )
    (p,) = result.specimen.protocols
    np.testing.assert_allclose(p.stretch_x[-30:], 1 + 0.2 * T, rtol=1e-8)
    np.testing.assert_allclose(p.load_x[-30:], 8e-3 + 0.3 * T**2, rtol=1e-7)
    assert "stretch_x = 1 + {Disp X (mm)} / 10: 0 0.0689655172 0.137931034 -> 1 1.0069" in (
        result.account
    )


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("force_x_N=-{Fx (mN)}", "no number in '-{Fx (mN)}' converts it"),
        ("piola_x_kPa={Fx (N)} / 12", "over mm2 which gives no kPa"),
        ("stretch_x={Disp (mm)}", "a stretch starts near 1"),
        ("stretch_x=1 + {Disp (cm)} / 10", "no column 'Disp (cm)'"),
        ("stretch_x=log({Disp (mm)})", "= log({Disp (mm)}) is not a finite number"),
        ("stretch_x=1 + {Disp (mm)} / LENGTH_MM", "'LENGTH_MM' is neither"),
        ("stretch_x=1 + {Disp (mm)} / 10:mN", "stretch_x is not in mN"),
        ("protocol={Disp (mm)}", "protocol cannot be computed"),
        ("stretch_x=1 + {Disp (mm)} / 10,stretch_y=lambda,force_y_N=Fx (N)", "used for both"),
    ],
)
def test_what_is_said_wrong_is_asked_about_or_refused(columns, says, tmp_path):
    names = "Disp (mm),lambda,Fx (mN),Fx (N),Fy (N)"
    path = table(tmp_path, names, 2 * T, 1 + 0.2 * T, 9e2 * T + 8, 0.9 * T + 0.008, 0.8 * T + 0.01)
    sound = "stretch_x=lambda,stretch_y={lambda},force_x_N=Fx (N),force_y_N=Fy (N)"
    if "piola" in columns:
        sound = "stretch_x=lambda,stretch_y={lambda},piola_y_kPa=Fy (N):kPa"
    sound += ",ignore=Fx (mN)"
    with pytest.raises(InputError, match=re.escape(says)):
        biaxbayes.convert(path, machine="generic", columns=(sound, columns), **SIZE)


def test_a_file_is_shown_before_it_is_converted(tmp_path):
    path = table(tmp_path, "lambda_x,Fx [mN]", 1 + T, 9 * T)
    (sheet,) = preview(path).values()
    assert (sheet.names, sheet.units, sheet.rows) == (("lambda_x", "Fx [mN]"), ("", "mN"), 30)
    assert sheet.lines[0] == 2 and sheet.cells[0] == ("1", "0") and not sheet.problem
