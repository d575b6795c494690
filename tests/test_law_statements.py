"""What a law states beside its stress: starting points, priors and nearness to the ends of ranges.

Each is compared with its definition, written here a second time.
"""

import numpy as np
import pytest
from scipy.stats import spearmanr

from biaxbayes.laws import LAWS, law_named, materials
from biaxbayes.laws.law import ABSENT_STRESS_FRACTION
from biaxbayes.laws.materials import Material
from biaxbayes.model.assembly import to_slot
from typical_laws import RECOVERED, TYPICAL, random_materials, stress_at_point

X, Y = 1.5, 1.4
Z = 1.0 / (X * Y)
REFERENCE = (X, Y, Z)
"""Squared principal stretches, the diagonal of C, of an incompressible sheet."""


def coordinates(law, values):
    """Sampling coordinates of a material at the reference state, for a peak of 100 kPa."""
    transform = law.sampling_transform(law.names, REFERENCE, 0.3, REFERENCE, 100.0)
    slots = {p.name: to_slot(p, np.array([v])) for p, v in zip(law.parameters, values, strict=True)}
    return law.to_sampling_coordinates(transform, slots)


def test_goh_is_sampled_in_stresses_and_the_exponent_at_the_reference_state():
    for material in random_materials("goh", 20):
        C1, k1, k2, alpha, kappa = (float(np.ravel(v)[0]) for v in material.theta)
        Hx, Hy = (kappa + (1 - 3 * kappa) * f(alpha) ** 2 for f in (np.cos, np.sin))
        E = Hx * X + Hy * Y + kappa * Z - 1.0
        fibre_sum = Hx * X + Hy * Y - 2 * kappa * Z  # s_x + s_y over 4 k1 E exp(k2 E^2)
        # the mean of both stresses of matrix and fibres
        stress = C1 * (X + Y - 2 * Z), 2 * k1 * E * np.exp(k2 * E**2) * fibre_sum
        result = coordinates(material.law, material.values)
        for name, value in zip(("C1", "k1", "k2"), (*stress, k2 * E**2), strict=True):
            np.testing.assert_allclose(result[name], np.log(value), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_random_shapes_reach_from_straight_to_steep_at_the_largest_stretches(name):
    """Each exponent of the law, at each material's own largest stretches, on its own."""
    law, rng = law_named(name), np.random.default_rng(6)
    largest = rng.uniform(1.05, 1.6, (2000, 2))
    points, features = law.random_materials(len(largest), largest, rng)
    assert len(points) == len(features) == len(largest)
    X, Y = largest.T**2
    constants = law.constants_from_fit(*points.T)
    every = materials.exponents(constants, X, Y, 1.0 / (X * Y))
    exponents = np.array(every[: len(law.formulas)])
    assert np.all((exponents >= 0.0) & (exponents < 40.0))
    for exponent in exponents:
        assert np.quantile(exponent, 0.1) < 0.3
        assert np.quantile(exponent, 0.9) > 2.0
    # the features that keep starting points apart are those of the exponents, each alone
    if name == "fung":
        green_strain = 0.5 * (largest**2 - 1.0)
        alone = points[:, 2:4] * green_strain**2
        np.testing.assert_allclose(0.3 * alone, features[:, :2], atol=1e-9)
    elif name == "may-newman":
        isotropic = points[:, 2] * (X + Y + 1.0 / (X * Y) - 3.0) ** 2
        np.testing.assert_allclose(0.3 * isotropic, features[:, 0], atol=1e-9)
    else:
        for exponent, feature in zip(exponents, features.T, strict=False):
            assert spearmanr(exponent, feature).statistic > 0.99
    for i, j in zip(*np.triu_indices(len(exponents), 1), strict=True):
        assert abs(spearmanr(exponents[i], exponents[j]).statistic) < 0.5


@pytest.mark.parametrize("name", LAWS)
def test_a_material_moved_off_the_ends_of_its_ranges_has_finite_coordinates_and_else_stays(name):
    law = law_named(name)
    inside = law.material_at(RECOVERED[name]).values
    np.testing.assert_allclose(law.clip_inside(inside), inside, rtol=1e-12)
    for material in random_materials(name, 10):
        for i, p in enumerate(law.parameters):
            for end in p.range:
                if not np.isfinite(end) or (end and p.logarithmic):
                    continue
                at_end = [end if i == j else v for j, v in enumerate(material.values)]
                if not law.is_admissible(dict(zip(law.names, at_end, strict=True))):
                    continue
                moved = law.clip_inside(at_end)
                found = coordinates(law, moved)
                assert all(np.isfinite(v).all() for v in found.values())
                # what moves stays near: a hundredth of a stiffness or an exponent, few degrees
                near = [5.0 if q.name == "alpha" else 0.021 for q in law.parameters]
                assert np.all(np.abs(np.subtract(moved, at_end)) <= near)


@pytest.mark.parametrize("name", LAWS)
def test_default_priors_are_as_wide_as_the_page_on_laws_says(name):
    for p in law_named(name).parameters:
        family, first, second = p.prior
        if family == "lognormal":
            assert 5.0 <= first <= 50.0
            # a factor of 30 to 60 either way holds 90 %
            assert second in (2.0, 2.5)
        elif family == "normal":
            assert (p.name, first, second) == ("b_xy", 0.0, 30.0)
        else:
            assert family == "uniform"
            assert (first, second) == p.range


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(("stretch", "peak_kPa"), [(1.2, 100.0), (1.4, 30.0)])
def test_the_median_of_a_scaled_prior_carries_the_load(name, stretch, peak_kPa):
    law = law_named(name)
    prior = law.scaled_prior(stretch, peak_kPa)
    assert tuple(prior) == law.names
    assert {second for family, _, second in prior.values() if family == "lognormal"} == {0.8}
    medians = {
        n: 0.5 * (first + second) if family == "uniform" else first
        for n, (family, first, second) in prior.items()
    }
    medians |= {"kappa": 0.0} if "kappa" in medians else {}
    material = law.material_at([medians[n] for n in law.names])
    for stress in material.cauchy(stretch, stretch):
        assert stress / stretch == pytest.approx(peak_kPa, rel=1e-12)
    # matrix: 30 % of the nominal stress
    alone = medians | dict.fromkeys(law.amplitudes[1:], 0.0)
    for stress in law.material_at([alone[n] for n in law.names]).cauchy(stretch, stretch):
        assert stress / stretch == pytest.approx(0.3 * peak_kPa, rel=1e-12)


EXPONENTS = {  # exponent per unit of a parameter at stretches (x, y)
    "goh": {"k2": lambda v, x, y: _fibre_strain(v, x, y) ** 2},
    "hgo": {"k2": lambda v, x, y: _fibre_strain(v, x, y) ** 2},
    "goh-exponential": {
        "b": lambda v, x, y: x**2 + y**2 + (x * y) ** -2 - 3,
        "k2": lambda v, x, y: _fibre_strain(v, x, y) ** 2,
    },
    "four-fibre": {
        "k2_x": lambda v, x, y: (x**2 - 1) ** 2,
        "k2_y": lambda v, x, y: (y**2 - 1) ** 2,
        "k2_d": lambda v, x, y: _fibre_strain(v, x, y) ** 2,
    },
    "lee-sacks": {
        "c2": lambda v, x, y: (x**2 + y**2 + (x * y) ** -2 - 3) ** 2,
        "c3": lambda v, x, y: _fibre_strain(v, x, y) ** 2,
    },
}


def _fibre_strain(values, x, y):
    """E = H : C - 1 with the diagonals of the structure tensor H and of C."""
    kappa, cos2 = values.get("kappa", 0.0), np.cos(values["alpha"]) ** 2
    Hx, Hy = (kappa + (1 - 3 * kappa) * share for share in (cos2, 1 - cos2))
    return Hx * x**2 + Hy * y**2 + kappa * (x * y) ** -2 - 1


LARGEST = np.array([[1.25, 1.3]])


def one_draw(name: str):
    """A typical material as one draw, and its natural values by name."""
    law = law_named(name)
    material = law.material_at(TYPICAL[name] if name != "may-newman" else RECOVERED[name])
    theta = [float(np.ravel(v)[0]) for v in material.theta]
    values = dict(zip(law.names, theta, strict=True))
    return law, Material(law, tuple(np.full((1, 1), v) for v in theta)), values


@pytest.mark.parametrize("name", EXPONENTS)
def test_an_exponent_is_near_to_none_below_a_tenth_at_the_largest_stretch(name):
    law, material, values = one_draw(name)
    result = law.bound_tolerances(material, [LARGEST])
    for parameter, exponent in EXPONENTS[name].items():
        assert result[parameter] * exponent(values, *LARGEST[0]) == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize("top", [(1.25, 1.3), (1.05, 1.08)])
def test_fung_has_an_exponent_near_to_none_below_a_tenth_at_the_largest_stretch(top):
    law, material, values = one_draw("fung")
    result = law.bound_tolerances(material, [np.array([[1.02, 1.01]]), np.array([top])])
    E_x, E_y = (0.5 * (s**2 - 1.0) for s in top)
    Q = values["b_x"] * E_x**2 + values["b_y"] * E_y**2 + 2.0 * values["b_xy"] * E_x * E_y
    for name in ("b_x", "b_y"):
        assert result[name] / values[name] * Q == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize("name", [n for n in LAWS if n not in ("goh", "fung")])
def test_an_amplitude_is_near_to_none_where_it_carries_a_twentieth_of_the_stress(name):
    law, material, values = one_draw(name)
    result = law.bound_tolerances(material, [LARGEST])
    whole = sum(float(np.ravel(s)[0]) for s in material.cauchy(LARGEST[:, :1], LARGEST[:, 1:]))
    for amplitude in law.amplitudes:
        alone = values | dict.fromkeys(law.amplitudes, 0.0) | {amplitude: result[amplitude]}
        at = law.to_fit_coordinates(
            [np.degrees(v) if n == "alpha" else v for n, v in alone.items()]
        )
        assert sum(stress_at_point(law, at, *LARGEST[0])) == pytest.approx(
            ABSENT_STRESS_FRACTION * whole, rel=1e-9
        )


@pytest.mark.parametrize(("name", "matrix", "rest"), [("goh", "C1", "k1"), ("fung", "c0", "c")])
def test_stiffnesses_are_near_to_none_below_a_twentieth_of_the_small_strain_stiffness(
    name, matrix, rest
):
    law, material, values = one_draw(name)
    result = law.bound_tolerances(material, [LARGEST])

    def trace(of: dict[str, float]) -> float:
        """Trace of the Hessian of W by log stretches where unloaded, by central differences."""
        at = law.material_at([np.degrees(v) if n == "alpha" else v for n, v in of.items()])
        h = 1e-5
        x = at.cauchy(np.exp(h), 1.0)[0] - at.cauchy(np.exp(-h), 1.0)[0]
        y = at.cauchy(1.0, np.exp(h))[1] - at.cauchy(1.0, np.exp(-h))[1]
        return float(x + y) / (2.0 * h)

    whole = trace(values)
    for kept, left_out in ((matrix, rest), (rest, matrix)):
        share = trace(values | {kept: result[kept], left_out: 0.0}) / whole
        assert share == pytest.approx(0.05, rel=1e-5)
