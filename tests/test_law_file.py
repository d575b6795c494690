"""Laws of the user's own: one written as GOH is GOH, runs keep its text, bad files are refused."""

import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError, RunError
from biaxbayes.laws import law_named
from biaxbayes.model.density import evaluate
from biaxbayes.model.posterior import Posterior
from biaxbayes.runs.provenance import parse_options, settings_table
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from biaxbayes.verbs.options import fixed_values
from commands import refused, run
from quick_posteriors import runs_without_figures, small_specimen

GOH_FILE = '''"""Dispersed fibres."""
import numpy as np

third = 1 / 3
parameters = {
    "C1_kPa": ("lognormal", 10, 2),
    "k1_kPa": ("lognormal", 30, 2.5),
    "k2": ("lognormal", 10, 2),
    "alpha_deg": ("uniform", 0, 90),
    "kappa": ("uniform", 0, third),
}
exponents = {"k2": "k2 E^2"}

def strain(X, Y, Z, t, kappa):
    spread = 1 - 3 * kappa
    return (kappa + spread * t) * X + (kappa + spread * (1 - t)) * Y + kappa * Z - 1

def energy(X, Y, Z, C1, k1, k2, cos2_alpha, kappa):
    E = strain(X, Y, Z, cos2_alpha, kappa)
    return C1 * (X + Y + Z - 3) + k1 / k2 * (np.exp(k2 * E**2) - 1)
'''
DOUBLING = "def f0(x):\n    return x\n\n" + "\n".join(
    f"def f{i}(x):\n    return f{i - 1}(x) + f{i - 1}(x)\n" for i in range(1, 60)
)
"""Functions that call the one before twice."""
VALUES = {"C1": 9.0, "k1": 20.0, "k2": 4.0, "alpha": 42.0, "kappa": 0.15}


@pytest.fixture
def own_goh(tmp_path) -> Path:
    path = tmp_path / "dispersed.py"
    path.write_text(GOH_FILE)
    return path


def test_a_material_of_a_file_has_the_stress_and_energy_of_its_law(own_goh):
    own, built_in = (biaxbayes.law(str(name), **VALUES) for name in (own_goh, "goh"))
    rng = np.random.default_rng(1)
    lx, ly = rng.uniform(0.95, 1.3, (2, 50))
    np.testing.assert_allclose(own.cauchy(lx, ly), built_in.cauchy(lx, ly), rtol=1e-12)
    np.testing.assert_allclose(own.strain_energy(lx, ly), built_in.strain_energy(lx, ly), rtol=1e-9)
    np.testing.assert_allclose(
        own.cauchy_by_log_stretch(lx, ly), built_in.cauchy_by_log_stretch(lx, ly), rtol=1e-9
    )


EVERY_OPERATION = """
import numpy as np

parameters = {"c_kPa": ("lognormal", 20, 2), "k_kPa": ("lognormal", 30, 2.5)}

def energy(X, Y, Z, c, k):
    E, F = X - 1, Y - 1
    larger = np.maximum(-E, -F) ** 4 + np.maximum(E, 2 * F) ** 2 + np.maximum(E - F, 0) ** 2
    stiff = np.expm1(E * F) + np.sqrt(1 + E * E) - 1 - (-np.log(Y)) ** 3 / X + np.square(F)
    powers = ((X * Y) ** 1.5 - 1) ** 2 + (Z**-2 - 1) ** 2
    return c * (X + Y + Z - 3 + powers) + k * (np.exp(E) * F**3 + larger + stiff)
"""


def test_every_operation_of_an_energy_has_its_value_and_slope(tmp_path):
    path = tmp_path / "every.py"
    path.write_text(EVERY_OPERATION)
    own, plain = biaxbayes.law(str(path), c=3.0, k=5.0), {}
    exec(EVERY_OPERATION, plain)

    def energy(lx, ly):
        return plain["energy"](lx**2, ly**2, (lx * ly) ** -2, 3.0, 5.0)

    lx, ly = np.random.default_rng(2).uniform(0.9, 1.3, (2, 200))
    assert {*np.sign(lx - ly), *np.sign(lx**2 - 2 * ly**2 + 1)} == {-1.0, 1.0}
    np.testing.assert_allclose(
        own.strain_energy(lx, ly) - own.strain_energy(1.0, 1.0), energy(lx, ly) - energy(1.0, 1.0)
    )
    # s = l dW/dl of an incompressible sheet
    step = 1e-6
    x = (energy(lx * np.exp(step), ly) - energy(lx * np.exp(-step), ly)) / (2 * step)
    y = (energy(lx, ly * np.exp(step)) - energy(lx, ly * np.exp(-step))) / (2 * step)
    np.testing.assert_allclose(own.cauchy(lx, ly), (x, y), rtol=1e-6, atol=1e-6)


