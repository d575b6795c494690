"""Laws weighed by what they predict: stacking against an optimiser, the verb and its files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import beta, norm

import biaxbayes
from biaxbayes.comparison.law_comparison import (
    MAX_LAW_DRAWS,
    MAX_PART_DRAWS,
    WHOLE,
    Prediction,
    Task,
    left_out_parts,
    only,
    sample_part,
    without,
)
from biaxbayes.comparison.law_weights import STACKED, weigh_laws
from biaxbayes.comparison.mixture import (
    LEAST_SHARPNESS,
    PRIOR_READINGS,
    SHARPNESS_LOG_SD,
    calibrated_levels,
    mixed_percentiles,
    mixed_probabilities,
    mixture_bands,
    mixture_draws,
    sharpness,
    stacking_weights,
    weighted_density,
)
from biaxbayes.errors import InputError, Interrupted, NotConverged
from biaxbayes.identifiability.mounting_interval import MEASURED_REASON, interval_from_predictions
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.specimens.specimen_file import write_specimen
from commands import exit_code
from quick_posteriors import small_specimen
from quick_posteriors import specimen as specimen_of

LAWS = "goh,hgo"


def test_stacking_weights_are_those_of_an_optimiser():
    rng = np.random.default_rng(4)
    for models in (2, 3, 5):
        density = rng.normal(0.0, 2.0, (models, 60)) + rng.normal(0.0, 0.5, (models, 1))
        worth = rng.uniform(0.05, 1.0, 60)

        def loss(z, density=density, worth=worth):
            w = np.exp(z - np.logaddexp.reduce(z))
            mixed = np.logaddexp.reduce(density + np.log(w)[:, None], axis=0)
            return -(worth @ mixed) - PRIOR_READINGS * np.log(w).mean()

        z = minimize(loss, np.zeros(models), method="BFGS", options={"gtol": 1e-9}).x
        expected = np.exp(z - np.logaddexp.reduce(z))
        result = stacking_weights(density, worth)
        np.testing.assert_allclose(result, expected, atol=2e-6)
        assert result.sum() == pytest.approx(1.0)
        # never below what the best single model predicts, less what the prior asks for
        mixed = worth @ weighted_density(density, result)
        assert mixed > (density @ worth).max() - models * np.log(1e3)


def test_nothing_to_tell_apart_leaves_equal_weights():
    same = np.tile(np.linspace(-3.0, 0.0, 20), (4, 1))
    np.testing.assert_allclose(stacking_weights(same, np.ones(20)), 0.25)
    # a reading that no model allows says nothing
    barred = np.hstack([same, np.full((4, 1), -np.inf)])
    np.testing.assert_allclose(stacking_weights(barred, np.ones(21)), 0.25)


def test_levels_of_a_mixture_that_spreads_too_wide_hold_what_they_say():
    """Two models of unlike bias, each right about its own error: Gneiting and Ranjan's example."""
    rng = np.random.default_rng(8)
    readings, draws = 4000, 50
    first, second = rng.normal(0.0, 1.0, (2, readings))
    measured = first + second + rng.normal(0.0, 0.5, readings)
    model = [np.tile(seen, (draws, 1)) for seen in (first, second)]
    sd = [np.full((draws, readings), np.sqrt(1.25))] * 2
    weight = np.array([0.5, 0.5])
    probability = mixed_probabilities(measured, model, sd, weight)
    half = readings // 2
    c = sharpness(probability[:half], np.ones(half))

    def coverage(levels):
        low, high = mixed_percentiles(model, sd, weight, levels)
        return np.mean(((low <= measured) & (measured <= high))[half:])

    assert c > 1.1
    assert coverage((0.05, 0.95)) > 0.925
    # 0.015 is two Monte Carlo errors of 2,000 readings
    assert coverage(calibrated_levels((0.05, 0.95), c)) == pytest.approx(0.9, abs=0.015)
    # the levels themselves are those of the beta distribution, and one half stays one half
    assert calibrated_levels((0.05, 0.5, 0.95), 1.0) == pytest.approx((0.05, 0.5, 0.95))
    low, middle, high = calibrated_levels((0.05, 0.5, 0.95), c)
    assert 0.05 < low < middle < high < 0.95
    assert beta(c, c).cdf(low) == pytest.approx(0.05)


