"""The benchmark's files agree with their truths, its scorer counts, its table is quoted."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import run
import score
from biaxbayes import GOH, read_specimen

FOLDER = Path(__file__).parents[1] / "benchmark"
TRUTHS = json.loads((FOLDER / "truth.json").read_text(encoding="utf-8"))
STRETCHES = ("mounting_stretch_x", "mounting_stretch_y")


def submission(folder, half_width, shift=0.0):
    """An answer whose intervals are the truth times 1 + shift, +- half_width (relative)."""
    low, high = 1.0 + shift - half_width, 1.0 + shift + half_width
    quantiles, loads = [], []
    for name, truth in TRUTHS.items():
        for parameter, value in truth["parameters"].items():
            ends = (value * low, value * (1.0 + shift), value * high)
            quantiles.append((name, parameter, *ends))
        for row, pair in enumerate(truth["held_out"]["piola_kPa"]):
            loads.append((name, row, *(v * f for f in (low, 1.0 + shift, high) for v in pair)))
    folder.mkdir()
    columns = ["specimen", "parameter", "q05", "q50", "q95"]
    pd.DataFrame(quantiles, columns=columns).to_csv(folder / "quantiles.csv", index=False)
    columns = ["specimen", "row", "x_q05", "y_q05", "x_q50", "y_q50", "x_q95", "y_q95"]
    pd.DataFrame(loads, columns=columns).to_csv(folder / "held-out.csv", index=False)
    seconds = pd.DataFrame({"specimen": list(TRUTHS), "seconds": 2.0})
    seconds.to_csv(folder / "seconds.csv", index=False)
    return folder


def test_intervals_around_the_truth_hold_and_others_do_not(tmp_path):
    good = score.scores(TRUTHS, submission(tmp_path / "good", 0.1))
    off = score.scores(TRUTHS, submission(tmp_path / "off", 0.1, shift=0.2))
    parameters = sum(set(t["parameters"]) >= {"C1"} for t in TRUTHS.values()) * 5
    assert good["parameters held"] == f"{parameters} of {parameters}"
    assert off["parameters held"] == f"0 of {parameters}"
    assert good["mounting held"] == "38 of 38"  # two of each but the tube
    assert good["left out inside, %"] == 100.0
    assert off["left out inside, %"] == 0.0
    assert good["left out error, %"] == pytest.approx(0.0)
    # a fifth of loads between nothing and their peak
    assert 5.0 < off["left out error, %"] < 20.0
    assert good["specimens"] == 20
    assert good["seconds"] == 2.0


def test_widths_are_decades_and_shares_of_ranges(tmp_path):
    found = score.interval_rows(TRUTHS, score.read_submission(submission(tmp_path / "a", 0.1))[0])
    widths = found.set_index(["specimen", "parameter"])["width"]
    assert widths["20-tube", "k1"] == pytest.approx(np.log10(1.1 / 0.9))
    assert widths["20-tube", "alpha"] == pytest.approx(0.2 * 42.0 / 90.0)
    assert widths["20-tube", "kappa"] == pytest.approx(0.2 * 0.12 * 3.0)


def test_point_estimates_have_errors_and_no_coverage(tmp_path):
    folder = submission(tmp_path / "points", 0.1, shift=0.05)
    for file in ("quantiles.csv", "held-out.csv"):
        table = pd.read_csv(folder / file)
        table.loc[:, [c for c in table if c.endswith(("q05", "q95"))]] = np.nan
        table.to_csv(folder / file, index=False)
    found = score.scores(TRUTHS, folder)
    assert found["parameters held"] == "0 of 0"
    assert np.isnan(found["left out inside, %"])
    assert found["mounting error"] == pytest.approx(0.05, rel=0.2)


def test_a_path_left_unfinished_counts_as_missed(tmp_path):
    folder = submission(tmp_path / "short", 0.1)
    table = pd.read_csv(folder / "held-out.csv")
    table[table["row"] < 5].to_csv(folder / "held-out.csv", index=False)
    assert score.scores(TRUTHS, folder)["left out inside, %"] < 30.0


@pytest.mark.parametrize("name", [n for n in TRUTHS if "noise" in n])
def test_loads_of_the_true_law_differ_from_readings_by_noise(name):
    specimen, truth = read_specimen(FOLDER / "specimens" / f"{name}.csv"), TRUTHS[name]
    p = truth["parameters"]
    material = GOH(p["C1"], p["k1"], p["k2"], p["alpha"], p["kappa"])
    lm = np.array([p[n] for n in STRETCHES])
    area = np.array([specimen.edge_y_mm, specimen.edge_x_mm]) * specimen.thickness_mm * 1e-3
    residuals = [
        np.column_stack([q.load_x, q.load_y])
        - area * np.transpose(material.piola(*(q.stretch * lm).T))
        for q in specimen.protocols
    ]
    assert np.std(residuals) == pytest.approx(specimen.load_noise, rel=0.15)
    path = np.array(truth["held_out"]["stretch"]) * lm
    load = np.transpose(material.piola(*path.T))
    assert np.array(truth["held_out"]["piola_kPa"]) == pytest.approx(load, rel=1e-4, abs=1e-5)


def test_the_readme_quotes_the_table_of_the_submissions():
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    for folder in sorted((FOLDER / "submissions").iterdir()):
        row = score.scores(TRUTHS, folder)
        for value in row.values():
            assert score.cell(value) in text, (folder.name, row)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["pymech"], "no tool pymech; there are biaxbayes, "),
        (["pymecht", "--only", "21-tube", "--out", "one"], "no specimen 21-tube"),
        (["pymecht", "--only", "20-tube"], "--only needs a folder --out of its own"),
    ],
)
def test_a_wrong_name_is_said_before_anything_runs(words, said, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["run.py", *words])
    with pytest.raises(SystemExit) as stopped:
        run.main()
    assert stopped.value.code == 2
    assert said in capsys.readouterr().err