@pytest.mark.long
def test_goh_in_a_file_has_the_density_of_goh(own_goh):
    rng, n = np.random.default_rng(2), 100
    own, built_in = (
        Posterior(small_specimen(), law=str(name), noise="independent") for name in (own_goh, "goh")
    )
    values = {
        name: v * np.exp(0.3 * rng.standard_normal(n)) if name in ("C1", "k1", "k2") else None
        for name, v in VALUES.items()
    } | {"alpha": rng.uniform(5, 85, n), "kappa": rng.uniform(0.01, 0.32, n)}
    for name in built_in.free:
        if name not in values:
            values[name] = rng.uniform(1.0, 1.03, n)
    of_own, of_built_in = (
        evaluate(p.assembly.problem, p.coordinates(values)) for p in (own, built_in)
    )
    assert np.isfinite(of_own.log_prior).sum() > 50
    density = of_built_in.log_prior - of_built_in.log_jacobian
    np.testing.assert_allclose(of_own.log_prior - of_own.log_jacobian, density, rtol=1e-9)
    np.testing.assert_allclose(of_own.residual, of_built_in.residual, rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_a_law_is_kept_by_its_text_without_the_file(own_goh):
    posterior = Posterior(small_specimen(), law=str(own_goh), noise="independent")
    law = pickle.loads(pickle.dumps(posterior.law))
    stored = json.loads(json.dumps(settings_table(posterior)))
    own_goh.unlink()
    again = Posterior(small_specimen(), **parse_options(stored))
    assert again.law == law == posterior.law
    assert (law.name, law.title) == ("dispersed", "Dispersed fibres")
    u = np.random.default_rng(3).normal(0.0, 0.1, (5, posterior.dimension))
    np.testing.assert_array_equal(again.log_prob(u), posterior.log_prob(u))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("import numpy as np", "import os"), "line 2: `import os`"),
        (("third = 1 / 3", "third = open('x')"), "line 4: `open('x')`"),
        (("third = 1 / 3", "third = np.load('x')"), "line 4: `np.load`"),
        (("third = 1 / 3", "third = ().__class__"), "line 4: `().__class__`"),
        (("    spread", "    while 1: pass\n    spread"), "line 15: `while 1:`"),
        (("1 / 3", "1 / / 3"), "line 4: not valid Python"),
        (("third = 1 / 3", "third = fourth"), "name 'fourth' is not defined"),
        (("third = 1 / 3", "third = 9**9**9**9"), "cannot be read"),
        (("parameters =", "numbers ="), "`energy` and a table `parameters`"),
        (("C1, k1, k2, cos2_alpha", "C1, k1, k2, alpha"), "X, Y, Z, C1, k1, k2, cos2"),
        (('("lognormal", 10, 2),\n    "k1', '10,\n    "k1'), "C1_kPa has no prior"),
        (('"C1_kPa"', '"C 1"'), "'C 1' is not a valid name of a parameter"),
        (('"C1_kPa"', '"thickness"'), "'thickness' is not a valid name of a parameter"),
        (("np.exp(k2 * E**2) - 1", "np.exp(k2 * E**2)"), "kPa in the unloaded state; it must be 0"),
        (("C1 * (X", "C1**2 * (X"), "the energy is not proportional to C1"),
        (("k1 / k2 *", "-k1 / k2 *"), "the term of k1 gives no tension under equal stretches"),
        (("E = strain(X, Y, Z, cos2_alpha, kappa)", "E = F"), "cannot be computed: name 'F'"),
        (("np.exp(k2 * E**2)", "np.exp(k2 * E**2, E)"), "an energy cannot use np.exp with"),
        (('{"k2": "k2 E^2"}', '{"k3": "k3 E^2"}'), "`exponents` has to be like"),
        (('{"k2": "k2 E^2"}', '{"k2": "a", "kappa": "b"}'), "one formula for each exponential"),
        (("return C1 * (X + Y + Z - 3)", "return C1 * (X > 1)"), "unloaded state|no tension"),
        (("third = 1 / 3", 'third = "%1900000000f" % 1'), "line 4: `'%1900000000f'`"),
        (("third = 1 / 3", 'third = b"%1900000000f" % 1'), "line 4: `b'%1900000000f'`"),
        (("third = 1 / 3", "third = (1, 1)" + "\nthird = third + third" * 40), "line 4: `(1, 1)`"),
        (("third = 1 / 3", "third = not 1"), "line 4: `not 1`"),
        (
            ("third = 1 / 3", "two = (1 < 2) + (1 < 2)\nthird = two**two**two**two**two**two"),
            "read",
        ),
        (("def strain", f"{DOUBLING}\n\ndef strain"), "more than 1000 operations"),
        (("E = strain(", "E = energy("), "a function calls itself"),
        (("def strain(X, Y, Z", "def strain(energy, Y, Z"), "`energy` is not allowed"),
        (("E = strain(", "f = strain\n    E = f("), "`strain` is not allowed"),
        (("third = 1 / 3", "third = 1" + " + 1" * 6000), "more than 20,000 characters"),
    ],
)
def test_files_that_are_no_law_are_refused_in_one_line(own_goh, change, message):
    assert change[0] in GOH_FILE
    own_goh.write_text(GOH_FILE.replace(*change))
    with pytest.raises(InputError) as error:
        law_named(str(own_goh))
    text = f"{error.value}"
    assert re.search(message if "|" in message else re.escape(message), text), text
    assert "dispersed.py" in text and "\n" not in text