def test_probabilities_of_a_mixture_are_those_of_its_parts_and_of_its_percentiles():
    rng = np.random.default_rng(3)
    measured = rng.normal(0.0, 2.0, 40)
    model = [rng.normal(m, 0.5, (400, 40)) for m in (-1.0, 2.0)]
    sd = [np.full((400, 40), s) for s in (0.5, 1.5)]
    weight = np.array([0.75, 0.25])
    result = mixed_probabilities(measured, model, sd, weight)
    expected = sum(
        w * norm.cdf(measured, m, s).mean(axis=0) for w, m, s in zip(weight, model, sd, strict=True)
    )
    np.testing.assert_allclose(result, expected, rtol=1e-12)
    (at,) = mixed_percentiles(model, sd, weight, (0.3,))
    # percentiles take draws in proportion to the weights, 400 in all
    np.testing.assert_allclose(mixed_probabilities(at, model, sd, weight), 0.3, atol=0.02)
    # one draw that overflows says nothing, a law of nothing else has no part
    model[0][7, :5], sd[0][7, :5] = np.inf, np.inf
    again = mixed_probabilities(measured, model, sd, weight)
    np.testing.assert_allclose(again, result, atol=2e-3)
    model[0][:, 0], sd[0][:, 0] = np.inf, np.inf
    alone = norm.cdf(measured[0], model[1][:, 0], sd[1][:, 0]).mean()
    assert mixed_probabilities(measured, model, sd, weight)[0] == pytest.approx(alone)


def test_uniform_probabilities_and_few_readings_leave_the_levels():
    u = (np.arange(500) + 0.5) / 500
    assert sharpness(u, np.ones(500)) == pytest.approx(1.0, abs=0.01)
    narrow = 0.5 + 0.2 * (u - 0.5)
    assert sharpness(narrow, np.full(500, 1e-4)) == pytest.approx(1.0, abs=0.05)
    assert sharpness(narrow, np.ones(500)) > 5.0
    assert sharpness(np.r_[0.0, u, 1.0], np.ones(502)) < 1.0
    assert sharpness(np.r_[np.nan, u], np.r_[50.0, np.ones(500)]) == pytest.approx(1.0, abs=0.01)
    assert sharpness(np.zeros(9), np.ones(9)) == pytest.approx(LEAST_SHARPNESS, abs=1e-3)


def test_sharpness_is_the_mode_of_a_beta_likelihood_and_a_lognormal_prior():
    rng = np.random.default_rng(4)
    u, worth = beta(3.0, 3.0).rvs(60, random_state=rng), rng.uniform(0.2, 1.0, 60)

    def minus_log_density(log_c):
        c = np.exp(log_c)
        return -worth @ beta.logpdf(u, c, c) - norm.logpdf(log_c, 0.0, SHARPNESS_LOG_SD)

    expected = np.exp(minimize_scalar(minus_log_density, bracket=(0.0, 1.0)).x)
    assert 1.2 < expected < 2.9  # neither the prior's nor the likelihood's own
    assert sharpness(u, worth) == pytest.approx(expected, rel=1e-4)


@pytest.fixture(scope="module")
def two_laws():
    """Draws of GOH, and of the same with aligned fibres, that scatter in C1 alone."""
    specimen = small_specimen()
    values = {"k1": 60.0, "k2": 8.0, "alpha": 38.0, "noise_sd": 0.01}
    values |= {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02}
    common = pd.DataFrame([values] * 2000).assign(C1=np.linspace(10.0, 18.0, 2000))
    drawn = {"goh": common.assign(kappa=0.1), "hgo": common}
    result = {
        (law, WHOLE): Prediction("converged", "", 0.1, (), table) for law, table in drawn.items()
    }
    posteriors = {law: Posterior(specimen, law=law, noise="independent") for law in drawn}
    return specimen, result, posteriors


