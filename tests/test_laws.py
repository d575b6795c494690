"""Every law: printed stresses, derivatives against complex steps, sampling coordinates, fits."""

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.fitting.fit import fit
from biaxbayes.laws import LAWS, law_named
from biaxbayes.laws.coordinates import to_slots
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.materials import (
    cauchy_stress,
    constants_at,
    energy,
    exponents,
    squared_stretches,
)
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.model.assembly import to_slot
from biaxbayes.specimens.specimen import Protocol, Specimen
from typical_laws import RECOVERED, STRESSES, TYPICAL, random_materials, stress_at_point

STEP = 1e-30


@pytest.mark.parametrize(("name", "values", "stretch", "stress"), STRESSES)
def test_stresses_are_the_printed_ones(name, values, stretch, stress):
    labels = [p.label for p in law_named(name).parameters]
    material = biaxbayes.law(name, **dict(zip(labels, values, strict=True)))
    # the printed numbers have seven digits at least
    np.testing.assert_allclose(material.cauchy(*stretch), stress, rtol=5e-7)


@pytest.mark.parametrize("name", LAWS)
def test_an_unloaded_material_stores_no_energy(name):
    for material in random_materials(name, 20):
        assert abs(material.strain_energy(1.0, 1.0)) < 1e-12 * material.strain_energy(1.2, 1.1)


@pytest.mark.parametrize("name", LAWS)
def test_derivatives_are_those_of_the_energy(name):
    """Stress and its slope at a thousand random states against complex steps of W and of s."""
    rng = np.random.default_rng(1)
    for material in random_materials(name, 100):
        x, y = rng.uniform(-0.1, 0.25, (2, 10))

        def stress(a, b, c=material.constants):
            # s_k = dW / d ln l_k of the energy as a function of both log stretches
            result = []
            for k in range(2):
                u, v = a + (k == 0) * 1j * STEP, b + (k == 1) * 1j * STEP
                X, Y = np.exp(2.0 * u), np.exp(2.0 * v)
                result.append(np.imag(energy(c, X, Y, 1.0 / (X * Y))) / STEP)
            return np.array(result)

        expected = stress(x, y)
        result = np.array(material.cauchy(np.exp(x), np.exp(y)))
        size = np.abs(expected).max()
        np.testing.assert_allclose(result, expected, rtol=1e-10, atol=1e-12 * size)
        slope = material.cauchy_by_log_stretch(np.exp(x), np.exp(y))
        for k in range(2):
            u, v = x + (k == 0) * 1j * STEP, y + (k == 1) * 1j * STEP
            stepped = np.imag(np.array(material.cauchy(np.exp(u), np.exp(v)))) / STEP
            np.testing.assert_allclose(
                slope[:, k], stepped, rtol=1e-10, atol=1e-12 * np.abs(stepped).max()
            )


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("reparametrised", [True, False])
def test_sampling_coordinates_turn_back_and_their_jacobian_is_the_derivative(name, reparametrised):
    law = law_named(name)
    reference = (1.5, 1.4, 1.0 / (1.5 * 1.4))
    given = (law.names, reference, 0.3, reference, 100.0)
    transform = law.sampling_transform(*given, reparametrised=reparametrised)
    for material in random_materials(name, 30):
        slots = {
            p.name: to_slot(p, np.array([v]))
            for p, v in zip(law.parameters, material.values, strict=True)
        }
        there = law.to_sampling_coordinates(transform, slots)
        u = np.array([there[n][0] for n in law.names])

        def natural(at):
            value = at.copy()
            return value, to_slots(transform, value)

        value, log_jacobian = natural(u)
        natural_slots = [slots[n][0] for n in law.names]
        np.testing.assert_allclose(value, natural_slots, rtol=1e-9, atol=1e-9)
        if not reparametrised:  # densities are defined in the parameters themselves
            np.testing.assert_array_equal(u, natural_slots)
        step = 1e-6 * np.maximum(np.abs(u), 1e-2)
        columns = [
            (natural(u + d)[0] - natural(u - d)[0]) / (2.0 * step[i])
            for i, d in enumerate(np.diag(step))
        ]
        _, expected = np.linalg.slogdet(np.column_stack(columns))
        assert log_jacobian == pytest.approx(expected, abs=2e-4)
        low, high = np.array(
            [law.sampling_bounds(transform).get(n, (-np.inf, np.inf)) for n in law.names]
        ).T
        assert np.all((low <= u) & (u <= high))
        for i in range(u.size):
            for end, outward in ((low[i], -1e-9), (high[i], 1e-9)):
                beyond = u.copy()
                beyond[i] = end + outward
                assert np.isinf(end) or natural(beyond)[1] == -np.inf
                # an angle, a dispersion or a share may be fixed at its very end
                if np.isfinite(end) and name != "fung":
                    beyond[i] = end
                    assert np.isfinite(natural(beyond)[1])
        logarithmic = np.array([p.logarithmic for p in law.parameters])
        parameters = np.where(logarithmic, np.exp(np.where(logarithmic, value, 0.0)), value)
        constants = constants_at(transform.constants, parameters)
        stress = cauchy_stress(constants, *squared_stretches([1.1], [1.2]))
        expected = material.cauchy(np.array([1.1]), np.array([1.2]))
        np.testing.assert_allclose(stress, np.array(expected), rtol=1e-8)


