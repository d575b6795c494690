"""What a law states beside its stress: coordinates, starting points, priors and nearness to edges.

Each is compared with its definition, written here a second time.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr

from biaxbayes.laws import LAWS, law_named
from biaxbayes.laws.law import ABSENT_STRESS_FRACTION, TransformInputs
from biaxbayes.laws.materials import Material
from biaxbayes.laws.screening import MIN_MATRIX_FRACTION, Screening, screen
from biaxbayes.mechanics.mounting import section_per_stress
from biaxbayes.model.assembly import to_slot
from test_laws import RECOVERED, TYPICAL, random_materials, stress_at_point

# --- sampling coordinates at a reference state ---------------------------------------------------

X, Y = 1.5, 1.4
Z = 1.0 / (X * Y)
I1, PEAK_KPA = X + Y + Z, 100.0


def root(amount: float, unit: float) -> float:
    """The u of amount = unit ln(1 + e^u)^2."""
    return float(np.log(np.expm1(np.sqrt(amount / unit))))


def of_stress(S: float) -> float:
    return root(S, 0.01 * PEAK_KPA)


def of_exponent(q: float) -> float:
    return root(q, 0.1)


def fibre_strain(alpha: float, kappa: float = 0.0) -> tuple[float, float, float]:
    """E*, and gx, gy of the dispersed fibres."""
    cos2 = np.cos(alpha) ** 2
    H = kappa + (1 - 3 * kappa) * cos2, kappa + (1 - 3 * kappa) * (1 - cos2), kappa
    return H[0] * X + H[1] * Y + H[2] * Z - 1.0, H[0] * X - H[2] * Z, H[1] * Y - H[2] * Z


# What an isotropic term c (I1 - 3) carries: s_x = 2 c (X - Z), s_y = 2 c (Y - Z), and their mean.
MATRIX = X + Y - 2 * Z


def goh(C1, k1, k2, alpha, kappa):
    E, gx, gy = fibre_strain(alpha, kappa)
    return {
        "C1": np.log(C1 * MATRIX),
        "k1": np.log(2 * k1 * E * np.exp(k2 * E**2) * (gx + gy)),
        "k2": np.log(k2 * E**2),
    }


def hgo(C1, k1, k2, alpha):
    return goh(C1, k1, k2, alpha, 0.0) | {"alpha": alpha}


def goh_exponential(C1, b, k1, k2, alpha, kappa):
    q = b * (I1 - 3.0)
    matrix = {"C1": np.log(C1 * np.exp(q) * MATRIX), "b": np.log(q)}
    return goh(C1, k1, k2, alpha, kappa) | matrix


def four_fibre(c, k1_x, k2_x, k1_y, k2_y, k1_d, k2_d, alpha):
    result = {"c": of_stress(0.5 * c * MATRIX), "alpha": alpha}
    E_d, _, _ = fibre_strain(alpha)
    families = (("x", k1_x, k2_x, X - 1, 0.5), ("y", k1_y, k2_y, Y - 1, 0.5), ("d", k1_d, k2_d, E_d, 1))  # fmt: skip  # noqa: E501
    for f, k1, k2, E, n in families:
        result[f"k2_{f}"] = of_exponent(k2 * E**2)
        result[f"k1_{f}"] = of_stress(n * k1 * (E + 1) * E * np.exp(k2 * E**2))
    return result


def fung(c0, c, b_x, b_y, b_xy):
    Ex, Ey = 0.5 * (X - 1), 0.5 * (Y - 1)
    Q = b_x * Ex**2 + b_y * Ey**2 + 2 * b_xy * Ex * Ey
    slope = X * (b_x * Ex + b_xy * Ey) + Y * (b_y * Ey + b_xy * Ex)
    return {
        "c0": np.log(c0 * MATRIX),
        "c": np.log(0.5 * c * np.exp(Q) * slope),
        "b_x": np.log(b_x * Ex**2 + b_y * Ey**2),
        "b_y": np.log(b_y * Ey**2 / (b_x * Ex**2)),
        "b_xy": b_xy / np.sqrt(b_x * b_y),
    }


def holzapfel_2005(mu, k1, k2, alpha, rho):
    E, _, _ = fibre_strain(alpha)
    q = k2 * ((1 - rho) * E**2 + rho * (I1 - 3) ** 2)
    G = (1 - rho) * E * (E + 1) + rho * (I1 - 3) * MATRIX
    return {
        "mu": np.log(0.5 * mu * MATRIX),
        "k1": np.log(2 * k1 * G * np.exp(q)),
        "k2": np.log(q),
        "alpha": alpha,
        "rho": rho,
    }


def may_newman(c0, k1, k2, k3, alpha):
    E, _, _ = fibre_strain(alpha)
    J, stretch = I1 - 3, np.sqrt(E + 1)
    u = stretch - 1
    Q = k2 * J**2 + k3 * u**4
    G = k2 * J * MATRIX + k3 * u**3 * stretch
    return {
        "c0": np.log(c0 * MATRIX),
        "k1": np.log(2 * k1 / (k2 + k3) * G * np.exp(Q)),
        "k2": np.log(Q),
        "k3": np.log(k3 * u**4 / (k2 * J**2)),
        "alpha": alpha,
    }


def lee_sacks(c0, c1, c2, c3, delta, alpha):
    E, _, _ = fibre_strain(alpha)
    q2, q3 = c2 * (I1 - 3) ** 2, c3 * E**2
    isotropic = delta * c2 * (I1 - 3) * np.exp(q2) * MATRIX
    fibres = (1 - delta) * c3 * E * np.exp(q3) * (E + 1)
    return {
        "c0": of_stress(c0 * MATRIX),
        "c1": of_stress(c1 * (isotropic + fibres)),
        "c2": of_exponent(q2),
        "c3": of_exponent(q3),
        "delta": delta,
        "alpha": alpha,
    }


DEFINED = {
    "goh": goh,
    "hgo": hgo,
    "goh-exponential": goh_exponential,
    "four-fibre": four_fibre,
    "fung": fung,
    "holzapfel-2005": holzapfel_2005,
    "may-newman": may_newman,
    "lee-sacks": lee_sacks,
}


@pytest.mark.parametrize("name", LAWS)
def test_sampling_coordinates_are_what_the_law_says_of_its_reference_state(name):
    law = law_named(name)
    inputs = TransformInputs(law.names, (X, Y, Z), 0.3, True, (X, Y, Z), PEAK_KPA)
    transform = law.sampling_transform(inputs)
    for material in random_materials(name, 20):
        slots = {
            p.name: to_slot(p, np.array([v]))
            for p, v in zip(law.parameters, material.values, strict=True)
        }
        result = law.to_sampling_coordinates(transform, slots)
        expected = DEFINED[name](*(float(np.ravel(v)[0]) for v in material.theta))
        assert len(expected) >= len(law.names) - 2  # the chart of alpha and kappa has its own test
        for parameter, value in expected.items():
            np.testing.assert_allclose(result[parameter], value, rtol=1e-9, atol=1e-9)


# --- starting points of fits ---------------------------------------------------------------------


def readings(name: str, *, with_mounting: bool, fixed: tuple[int, ...] = ()) -> Screening:
    """Exact nominal stresses of a typical material, mounted at 1, 1; some coordinates fixed."""
    law = law_named(name)
    up = np.linspace(1.02, 1.2, 8)
    stretch = np.array([np.concatenate([up, up, 0.5 * (1 + up)]), np.concatenate([up, 0.5 * (1 + up), up])])  # fmt: skip  # noqa: E501
    point = law.to_fit_coordinates(RECOVERED[name])

    def load_factor(total):
        return section_per_stress(1.0, total, mounted=False)

    stress = np.array(stress_at_point(law, point, *stretch)) * load_factor(stretch)
    free = np.setdiff1d(np.arange(point.size), fixed)
    no_strip = np.full(stretch.shape[1], -1)
    return Screening(stretch, stress, no_strip, with_mounting, point, free, 400, load_factor)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("with_mounting", [False, True])
def test_screened_points_have_the_cost_they_say_and_the_best_amplitudes(name, with_mounting):
    law = law_named(name)
    data = readings(name, with_mounting=with_mounting)
    points, mounting, costs, marks = screen(law, data, np.random.default_rng(2))
    assert len(points) == len(mounting) == len(costs) == len(marks) == data.size
    assert np.all((law.lower <= points) & (points <= law.upper))
    assert np.all(mounting == 1.0) or with_mounting
    assert np.all(mounting >= 1.0)
    floor = MIN_MATRIX_FRACTION * np.abs(data.stress).max() if with_mounting else 0.0

    def cost(point, lm):
        total = data.stretch * lm[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            load = np.array(stress_at_point(law, point, *total)) * data.factor(total)
        return float(np.sum((load - data.stress) ** 2))

    amplitudes = [law.names.index(n) for n in law.amplitudes]
    size = float(np.sum(data.stress**2))
    compared = 0
    for point, lm, message in zip(points, mounting, costs, strict=True):
        # a matrix raised to the least, or an amplitude cut at its limit, has another cost
        raised = point[amplitudes[0]] <= floor * (1 + 1e-9)
        if not np.isfinite(message) or raised or np.any(point[amplitudes] >= law.upper[amplitudes]):
            continue
        compared += 1
        assert cost(point, lm) == pytest.approx(message, rel=1e-6, abs=1e-9 * size)
        for i in amplitudes:
            for factor in (0.98, 1.02):
                other = point.copy()
                other[i] *= factor
                assert cost(other, lm) >= message * (1 - 1e-7) - 1e-9 * size
    assert compared > 0.3 * data.size


@pytest.mark.parametrize("name", LAWS)
def test_screened_points_keep_what_is_fixed(name):
    law = law_named(name)
    for fixed in range(len(law.names)):
        data = readings(name, with_mounting=False, fixed=(fixed,))
        points, _, costs, _ = screen(law, data, np.random.default_rng(4))
        np.testing.assert_allclose(points[np.isfinite(costs), fixed], data.point[fixed])


@pytest.mark.parametrize("name", LAWS)
def test_screened_points_with_fixed_amplitudes_have_the_cost_they_report(name):
    law = law_named(name)
    fixed = tuple(law.names.index(n) for n in law.amplitudes)
    data = readings(name, with_mounting=False, fixed=fixed)
    points, _, costs, _ = screen(law, data, np.random.default_rng(4))
    assert np.isfinite(costs).mean() > 0.3
    for point, message in zip(points[:50], costs[:50], strict=True):
        np.testing.assert_array_equal(point[list(fixed)], data.point[list(fixed)])
        if np.isfinite(message):
            load = np.array(stress_at_point(law, point, *data.stretch))
            load *= data.factor(data.stretch[None])[0]
            assert np.sum((load - data.stress) ** 2) == pytest.approx(message, rel=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_some_screened_points_describe_what_the_law_made(name):
    """A hundredth of random shapes lie within a fifth of the loads."""
    data = readings(name, with_mounting=False)
    law = law_named(name)
    _, _, costs, _ = screen(law, data, np.random.default_rng(5))
    miss = np.sqrt(np.sort(costs) / np.sum(data.stress**2))
    assert miss[len(miss) // 100] < 0.2


@pytest.mark.parametrize("name", LAWS)
def test_random_shapes_reach_from_straight_to_steep_at_the_largest_stretches(name):
    """Each exponent of the law, at each material's own largest stretches, on its own."""
    law, rng = law_named(name), np.random.default_rng(6)
    largest = rng.uniform(1.05, 1.6, (2000, 2))
    points, marks = law.random_materials(len(largest), largest, rng)
    assert len(points) == len(marks) == len(largest)
    X, Y = largest.T**2
    reached = np.array(law.exponents_at(law.constants_from_fit(*points.T), X, Y, 1.0 / (X * Y)))
    assert np.all((reached >= 0.0) & (reached < 40.0))
    for exponent in reached:
        assert np.quantile(exponent, 0.1) < 0.3
        assert np.quantile(exponent, 0.9) > 2.0
    # the marks that keep starting points apart are those of the exponents, each alone
    if name == "fung":
        alone = points[:, 2:4] * (0.5 * (largest**2 - 1.0)) ** 2
        np.testing.assert_allclose(0.3 * alone, marks[:, :2], atol=1e-9)
    elif name == "may-newman":
        isotropic = points[:, 2] * (X + Y + 1.0 / (X * Y) - 3.0) ** 2
        np.testing.assert_allclose(0.3 * isotropic, marks[:, 0], atol=1e-9)
    else:
        for exponent, mark in zip(reached, marks.T, strict=False):
            assert spearmanr(exponent, mark).statistic > 0.99
    for i, j in zip(*np.triu_indices(len(reached), 1), strict=True):
        assert abs(spearmanr(reached[i], reached[j]).statistic) < 0.5