def test_draws_of_the_mixture_are_those_of_each_law_by_its_weight(two_laws):
    specimen, result, posteriors = two_laws
    drawn = mixture_draws(specimen, list(posteriors), np.array([0.7, 0.3]), result, posteriors)
    assert drawn["law"].value_counts().to_dict() == {"goh": 1400, "hgo": 600}
    assert drawn.index.tolist() == list(range(2000))
    for law, kappa in (("goh", 0.1), ("hgo", 0.0)):
        own = drawn[drawn["law"] == law]
        first, last = own.iloc[0], own.iloc[-1]
        for row, C1 in ((first, 10.0), (last, 18.0)):
            material = GOH(C1, 60.0, 8.0, 38.0, kappa)
            p = specimen.protocols[1]
            stress = material.cauchy(1.01 * p.stretch_x.max(), 1.02 * p.stretch_y.max())
            output = [row[f"cauchy_{axis}_kPa[{p.name}]"] for axis in "xy"]
            assert output == pytest.approx(np.ravel(stress), rel=1e-3)
            # d s_x / d ln l_x by central differences
            h = np.exp(1e-5)
            slope = [
                (material.cauchy(h, 1.0)[0] - material.cauchy(1.0 / h, 1.0)[0]) / 2e-5,
                (material.cauchy(1.0, h)[1] - material.cauchy(1.0, 1.0 / h)[1]) / 2e-5,
            ]
            output = [row["stiffness_xx_kPa"], row["stiffness_yy_kPa"]]
            assert output == pytest.approx(np.ravel(slope), rel=1e-3)
        np.testing.assert_allclose(own["mounting_stretch_y"], 1.02)
    alone = mixture_draws(specimen, list(posteriors), np.array([1.0, 0.0]), result, posteriors)
    assert set(alone["law"]) == {"goh"}


def test_bands_of_a_mixture_of_one_law_are_those_of_its_draws(two_laws):
    specimen, result, posteriors = two_laws
    table = result["goh", WHOLE].draws
    middle = {("goh", WHOLE): replace(result["goh", WHOLE], draws=table.assign(C1=14.0))}
    one = np.array([1.0])
    bands = mixture_bands(specimen, ["goh"], one, middle, posteriors, 1.0)
    p = specimen.protocols[2]
    own = bands[(bands["protocol"] == p.name) & (bands["direction"] == "y")]
    lm = (1.01, 1.02)
    stress = GOH(14.0, 60.0, 8.0, 38.0, 0.1).cauchy(lm[0] * p.stretch_x, lm[1] * p.stretch_y)[1]
    # f_y = s_y A_y / l_y, of unloaded dimensions
    load = (stress * specimen.area[1] / (lm[1] * p.stretch_y))[p.rest_rows :]
    for q, z in (("q05", norm.ppf(0.05)), ("q50", 0.0), ("q95", norm.ppf(0.95))):
        np.testing.assert_allclose(own[f"credible_{q}"], load, rtol=1e-6)
        np.testing.assert_allclose(own[f"predictive_{q}"], load + 0.01 * z, rtol=1e-6, atol=1e-8)


def test_draws_of_a_law_without_a_part_have_the_columns_of_its_run():
    specimen = small_specimen()
    options = {"noise": "independent", "mounting": "exact"}
    for part, kept in ((None, MAX_LAW_DRAWS), (left_out_parts(specimen)[0], MAX_PART_DRAWS)):
        task = Task("goh", specimen, part, options, seed=1, ess=20.0, max_steps=64)
        result = sample_part(task)
        assert len(result.draws) == kept
        shown = specimen if part is None else without(specimen, part)
        target = Posterior(shown, **options)
        expected = set(target.target().quantities(np.zeros((1, target.dimension))))
        assert set(result.draws) == expected
        assert [len(r) for r in result.residuals] == [p.rows - p.rest_rows for p in shown.protocols]


