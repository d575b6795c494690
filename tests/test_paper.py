"""The page of the method paper: what ``scripts/reproduce_paper.py`` finds, pinned."""

import numpy as np
import pytest

from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from studies.paper import printed, tables
from studies.paper.experiments import mae, theta

# Cells of Tables 3 and 4 that print and computation do not share.
MISPRINTS = {
    ("weisbecker-media", "zeroed", "1.010"): ["C1"],
    ("smoljkic-m55", "standard", "1.015"): ["R2"],
}


@pytest.fixture(scope="module")
def comparisons():
    result = [c for material in printed.VIRTUAL for c in tables.compare(material)]
    return {(c.material, c.printed.method, c.prestretch): c for c in result}


def test_tables_3_and_4_agree_but_for_two_cells(comparisons):
    assert len(comparisons) == 16
    differing = {key: c.differs() for key, c in comparisons.items() if c.differs()}
    assert differing == MISPRINTS


def test_parameters_within_one_unit_of_the_last_digit(comparisons):
    for key, c in comparisons.items():
        for index, name in enumerate(printed.PARAMETERS):
            if name not in MISPRINTS.get(key, []):
                assert abs(c.parameter_gap(index)) <= 1.0, (key, name)


def test_r2_and_mae_of_the_printed_parameters(comparisons):
    for key, c in comparisons.items():
        if "R2" not in MISPRINTS.get(key, []):
            assert abs(c.r2_printed - float(c.printed.r2)) <= 0.001, key
        assert abs(c.mae_printed - float(c.printed.mae)) <= 0.1, key


def test_the_two_disagreements_are_what_the_page_says(comparisons):
    media = comparisons["weisbecker-media", "zeroed", "1.010"]
    assert media.own.material.C1_kPa == pytest.approx(14.06, abs=0.005)
    assert media.mae_printed == pytest.approx(57.2, abs=0.1)
    assert media.mae_own == pytest.approx(48.9, abs=0.1)
    m55 = comparisons["smoljkic-m55", "standard", "1.015"]
    assert m55.r2_printed == pytest.approx(0.932, abs=5e-4)
    assert tables.next_row_r2("smoljkic-m55", "standard", "1.015") == pytest.approx(0.879, abs=5e-4)


def test_mae_of_a_hand_computed_row():
    # Weisbecker, zeroed, 1.005: |0|, 7.9/140, 0.59/11.9, 0.07/38.4, 0.001/0.21
    values = [float(v) for v in printed.VIRTUAL["weisbecker-media"]["zeroed", "1.005"].theta]
    truth = [float(v) for v in printed.TRUTH["weisbecker-media"]]
    by_hand = 200.0 * (0.0 + 7.9 / 140 + 0.59 / 11.9 + 0.07 / 38.4 + 0.001 / 0.21)
    assert mae(values, truth) == pytest.approx(by_hand, rel=1e-12)


def test_printed_truth_is_the_shipped_material():
    for name, texts in printed.TRUTH.items():
        np.testing.assert_allclose(theta(MATERIALS[name].material), [float(v) for v in texts])
    for name, rows in printed.TABLE6.items():
        np.testing.assert_allclose(theta(MATERIALS[name].material), rows["fip"].values)
        assert rows["fip"].mounting_stretch == MATERIALS[name].mounting_stretch
    for name, rows in printed.TABLE5.items():
        for method, row in rows.items():
            shipped = MATERIALS[f"sheep{name}-{method}"]
            np.testing.assert_allclose(theta(shipped.material), row.values)
            assert row.mounting_stretch == shipped.mounting_stretch


# Forces of the printed fip rows of Table 6 at their printed mounting stretches, mN.
FORCES = {
    "donor1": (62, 109),
    "donor2": (93, 123),
    "donor2-intima": (1.7, 1.9),
    "donor2-media": (15.8, 12.6),
    "donor2-adventitia": (3.5, 4.5),
}


@pytest.mark.parametrize("name", FORCES)
def test_forward_mounting_forces(name):
    # Worked from the equation of the force, not through a specimen
    C1, k1, k2, alpha, kappa = printed.TABLE6[name]["fip"].values
    lx, ly = printed.TABLE6[name]["fip"].mounting_stretch
    c2 = np.cos(np.deg2rad(alpha)) ** 2
    H = np.array([kappa + (1 - 3 * kappa) * c2, kappa + (1 - 3 * kappa) * (1 - c2)])
    az = 1.0 / (lx * ly) ** 2
    E = H @ [lx**2, ly**2] + kappa * az - 1.0
    e = 4.0 * k1 * E * np.exp(k2 * E**2)
    stretch = np.array([lx, ly])
    cauchy = (2 * C1 + H * e) * stretch**2 - (2 * C1 + kappa * e) * az
    force = cauchy / stretch * 20.0 * MATERIALS[name].thickness_mm  # kPa mm^2 = mN
    np.testing.assert_allclose(tables.mounting_force_mN(name), force, rtol=1e-10)
    np.testing.assert_allclose(force, FORCES[name], rtol=0.03)
    outside = force.min() < 12 or force.max() > 24
    assert outside == (name != "donor2-media")


@pytest.mark.parametrize("name", FORCES)
def test_printed_rows_and_virtual_rows_imply_one_mounting_force(name):
    printed_rows = tables.implied_force_mN(name)
    virtual_rows = tables.implied_force_mN(name, virtual=True)
    np.testing.assert_allclose(printed_rows, virtual_rows, rtol=0.15)


def test_table_6_r2_but_for_the_intima():
    differing = [
        (name, method)
        for name in printed.TABLE6
        for method in ("standard", "zeroed")
        if tables.bias(name, method).differs
    ]
    assert differing == [("donor2-intima", "standard")]
    assert tables.bias("donor2-intima", "standard").r2_printed == pytest.approx(0.806, abs=1e-3)


@pytest.mark.parametrize("specimen", printed.TABLE5)
def test_rows_of_table_5_describe_one_record(specimen):
    for top in (1.2, 1.3, 1.4):
        mounting_kPa, r2 = tables.agreement(specimen, top)
        assert r2 > 0.997
        np.testing.assert_allclose(mounting_kPa["linden"], mounting_kPa["fip"], rtol=0.035)
    if specimen == "3":  # and yet differ by more than twofold in C1
        rows = printed.TABLE5["3"]
        assert GOH(*rows["fip"].values).C1_kPa > 2.3 * GOH(*rows["linden"].values).C1_kPa
