"""The GOH membrane, its mounted state and the sampling charts."""

import numpy as np
import pytest
from scipy.optimize import root

from biaxbayes.errors import InputError
from biaxbayes.laws import law_named
from biaxbayes.laws.chart import angles_from_chart, chart_from_angles
from biaxbayes.laws.dispersed_fibres import dispersion_as_goh, structure_tensor
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from biaxbayes.mechanics.mounting import (
    BRACKET,
    log_change_of_variables,
    mounting_stretches,
    solve_balance,
)
from goh_functions import cauchy_stress, strain_energy

STEP = 1e-30  # of a complex-step derivative: no cancellation, so no truncation error either
CORNERS = [(kappa, alpha) for kappa in (0.0, 0.15, 1 / 3) for alpha in (0.0, np.pi / 5, np.pi / 2)]


def energy_of_equation_5(C1, k1, k2, alpha, kappa, lx, ly, lz):
    """Eq. 5 as printed: invariants of C and of two mean fibre directions."""
    C = np.diag([lx * lx, ly * ly, lz * lz])
    I1 = np.trace(C)
    W = C1 * (I1 - 3.0)
    for angle in (alpha, -alpha):
        M = np.array([np.cos(angle), np.sin(angle), 0.0])
        Ii = M @ C @ M
        W = W + k1 / (2 * k2) * (np.exp(k2 * (kappa * I1 + (1 - 3 * kappa) * Ii - 1) ** 2) - 1)
    return W


def random_theta(rng, kappa=None, alpha=None):
    return (
        10 ** rng.uniform(-1, 2.5),
        10 ** rng.uniform(-2, 3),
        10 ** rng.uniform(-3, 1.5),
        rng.uniform(0, np.pi / 2) if alpha is None else alpha,
        rng.uniform(0, 1 / 3) if kappa is None else kappa,
    )


