"""Verdicts on specimens whose answer is known, and each piece of evidence on its own."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import root
from scipy.stats import norm

from biaxbayes.derived.determined import determined
from biaxbayes.fitting.law_fits import CANDIDATE_LAWS
from biaxbayes.identifiability.identify import Identifiability, identify_draws, identify_run
from biaxbayes.identifiability.marginals import ComparisonScale, count_modes, density, range_ends
from biaxbayes.identifiability.partners import Partners, find_partners
from biaxbayes.identifiability.power_scaling import ends_by_prior, log_prior, sensitivity
from biaxbayes.identifiability.sloppiness import sloppiness
from biaxbayes.identifiability.verdict import (
    BOUNDED,
    COMBINATION,
    FIXED,
    IDENTIFIED,
    NO_VERDICT,
    NOT_IDENTIFIED,
)
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import DrawnPrior, Prior
from biaxbayes.parameters import Quantity
from biaxbayes.prediction.predictive_checks import predictive_checks
from biaxbayes.runs.run_result import run_result
from biaxbayes.sampling.convergence import assess
from goh_functions import GOH_LAW, PARAMETERS
from quick_posteriors import EQUIBIAXIAL, Sampled, sampled, specimen


def identify(run) -> Identifiability:
    """Assess a run, or anything with a posterior, draws and a state."""
    return identify_run(run.posterior(), run.draws, run.state)


# --- specimens built so that the answer is known ---

CASES = {
    "determined": {"material": GOH(10, 40, 5, 40, 0.15), "total_stretch": 1.25, "noise_N": 0.001},
    "isotropic": {"material": GOH(10, 40, 5, 30, 1 / 3), "total_stretch": 1.25},
    "aligned": {"material": GOH(10, 20, 5, 40, 0.0)},
    "low": {"material": GOH(10, 50, 5, 40, 0.2), "total_stretch": 1.05},
    "equibiaxial": {"material": GOH(10, 40, 5, 40, 0.15), "ratios": EQUIBIAXIAL, "noise_N": 0.005},
}


@cache
def case(name: str) -> Sampled:
    return sampled(specimen(**CASES[name]))


def test_three_ratios_to_high_stretch_determine_all_five():
    result = identify(case("determined"))
    assert [result[name].verdict for name in PARAMETERS] == [IDENTIFIED] * 5
    assert {f.law for f in result.fits.fits} == set(CANDIDATE_LAWS)
    assert all(result[name].diagnostics.contraction > 0.99 for name in PARAMETERS)


@pytest.mark.long
def test_the_angle_of_an_isotropic_material_is_not_determined():
    result = identify(case("isotropic"))
    assert result["kappa"].verdict == BOUNDED
    assert result["kappa"].diagnostics.ends[1].support > 0.147
    assert "isotropic" in result["kappa"].assessment.reason
    assert result["alpha"].verdict == NOT_IDENTIFIED
    assert "kappa = 1/3" in result["alpha"].assessment.reason
    # what does not depend on the angle is determined all the same
    assert result["C1"].verdict == result["k1"].verdict == result["k2"].verdict == IDENTIFIED


@pytest.mark.long
def test_low_stretch_does_not_determine_the_exponent():
    result = identify(case("low"))["k2"]
    assert result.verdict == NOT_IDENTIFIED
    assert result.diagnostics.contraction < 0.75
    assert result.diagnostics.ends[0].support > 0.147
    # the exponent carries prior information only: it moves with the prior more than any other
    assert result.diagnostics.prior_sensitivity > 0.05


@pytest.mark.long
def test_one_ratio_trades_dispersion_for_angle():
    result = identify(case("equibiaxial"))
    for name, other in (("kappa", "alpha"), ("alpha", "kappa")):
        assert other in result[name].diagnostics.partners.names
        assert result[name].diagnostics.partners.spread_given_partners < 0.5
    assert {result[name].verdict for name in ("alpha", "k1", "k2")} == {COMBINATION}
    # of the dispersion alone the data say no more than its range
    kappa = result["kappa"]
    assert kappa.verdict == NOT_IDENTIFIED and "as wide as the prior" in kappa.assessment.reason


def test_aligned_fibres_are_one_sided_not_undetermined():
    result = identify(case("aligned"))["kappa"]
    assert result.verdict == BOUNDED
    low, high = result.diagnostics.ends
    assert low.value == 0.0 and low.kind == "physical"
    assert low.mass > 10 * low.prior_mass and low.prior_mass == pytest.approx(0.06)
    assert high.support < 0.01
    assert "aligned fibres" in result.assessment.reason and result.assessment.bound == "high"


def test_a_stuck_chain_gives_no_verdict():
    good = case("determined")
    stuck = {name: q.copy() for name, q in good.chains.items()}
    for q in stuck.values():
        q[0] = q[0, :1, :1]  # the first ensemble has never moved
    state = assess(stuck, target_ess=150.0).state
    draws = pd.DataFrame({name: q.ravel() for name, q in stuck.items()})
    assert state == "unusable"
    result = identify_draws(good.posterior(), draws, state)
    assert {p.verdict for p in result.parameters} == {NO_VERDICT}
    assert all(p.diagnostics is None for p in result.parameters)  # no number to be misread either
    assert "not converged" in result["kappa"].assessment.reason


# --- draws made up, so that each rule is met alone ---


def made_up(priors=None, n=8000, **columns: np.ndarray) -> Sampled:
    """Draws from the prior, but for the columns given."""
    target = Posterior(specimen(GOH(10, 20, 5, 40, 0.15)), noise="independent", priors=priors or {})
    rng = np.random.default_rng(1)
    draws = {}
    for name in (*PARAMETERS, "mounting_stretch_x", "mounting_stretch_y"):
        prior = target.priors[name]
        fixed = prior if isinstance(prior, float | int) else 1.0
        draws[name] = prior.sample(rng, n) if isinstance(prior, Prior) else np.full(n, fixed)
    reading, sd = target.specimen.mounting_readings(shared=True)
    for k, axis in enumerate("xy"):
        draws[f"mounting_force_{axis}"] = rng.normal(reading[0, k], sd[0, k], n)
    draws |= {"noise_sd": np.full(n, 0.002), "log_likelihood": np.zeros(n)}
    return Sampled(target, pd.DataFrame(draws | columns), "converged", {})


def test_draws_from_the_prior_are_prior_dominated():
    result = identify(made_up(n=16_000))
    assert {p.verdict for p in result.parameters} == {NOT_IDENTIFIED}
    for p in result.parameters:
        assert abs(p.diagnostics.contraction) < 0.06
        assert p.diagnostics.prior_excluded < 0.03
        for end in p.diagnostics.ends:
            assert end.support > 0.5
            if end.mass > 0.02:
                assert end.mass == pytest.approx(end.prior_mass, rel=0.25)
    # the information is the prior's alone
    assert result["C1"].diagnostics.prior_sensitivity > 0.05
    assert result["C1"].diagnostics.likelihood_sensitivity < 0.01
    # a flat prior has no power to scale
    assert result["kappa"].diagnostics.prior_sensitivity < 0.01


@pytest.mark.parametrize("mirror", [0.0, 90.0])
def test_a_narrow_angle_at_a_mirror_is_identified(mirror):
    away = np.abs(np.random.default_rng(8).normal(0.0, 2.0, 8000))
    kappa = np.random.default_rng(9).normal(0.15, 0.01, 8000)
    result = identify(made_up(alpha=np.abs(mirror - away), kappa=kappa))["alpha"]
    assert result.verdict == IDENTIFIED
    assert result.diagnostics.ends == ()
    assert result.diagnostics.modes == 1


def test_a_measured_angle_is_known_from_the_prior_not_from_the_data():
    rng = np.random.default_rng(3)
    priors = {"alpha": {"distribution": "normal", "mean": 41.0, "sd": 3.0}}
    result = identify(made_up(priors=priors, alpha=rng.normal(41.0, 2.9, 8000)))["alpha"]
    assert result.verdict == NOT_IDENTIFIED


def test_fixed_and_tied_parameters_are_named():
    result = identify(made_up(priors={"kappa": 0.1}))
    assert result["kappa"].verdict == FIXED
    assert "kappa" not in {row.name for row in result.reported}
    judged = [p.diagnostics for p in result.parameters if p.diagnostics is not None]
    assert judged and not any("kappa" in diagnostics.partners.names for diagnostics in judged)


def test_a_ridge_names_all_who_move_along_it():
    rng = np.random.default_rng(4)
    kappa = rng.uniform(0.02, 0.3, 8000)
    alpha = 30.0 + 400.0 * kappa**2 + rng.normal(0.0, 0.3, 8000)
    k1 = np.exp(3.0 + 6.0 * kappa + rng.normal(0.0, 0.02, 8000))
    result = identify(made_up(kappa=kappa, alpha=alpha, k1=k1))
    assert result["kappa"].verdict == COMBINATION
    assert set(result["kappa"].diagnostics.partners.names) == {"alpha", "k1"}
    assert "trades with" in result["kappa"].assessment.reason


# --- pieces of evidence ---


def test_partners_reproduce_a_known_conditional_spread():
    rng = np.random.default_rng(5)
    x, noise, free = rng.normal(size=(3, 12000))
    y = 0.8 * x + 0.5 * x**2 + 0.3 * noise
    result = find_partners(np.column_stack([x, y, free]), ("x", "y", "free"))
    assert result["y"].names == ("x",)
    # sd of y is sqrt(0.64 + 2 * 0.25 + 0.09)
    assert result["y"].spread_given_all == pytest.approx(0.3 / np.sqrt(1.23), rel=0.03)
    assert result["free"].names == () and result["free"].spread_given_all > 0.98


def test_a_parameter_alone_has_no_partners():
    x = np.random.default_rng(5).normal(size=(1000, 1))
    assert find_partners(x, ("x",))["x"] == Partners((), 1.0, 1.0)


def test_a_prior_given_by_draws_has_the_log_density_of_its_distribution():
    rng = np.random.default_rng(7)
    quantity = Quantity(GOH_LAW.parameter("alpha"))
    stated = Prior("normal", 40.0, 3.0)
    drawn = DrawnPrior(stated.ppf(rng.random(200_000)))
    draws = pd.DataFrame({"alpha": np.linspace(34.0, 46.0, 50)})
    logs = [log_prior((ComparisonScale(quantity, prior),), draws) for prior in (stated, drawn)]
    np.testing.assert_allclose(np.ptp(logs[1] - logs[0]), 0.0, atol=0.1)


def test_partners_that_tell_nothing_alone_are_named_together():
    rng = np.random.default_rng(6)
    a, b, c, free, noise = rng.normal(size=(5, 12000))
    names = ("y", "a", "b", "c", "free")
    # neither a nor b alone takes a fifth off the spread of a product
    product = a * b + 0.1 * noise
    result = find_partners(np.column_stack([product, a, b, c, free]), names)["y"]
    assert set(result.names) == {"a", "b"}
    assert result.spread_given_partners == pytest.approx(0.1 / np.sqrt(1.01), rel=0.05)
    # each of three leaves 0.82 of the spread, all of them 0.1
    total = a + b + c + 0.17 * noise
    result = find_partners(np.column_stack([total, a, b, c, free]), names)["y"]
    assert set(result.names) == {"a", "b", "c"}
    assert result.spread_given_partners == pytest.approx(0.17 / np.sqrt(3.03), rel=0.05)


@pytest.mark.parametrize(("third", "partners"), [(0.60, "ab"), (0.78, "abc")])
def test_partners_suffice_where_all_others_narrow_by_a_quarter_at_most(third, partners):
    """Given a and b, the sd is 1.2 times that given all, or 1.32 times."""
    rng = np.random.default_rng(8)
    a, b, c, noise = rng.normal(size=(4, 12000))
    y = 2.0 * a + 0.8 * b + third * c + 0.9 * noise
    result = find_partners(np.column_stack([y, a, b, c]), ("y", "a", "b", "c"))["y"]
    assert "".join(sorted(result.names)) == partners


@pytest.mark.parametrize("half", [0, 1])
def test_a_peak_that_one_half_of_the_draws_shows_is_no_mode(half):
    draws = np.random.default_rng(3).normal(size=4000)
    both = draws.copy()
    both[::8], both[1::8] = both[::8] + 9.0, both[1::8] + 9.0
    assert count_modes(both) == 2
    draws[half::4] += 9.0
    assert count_modes(draws) == 1


@pytest.mark.parametrize("seed", range(5))
def test_modes_are_counted_and_noise_is_not(seed):
    rng = np.random.default_rng(seed)
    assert count_modes(rng.normal(size=4000)) == 1
    assert count_modes(rng.uniform(0.0, 1.0, 4000), (0.0, 1.0)) == 1
    assert count_modes(np.abs(rng.normal(size=4000)), (0.0, np.inf)) == 1
    two = np.where(rng.random(4000) < 0.3, rng.normal(5.0, 1.0, 4000), rng.normal(size=4000))
    assert count_modes(two) == 2
    rare = np.where(rng.random(4000) < 0.01, rng.normal(9.0, 1.0, 4000), rng.normal(size=4000))
    assert count_modes(rare) == 1
    assert count_modes(np.full(100, 2.5)) == 1


def test_edge_support_is_a_likelihood_ratio():
    # kappa with a flat prior and a normal likelihood around 0.03, cut at zero
    rng = np.random.default_rng(7)
    for z in (0.5, 1.5, 3.0):
        draws = rng.normal(0.03, 0.03 / z, 60_000)
        draws = draws[(draws > 0.0) & (draws < 1 / 3)]
        scale = ComparisonScale(
            Quantity(GOH_LAW.parameter("kappa")), Prior("uniform", low=0.0, high=1 / 3)
        )
        likelihood = density(scale.prior.cdf(draws), (0.0, 1.0))
        low, _ = range_ends(scale, draws, likelihood, 0.02)
        assert low.support == pytest.approx(np.exp(-0.5 * z * z), abs=0.04)
        assert low.mass == pytest.approx((draws < 0.02).mean())


def test_power_scaling_moves_a_normal_as_theory_says():
    # A normal sample scaled by N(0, 1)^(a - 1) is normal again, with precision a.
    x = norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    a = 1.01
    grid = np.linspace(x[0], x[-1], 200_001)
    P, Q = norm.cdf(grid), norm.cdf(grid * np.sqrt(a))
    M = 0.5 * (P + Q)
    step = grid[1] - grid[0]
    expected = np.sqrt(
        np.sum(P * np.log2(P / M) + Q * np.log2(Q / M)) * step / (np.sum(P + Q) * step)
    )
    result = sensitivity(x[:, None], -0.5 * x * x)[0]
    assert result == pytest.approx(expected / np.log2(a), rel=0.02)


def test_an_end_that_the_prior_decides_is_named():
    """Draws of prior times likelihood, both normal, and of a prior that the data cut from below."""
    z = norm.ppf((np.arange(20_000) + 0.5) / 20_000)

    def decided(centre: float, sd: float) -> tuple[bool, bool]:
        # posterior under the prior N(0, 1) and a likelihood N(centre, sd)
        weight = 1.0 / (1.0 + sd**2)
        x = weight * centre + np.sqrt(weight) * sd * z
        return ends_by_prior(x, -0.5 * x * x)

    assert decided(0.0, 1e3) == decided(0.0, 1.0) == (True, True)
    assert decided(0.0, 0.3) == decided(1.0, 0.1) == (False, False)
    # drawn far from where the data have it
    assert decided(3.0, 0.5) == (True, True)
    cut = np.abs(z)
    assert ends_by_prior(cut, -0.5 * cut * cut) == (False, True)
    flat = np.linspace(0.0, 1.0, 1000)
    assert ends_by_prior(flat, np.zeros(1000)) == (False, False)


# --- what is written ---


def result_of(made, state="converged"):
    result = identify_draws(made.target, made.draws, state)
    result = replace(result, checks=predictive_checks(made.target, made.draws))
    return result, run_result(result, made.target, made.draws, pd.DataFrame(), {})


def test_a_mounting_stretch_alone_calls_for_a_photograph():
    """More parameters that are not identified call for a test, and none for nothing."""
    made = case("determined")
    posterior, draws = made.posterior(), made.draws
    result = identify_draws(posterior, draws, "converged")
    result = replace(result, checks=predictive_checks(posterior, draws))

    def advice(*unknown: str) -> str:
        of = {
            p.name: NOT_IDENTIFIED if p.name in unknown else IDENTIFIED for p in result.parameters
        }
        parameters = tuple(
            replace(p, assessment=replace(p.assessment, verdict=of[p.name]))
            for p in result.parameters
        )
        judged = replace(result, parameters=parameters)
        return run_result(judged, posterior, draws, pd.DataFrame(), {}).advice

    assert advice() == ""
    text = advice("mounting_stretch_y")
    assert "photograph two marks" in text and "# mounting_stretch_y: VALUE +- SD" in text
    assert "mounting_stretch_x" not in text
    text = advice("mounting_stretch_y", "k2")
    assert "photograph" not in text and "cut two strips" in text


# --- what is determined, and what moves freely ---


def test_determined_quantities_are_those_of_the_material():
    material = GOH(10.0, 40.0, 5.0, 40.0, 0.15)
    made = made_up(
        **{n: np.full(8000, v) for n, v in zip(PARAMETERS, material.values, strict=True)}
    )
    lx, ly = 1.12, 1.07
    table = determined(made.target, made.draws, stretches=[(lx, ly)])
    value = dict(zip(table["quantity"], table["median"], strict=True))
    np.testing.assert_allclose([value[n] for n in ("Hx", "Hy", "Hz")], material.structure_tensor())
    h = 1e-30
    # complex step: d s / d ln l = Im s(l exp(i h)) / h
    for at, stem in (((lx, ly), "tangent stiffness"), ((1.0, 1.0), "small-strain stiffness")):
        by_x = material.cauchy(at[0] * np.exp(1j * h), at[1])
        by_y = material.cauchy(at[0], at[1] * np.exp(1j * h))
        assert value[f"{stem} xx"] == pytest.approx(by_x[0].imag / h)
        assert value[f"{stem} xy"] == pytest.approx(by_y[0].imag / h)
        assert value[f"{stem} yy"] == pytest.approx(by_y[1].imag / h)
    # the Cauchy stress is the derivative of the energy by the log stretch
    energy = material.strain_energy(lx * np.exp(1j * h), ly)
    assert value["Cauchy stress x"] == pytest.approx(energy.imag / h)
    assert value["strain energy"] == pytest.approx(energy.real)
    Hx, Hy, Hz = material.structure_tensor()
    E = Hx * lx**2 + Hy * ly**2 + Hz / (lx * ly) ** 2 - 1.0
    assert value["exponent k2 E^2"] == pytest.approx(5.0 * E * E)


def test_traded_parameters_leave_the_stress_determined():
    made = case("equibiaxial")
    table = determined(made.target, made.draws)
    stress = table[table["quantity"].isin(("Cauchy stress x", "Cauchy stress y"))]
    assert stress["relative_width"].max() < 0.1
    low, high = np.quantile(made.draws["kappa"], [0.05, 0.95])
    assert high - low > 0.15


def loads_along(material: GOH, load: np.ndarray, data) -> np.ndarray:
    """Stress of every row, from the mounting load alone, with SciPy's root finder."""
    balance = root(
        lambda lm: np.array(material.piola(*lm)) - load / data.area, [1.01, 1.01], tol=1e-13
    )
    assert balance.success
    each = [material.piola(*(p.stretch * balance.x).T) for p in data.protocols]
    return np.concatenate(each, axis=None)