@pytest.mark.parametrize("name", LAWS)
def test_coordinates_of_fits_turn_back(name):
    law = law_named(name)
    for material in random_materials(name, 30):
        point = law.to_fit_coordinates(material.values)
        assert np.all((law.lower <= point) & (point <= law.upper))
        np.testing.assert_allclose(
            law.from_fit_coordinates(point), material.values, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(
            stress_at_point(law, point, 1.1, 1.2), material.cauchy(1.1, 1.2), rtol=1e-9
        )


@pytest.mark.parametrize("name", LAWS)
def test_three_protocols_without_noise_give_the_parameters_back(name):
    values = RECOVERED[name]
    lm = (1.02, 1.01)
    protocols = []
    for label, ratio in (("equal", (1.0, 1.0)), ("x", (1.0, 0.5)), ("y", (0.5, 1.0))):
        true = virtual_test(
            law_named(name).material_at(values),
            mounting_stretch=lm,
            total_stretch=1.25,
            ratio=ratio,
            increments=24,
        )
        curves = (*true.measured.T, *true.piola_kPa.T)
        protocols.append(Protocol(label, *curves))
    specimen = Specimen("virtual", tuple(protocols), "piola")
    result = fit(specimen, law=name)
    assert result.converged
    assert result.rmse_kPa < 1e-6 * specimen.peak_load
    np.testing.assert_allclose(result.material.values, values, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(result.mounting_stretch, [lm], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("fungus", {}, "did you mean fung"),
        ("fung", {"c0_kPa": 10}, "needs c_kPa and b_x and b_y and b_xy"),
        ("fung", {"c0": 1, "c": 1, "b_x": 1, "b_y": 1, "b_xy": 2}, "b_x b_y has to be larger"),
        ("fung", {"c0": 1, "c": 1, "b_x": 1, "b_y": 1, "b_z": 2}, "b_z is not a parameter"),
        ("fung", {"c0": 1, "c0_kPa": 1, "c": 1, "b_x": 1, "b_y": 1, "b_xy": 0}, "given twice"),
        ("hgo", {"C1": 1, "k1": 1, "k2": 1, "alpha": 91}, "between 0 and 90 degrees"),
    ],
)
def test_materials_that_are_none(name, values, message):
    with pytest.raises(InputError) as error:
        biaxbayes.law(name, **values)
    assert message in f"{error.value}"


@pytest.mark.parametrize(
    ("name", "value"),
    [("k2_kPa", np.nan), ("k1", -1e-9), ("alpha", 90.01), ("alpha", -0.01), ("kappa", 0.334)]
    + [("kappa", -1e-9)],
)
def test_goh_materials_that_are_none(name, value):
    values = {"C1": 1.0, "k1": 1.0, "k2": 1.0, "alpha": 45.0, "kappa": 0.1}
    with pytest.raises(ValueError):
        GOH(*(values | {name.removesuffix("_kPa"): value}).values())


EXPONENTS = [(name, ("k2",)) for name in ("goh", "hgo", "goh-exponential", "holzapfel-2005")]
EXPONENTS += [("may-newman", ("k2",)), ("goh-exponential", ("b",)), ("four-fibre", ("k2_x",))]
EXPONENTS += [("four-fibre", ("k2_y", "k2_d")), ("fung", ("b_x", "b_xy"))]
EXPONENTS += [("lee-sacks", ("c2",)), ("lee-sacks", ("c3",))]


@pytest.mark.parametrize(("name", "exponents"), EXPONENTS)
def test_energy_and_stress_without_an_exponent_are_its_limit(name, exponents):
    law = law_named(name)
    values = dict(zip(law.names, TYPICAL[name], strict=True))
    none, few = (
        law.material_at([(values | dict.fromkeys(exponents, v))[n] for n in law.names])
        for v in (0.0, 1e-7)
    )
    assert none.strain_energy(1.2, 1.1) == pytest.approx(few.strain_energy(1.2, 1.1), rel=1e-5)
    np.testing.assert_allclose(none.cauchy(1.2, 1.1), few.cauchy(1.2, 1.1), rtol=1e-5)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_fung_holds_where_its_form_is_definite(sign):
    law = law_named("fung")
    for b_x, b_y in ((8.0, 5.0), (0.4, 0.9), (50.0, 300.0)):
        most = sign * np.sqrt(b_x * b_y)
        for share, holds in ((0.999, True), (1.001, False)):
            values = {"c0": 1.0, "c": 1.0, "b_x": b_x, "b_y": b_y, "b_xy": share * most}
            assert bool(law.is_admissible(values)) is holds


def test_a_stress_that_overflows_is_refused():
    material = biaxbayes.law("fung", c0=1, c=1, b_x=50, b_y=50, b_xy=0)
    with pytest.raises(InputError, match="no finite stress at stretches 5, 4"):
        material.cauchy(5.0, 4.0)
    with pytest.raises(InputError, match="`fibre_switch` does not apply to the law hgo"):
        law_named("hgo", fibre_switch=True)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("stretch", [1.1, 1.3])
def test_exponents_of_a_typical_material_are_one(name, stretch):
    law = law_named(name)
    values = {p.name: 45.0 if p.mirror else 1.0 for p in law.parameters} | law.prior_medians(
        stretch
    )
    material = law.material(values)
    squared = stretch**2, stretch**2, stretch**-4
    found = exponents(material.constants, *squared)[: len(law.formulas)]
    np.testing.assert_allclose(np.ravel(found), 1.0, rtol=1e-12)