@pytest.mark.parametrize(("kappa", "alpha"), [(None, None), *CORNERS])
def test_energy_is_equation_5(kappa, alpha):
    """Its derivatives are the stress: see the tests of all laws."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        theta = random_theta(rng, kappa, alpha)
        for lx, ly in rng.uniform(0.9, 1.35, (25, 2)):
            expected = energy_of_equation_5(*theta, lx, ly, 1 / (lx * ly))
            result = strain_energy(*theta, lx, ly)
            assert result == pytest.approx(expected, rel=1e-10, abs=1e-12 * sum(theta[:2]))


def test_fibre_switch_drops_compressed_fibres_and_nothing_else():
    theta = (12.0, 300.0, 7.0, np.pi / 2, 0.0)  # fibres along y
    matrix = cauchy_stress(12.0, 0.0, 7.0, np.pi / 2, 0.0, 1.1, 0.95)
    np.testing.assert_allclose(cauchy_stress(*theta, 1.1, 0.95, fibre_switch=True), matrix)
    assert abs(cauchy_stress(*theta, 1.1, 0.95)[1] - matrix[1]) > 1.0
    np.testing.assert_allclose(
        cauchy_stress(*theta, 0.95, 1.1, fibre_switch=True), cauchy_stress(*theta, 0.95, 1.1)
    )


def test_structure_tensor_has_unit_trace_and_turns_with_the_axes():
    rng = np.random.default_rng(2)
    alpha, kappa = rng.uniform(0, np.pi / 2, 50), rng.uniform(0, 1 / 3, 50)
    Hx, Hy, Hz = structure_tensor(np.cos(alpha) ** 2, kappa)
    np.testing.assert_allclose(Hx + Hy + Hz, 1.0, rtol=1e-15)
    np.testing.assert_allclose(
        structure_tensor(np.sin(alpha) ** 2, kappa), (Hy, Hx, Hz), rtol=0, atol=1e-15
    )


def test_dispersion_in_and_out_of_plane_is_goh_at_another_angle():
    """The structure tensor of Holzapfel et al. 2015, Eq. 2.17, from its two directions."""
    rng, output = np.random.default_rng(8), 0
    for _ in range(400):
        kappa_ip, kappa_op, alpha = rng.uniform(0, 1), rng.uniform(0, 0.5), rng.uniform(0, 90)
        A, B = 2 * kappa_op * kappa_ip, 2 * kappa_op * (1 - 2 * kappa_ip)
        angle = np.radians(alpha)
        M, normal = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
        H = A * np.eye(3) + B * np.outer(M, M) + (1 - 3 * A - B) * np.outer(normal, normal)
        expected = np.diag(H)
        if expected[2] > min(expected[:2]):
            with pytest.raises(InputError, match="GOH has no such dispersion"):
                dispersion_as_goh(kappa_ip, kappa_op, alpha)
            continue
        output += 1
        angle_deg, kappa = dispersion_as_goh(kappa_ip, kappa_op, alpha)
        np.testing.assert_allclose(
            structure_tensor(np.cos(np.radians(angle_deg)) ** 2, kappa), expected, atol=1e-12
        )
    assert 50 < output < 350
    assert dispersion_as_goh(0.0, 0.5, 41.0) == pytest.approx((41.0, 0.0))
    assert dispersion_as_goh(0.5, 1 / 3, 41.0)[1] == pytest.approx(1 / 3)
    with pytest.raises(InputError, match="are out of range"):
        dispersion_as_goh(1.2, 0.5, 41.0)


def material_of(rng):
    C1, k1, k2, alpha, kappa = random_theta(rng)
    return GOH(C1, k1, k2, float(np.rad2deg(alpha)), kappa)


def carried(material, lm, geometry):
    """What a specimen carries at a stretch: force over its section as the dimensions say."""
    return np.array(material.piola(*lm) if geometry == "unloaded" else material.cauchy(*lm))


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_mounted_state_balances_its_reading_and_the_change_of_variables_follows(geometry):
    rng = np.random.default_rng(8)
    met = 0
    for _ in range(60):
        material = material_of(rng)
        lm = rng.uniform(1.0, 1.12, 2)
        p0 = carried(material, lm, geometry)
        found = mounting_stretches(material, *p0, geometry=geometry)
        if np.isnan(found).any():
            continue  # an unstable state: see the test of stability
        met += 1
        np.testing.assert_allclose(carried(material, found, geometry), p0, rtol=1e-9)
        np.testing.assert_allclose(found, lm, rtol=1e-9)
        peer = root(lambda x, m=material, p=p0: carried(m, x, geometry) - p, lm * 0.999, tol=1e-13)
        np.testing.assert_allclose(found, peer.x, rtol=1e-7)
        # complex step of the balance in lm gives det dp0/dlm without the module's Jacobian
        steps = (carried(material, lm + 1j * STEP * e, geometry).imag / STEP for e in np.eye(2))
        slope = np.column_stack(list(steps))
        mounted = geometry == "mounted"
        _, *root_and_jacobian = solve_balance(material.constants, *p0, mounted)
        change = log_change_of_variables(*root_and_jacobian, mounted)
        assert change == pytest.approx(np.log(np.linalg.det(slope)), abs=1e-7)
    assert met > 45


def test_only_stable_roots_inside_the_bracket_count():
    soft = GOH(1.0, 0.0, 0.0, 45.0, 0.1)
    # no neo-Hookean balances that, or beyond the bracket
    for geometry in ("unloaded", "mounted"):
        assert np.isnan(mounting_stretches(soft, 100.0, 100.0, geometry=geometry)).all()
    np.testing.assert_allclose(mounting_stretches(soft, 0.0, 0.0), 1.0, atol=1e-12)
    rng = np.random.default_rng(4)
    for _ in range(200):
        material = material_of(rng)
        p0 = rng.uniform(-0.5, 2.0, 2) * material.C1_kPa
        found = mounting_stretches(material, *p0)
        if np.isfinite(found).all():
            assert np.all((found > BRACKET[0]) & (found < BRACKET[1]))
            carries = material.piola(*found)
            np.testing.assert_allclose(carries, p0, atol=1e-9 * material.C1_kPa)
            # the energy less the work of the dead load has a minimum there
            energy = [
                material.strain_energy(*(found * (1 + d))) - p0 @ (found * (1 + d))
                for d in (np.array([0, 0]), *(1e-4 * rng.standard_normal((6, 2))))
            ]
            assert min(energy[1:]) > energy[0]
        else:
            assert np.isnan(found).all()


ISOTROPY_SCALES = (0.02, 0.3, 1.0)


def chart_and_back(isotropy_scale):
    return (
        lambda d, v: angles_from_chart(d, v, isotropy_scale),
        lambda a, k: chart_from_angles(a, k, isotropy_scale),
    )


@pytest.mark.parametrize("isotropy_scale", ISOTROPY_SCALES)
def test_chart_round_trip_and_jacobian(isotropy_scale):
    forward, back = chart_and_back(isotropy_scale)
    rng = np.random.default_rng(6)
    for alpha, kappa in zip(
        rng.uniform(0.01, 1.56, 300), rng.uniform(0.001, 0.333, 300), strict=True
    ):
        d, v = back(alpha, kappa)
        assert 0 <= v <= 1
        there = forward(float(d), float(v))
        np.testing.assert_allclose(there[:2], (alpha, kappa), rtol=1e-7, atol=1e-8)
        Hx, Hy, _ = structure_tensor(np.cos(alpha) ** 2, kappa)
        assert d == pytest.approx(np.log(Hx / Hy), abs=1e-9)
        if 0.02 < v < 0.98:
            h = 1e-6
            columns = [
                (np.array(forward(d + a, v + b)[:2]) - forward(d - a, v - b)[:2]) / (2 * h)
                for a, b in ((h, 0), (0, h))
            ]
            det = abs(np.linalg.det(np.array(columns)))
            assert there[2] == pytest.approx(np.log(det), abs=2e-4)


@pytest.mark.parametrize("isotropy_scale", ISOTROPY_SCALES)
def test_ends_of_the_chart_are_the_physical_ones(isotropy_scale):
    forward, back = chart_and_back(isotropy_scale)
    for d in (-2.0, -0.3, 0.4, 3.0):
        alpha, kappa, log_jacobian = forward(d, 0.0)
        assert alpha == pytest.approx(0.0 if d > 0 else np.pi / 2, abs=1e-12)
        assert 0 < kappa < 1 / 3 and np.isfinite(log_jacobian)
        alpha, kappa, log_jacobian = forward(d, 1.0)
        assert kappa == pytest.approx(0.0, abs=1e-12)
        assert 0 < alpha < np.pi / 2 and np.isfinite(log_jacobian)
    for alpha in (0.3, 0.9, 1.5):
        assert back(alpha, 0.0)[1] == pytest.approx(1.0, abs=1e-9)
    for kappa in (0.1, 0.3):
        assert back(0.0, kappa)[1] == pytest.approx(0.0, abs=1e-9)


def test_area_of_the_chart_is_that_of_the_box():
    """Integrated over the chart, the Jacobian gives the area of (alpha, kappa) exactly."""
    for isotropy_scale in ISOTROPY_SCALES:
        forward, _ = chart_and_back(isotropy_scale)
        # Gauss-Legendre in v and in s, d = tan s, which reaches the far ends of d
        s, ws = np.polynomial.legendre.leggauss(200)
        v, wv = np.polynomial.legendre.leggauss(200)
        d = np.tan(s * np.pi / 2)
        keep = np.abs(d) < 60
        total = 0.0
        for di, wi in zip(d[keep], (ws * np.pi / 2 * (1 + d**2))[keep], strict=True):
            values = [np.exp(forward(di, 0.5 * (1 + vj))[2]) for vj in v]
            total += wi * 0.5 * float(np.dot(wv, values))
        assert total == pytest.approx(np.pi / 2 / 3, rel=5e-3)


def test_columns_lists_and_numbers_give_the_same_stress():
    """A table's column has no real part of its own; whatever NumPy takes is taken."""
    import pandas as pd

    material = GOH(C1_kPa=14.0, k1_kPa=140.0, k2=11.9, alpha_deg=38.4, kappa=0.21)
    table = pd.DataFrame({"x": [1.0, 0.98, 1.1], "y": [1.0, 1.05, 1.1]}, index=[7, 8, 9])
    for function in (material.cauchy, material.piola, material.strain_energy):
        wanted = np.array([function(x, y) for x, y in table.itertuples(index=False)]).T
        for x, y in ((table["x"], table["y"]), (list(table["x"]), list(table["y"]))):
            np.testing.assert_array_equal(np.array(function(x, y)), wanted)
    draws = pd.Series([10.0, 20.0])
    stress, _ = cauchy_stress(draws, 140.0, 11.9, 0.6, 0.1, 1.1, 1.1)
    assert stress.shape == (2,)


@pytest.mark.parametrize("name", MATERIALS)
def test_published_materials_are_materials_of_the_law(name):
    values = MATERIALS[name].material.values
    law_named("goh").checked_material(dict(zip(law_named("goh").names, values, strict=True)))
    assert all(1.0 <= stretch < 1.2 for stretch in MATERIALS[name].mounting_stretch)