def test_the_sloppy_direction_changes_the_curves_by_what_is_reported():
    made = case("equibiaxial")
    result = sloppiness(made.posterior(), made.draws)
    path = result.path
    low, high = np.quantile(made.draws[path.moved], [0.05, 0.95])
    ends = path.materials.iloc[[0, -1]]
    np.testing.assert_allclose(ends[path.moved], [low, high], atol=0.01 * (high - low))
    assert high - low > 0.15  # it is a long way
    stretches = ["mounting_stretch_x", "mounting_stretch_y"]
    assert list(path.to_frame()) == [*PARAMETERS, *stretches]
    np.testing.assert_array_equal(path.to_frame()[stretches], path.mounting_stretch[:, 0])
    materials = [GOH(*map(float, row)) for row in path.materials[list(PARAMETERS)].to_numpy()]
    load, data = path.mounting_load[0], made.target.specimen
    curves = [loads_along(material, load, data) for material in materials]
    change = max(np.abs(curve - curves[0]).max() for curve in curves)
    assert change == pytest.approx(path.change_kPa, rel=1e-3)
    most_kPa = float(re.search(r"by more than ([\d.e-]+) kPa", result.text)[1])
    assert change <= most_kPa <= 1.12 * change
    # less than one reading errs by
    assert change < float(re.search(r"errs by ([\d.e-]+) kPa", result.text)[1])
    for name in ("C1", "k1", "k2"):
        ratio = float(re.search(rf"{name} times ([\d.]+)", result.text)[1])
        assert ratio == pytest.approx(ends[name].iloc[1] / ends[name].iloc[0], rel=0.01)
    for name, unit, digits in (("kappa", "", 1e-3), ("alpha", " degrees", 0.1)):
        way, step = re.search(rf"{name} (up|down) ([\d.]+){unit}", result.text).groups()
        moved = ends[name].iloc[1] - ends[name].iloc[0]
        assert (1.0 if way == "up" else -1.0) * float(step) == pytest.approx(moved, abs=digits)


