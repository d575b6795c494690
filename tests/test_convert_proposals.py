"""Each proposal of a question converts the file, or asks what is open then; none of them fails."""

from pathlib import Path

import numpy as np
import pytest

import biaxbayes
from biaxbayes.machines.outcome import OpenQuestions

T = np.linspace(0.0, 1.0, 24)
UP_DOWN = np.concatenate([T, T[::-1]])
SIZE = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
OF_TUBE = {"thickness_mm": 0.1, "unloaded_outer_diameter_mm": 2.0, "unloaded_length_mm": 10.0}
ROUNDS = 8
"""Answers after which a file has to be converted."""


def load(stretch: np.ndarray, scale: float = 1.0) -> np.ndarray:
    strain = np.asarray(stretch) - 1.0
    strain = strain + 0.2 * strain[:, ::-1]
    return scale * (0.03 + 0.8 * strain + 20.0 * strain**2 * (1.0 + strain[:, :1] + strain[:, 1:]))


def path_of(*ratios: tuple[float, float], t: np.ndarray = UP_DOWN) -> np.ndarray:
    return 1.0 + np.concatenate([np.outer(t, ratio) for ratio in ratios])


def table(folder: Path, names: str, *columns: object) -> Path:
    path = folder / "raw.csv"
    cells = [[x if isinstance(x, str) else f"{x:.9g}" for x in column] for column in columns]
    rows = [",".join(row) for row in zip(*cells, strict=True)]
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


PLAIN = "lambda_x,lambda_y,Fx (N),Fy (N)"
MAPPED = "stretch_x=lambda_x,stretch_y=lambda_y,force_x_N=Fx (N),force_y_N=Fy (N)"
BOTH = path_of((0.2, 0.15), t=T)
LEVELS = np.concatenate(
    [np.column_stack([1 + 0.18 * UP_DOWN, np.full(48, y)]) for y in (1, 1.05, 1.1)]
)
CYCLES = path_of((0.2, 0.2), (0.2, 0.1), (0.2, 0.2))
LATE = path_of((0.2, 0.2), (0.2, 0.2)) + np.repeat([[0.0, 0.0], [0.04, 0.04]], 48, axis=0)


def stretches_and_forces(stretch: np.ndarray) -> tuple[str, str, list]:
    return PLAIN, MAPPED, [*stretch.T, *load(stretch).T]


def gaps() -> list:
    columns = [list(c) for c in (*BOTH.T, *load(BOTH).T)]
    columns[2][5], columns[3][9] = "OVLD", ""
    return columns


TUBE_NAMES = "Pressure (mmHg),Inner Diameter (um),Length (mm),Axial force (mN)"
TUBE = [10 + 100 * T**2, 1600 + 700 * T, np.full(24, 14.0), 30 + 5 * T]
OF_MM = "displacements,Disp X (mm),Disp Y (mm),Load X,Load Y".partition(",")[2]
CASES = {
    "levels": (*stretches_and_forces(LEVELS), {}),
    "cycles of two ratios": (*stretches_and_forces(CYCLES), {}),
    "a cycle that starts late": (*stretches_and_forces(LATE), {}),
    "protocols that start apart": (
        f"Protocol,{PLAIN}",
        f"protocol=Protocol,{MAPPED}",
        [["a"] * 24 + ["b"] * 24, *np.concatenate([BOTH, BOTH + [0.04, 0.0]]).T, *load(
            np.concatenate([BOTH, BOTH])).T],
        {},
    ),
    "a count that changes at the peaks": (
        f"Count,{PLAIN}",
        MAPPED,
        [np.repeat([1, 2, 3], [24, 48, 24]), *path_of((0.2, 0.2), (0.2, 0.2)).T,
         *load(path_of((0.2, 0.2), (0.2, 0.2))).T],
        {},
    ),
    "names without units": (OF_MM, "", [*(10 * (BOTH - 1)).T, *load(BOTH).T], {}),
    "one stretch": (
        "stretch,P11 (kPa),P22 (kPa)",
        "stretch_x=stretch,piola_x_kPa=P11 (kPa),piola_y_kPa=P22 (kPa)",
        [BOTH[:, 0], *load(BOTH, 30.0).T],
        {},
    ),
    "a strain of no known kind": (
        "time,eng exx,eng eyy,Fx (N),Fy (N)",
        "stretch_x=eng exx,force_x_N=Fx (N),force_y_N=Fy (N)",
        [T, *(BOTH - 1.0).T, *load(BOTH).T],
        {},
    ),
    "second Piola-Kirchhoff stresses": (
        "lambda_x,lambda_y,S11 (kPa),S22 (kPa)",
        "stretch_x=lambda_x,stretch_y=lambda_y,piola_x_kPa=S11 (kPa),piola_y_kPa=S22 (kPa)",
        [*BOTH.T, *load(BOTH, 30.0).T],
        {},
    ),
    "stresses of two kinds": (
        "lambda_x,lambda_y,T11 (kPa),T22 (kPa)",
        "stretch_x=lambda_x,stretch_y=lambda_y,piola_x_kPa=T11 (kPa),piola_y_kPa=T22 (kPa)",
        [*BOTH.T, *load(BOTH, 30.0).T],
        {"layer": "media"},
    ),
    "cells at both ends": (
        "lambda_x,lambda_y,Load X1 (N),Load X2 (N),Load Y1 (N),Load Y2 (N)",
        "stretch_x=lambda_x,stretch_y=lambda_y,force_x_N=Load X1 (N),force_y_N=Load Y1 (N)",
        [*BOTH.T, *np.repeat(load(BOTH), 2, axis=1).T],
        {},
    ),
    "distances in micrometres": (
        "Distance X (um),Distance Y (um),Fx (mN),Fy (mN)",
        "stretch_x=Distance X (um),stretch_y=Distance Y (um),force_x_N=Fx (mN),"
        "force_y_N=-{Fy (mN)}",
        [*(9e3 * BOTH).T, *load(BOTH, 40.0).T],
        {},
    ),
    "forces counted negative": (PLAIN, MAPPED, [*BOTH.T, *-load(BOTH).T], {}),
    "readings that are missing": (PLAIN, MAPPED, gaps(), {}),
    "stretches of their own time": (
        "Time load (s),Fx (N),Fy (N),Time video (s),lambda_x,lambda_y",
        "stretch_x=lambda_x,stretch_y=lambda_y,force_x_N=Fx (N),force_y_N=Fy (N)",
        [T, *load(BOTH).T, [*(3 * T[:8]), *[""] * 16],
         *([*(1 + 3 * T[:8] * k), *[""] * 16] for k in (0.2, 0.15))],
        {},
    ),
    "a tube of inner diameters": (
        TUBE_NAMES,
        "pressure_kPa=Pressure (mmHg),outer_diameter_mm=Inner Diameter (um),length_mm=Length (mm),"
        "axial_force_N=Axial force (mN)",
        TUBE,
        {"test": "tube", **OF_TUBE},
    ),
    "a pressure and no test": (
        "lambda_x,lambda_y,Pressure (kPa),Radius (mm)",
        "stretch_x=lambda_x,stretch_y=lambda_y",
        [*BOTH.T, 1 + 9 * T, 20 - 9 * T],
        {"layer": "media"},
    ),
}  # fmt: skip