def test_screened_goh_materials_reach_from_straight_to_steep():
    data = readings("goh", with_mounting=True)
    points, mounting, costs, _ = screen(law_named("goh"), data, np.random.default_rng(7))
    X, Y = (data.stretch * mounting[:, :, None]).transpose(1, 0, 2) ** 2
    law = law_named("goh")
    constants = law.constants_from_fit(*points.T[:, :, None])
    (reached,) = law.exponents_at(constants, X, Y, 1.0 / (X * Y))
    reached = reached.max(axis=1)[np.isfinite(costs)]
    assert np.quantile(reached, 0.1) < 0.02
    assert 0.1 < np.median(reached) < 1.0
    assert 10.0 < np.quantile(reached, 0.9) < reached.max() < 40.0
    t, kappa = points[:, 3], points[:, 4]
    for share, edge in ((t, 0.0), (t, 1.0), (kappa, 0.0)):
        assert 0.1 < np.mean(share == edge) < 0.3
    assert 0.15 < np.mean(np.all(mounting == 1.0, axis=1)) < 0.25
    assert kappa.max() == pytest.approx(1.0 / 3.0, abs=0.01)


@pytest.mark.parametrize("name", LAWS)
def test_a_point_of_a_fit_moved_off_its_bounds_lies_inside_them(name):
    law, rng = law_named(name), np.random.default_rng(9)
    inside = law.to_fit_coordinates(RECOVERED[name])
    np.testing.assert_array_equal(law.to_fit_coordinates(law.clip_inside(RECOVERED[name])), inside)
    far = np.where(np.isfinite(law.upper), law.upper, 50.0)
    for _ in range(50):
        at = np.where(rng.random(inside.size) < 0.5, law.lower, np.where(rng.random(inside.size) < 0.5, far, inside))  # fmt: skip  # noqa: E501
        moved = law.to_fit_coordinates(law.clip_inside(law.from_fit_coordinates(at)))
        assert np.all((law.lower < moved) & (moved <= law.upper))
        # shares and angles leave their upper end too
        for i, p in enumerate(law.parameters):
            if p.bounded or p.name == "alpha":
                assert moved[i] < law.upper[i]
                assert abs(moved[i] - at[i]) < 0.05


