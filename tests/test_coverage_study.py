"""The generator of the study of coverage, which shares no code with the package, and its tables."""

import math

import numpy as np
import pytest

from biaxbayes import GOH, read_specimen
from studies.coverage import specimens
from studies.coverage.study import judge_bands
from studies.coverage.tables import row_table, what_holds

STATES = np.array([[1.02, 1.05], [1.1, 1.1], [1.2, 1.01]])


def test_its_stresses_are_those_of_goh():
    parameters = (5.0, 20.0, 3.0, 40.0, 0.1)
    own = specimens.cauchy(specimens.goh(*parameters), STATES)
    assert own == pytest.approx(np.column_stack(GOH(*parameters).cauchy(*STATES.T)), rel=1e-12)


@pytest.mark.parametrize("kind", specimens.TISSUES)
def test_energies_of_other_tissue_are_analytic_and_free_of_stress_at_rest(kind):
    energy = specimens.MAKERS[kind](np.random.default_rng(3), np.array([1.2, 1.25]))
    step = 1e-6
    for k in range(2):
        x, y = (STATES + step * (np.arange(2) == k)).T
        u, v = (STATES - step * (np.arange(2) == k)).T
        slope = (energy(x, y, 1 / (x * y)) - energy(u, v, 1 / (u * v))).real / (2 * step)
        own = specimens.cauchy(energy, STATES)[:, k]
        assert own == pytest.approx(STATES[:, k] * slope, rel=1e-6)
    scale = np.abs(specimens.cauchy(energy, STATES)).max()
    at_rest = specimens.cauchy(energy, np.ones((1, 2)))
    assert np.abs(at_rest).max() < 1e-8 * scale


@pytest.mark.parametrize("family", specimens.FAMILIES)
def test_a_specimen_is_a_file_of_what_was_planned(family, tmp_path):
    case = specimens.make_case(family, 3, 7)
    assert case.text == specimens.make_case(family, 3, 7).text
    assert case.text != specimens.make_case(family, 3, 8).text
    file = tmp_path / "specimen.csv"
    file.write_text(case.text)
    found = read_specimen(file)
    assert [p.rows for p in found.protocols] == [specimens.ROWS] * 3
    mounting = [case.truth[f"mounting_stretch_{axis}"] for axis in "xy"]
    low, high = (1.14, 1.66) if family in specimens.FAR else (1.01, 1.12)
    assert low <= min(mounting) <= max(mounting) <= high
    assert ("C1" in case.truth) == (family in (*specimens.MISFITS, *specimens.NOISES))
    assert (case.left_out is None) == (family.startswith("misfit") or family in ("alike", "gain"))


def test_a_gaussian_process_has_unit_variance_and_its_length():
    rng = np.random.default_rng(1)
    at = np.linspace(0.0, 1.0, 11)[:, None]
    drawn = np.array([specimens.gaussian_process(at, 0.25, rng) for _ in range(4000)])
    expected = np.exp(-0.5 * ((at - at.T) / 0.25) ** 2)
    assert np.cov(drawn.T) == pytest.approx(expected, abs=0.08)


def test_shares_inside_bands():
    left_out = np.array([[1.0, 1.0, 1.0, 2.0, 1.1, 2.0], [1.1, 1.1, 3.0, 4.0, 3.0, 4.5]])
    bands = {}
    for axis, low, high in (("x", [0.9, 2.0], [1.2, 2.5]), ("y", [1.5, 3.5], [2.5, 4.2])):
        for band in ("credible", "predictive"):
            bands[f"piola_{axis}_kPa_{band}_low"] = low
            bands[f"piola_{axis}_kPa_{band}_high"] = high
    found = judge_bands(left_out, bands)
    assert found["credible"] == 0.75 and found["predictive"] == 0.5
    assert found["credible_width"] == pytest.approx((0.3 / 3 + 0.5 / 3 + 1 / 4 + 0.7 / 4) / 4)


def test_what_a_verdict_leaves_of_an_interval_is_judged():
    def row(parameter, true, verdict, bound=""):
        ends = {"q05": 1.0, "q50": 2.0, "q95": 3.0, "low": 1.0, "high": 3.0}
        return {"parameter": parameter, "true": true, "verdict": verdict, "bound": bound} | ends

    record = {
        "case": ["new", "fung", 1, 500],
        "state": "converged",
        "seconds": {"processor, sampled": 2.0},
        "rows": [
            row("C1", 4.0, "bounded", "low"),
            row("k1", 4.0, "bounded", "high"),
            row("alpha", 4.0, "not identified"),
            row("mounting_stretch_x", 1.5, "identified"),
        ],
    }
    other = {**record, "case": ["new", "fung", 1, 501], "state": "tentative"}
    rows = row_table([record, other])
    assert len(rows) == 4
    assert rows["inside"].tolist() == [False, False, False, True]
    assert rows["holds"].tolist() == [True, False, True, True]
    assert rows["stated"].tolist() == [True, True, False, True]
    assert rows["width"].tolist() == pytest.approx([math.log(3.0), math.log(3.0), 2.0, 2.0])
    table = what_holds(rows, "old", ["product", "family"])
    assert table.loc[0, "5 to 95 % holds"] == "1/4 0.25"
    assert (
        table.loc[0, "stated holds"] == "2/3 0.67" and table.loc[0, "truth below, above"] == "0, 3"
    )