def run(path: Path, options: dict):
    """The conversion, or its questions."""
    try:
        return biaxbayes.convert(path, machine="generic", **options)
    except OpenQuestions as questions:
        return questions


def with_answer(options: dict, proposal) -> dict:
    """The options of a command with one more."""
    if proposal.option == "columns":
        return options | {"columns": [*options["columns"], proposal.value]}
    return options | {proposal.option: proposal.value == "True" or proposal.value}


def whole(question):
    """The answer that is followed where another question is looked at."""
    return question.assumed or next((p for p in question.proposals if not p.blank), None)


@pytest.mark.parametrize("case", CASES)
def test_no_proposal_fails_when_it_is_followed(case, tmp_path):
    names, columns, readings, more = CASES[case]
    path = table(tmp_path, names, *readings)
    options = {"columns": [columns] if columns else [], **(more or {}), **({} if more else SIZE)}
    asked = run(path, options)
    assert isinstance(asked, OpenQuestions)
    for number, question in enumerate(asked.questions):
        others = [
            whole(q) for q in asked.questions[:number]
        ]  # what is asked later may depend on it
        for proposal in (p for p in question.proposals if not p.blank):
            answered = with_answer(options, proposal)
            for other in filter(None, others):
                answered = with_answer(answered, other)
            for _ in range(ROUNDS):
                result = run(path, answered)
                if not isinstance(result, OpenQuestions):
                    assert result.specimen.protocols
                    break
                # what has no whole answer is for the user, such as a length
                answers = [whole(q) for q in result.questions]
                if None in answers:
                    break
                for answer in answers:
                    answered = with_answer(answered, answer)
            else:
                pytest.fail(f"{proposal} leads to no end")


def test_a_proposal_does_not_lead_to_its_own_question(tmp_path):
    names, columns, readings, _ = CASES["a strain of no known kind"]
    path, options = table(tmp_path, names, *readings), {"columns": [columns], **SIZE}
    asked = run(path, options)
    assert len(asked.questions) == 2  # of a column that is named, and of one that is likely
    for question in asked.questions:
        for proposal in (p for p in question.proposals if not p.blank):
            then = run(path, with_answer(options, proposal))
            assert question.text not in {q.text for q in getattr(then, "questions", ())}, proposal


@pytest.mark.parametrize("cycles", ["last", "all", "2"])
@pytest.mark.parametrize("branch", ["loading", "unloading"])
def test_the_rows_that_the_account_shows_repeat_the_cut(cycles, branch, tmp_path):
    stretch = path_of((0.2, 0.2), (0.2, 0.2), (0.2, 0.2))
    path = table(tmp_path, PLAIN, *stretch.T, *load(stretch).T)
    options = {"columns": MAPPED, "branch": branch, "machine": "generic", **SIZE}
    result = biaxbayes.convert(path, cycles=cycles, **options)
    lines = [line.split() for line in result.account.split("\n") if "--rows" in line]
    assert len(lines) == len(result.recordings)
    for words, recording, p in zip(
        lines, result.recordings, result.specimen.protocols, strict=True
    ):
        rows = words[words.index("--rows") + 1].rstrip(";")
        again = biaxbayes.convert(path, rows=rows, **options)
        np.testing.assert_array_equal(again.recordings[0].lines, recording.lines)
        np.testing.assert_array_equal(again.specimen.protocols[0].stretch, p.stretch)