SD = 0.002


def predicted(geometry="unloaded", increments=8, **states):
    """Two laws that predict three protocols with one material each, the second 5 % too stiff."""
    made = specimen_of(GOH(14.0, 60.0, 8.0, 38.0, 0.1), increments=increments)
    specimen = replace(made, geometry=geometry)
    rng = np.random.default_rng(2)
    result = {}
    for law, k1, kappa in (("goh", 60.0, {"kappa": 0.1}), ("hgo", 63.0, {})):
        values = {"C1": 14.0, "k1": k1, "k2": 8.0, "alpha": 38.0, "noise_sd": SD, **kappa}
        values |= {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02}
        residuals = tuple(
            rng.normal(0.0, SD, (p.rows - p.rest_rows, 2)) for p in specimen.protocols
        )
        for name in (WHOLE, *(p.name for p in specimen.protocols)):
            state = states.get(law, "converged")
            reason = "" if state == "converged" else f"{state} for a reason"
            rmse_kPa = 0.1 if law == "goh" else 0.2
            table = pd.DataFrame([values] * 20)
            result[law, name] = Prediction(state, reason, rmse_kPa, residuals, table)
    return specimen, result


def misses(specimen, k1, kappa):
    """Measured less computed loads of each protocol, (rows, 2), and kPa of Cauchy stress a load."""
    material, out = GOH(14.0, k1, 8.0, 38.0, kappa), []
    for p in specimen.protocols:
        measured = np.column_stack([p.stretch_x, p.stretch_y])[p.rest_rows :]
        total = measured * (1.01, 1.02)
        # f_k = s_k A_k / l_k of the dimensions that were measured
        area = np.array(specimen.area) / (measured if specimen.geometry == "mounted" else total)
        load = np.column_stack(material.cauchy(*total.T)) * area
        out.append((np.column_stack([p.load_x, p.load_y])[p.rest_rows :] - load, area))
    return out


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_laws_are_weighed_by_densities_and_misses_that_can_be_computed_by_hand(geometry):
    specimen, result = predicted(geometry)
    judged = weigh_laws(specimen, {"noise": "independent"}, result, ["goh", "hgo"])
    table, parts = judged.table.set_index("law"), judged.parts
    assert judged.converged and judged.left_out == {}
    assert list(table.index) == ["goh", "hgo", STACKED]
    for law, k1, kappa in (("goh", 60.0, 0.1), ("hgo", 63.0, 0.0)):
        own = parts[parts["law"] == law]
        assert own["part"].tolist() == [p.name for p in specimen.protocols]
        square, size = 0.0, 0
        for (miss, area), (_, row) in zip(misses(specimen, k1, kappa), own.iterrows(), strict=True):
            density = norm.logpdf(miss, 0.0, SD).sum()
            assert row["left_out_density_nats"] == pytest.approx(density, rel=1e-9)
            in_kPa = miss / area
            assert row["left_out_rms_kPa"] == pytest.approx(np.sqrt((in_kPa**2).mean()), rel=1e-9)
            half = norm.ppf(0.95) * SD
            assert row["band_coverage"] == pytest.approx((np.abs(miss) <= half).mean())
            assert row["band_width"] == pytest.approx((2 * half / area).mean(), rel=1e-6)
            assert row["readings"] == row["effective_readings"] == miss.size
            square, size = square + (in_kPa**2).sum(), size + miss.size
        assert table["left_out_rms_kPa"][law] == pytest.approx(np.sqrt(square / size), rel=1e-9)
        assert table["left_out_density_nats"][law] == pytest.approx(
            own["left_out_density_nats"].sum()
        )
        for at in ("q05", "q50", "q95"):
            assert table[f"mounting_stretch_y_{at}"][law] == pytest.approx(1.02)
    assert table["weight"]["goh"] > 0.9
    assert table["weight"][["goh", "hgo"]].sum() == pytest.approx(1.0)
    low, high = table["weight_low"]["goh"], table["weight_high"]["goh"]
    assert 0.5 < low <= high < 1.0
    mixture = parts[parts["law"] == STACKED]
    assert mixture["weight"].tolist() == [1.0] * 3
    shares = {law: f"{table['weight'][law]:.2f}" for law in ("goh", "hgo")}
    assert repr(judged) == f"LawComparison(virtual: goh {shares['goh']}, hgo {shares['hgo']})"
    assert table["left_out_density_nats"][STACKED] == pytest.approx(
        mixture["left_out_density_nats"].sum()
    )
    sizes = mixture["readings"] / mixture["readings"].sum()
    rms = np.sqrt((sizes * mixture["left_out_rms_kPa"] ** 2).sum())
    assert table["left_out_rms_kPa"][STACKED] == pytest.approx(rms, rel=1e-9)
    assert set(judged.draws["law"]) == {"goh", "hgo"}
    assert len(judged.bands) == mixture["readings"].sum()
    for axis, middle in (("x", 1.01), ("y", 1.02)):
        (row,) = (r for r in judged.reported if r.name == f"mounting_stretch_{axis}")
        margin = 0.09 * (middle - 1.0)
        assert (row.low, row.high) == (
            pytest.approx(middle - margin),
            pytest.approx(middle + margin),
        )


