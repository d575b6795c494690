"""Comparisons and distances, against closed forms and specimens of known material."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ks_2samp, mannwhitneyu, norm

from biaxbayes.comparison.compare import ComparedRun, compare, differing_settings
from biaxbayes.comparison.distance import contractions, distance, prior_material
from biaxbayes.derived.determined import Derived, derived_quantities
from biaxbayes.errors import InputError
from biaxbayes.figures.comparisons import forest_figure
from biaxbayes.identifiability.reported import Reported
from biaxbayes.identifiability.verdict import Thresholds
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Tie
from biaxbayes.reports.comparison import distance_tables
from commands import refused, run
from goh_functions import GOH_LAW
from made_up import SOFT, STIFF
from quick_posteriors import EQUIBIAXIAL, sampled, small_specimen, specimen
from readable import assert_readable


def test_distance_of_normal_draws_is_that_of_the_distributions():
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.0, 1.0, 20_000), rng.normal(2.0, 1.5, 30_000)
    result = distance(a, b)
    sd = np.hypot(1.0, 1.5)
    assert result["standardised"] == pytest.approx(2.0 / sd, abs=0.02)
    assert result["probability_b_greater"] == pytest.approx(norm.cdf(2.0 / sd), abs=0.005)
    ends = [result[f"difference_{q}"] for q in ("q05", "q50", "q95")]
    assert ends == pytest.approx(norm.ppf([0.05, 0.5, 0.95], 2.0, sd), abs=0.05)


def test_distance_agrees_with_scipy_ties_included():
    rng = np.random.default_rng(2)
    a, b = rng.integers(0, 9, 300).astype(float), rng.integers(2, 12, 200).astype(float)
    result = distance(a, b)
    assert result["kolmogorov"] == pytest.approx(ks_2samp(a, b).statistic)
    greater = mannwhitneyu(b, a).statistic / 300 / 200
    assert result["probability_b_greater"] == pytest.approx(greater)


def test_contraction_is_that_of_the_variance_of_a_log_where_there_is_a_unit():
    z = norm.ppf((np.arange(4000) + 0.5) / 4000)

    def of(unit, values):
        return Derived("stress", "any", unit, None, values)

    prior = [of("", 3.0 + 2.0 * z), of("kPa", np.exp(1.0 + 0.8 * z)), of("kPa", np.exp(z))]
    posterior = [of("", 1.0 + 0.5 * z), of("kPa", np.exp(2.0 + 0.4 * z)), of("kPa", 0.0 * z)]
    # 1 - (0.5 / 2)^2, 1 - (0.4 / 0.8)^2; of nothing that is positive there is no spread to speak of
    assert contractions(prior, posterior) == pytest.approx([1 - 1 / 16, 1 - 1 / 4, -np.inf])


def test_materials_of_the_priors_are_independent_draws_of_them():
    target = Posterior(
        small_specimen(), noise="independent", priors={"k1": Tie(0.5, "C1"), "kappa": 0.1}
    )
    names = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x")
    result = prior_material(target, pd.DataFrame({name: [1.0] for name in names}))
    assert set(result) == set(names[:-1])
    for name in ("C1", "k2", "alpha"):
        levels = np.array([0.01, 0.25, 0.5, 0.75, 0.99])
        at = target.priors[name].ppf(levels)
        below = [(result[name] < x).mean() for x in at]
        assert below == pytest.approx(levels, abs=3e-4)  # evenly spread: no Monte Carlo error
    np.testing.assert_array_equal(result["kappa"], 0.1)
    np.testing.assert_allclose(result["k1"], 0.5 * result["C1"])
    ranks = result[["C1", "k2", "alpha"]].rank().corr().to_numpy()
    # four standard errors of a correlation of 4,096 pairs
    assert np.abs(ranks - np.eye(3)).max() < 4.0 / np.sqrt(len(result))


def test_derived_quantities_are_the_materials_own():
    columns = {"C1": 10.0, "k1": 40.0, "k2": 8.0, "alpha": 40.0, "kappa": 0.1}
    draws = pd.DataFrame({k: [v, v] for k, v in columns.items()})
    result = {d.key: d for d in derived_quantities(draws, GOH_LAW, [1.1], [1.0])}
    assert result["cauchy_x at 1.1"].values == pytest.approx(SOFT.cauchy(1.1, 1.1)[0])
    H = SOFT.structure_tensor()
    assert [result[f"H{k}"].values[0] for k in "xyz"] == pytest.approx(H)
    # d s_x / d ln l_x by central differences
    h = 1e-5
    ahead, behind = (SOFT.cauchy(np.exp(s * h), 1.0)[0] for s in (1.0, -1.0))
    assert result["stiffness_x at 1"].values[0] == pytest.approx(
        (ahead - behind) / (2 * h), rel=1e-6
    )


@pytest.fixture(scope="module")
def members():
    def member(label, material, **how):
        result = sampled(specimen(material, increments=10, **how), ess=60.0)
        return ComparedRun(label, result.target, result.draws, result.state)

    one = member("one <ratio>", SOFT, ratios=EQUIBIAXIAL)
    return [member("soft", SOFT), member("stiff", STIFF), one]


@pytest.fixture(scope="module")
def result(members):
    return compare(members)


def _row(result, a, b, quantity, stretch=None):
    t = result.distances
    rows = t[(t.run_a == a) & (t.run_b == b) & (t.quantity == quantity)]
    return rows[rows.total_stretch == stretch].iloc[0] if stretch else rows.iloc[0]


def test_a_stiffer_matrix_shows_in_what_is_determined(result):
    row = _row(result, "soft", "stiff", "C1")
    assert row.identified_in_both
    assert row.standardised > 5.0
    assert row.difference_q05 < 15.0 < row.difference_q95
    assert row.kolmogorov > 0.99
    same = _row(result, "soft", "stiff", "Hx")
    assert abs(same.standardised) < 4.0


@pytest.mark.long
def test_ignoring_the_mounting_stretch_moves_the_stress_off_the_true_one():
    """A mounted state taken as unloaded makes every total stretch too small."""
    data = specimen(SOFT, increments=10)
    runs = []
    for label, mounting in (("inferred", "noisy"), ("ignored", "ignored")):
        run = sampled(data, ess=60.0, mounting=mounting)
        runs.append(ComparedRun(label, run.target, run.draws, run.state))
    result = compare(runs)
    assert any("noisy (inferred), ignored (ignored)" in note for note in result.notes)
    for axis, true in zip(
        "xy", SOFT.cauchy(result.stretches[-1], result.stretches[-1]), strict=True
    ):
        row = _row(result, "inferred", "ignored", f"cauchy_{axis}", result.stretches[-1])
        assert row.median_a == pytest.approx(true, rel=0.05)
        assert row.standardised > 5.0 and row.median_b > 1.1 * true


def test_what_one_run_does_not_determine_is_no_difference(result, members):
    """Equibiaxial stretch alone trades kappa with alpha; its stress is known all the same."""
    strict = compare(members, thresholds=Thresholds(traded_width=1.0))
    assert not _row(strict, "soft", "one <ratio>", "kappa").identified_in_both
    stress = _row(result, "soft", "one <ratio>", "cauchy_x", result.stretches[-1])
    assert stress.identified_in_both
    assert abs(stress.standardised) < 4.0


def test_common_stretches_were_reached_by_every_run(members):
    short = Posterior(specimen(SOFT, total_stretch=1.1, increments=10), noise="independent")
    result = compare([members[0], ComparedRun("short", short, members[0].draws, "converged")])
    assert result.stretches[-1] == pytest.approx(1.1, abs=2e-3)


def test_distances_and_forest_are_of_the_draws_that_the_report_is_of(members, result):
    assert_readable(forest_figure(result), 180.0)
    for name in ("C1", "alpha"):
        row = _row(result, "soft", "stiff", name)
        medians = [{r.name: r.median for r in rows}[name] for rows in result.reported]
        assert [row.median_a, row.median_b] == pytest.approx(medians[:2], rel=1e-9)
    figure = forest_figure(result)
    (panel,) = [ax for ax in figure.axes if ax.get_xlabel() == r"$\lambda_{\mathrm{m},x}$"]
    thin = [tuple(line.get_xdata()) for line in panel.lines if line.get_linewidth() == 0.9]
    for member, ends in zip(members, thin, strict=False):
        assert ends == pytest.approx(np.quantile(member.draws["mounting_stretch_x"], [0.05, 0.95]))


def test_unreliable_runs_determine_nothing(members):
    shaky = ComparedRun("shaky", members[0].posterior, members[0].draws, "tentative")
    result = compare([members[0], shaky])
    assert not result.converged
    assert not result.distances["identified_in_b"].any()
    assert any("same measurements" in note for note in result.notes)
    bad = ComparedRun("bad", members[0].posterior, members[0].draws, "unusable")
    with pytest.raises(InputError, match="not converged"):
        compare([members[0], bad])
    with pytest.raises(InputError, match="same label"):
        compare([members[0], members[0]])


def test_different_settings_are_pointed_out(members):
    options = {"noise": "independent", "mounting": "zeroed", "priors": {"kappa": 0.0}}
    other = Posterior(specimen(SOFT, increments=10), **options)
    notes = differing_settings([("a", members[0].posterior), ("b", other)])
    assert any("noisy (a), zeroed (b)" in note for note in notes)
    assert any("kappa" in note and "fixed at 0 (b)" in note for note in notes)
    assert differing_settings([("a", members[0].posterior), ("b", members[1].posterior)]) == []


def test_runs_of_different_laws_are_compared_by_what_both_have():
    rng, data = np.random.default_rng(6), small_specimen()
    values = {"C1": 10.0, "k1": 40.0, "k2": 8.0, "alpha": 40.0, "kappa": 0.1}
    members = []
    for law in ("goh", "hgo"):
        posterior = Posterior(data, law=law, noise="independent")
        names = [n for n in values if n in posterior.law.names]
        draws = {n: values[n] * rng.uniform(0.9, 1.1, 50) for n in names}
        draws |= {f"mounting_stretch_{axis}": rng.uniform(1.01, 1.02, 50) for axis in "xy"}
        row = Reported(
            posterior.quantities["C1"], 10.0, 9.0, 11.0, "identified", "the data determine it"
        )
        members.append(ComparedRun(law, posterior, pd.DataFrame(draws), "converged", [row]))
    for pair in (members, members[::-1]):
        result = compare(pair)
        shared = set(result.distances["quantity"])
        forest_figure(result)
        assert {"C1", "alpha", "cauchy_x", "stiffness_y"} <= shared
        assert "kappa" not in shared


def test_a_small_median_keeps_two_digits_beside_a_large_difference():
    row = {"run_a": "media", "run_b": "intima", "quantity": "k2", "total_stretch": np.nan}
    row |= {"unit": "1", "median_a": 1.63, "median_b": 84.31, "standardised": 2.0}
    row |= {"difference_q05": 41.0, "difference_q50": 82.7, "difference_q95": 151.0}
    row |= {"probability_b_greater": 0.99, "kolmogorov": 0.9}
    row |= {"identified_in_a": True, "identified_in_b": True}
    (table,) = distance_tables(pd.DataFrame([row]))
    text = " ".join(table.lines())
    assert " 1.6 " in text and " 84 " in text


@pytest.mark.long
def test_the_command_names_runs_by_their_specimens_or_as_it_is_told(
    small_run, media_run, tmp_path, capsys
):
    """And prints what it writes."""
    arguments = ("compare", small_run.path, media_run.path, "--anyway", "--out")
    for labels in ((), ("--labels", "thin, thick")):
        out = tmp_path / f"{len(labels)}"
        code, said, _ = run(capsys, *arguments, out, *labels)
        assert code in (0, 3) and "compare.html" in said
        page = (out / "compare.html").read_text(encoding="utf-8")
        named = ("thin", "thick") if labels else ("virtual", "donor2-media")
        assert all(f"\n{name}: medians" in f"\n{said}" and name in page for name in named)
    assert "3 --labels for 2 runs" in refused(
        capsys, *arguments, tmp_path / "x", "--labels", "a,b,c"
    )