def test_a_file_that_is_missing_or_named_as_a_law_is_refused(tmp_path, own_goh, capsys):
    assert "no such file" in refused(capsys, "fit", tmp_path / "x.csv", "--law", tmp_path / "no.py")
    named = own_goh.rename(tmp_path / "goh.py")
    with pytest.raises(InputError, match="there is a law goh"):
        law_named(str(named))


@pytest.mark.long
def test_a_run_of_an_own_law_is_read_and_resumed_without_the_file(own_goh, tmp_path, capsys):
    out = tmp_path / "run"
    options = {"noise": "independent", "mounting": "exact", "ess": 60, "seed": 3}
    with runs_without_figures():
        biaxbayes.sample(small_specimen(), out=out, law=str(own_goh), **options)
        text = f"# dispersed.py\n{GOH_FILE}"
        own_goh.unlink()
        found = biaxbayes.open_run(out)
        assert found.provenance["settings"]["law"] == found.law.key == text
        assert found.result.law == "dispersed"
        options["ess"] = 90
        biaxbayes.sample(small_specimen(), out=out, law=text, resume=True, **options)
    code, printed, _ = run(capsys, "predict", out, "--anyway")
    assert code == 0, printed
    # what a run of a stranger says of its law is not run
    record = json.loads((out / "provenance.json").read_text())
    record["settings"]["law"] = text.replace("third = 1 / 3", "third = __import__('os').getpid()")
    (out / "provenance.json").write_text(json.dumps(record))
    with pytest.raises(RunError, match="is not allowed"):
        assert biaxbayes.open_run(out).law


def test_a_law_of_amplitudes_alone_is_fitted(tmp_path):
    """It has no exponents in which starting points could differ."""
    path = tmp_path / "yeoh.py"
    path.write_text(
        'parameters = {"C1_kPa": ("lognormal", 10, 2), "C2_kPa": ("lognormal", 30, 2.5)}\n'
        "def energy(X, Y, Z, C1, C2):\n"
        "    return C1 * (X + Y + Z - 3) + C2 * (X + Y + Z - 3) ** 2\n"
    )
    law = law_named(str(path))
    specimen, _ = virtual_specimen(
        law.checked_material({"C1": 8.0, "C2": 25.0}),
        name="rubber",
        mounting_stretch=(1.03, 1.02),
        total_stretch=1.3,
        machine=Machine(noise_N=1e-5),
        seed=1,
    )
    found = biaxbayes.fit(specimen, law=str(path))
    np.testing.assert_allclose(found.material.values, [8.0, 25.0], rtol=0.01)
    np.testing.assert_allclose(found.mounting_stretch, [[1.03, 1.02]], atol=0.001)


@pytest.mark.parametrize(
    ("parameters", "energy", "medians"),
    [
        ('"mu_kPa": ("lognormal", 10, 2)', "mu / 2", ()),
        ('"mu_kPa": ("lognormal", 10, 2), "a": ("normal", 0.5, 0.1)', "mu * (1 + a) / 2", (0.5,)),
    ],
)
def test_a_single_amplitude_carries_the_whole_load_of_a_scaled_prior(
    parameters, energy, medians, tmp_path
):
    """At the medians of what is no amplitude."""
    path = tmp_path / "neo.py"
    names = "mu, a" if medians else "mu"
    path.write_text(
        f"parameters = {{{parameters}}}\n"
        f"def energy(X, Y, Z, {names}):\n"
        f"    return {energy} * (X + Y + Z - 3)\n"
    )
    law = law_named(str(path))
    family, median, _ = law.scaled_prior(1.2, 40.0)["mu"]
    stress, _ = law.material_at([median, *medians]).cauchy(1.2, 1.2)
    assert family == "lognormal" and stress / 1.2 == pytest.approx(40.0)


def test_an_angle_of_any_name_that_looks_like_radians_is_warned_of(tmp_path, capsys):
    path = tmp_path / "dispersed.py"
    path.write_text(GOH_FILE.replace("alpha", "theta"))
    given = ("theta_deg=0.7", "k2=0.7")
    assert fixed_values(given, law_named(str(path))) == {"theta": 0.7, "k2": 0.7}
    warnings = capsys.readouterr().err
    assert "theta_deg=40.11" in warnings and "k2" not in warnings
