"""Cycles in one record: each ratio becomes a protocol, and whether they repeat is reported."""

import re
from pathlib import Path

import numpy as np
import pytest

from biaxbayes import GOH
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.conversion import convert
from biaxbayes.machines.outcome import OpenQuestions
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.specimens.check import check_specimen

T = np.linspace(0.0, 1.0, 31)
UP_DOWN = np.concatenate([T, T[-2:0:-1]])
NAMES = "lx,ly,P_kPa,Q_kPa"
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
TARGETS = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")
COLUMNS = "stretch_x=lx,stretch_y=ly,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"


def load_of(stretch: np.ndarray) -> np.ndarray:
    e = stretch - 1.0
    return 2.0 + 100.0 * e @ np.array([[2.0, 0.5], [0.5, 1.0]]) * (1 + 20 * (e**2).sum(1))[:, None]


def read(folder: Path, stretch: np.ndarray, load: np.ndarray, **choice):
    path = folder / "record.csv"
    table = np.hstack([stretch, load])
    np.savetxt(path, table, delimiter=",", header=NAMES, comments="", fmt="%.12g")
    answers = {"cycles": "last", "branch": "loading", "columns": (COLUMNS,)} | choice
    return convert([path], Choice("generic", **answers), header={})


def record(ratios, softening=None, noise=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Cycles of the given peaks of strain, one after the other."""
    softening = [1.0] * len(ratios) if softening is None else softening
    strain = np.concatenate([np.outer(UP_DOWN, ratio) for ratio in ratios])
    factor = np.repeat(softening, len(UP_DOWN))[:, None]
    rng = np.random.default_rng(1)
    stretch = 1.0 + strain + noise * rng.standard_normal(strain.shape)
    return stretch, (load_of(1.0 + strain) - 2.0) * factor + 2.0


@pytest.mark.parametrize(
    ("peaks", "names"),
    [
        ([(0.2, 0.2), (0.2, 0.1), (0.1, 0.2)], ["1:1", "1:0.5", "0.5:1"]),
        ([(0.2, 0.15), (0.15, 0.2)], ["1:0.75", "0.75:1"]),
        ([(0.2, 0.0), (0.2, 0.2)], ["1:0", "1:1"]),
    ],
)
@pytest.mark.parametrize("interleaved", [False, True])
def test_each_ratio_of_a_record_is_a_protocol(peaks, names, interleaved, tmp_path):
    order = [*peaks, *peaks] if interleaved else [p for p in peaks for _ in range(2)]
    with pytest.raises(OpenQuestions, match="stretch ratios") as question:
        read(tmp_path, *record(order, noise=1e-4))
    assert all(name in question.value.choices["protocols_by=ratio"] for name in names)
    result = read(tmp_path, *record(order, noise=1e-4), protocols_by="ratio")
    assert [p.name for p in result.specimen.protocols] == names
    for p, peak in zip(result.specimen.protocols, peaks, strict=True):
        got = np.column_stack([p.stretch_x, p.stretch_y])[-1]
        np.testing.assert_allclose(got / got[0], (1 + np.array(peak)) / (1 + peak[0]), atol=2e-3)
    first = read(tmp_path, *record(order), cycles="1", protocols_by="ratio")
    assert [r.rows[-1] < 61 * len(order) for r in first.recordings]
    every = read(tmp_path, *record(order), cycles="all", protocols_by="none")
    assert len(every.specimen.protocols) == len(order)


def test_an_unloading_branch_goes_from_the_peak_to_the_valley_of_both_cycles(tmp_path):
    paths = record([(0.2, 0.2)] * 2)
    (taken,) = read(tmp_path, *paths, cycles="1", branch="unloading").recordings
    assert sorted(taken.rows) == list(range(30, 61))


def test_a_load_controlled_record_is_split_by_its_loads(tmp_path):
    """Creep turns the stretches from cycle to cycle; the loads keep their ratio."""
    paths = []
    for creep in (1.0, 1.3, 1.35):
        path = np.column_stack([0.15 * creep * UP_DOWN, 0.1 * UP_DOWN])
        paths.append((1.0 + path, 2.0 + np.outer(UP_DOWN, [50.0, 50.0])))
    for creep in (1.0, 1.1):
        path = np.column_stack([0.12 * UP_DOWN, 0.12 * creep * UP_DOWN])
        paths.append((1.0 + path, 2.0 + np.outer(UP_DOWN, [25.0, 50.0])))
    stretch, load = (np.concatenate(part) for part in zip(*paths, strict=True))
    with pytest.raises(OpenQuestions) as question:
        read(tmp_path, stretch, load)
    told = question.value.choices["protocols_by=load-ratio"]
    assert "1:1: cycles 1 2 3; 0.5:1: cycles 4 5" in told
    result = read(tmp_path, stretch, load, protocols_by="load-ratio")
    assert [p.name for p in result.specimen.protocols] == ["1:1", "0.5:1"]
    assert result.specimen.protocols[0].stretch_x[-1] == pytest.approx(1.0 + 0.15 * 1.35)


@pytest.mark.parametrize(
    ("softening", "settled"),
    [([1.5, 1.2, 1.1], False), ([1.5, 1.02, 1.01], True), ([1.4, 1.0], False)],
)
def test_whether_preconditioning_has_settled(softening, settled, tmp_path):
    result = read(tmp_path, *record([(0.2, 0.2)] * len(softening), softening))
    (recording,) = result.recordings
    message = " ".join((*recording.notes, *recording.assumptions))
    assert ("has not settled" in message) is not settled
    change = (softening[-1] - softening[-2]) / softening[-1]
    told = float(re.search(r"peak load changes by (\S+)% in x", message)[1]) / 100.0
    assert told == pytest.approx(change, abs=0.008)
    assert ("has not settled" in str(result.specimen.metadata.get("conversion"))) is not settled


@pytest.mark.parametrize(("axes", "wrong"), [("x", "x"), ("y", "y"), ("xy", "x")])
def test_tension_that_counts_negative(axes, wrong, tmp_path):
    stretch, load = record([(0.2, 0.15)])
    signs = [-1.0 if axis in axes else 1.0 for axis in "xy"]
    with pytest.raises(OpenQuestions) as asked:
        read(tmp_path, stretch, load * signs)
    answers = tuple(q.default.value for q in asked.value.questions)
    assert answers[0] == f"piola_{wrong}_kPa=-{{{'P' if wrong == 'x' else 'Q'}_kPa}}:kPa"
    assert len(answers) == len(axes)
    result = read(tmp_path, stretch, load * signs, columns=(COLUMNS, *answers))
    np.testing.assert_allclose(result.specimen.protocols[0].load_y, load[:31, 1], rtol=1e-9)
    assert f"piola_{wrong}_kPa = -{{" in str(result.specimen.metadata["conversion"])


GAUGE_MM = (10.2, 10.15)
NOISES = (0.002, 0.005, 0.01, 0.02)
SHAPES = {
    "60 rows a side": {"rows": 60},
    "25 rows a side": {"rows": 25},
    "200 rows a side": {"rows": 200},
    "a slow return": {"rows": 40, "back": 120},
    "a fast return": {"rows": 60, "back": 15},
    "rest between cycles": {"rows": 50, "rest": 12},
    "holds at the peak": {"rows": 50, "hold": 15},
    "rest and holds": {"rows": 80, "rest": 5, "hold": 8},
    "one ratio": {"rows": 60, "ratios": ((1.0, 1.0),)},
    "five ratios": {
        "rows": 40, "ratios": ((1, 1), (1, 0.75), (0.75, 1), (1, 0.5), (0.5, 1)),
    },
    "a fixed direction": {"rows": 60, "ratios": ((1, 0), (1, 1), (0, 1))},
    "no rest at all, 101 rows": {"rows": 101, "back": 101},
}  # fmt: skip


def cycled_export(
    noise: float, *, rows: int, back: int = 0, rest: int = 0, hold: int = 0, ratios=RATIOS
) -> tuple[np.ndarray, list[np.ndarray], list[tuple[float, float]]]:
    """Displacements and noisy forces of three cycles a ratio, and the rows of each last rise."""
    columns, last, start = [], [], 0
    for ratio in ratios:
        test = virtual_test(
            GOH(12.0, 60.0, 8.0, 40.0, 0.15), mounting_stretch=(1.02, 1.015),
            measured_stretch=1.18, ratio=ratio, increments=400, edge_x_mm=10.0, edge_y_mm=10.0,
            thickness_mm=1.2,
        )  # fmt: skip
        force = test.force_N
        stretch = test.measured
        for softening in (1.25, 1.05, 1.0):
            up, down = np.linspace(0, 1, rows), np.linspace(1, 0, back or rows)[1:-1]
            t = np.concatenate([np.zeros(rest), up, np.ones(hold), down])
            falls = np.arange(t.size) >= rest + rows
            at = np.linspace(0, 1, len(force))
            moved, load = (
                np.column_stack([np.interp(t, at, curve) for curve in curves.T])
                for curves in (stretch, force)
            )
            lost = np.where(falls, 0.9 - 0.15 * (1 - t), 1.0)[:, None]
            load = force[0] + (load - force[0]) * softening * lost
            columns.append(np.hstack([(moved - 1.0) * GAUGE_MM, load]))
            first = start + (rest or 0)
            start += t.size
        last.append(np.arange(first - rest, first + rows))
    table = np.concatenate(columns)
    rng = np.random.default_rng([rows, hold, round(1e4 * noise)])
    table[:, 2:] += noise * table[:, 2:].max() * rng.standard_normal((len(table), 2))
    return table, last, list(ratios)


@pytest.mark.parametrize("seed", range(4))
def test_a_record_with_missing_rows_starts_at_its_valley(seed, tmp_path):
    """Uneven sampling is no noise of the path: the end of the fall before is not at rest."""
    stretch, load = record([(0.2, 0.2)] * 3)
    kept = np.random.default_rng(seed).random(len(stretch)) < 0.6
    kept[120:124] = True
    (recording,) = read(tmp_path, stretch[kept], load[kept]).recordings
    assert np.abs(recording.stretch[0] - 1.0).max() < 1e-9 or recording.stretch.argmin() == 0


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("shape", SHAPES)
def test_a_cycled_export_is_cut_right(shape, noise, tmp_path):
    table, last, ratios = cycled_export(noise, **SHAPES[shape])
    path = tmp_path / "cycled.csv"
    names = "Disp X [mm],Disp Y [mm],Load X [N],Load Y [N]"
    np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.9f")
    said = [f"1 + {{{n}}} / {g}" for n, g in zip(names.split(",")[:2], GAUGE_MM, strict=True)]
    sources = [*said, *names.split(",")[2:]]
    columns = ",".join(f"{k}={v}" for k, v in zip(TARGETS, sources, strict=True))
    answers = {"cycles": "last", "branch": "loading"}
    answers |= {"protocols_by": "ratio"} if len(ratios) > 1 else {}
    choice = Choice("generic", (columns,), **answers)
    size = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
    result = convert([path], choice, header=size)
    named = [p.name for p in result.specimen.protocols]
    assert named == [f"{x:g}:{y:g}" for x, y in ratios] if len(ratios) > 1 else ["cycled"]
    for recording, p, rows in zip(result.recordings, result.specimen.protocols, last, strict=True):
        # the last row of the fall lies at the valley, or one step above it
        assert recording.rows[0] in (rows[0] - 1, rows[0]) or shape == "a slow return"
        assert recording.rows[-1] == rows[-1]
        assert p.stretch.min() > 1.0 - 1e-9 and np.abs(np.array(p.reference) - 1.0).max() < 1e-3
        assert not [f for f in check_specimen(result.specimen) if f.severity == "error"]
    common = convert([path], choice, header={**size, "reference": "common"}).specimen
    rest = [[p.rest_rows for p in s.protocols] for s in (common, result.specimen)]
    assert rest[0] == rest[1]
    left_out = sum(bool(reason) for reason in result.records[0].reasons)
    assert sum(r.rows.size for r in result.recordings) + left_out == len(table)