@pytest.mark.parametrize("name", LAWS)
def test_a_material_moved_off_its_edges_has_finite_coordinates_and_else_stays(name):
    law = law_named(name)
    inputs = TransformInputs(law.names, (X, Y, Z), 0.3, True, (X, Y, Z), PEAK_KPA)
    transform = law.sampling_transform(inputs)

    def finite(values) -> bool:
        slots = {
            p.name: to_slot(p, np.array([v])) for p, v in zip(law.parameters, values, strict=True)
        }
        result = law.to_sampling_coordinates(transform, slots)
        return bool(np.all([np.isfinite(v).all() for v in result.values()]))

    inside = law.material_at(RECOVERED[name]).values
    np.testing.assert_allclose(law.clip_inside(inside), inside, rtol=1e-12)
    for material in random_materials(name, 10):
        for i, p in enumerate(law.parameters):
            for edge in p.range:
                if not np.isfinite(edge) or (edge and p.logarithmic):
                    continue
                at_edge = [edge if i == j else v for j, v in enumerate(material.values)]
                if not law.is_admissible(dict(zip(law.names, at_edge, strict=True))):
                    continue
                moved = law.clip_inside(at_edge)
                assert finite(moved)
                # what moves stays near: a hundredth of a stiffness or an exponent, few degrees
                near = [5.0 if q.name == "alpha" else 0.021 for q in law.parameters]
                assert np.all(np.abs(np.subtract(moved, at_edge)) <= near)


