"""Thin-walled inflation against energy, hand calculation and its own inverse."""

import numpy as np
import pytest

from biaxbayes.laws.published import MATERIALS
from biaxbayes.prediction.inflation import (
    MMHG_PER_KPA,
    Tube,
    inflation_axial_force,
    inflation_pressure,
    inflation_stretch,
)
from goh_functions import at, strain_energy

MEDIA = MATERIALS["weisbecker-media"].material.theta


@pytest.mark.parametrize("circumferential", ["x", "y"])
@pytest.mark.parametrize("axial", [1.0, 1.15])
def test_pressure_is_the_derivative_of_energy_by_enclosed_volume(circumferential, axial):
    """Virtual work: p dV = dW, with V inside the mid surface, by complex step."""
    tube = Tube(9.0, 1.2, axial, circumferential)
    stretch, h = 1.13, 1e-30
    state = complex(stretch, h)
    x, y = (state, axial) if circumferential == "x" else (axial, state)
    wall = 2.0 * np.pi * 9.0 * 1.2  # per unit of unloaded length
    energy = wall * strain_energy(*MEDIA, x, y)
    volume = np.pi * (state * 9.0) ** 2 * axial
    p = inflation_pressure(at(*MEDIA), tube, stretch)
    assert p == pytest.approx((energy.imag / h) / (volume.imag / h), rel=1e-12)


def test_axial_force_is_the_derivative_of_energy_by_length_at_constant_pressure():
    """f = d(W - p V)/dL at fixed radius and pressure."""
    stretch, axial, h = 1.1, 1.2, 1e-30
    tube = Tube(9.0, 1.2, axial, "x")
    p = inflation_pressure(at(*MEDIA), tube, stretch)
    state = complex(axial, h)
    energy = 2.0 * np.pi * 9.0 * 1.2 * strain_energy(*MEDIA, stretch, state)
    volume = np.pi * (stretch * 9.0) ** 2 * state
    expected = (energy - p * volume).imag / h
    assert inflation_axial_force(at(*MEDIA), tube, stretch) == pytest.approx(expected, rel=1e-12)


def test_neo_hookean_tube_by_hand():
    """C1 = 50 kPa, R = 10 mm, H = 1 mm, la = 1, lt = 1.2.

    s_t = 2 * 50 * (1.44 - 1/1.44) = 74.5556 kPa;  h = 1/1.2 = 0.83333 mm;  r = 12 mm
    p = 74.5556 * 0.83333 / 12 = 5.17747 kPa
    """
    tube = Tube(10.0, 1.0)
    p = inflation_pressure(at(50.0, 0.0, 1.0, 0.5, 0.1), tube, 1.2)
    assert p == pytest.approx(5.177469135802469, rel=1e-12)
    assert tube.mid_diameter_mm(1.2) == pytest.approx(24.0)
    assert tube.outer_diameter_mm(1.2) == pytest.approx(24.0 + 1.0 / 1.2)


def test_stretch_inverts_pressure_for_many_draws():
    rng = np.random.default_rng(3)
    n = 200
    theta = (
        rng.uniform(2.0, 30.0, n),
        rng.uniform(40.0, 150.0, n),
        rng.uniform(0.5, 30.0, n),
        rng.uniform(0.3, 1.2, n),
        rng.uniform(0.0, 0.3, n),
    )
    tube = Tube(8.0, 1.5, 1.1, "y")
    wanted = np.array([0.0, 2.0, 10.7, 16.0])
    stretch = inflation_stretch(at(*(v[:, None] for v in theta)), tube, wanted)
    assert np.isfinite(stretch).all()
    assert (np.diff(stretch, axis=1) > 0.0).all()
    back = inflation_pressure(at(*(v[:, None] for v in theta)), tube, stretch)
    np.testing.assert_allclose(back, np.broadcast_to(wanted, back.shape), rtol=1e-7, atol=1e-8)


def test_unloaded_tube_rests_at_its_own_radius():
    assert inflation_stretch(at(*MEDIA), Tube(9.0, 1.0), [0.0])[0, 0] == pytest.approx(
        1.0, abs=1e-12
    )
    held = inflation_stretch(at(*MEDIA), Tube(9.0, 1.0, 1.2), [0.0])[0, 0]
    assert held < 1.0  # pulled along, it narrows


def test_a_soft_tube_has_no_state_at_a_high_pressure():
    # Neo-Hookean: p = 2 C1 H/R (1 - lt^-4) la^-1 never reaches 2 C1 H / R = 1 kPa
    stretch = inflation_stretch(at(5.0, 0.0, 1.0, 0.5, 0.1), Tube(10.0, 1.0), [0.5, 1.1])
    assert stretch[0, 0] == pytest.approx(0.5**-0.25, rel=1e-10)
    assert np.isnan(stretch[0, 1])


def test_stiff_exponential_overflow_is_a_wall_not_a_warning():
    stretch = inflation_stretch(at(2.0, 30.0, 4000.0, 0.7, 0.2), Tube(10.0, 1.0), [16.0])
    assert 1.0 < stretch[0, 0] < 1.2


@pytest.mark.parametrize(
    "values", [(-1.0, 1.0, 1.0), (5.0, 0.0, 1.0), (5.0, 6.0, 1.0), (5.0, 1.0, np.nan)]
)
def test_impossible_tubes_are_refused(values):
    with pytest.raises(ValueError):
        Tube(*values)


def test_millimetres_of_mercury():
    # 1 mmHg is 133.322 Pa
    assert pytest.approx(1.0, abs=1e-5) == 0.133322 * MMHG_PER_KPA
