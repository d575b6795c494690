"""The generator of the study of coverage, which shares no code with the package, and its tables."""

import numpy as np
import pytest

from biaxbayes import GOH, read_specimen
from studies.coverage import specimens

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
    of_goh = (*specimens.MISFITS, *specimens.NOISES, *specimens.MACHINES)
    assert ("C1" in case.truth) == (family in of_goh)
    of_one_path = ("alike", "gain", *specimens.MACHINES)
    assert (case.left_out is None) == (family.startswith("misfit") or family in of_one_path)