def test_weights_of_the_other_parts_alone_and_of_none():
    specimen, result = predicted()
    judged = weigh_laws(specimen, {"noise": "independent"}, result, ["goh", "hgo"])
    # of the first part, by the weights that the other two alone give
    others = np.array(
        [
            np.concatenate([norm.logpdf(miss, 0.0, SD).ravel() for miss, _ in missed[1:]])
            for missed in (misses(specimen, 60.0, 0.1), misses(specimen, 63.0, 0.0))
        ]
    )
    expected = stacking_weights(others, np.ones(others.shape[1]))
    mixture = judged.parts[judged.parts["law"] == STACKED].set_index("part")
    first = np.concatenate([m.ravel() for m, _ in misses(specimen, 60.0, 0.1)[:1]])
    second = np.concatenate([m.ravel() for m, _ in misses(specimen, 63.0, 0.0)[:1]])
    density = np.log(expected @ np.exp(norm.logpdf([first, second], 0.0, SD))).sum()
    name = specimen.protocols[0].name
    assert mixture["left_out_density_nats"][name] == pytest.approx(density, rel=1e-9)


def test_levels_of_bands_come_from_the_other_parts_alone():
    """A part that is missed widens the bands of the others and not its own."""
    specimen, result = predicted()
    first, *rest = specimen.protocols
    load = first.load_x + np.where(np.arange(first.rows) < first.rest_rows, 0.0, 5.0 * SD)
    missed = replace(specimen, protocols=(replace(first, load_x=load), *rest))

    def levels(measured, result=result, noise="independent"):
        judged = weigh_laws(measured, {"noise": noise}, result, ["goh", "hgo"])
        mixture = judged.parts[judged.parts["law"] == STACKED]
        np.testing.assert_allclose(mixture["band_low_level"] + mixture["band_high_level"], 1.0)
        return mixture["band_low_level"].to_numpy()

    before, after = levels(specimen), levels(missed)
    assert after[0] == pytest.approx(before[0], rel=1e-9)
    assert (after[1:] < before[1:] - 0.005).all()
    # smooth residuals: the readings of a part are worth little, and have as little to say
    smooth = {
        key: replace(
            p, residuals=tuple(SD * np.sin(np.cumsum(0.3 + 0 * r, 0)) for r in p.residuals)
        )
        for key, p in result.items()
    }
    light = levels(missed, smooth, "effective")
    assert (np.abs(light[1:] - 0.05) < 0.45 * np.abs(after[1:] - 0.05)).all()