def test_the_stiff_direction_is_the_known_one():
    rng = np.random.default_rng(10)
    C1 = np.exp(rng.normal(2.0, 0.5, 8000))
    k1 = 30.0 / np.sqrt(C1) * np.exp(rng.normal(0.0, 0.01, 8000))
    rest = {"k2": np.exp(rng.normal(1.0, 0.4, 8000)), "kappa": rng.uniform(0.05, 0.3, 8000)}
    made = made_up(C1=C1, k1=k1, alpha=rng.uniform(20.0, 60.0, 8000), **rest)
    stiff = sloppiness(made.target, made.draws).directions[0]
    # k1 C1^0.5 is known to 1.645 % (90 %)
    assert stiff["in_words"].startswith("best known: C1^0.5 k1,")
    assert "to 1.7 % (90 %)" in stiff["in_words"]


def test_ties_and_fixed_materials_have_no_sloppy_direction():
    mild = np.random.default_rng(12).uniform(1.0, 3.0, 8000)
    tied = made_up(priors={"k1": "2.0 * C1"}, k2=mild)
    tied = tied._replace(draws=tied.draws.assign(k1=2.0 * tied.draws["C1"]))
    _, result = result_of(tied)
    assert not result.directions and len(result.determined)
    assert "k1" not in {r.name for r in result.reported}
    fixed = dict(zip(PARAMETERS, (10.0, 20.0, 5.0, 40.0, 0.15), strict=True))
    fixed_run = made_up(priors=fixed)
    assert sloppiness(fixed_run.target, fixed_run.draws) is None
    assert identify(fixed_run)["C1"].verdict == FIXED
