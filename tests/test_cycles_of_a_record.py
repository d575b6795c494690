"""Cycles in one record: each ratio becomes a protocol, and whether they repeat is reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.conversion import convert
from virtual_biotester import biotester_export

T = np.linspace(0.0, 1.0, 31)
UP_DOWN = np.concatenate([T, T[-2:0:-1]])
NAMES = "lx,ly,P_kPa,Q_kPa"
COLUMNS = "stretch_x=lx,stretch_y=ly,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"


def load_of(stretch: np.ndarray) -> np.ndarray:
    e = stretch - 1.0
    return 2.0 + 100.0 * e @ np.array([[2.0, 0.5], [0.5, 1.0]]) * (1 + 20 * (e**2).sum(1))[:, None]


def read(folder: Path, stretch: np.ndarray, load: np.ndarray, **choice):
    path = folder / "record.csv"
    table = np.hstack([stretch, load])
    np.savetxt(path, table, delimiter=",", header=NAMES, comments="", fmt="%.12g")
    return convert([path], Choice("generic", (COLUMNS,), **choice), header={})


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
    result = read(tmp_path, *record(order, noise=1e-4))
    assert [p.name for p in result.specimen.protocols] == names
    for p, peak in zip(result.specimen.protocols, peaks, strict=True):
        got = np.column_stack([p.stretch_x, p.stretch_y])[-1]
        np.testing.assert_allclose(got / got[0], (1 + np.array(peak)) / (1 + peak[0]), atol=2e-3)
    assert "the record holds the ratios " + ", ".join(names) in " ".join(result.recordings[0].notes)
    # A cycle that is chosen by its number is taken alone.
    (only,) = read(tmp_path, *record(order), cycle="1").specimen.protocols
    assert only.stretch_x.max() == pytest.approx(1.0 + peaks[0][0])


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
    result = read(tmp_path, stretch, load)
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
    assert f"peak load changes by {change:+.1%} in x" in message
    assert ("has not settled" in str(result.specimen.metadata.get("conversion"))) is not settled


def test_preconditioning_of_a_biotester(tmp_path):
    path = tmp_path / "raw.csv"
    size = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
    path.write_text(biotester_export(cycles=3).text())
    result = convert([path], Choice("biotester"), header=size)
    # The export softens by a tenth from cycle to cycle of three.
    assert "has not settled" in " ".join(result.recordings[0].assumptions)
    path.write_text(biotester_export(cycles=30).text())
    result = convert([path], Choice("biotester"), header=size)
    assert "peak load changes by" in " ".join(result.recordings[0].notes)


@pytest.mark.parametrize(("axes", "wrong"), [("x", "x"), ("y", "y"), ("xy", "x")])
def test_tension_that_counts_negative(axes, wrong, tmp_path):
    stretch, load = record([(0.2, 0.15)])
    signs = [-1.0 if axis in axes else 1.0 for axis in "xy"]
    with pytest.raises(InputError, match=f"`tension_negative={wrong}`"):
        read(tmp_path, stretch, load * signs)
    result = read(tmp_path, stretch, load * signs, tension_negative=axes)
    np.testing.assert_allclose(result.specimen.protocols[0].load_y, load[:31, 1], rtol=1e-9)
    assert "is reversed" in str(result.specimen.metadata["conversion"])


def test_a_strip_is_no_specimen(tmp_path):
    stretch, load = record([(0.2, 0.0)])
    load[:, 1] = 0.0
    with pytest.raises(InputError, match="niaxial strips"):
        read(tmp_path, stretch, load)