def test_single_readings_are_predicted_whatever_the_posterior_averages():
    specimen, result = predicted(increments=40)
    judged = weigh_laws(specimen, {"noise": "effective", "thin": 10}, result, ["goh", "hgo"])
    own = judged.parts[judged.parts["law"] == "goh"]
    assert own["readings"].tolist() == [2 * (p.rows - p.rest_rows) for p in specimen.protocols]


def test_laws_that_failed_or_have_not_converged_are_named():
    specimen, result = predicted(hgo="tentative")
    judged = weigh_laws(specimen, {"noise": "independent"}, result, ["goh", "hgo"])
    assert not judged.converged and judged.left_out == {}
    specimen, result = predicted(hgo="failed")
    judged = weigh_laws(specimen, {"noise": "independent"}, result, ["goh", "hgo"])
    assert not judged.converged
    assert judged.left_out == {"hgo": f"{WHOLE}: failed for a reason"}
    assert judged.table.set_index("law")["weight"]["goh"] == pytest.approx(1.0)
    assert np.isnan(judged.table.set_index("law")["weight"]["hgo"])
    specimen, result = predicted(hgo="failed", goh="unusable")
    with pytest.raises(NotConverged, match=r"no law could be sampled.*goh.*unusable for a reason"):
        weigh_laws(specimen, {"noise": "independent"}, result, ["goh", "hgo"])


def test_a_measured_mounting_stretch_is_reported_as_the_mixture_has_it():
    specimen, result = predicted()
    measured = replace(
        specimen, metadata={**specimen.metadata, "mounting_stretch_x": "1.01 +- 0.01"}
    )
    judged = weigh_laws(measured, {"noise": "independent"}, result, ["goh", "hgo"])
    row = judged.reported[0]
    assert row.name == "mounting_stretch_x" and row.reason == MEASURED_REASON
    assert [row.low, row.high] == pytest.approx([1.01, 1.01])