# --- default priors, and priors that follow from stretch and stress -------------------------------


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
    matrix = {"four-fibre": ("k1_x", "k1_y", "k1_d"), "fung": ("c",), "lee-sacks": ("c1",)}
    alone = medians | dict.fromkeys(matrix.get(name, ("k1",)), 0.0)
    for stress in law.material_at([alone[n] for n in law.names]).cauchy(stretch, stretch):
        assert stress / stretch == pytest.approx(0.3 * peak_kPa, rel=1e-12)


# --- nearness to edges ---------------------------------------------------------------------------

NEAR_EXPONENT = {  # parameter: exponent at a state, for one unit of it
    "goh": {"k2": lambda v, x, y: _strain(v, x, y) ** 2},
    "hgo": {"k2": lambda v, x, y: _strain(v, x, y) ** 2},
    "goh-exponential": {
        "b": lambda v, x, y: x**2 + y**2 + (x * y) ** -2 - 3,
        "k2": lambda v, x, y: _strain(v, x, y) ** 2,
    },
    "four-fibre": {
        "k2_x": lambda v, x, y: (x**2 - 1) ** 2,
        "k2_y": lambda v, x, y: (y**2 - 1) ** 2,
        "k2_d": lambda v, x, y: _strain(v, x, y) ** 2,
    },
    "lee-sacks": {
        "c2": lambda v, x, y: (x**2 + y**2 + (x * y) ** -2 - 3) ** 2,
        "c3": lambda v, x, y: _strain(v, x, y) ** 2,
    },
}