def test_parts_make_up_the_record_and_are_left_out_of_the_rest():
    three = small_specimen()
    assert [p.name for p in left_out_parts(three)] == [p.name for p in three.protocols]
    one = three.only(three.protocols[0].name)
    rest = one.protocols[0].rest_rows
    seen = []
    for part in left_out_parts(one):
        left, kept = only(one, part).protocols[0], without(one, part).protocols[0]
        assert left.rows - rest + kept.rows == one.protocols[0].rows
        assert left.stretch_x[0] == kept.stretch_x[0] == one.protocols[0].stretch_x[0]
        assert not set(left.load_x[rest:]) & set(kept.load_x[rest:])
        seen += list(left.stretch_x[rest:])
    np.testing.assert_array_equal(seen, one.protocols[0].stretch_x[rest:])


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Two laws on a specimen of three protocols whose truth is dispersed GOH."""
    folder = tmp_path_factory.mktemp("laws")
    write_specimen(small_specimen(), folder / "small.csv")
    return folder, exit_code(*command(folder))


def command(folder):
    options = ("--noise", "independent", "--mounting", "exact", "--ess", "60", "--workers", "1")
    return ("laws", folder / "small.csv", "--laws", LAWS, "--out", folder / "out", *options)


@pytest.mark.long
def test_the_law_of_the_truth_predicts_best(compared):
    folder, _ = compared
    table = pd.read_csv(folder / "out" / "laws.csv").set_index("law")
    assert list(table.index) == ["goh", "hgo", STACKED]
    assert table["weight"]["goh"] > 0.9
    assert table["weight"][["goh", "hgo"]].sum() == pytest.approx(1.0, abs=1e-5)
    assert table["left_out_rms_kPa"]["goh"] < table["left_out_rms_kPa"]["hgo"]
    assert table["left_out_density_nats"][STACKED] > table["left_out_density_nats"]["goh"] - 2.0
    assert table["mounting_stretch_x_q05"]["goh"] < table["mounting_stretch_x_q95"]["goh"]
    parts = pd.read_csv(folder / "out" / "left-out.csv")
    sums = parts.groupby("law")["left_out_density_nats"].sum()
    for law in table.index:
        assert sums[law] == pytest.approx(table["left_out_density_nats"][law], rel=1e-5)
    # weights that have seen a part predict it better, but for what their prior asks for
    mixture = parts[parts["law"] == STACKED]
    assert mixture["density_final_weights"].sum() > mixture["left_out_density_nats"].sum() - 0.5
    alone = parts[parts["law"] == "goh"]
    pd.testing.assert_series_equal(
        alone["density_final_weights"], alone["left_out_density_nats"], check_names=False
    )
    assert alone["band_low_level"].tolist() == pytest.approx([0.05] * len(alone))
    sums = mixture["band_low_level"] + mixture["band_high_level"]
    assert sums.tolist() == pytest.approx([1.0] * len(mixture), abs=1e-5)
    # the truth is known to the fit: readings spread as they should, and the levels hardly move
    assert mixture["band_low_level"].to_numpy() == pytest.approx(0.05, abs=0.04)
    levels = table.loc[STACKED, ["band_low_level", "band_high_level"]]
    assert levels.sum() == pytest.approx(1.0, abs=1e-5) and 0.01 < levels.iloc[0] < 0.09
    bands = pd.read_csv(folder / "out" / "stacked-bands.csv")
    assert (bands["credible_q05"] >= bands["predictive_q05"]).all()
    assert (bands["credible_q95"] <= bands["predictive_q95"]).all()
    inside = bands["measured"].between(bands["predictive_q05"], bands["predictive_q95"])
    assert 0.8 < inside.mean() < 0.98
    draws = pd.read_csv(folder / "out" / "stacked-draws.csv")
    shares = draws["law"].value_counts(normalize=True)
    assert shares["goh"] == pytest.approx(table["weight"]["goh"], abs=0.01)
    quantile = np.quantile(draws["mounting_stretch_x"], 0.5)
    assert quantile == pytest.approx(table["mounting_stretch_x_q50"][STACKED], rel=1e-5)
    for name in ("law-misfit", "law-mounting", "stacked-bands"):
        assert (folder / "out" / f"{name}.pdf").stat().st_size > 1000


@pytest.mark.long
def test_what_is_reported_is_the_same_in_table_page_and_terminal(compared, capsys):
    folder, _ = compared
    reported = pd.read_csv(folder / "out" / "report.csv").set_index("parameter")
    laws = pd.read_csv(folder / "out" / "laws.csv").set_index("law")
    page = (folder / "out" / "laws.html").read_text(encoding="utf-8")
    for name, true in (("mounting_stretch_x", 1.01), ("mounting_stretch_y", 1.02)):
        low, high = reported.loc[name, ["low", "high"]]
        both = laws.loc[LAWS.split(",")]  # two laws are compared, however much better one is
        margin = 0.09 * (both[f"{name}_q50"] - 1.0).abs()
        assert low == pytest.approx((both[f"{name}_q05"] - margin).min(), rel=1e-5)
        assert high == pytest.approx((both[f"{name}_q95"] + margin).max(), rel=1e-5)
        assert low < true < high
        row = reported.loc[name]
        assert row["reason"].startswith("the laws that predict best agree (goh")
        assert row["verdict"] == "identified"
        assert f"<strong>{row['interval']}</strong>" in page
    assert "2 <a" in page
    rms_kPa = f"{laws['left_out_rms_kPa']['goh']:.3g}"
    assert f"goh predicts left-out parts best: its rms error is {rms_kPa} kPa" in page
    assert "src=" in page and "http://" not in page and "<script" not in page
    # the terminal: the same command with --resume says it again
    assert exit_code(*command(folder), "--resume") in (0, 3)
    output = capsys.readouterr().out
    row = reported.loc["mounting_stretch_x"]
    assert f"mounting_stretch_x  {row['interval']}" in output and row["reason"] in output


def three(middle, width):
    return (middle - width, middle, middle + width)


def test_a_value_needs_the_laws_that_predict_equally_well_to_agree():
    intervals = {"goh": three(1.02, 0.002), "fung": three(1.022, 0.002), "hgo": three(1.3, 0.01)}
    density = {"goh": 10.0, "fung": 8.0, "hgo": 2.0}
    interval = interval_from_predictions(intervals, density, smooth=False)
    assert interval.is_value
    assert interval.low == pytest.approx(1.018 - 0.09 * 0.02)
    assert interval.high == pytest.approx(1.024 + 0.09 * 0.022)
    assert interval.reason == "the laws that predict best agree (goh and fung)"
    # a third law that predicts as well and lies elsewhere leaves the low end
    interval = interval_from_predictions(intervals, density | {"hgo": 9.0}, smooth=False)
    assert not interval.is_value
    assert interval.low == pytest.approx(1.018 - 0.09 * 0.02)
    assert interval.reason == (
        "the laws that predict best with their errors span 0.32; a value needs at most 0.035 "
        "(goh, hgo and fung)"
    )
    assert not interval_from_predictions(intervals, density, smooth=True).is_value


def test_a_low_end_rests_on_two_laws_and_lies_not_too_far_below_the_best():
    intervals = {"goh": three(1.2, 0.04), "fung": three(1.1, 0.02)}
    interval = interval_from_predictions(intervals, {"goh": 10.0, "fung": 0.0}, smooth=False)
    assert interval.low == pytest.approx(1.08 - 0.09 * 0.1)
    assert "span 0.19; a value needs at most 0.035 (goh and fung)" in interval.reason
    intervals["goh"] = three(1.5, 0.04)
    interval = interval_from_predictions(intervals, {"goh": 10.0, "fung": 0.0}, smooth=False)
    assert np.isnan(interval.low) and "below the best estimate (goh and fung)" in interval.reason


@pytest.mark.long
def test_a_comparison_is_resumed_and_never_overwritten(compared, capsys):
    folder, code = compared
    common = command(folder)
    before = (folder / "out" / "laws.csv").read_bytes()
    assert exit_code(*common) == 2
    assert "continue it with --resume" in capsys.readouterr().err
    removed = sorted((folder / "out" / "parts").glob("*.npz"))[1]
    removed.unlink()
    assert exit_code(*common, "--resume") == code
    assert (folder / "out" / "laws.csv").read_bytes() == before
    assert exit_code(*common, "--resume", "--seed", "2") == 2
    assert "another comparison" in capsys.readouterr().err
    with pytest.raises(Interrupted, match="0 of 8 posteriors"):
        biaxbayes.compare_laws(small_specimen(), laws=LAWS, workers=1, stop=lambda: 1)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(InputError, match="its own mounted state"):
        biaxbayes.compare_laws(small_specimen(), mounting_stretch="per-protocol", workers=1)
    with pytest.raises(InputError, match="did you mean fung"):
        biaxbayes.compare_laws(small_specimen(), laws="goh,fong")
    for nothing in ("", " , ", ()):
        with pytest.raises(InputError, match="`laws` names no law; laws are goh"):
            biaxbayes.compare_laws(small_specimen(), laws=nothing)
    with pytest.raises(InputError, match="goh alone cannot be compared"):
        biaxbayes.compare_laws(small_specimen(), laws="goh")
    with pytest.raises(InputError, match="belongs to one law"):
        biaxbayes.compare_laws(small_specimen(), law="goh", fibre_switch=True)