def _strain(values, x, y):
    kappa, cos2 = values.get("kappa", 0.0), np.cos(values["alpha"]) ** 2
    spread = 1 - 3 * kappa
    H = kappa + spread * cos2, kappa + spread * (1 - cos2), kappa
    return H[0] * x**2 + H[1] * y**2 + H[2] * (x * y) ** -2 - 1


TOP = np.array([[1.25, 1.3]])


def one_draw(name: str):
    """A typical material as one draw, and its natural values by name."""
    law = law_named(name)
    material = law.material_at(TYPICAL[name] if name != "may-newman" else RECOVERED[name])
    theta = [float(np.ravel(v)[0]) for v in material.theta]
    values = dict(zip(law.names, theta, strict=True))
    return law, Material(law, tuple(np.full((1, 1), v) for v in theta)), values


@pytest.mark.parametrize("name", NEAR_EXPONENT)
def test_an_exponent_is_near_to_none_below_a_tenth_at_the_largest_stretch(name):
    law, material, values = one_draw(name)
    result = law.bound_tolerances(material, [TOP])
    for parameter, per_unit in NEAR_EXPONENT[name].items():
        assert result[parameter] * per_unit(values, *TOP[0]) == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize("top", [(1.25, 1.3), (1.05, 1.08)])
def test_fung_has_an_exponent_near_to_none_below_a_tenth_at_the_largest_stretch(top):
    law, material, values = one_draw("fung")
    result = law.bound_tolerances(material, [np.array([[1.02, 1.01]]), np.array([top])])
    x, y = (0.5 * (s**2 - 1.0) for s in top)
    Q = values["b_x"] * x**2 + values["b_y"] * y**2 + 2.0 * values["b_xy"] * x * y
    for name in ("b_x", "b_y"):
        assert result[name] / values[name] * Q == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize("name", [n for n in LAWS if n not in ("goh", "fung")])
def test_an_amplitude_is_near_to_none_where_it_carries_a_twentieth_of_the_stress(name):
    law, material, values = one_draw(name)
    result = law.bound_tolerances(material, [TOP])
    whole = sum(float(np.ravel(s)[0]) for s in material.cauchy(TOP[:, :1], TOP[:, 1:]))
    for amplitude in law.amplitudes:
        alone = values | dict.fromkeys(law.amplitudes, 0.0) | {amplitude: result[amplitude]}
        at = law.to_fit_coordinates(
            [np.degrees(v) if n == "alpha" else v for n, v in alone.items()]
        )
        assert sum(stress_at_point(law, at, *TOP[0])) == pytest.approx(
            ABSENT_STRESS_FRACTION * whole, rel=1e-9
        )


@pytest.mark.parametrize(("name", "matrix", "rest"), [("goh", "C1", "k1"), ("fung", "c0", "c")])
def test_stiffnesses_are_near_to_none_below_a_twentieth_of_the_small_strain_stiffness(
    name, matrix, rest
):
    law, material, values = one_draw(name)
    result = law.bound_tolerances(material, [TOP])

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
