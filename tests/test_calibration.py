"""Calibration: ranks, bands and coverage against things known; simulation against the model."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtr
from scipy.stats import binom, binomtest, kstest, norm

from biaxbayes.calibration.calibration import REPLICATION, Calibration, replicate
from biaxbayes.calibration.ranks import (
    band_level,
    calibration_table,
    count_band,
    coverage,
    probability_inside,
    rank_counts,
    read_ranks,
    uniformity,
    uniformity_p_value,
)
from biaxbayes.calibration.simulated_specimen import (
    draw_truth,
    local_prior,
    priors_toml,
    protocol_prior,
    simulate_specimen,
)
from biaxbayes.errors import Interrupted, RunError
from biaxbayes.laws import LAWS
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.model.misfit import TOE_SHAPE
from biaxbayes.model.priors import Prior, Tie, read_priors
from biaxbayes.options import Settings
from biaxbayes.parallel import Processes
from biaxbayes.parameters import Quantities
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.verbs.calibrate import CalibrationResult, closing_message, run_calibration
from commands import run
from goh_functions import GOH_LAW
from studies.calibration import BROKEN, PosteriorWithoutDeterminant

DATA = Path(__file__).resolve().parents[1] / "data"
OPTIONS = {"mounting": "noisy", "noise": "independent", "mounting_stretch": "shared"}


def media(rows: int = 101) -> Specimen:
    """The shipped media, with every so many rows."""
    specimen = read_specimen(DATA / "donor2-media.csv")
    p = specimen.protocols[0]
    chosen = np.linspace(0, p.rows - 1, rows).round().astype(int)
    columns = {k: getattr(p, k)[chosen] for k in ("stretch_x", "stretch_y", "load_x", "load_y")}
    return replace(specimen, protocols=(replace(p, **columns),))


def study(
    specimen: Specimen | None = None, kind: type[Calibration] = Calibration, **options: object
) -> Calibration:
    specimen = specimen or media(21)
    given = {**OPTIONS, **options}
    plan = replace(REPLICATION, seed=3, ess=200, max_steps=384, population=1024)
    priors = protocol_prior(specimen, Settings(**given))
    return kind(specimen, given, priors, plan)


def test_two_thresholds_are_a_multinomial():
    n, level = 12, 0.2
    total = 0.0
    z = [1 / 3, 2 / 3]

    def inside(count: int, at: float) -> bool:
        return 2.0 * min(binom.cdf(count, n, at), binom.sf(count - 1, n, at)) > level

    for a in range(n + 1):
        for b in range(n + 1 - a):
            if inside(a, z[0]) and inside(a + b, z[1]):
                total += binom.pmf(a, n, 1 / 3) * binom.pmf(b, n - a, 1 / 2)
    assert probability_inside(n, 2, level) == pytest.approx(total, rel=1e-12)


# --- ranks and bands ---


def test_band_holds_uniform_ranks_as_often_as_it_says():
    n, draws, trials = 150, 31, 2000
    low, high = count_band(n, draws)
    rng = np.random.default_rng(1)
    ranks = rng.integers(0, draws + 1, (trials, n))
    counts = np.array([rank_counts(r, draws) for r in ranks])
    within = int(np.all((counts >= low) & (counts <= high), axis=1).sum())
    exact = probability_inside(n, draws, band_level(n, draws))
    assert 0.95 <= exact < 0.97
    assert binomtest(within, trials, exact).pvalue > 1e-3


def test_p_value_agrees_with_the_band_and_is_uniform():
    n, draws = 80, 15
    low, high = count_band(n, draws)
    rng = np.random.default_rng(2)
    p = []
    for _ in range(400):
        ranks = rng.integers(0, draws + 1, n)
        counts = rank_counts(ranks, draws)
        p.append(uniformity_p_value(ranks, draws))
        assert (p[-1] >= 0.05) == bool(np.all((counts >= low) & (counts <= high)))
    assert kstest(p, "uniform").pvalue > 1e-3


def test_coverage_counts_and_its_interval_is_exact():
    below = (np.arange(200) + 0.5) / 200
    observed, low, high = coverage(below, 0.8)
    assert observed == pytest.approx(0.8)
    exact = binomtest(160, 200).proportion_ci(method="exact")
    assert (low, high) == pytest.approx((exact.low, exact.high), rel=1e-9)
    assert coverage(np.full(5, 0.999), 0.95)[1] == 0.0
    assert coverage(np.full(5, 0.5), 0.5)[2] == 1.0


def test_verdict_allows_for_many_quantities():
    rng = np.random.default_rng(4)
    frame = pd.concat(
        pd.DataFrame(
            {
                "parameter": name,
                "unit": "-",
                "rank": rng.integers(0, 128, 300),
                "below": rng.random(300),
            }
        )
        for name in "abcdefghij"
    )
    table = calibration_table(frame, 127)
    assert uniformity(table)[0]
    frame.loc[frame["parameter"] == "c", "rank"] //= 2
    table = calibration_table(frame, 127)
    assert not uniformity(table)[0]
    assert table.set_index("parameter").loc["c", "inside_band"] == "no"


# --- priors ---


def test_priors_are_written_as_a_priors_file_reads_them(tmp_path):
    priors = {
        **protocol_prior(media(), Settings()),
        "kappa": 0.1,
        "k1": Tie(2.0, "C1"),
        "alpha": Prior("normal", 41.0, 5.0).within(0.0, 90.0),
    }
    path = tmp_path / "priors.toml"
    path.write_text(priors_toml(priors, "N", GOH_LAW))
    assert read_priors(path) == priors


def test_protocol_prior_has_no_absurd_draws():
    # Peak stress of a draw within three orders around the specimen's own, never megapascals.
    the_study = study(media())
    model, rng = the_study.model(), np.random.default_rng(1)
    peaks = []
    for _ in range(200):
        truth, _ = draw_truth(model, rng)
        assert truth["mounting_stretch_x"] > 0.98
        simulated = simulate_specimen(model, truth, rng)
        peaks.append(np.max(np.abs(simulated.load(simulated.protocols[0]) / simulated.area)))
    own = np.max(np.abs(media().load(media().protocols[0]) / media().area))
    low, middle, high = np.quantile(peaks, [0.005, 0.5, 0.995]) / own
    assert 0.02 < low < 0.3 < middle < 3.0 < high < 60.0


def test_local_prior_is_twice_as_wide_as_the_posterior_and_no_wider_than_its_prior():
    rng = np.random.default_rng(1)
    wide = {
        "C1": Prior("lognormal", 10.0, 2.0),
        "k1": Prior("lognormal", 30.0, 0.5),
        "alpha": Prior("uniform", low=0.0, high=90.0),
        "kappa": 0.1,
        "mounting_stretch_x": Prior("normal", 1.0, 0.1, low=0.0),
    }
    draws = {
        "C1": np.exp(rng.normal(1.0, 0.1, 20000)),
        "k1": np.exp(rng.normal(2.0, 0.4, 20000)),
        "alpha": rng.normal(88.0, 3.0, 20000),
        "mounting_stretch_x": rng.normal(1.0147, 0.0005, 20000),
    }
    local = local_prior(draws, wide, Quantities(GOH_LAW.parameters))
    assert local["C1"].location == pytest.approx(np.e, rel=0.01)
    assert local["C1"].scale == pytest.approx(0.2, rel=0.05)
    assert local["k1"].scale == 0.5
    assert (local["alpha"].family, local["alpha"].high) == ("normal", 90.0)
    assert local["kappa"] == 0.1
    # Not rounded away where the posterior is narrow.
    assert local["mounting_stretch_x"].location == pytest.approx(1.0147, abs=5e-5)


# --- simulation ---


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("loads", ["force", "cauchy"])
def test_simulated_readings_are_the_virtual_tests(geometry, loads):
    # Without noise, against the closed form of the virtual laboratory.
    specimen = replace(media(), geometry=geometry, loads=loads)
    the_study = study(specimen, mounting="exact")
    model, rng = the_study.model(), np.random.default_rng(5)
    truth, _ = draw_truth(model, rng)
    simulated = simulate_specimen(model, truth | {"noise_sd": 0.0}, rng)
    lm = np.array([truth["mounting_stretch_x"], truth["mounting_stretch_y"]])
    edges = np.array([20.0, 20.0]) / (lm if geometry == "mounted" else 1.0)
    thickness = 0.88 * (lm.prod() if geometry == "mounted" else 1.0)
    material = GOH(*(truth[k] for k in ("C1", "k1", "k2", "alpha", "kappa")))
    test = virtual_test(
        material, mounting_stretch=tuple(lm), measured_stretch=(1.2, 1.2), increments=100,
        edge_x_mm=edges[0], edge_y_mm=edges[1], thickness_mm=thickness,
    )  # fmt: skip
    force = test.force_N.T
    p = simulated.protocols[0]
    measured = np.array([p.load_x, p.load_y])
    if loads == "cauchy":
        stretch = np.array([p.stretch_x, p.stretch_y])
        measured = measured / stretch * (20.0 * 0.88e-3)
    np.testing.assert_allclose(measured, force, rtol=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("mounting", ["noisy", "exact", "free"])
def test_true_values_lie_in_the_support_of_the_posterior(mounting):
    the_study = study(mounting=mounting)
    # Stiff fibres in a soft matrix, pushed together: often without a stable mounted state.
    wide = {
        **the_study.priors,
        "C1": Prior("lognormal", 0.1, 1.0),
        "k1": Prior("lognormal", 100.0, 1.0),
        "mounting_stretch_x": Prior("normal", 0.95, 0.1, low=0.5),
    }
    the_study = replace(the_study, priors=wide)
    model, rng = the_study.model(), np.random.default_rng(6)
    rejected = 0
    for _ in range(60):
        truth, n = draw_truth(model, rng)
        rejected += n
        posterior = the_study.posterior(simulate_specimen(model, truth, rng))
        assert np.isfinite(posterior.log_density(truth))
        back = posterior.natural(posterior.coordinates(truth))
        for name in ("C1", "alpha", "kappa", "mounting_stretch_x", "mounting_force_y"):
            assert back[name][0] == pytest.approx(truth[name], rel=1e-5)
    assert rejected > 0


@pytest.mark.long
@pytest.mark.parametrize("law", [name for name in LAWS if name != "goh"])
def test_true_values_of_every_law_lie_in_the_support_of_its_posterior(law):
    """Priors of single parameters allow what a law does not: Fung's with an indefinite form."""
    the_study = study(law=law)
    model, rng = the_study.model(), np.random.default_rng(8)
    for _ in range(40):
        truth, _ = draw_truth(model, rng)
        posterior = the_study.posterior(simulate_specimen(model, truth, rng))
        assert np.isfinite(posterior.log_density(truth))


def test_mounting_reading_scatters_by_the_load_noise_and_rows_by_the_true_sd():
    the_study = study(media())
    model, rng = the_study.model(), np.random.default_rng(7)
    truth, _ = draw_truth(model, rng)
    still = simulate_specimen(model, truth | {"noise_sd": 0.0}, rng)
    z, rows = [], []
    for _ in range(200):
        simulated = simulate_specimen(model, truth, rng)
        reading, sd = simulated.mounting_readings(shared=True)
        force = [truth["mounting_force_x"], truth["mounting_force_y"]]
        z.extend(((reading - force) / sd).ravel())
        a, b = simulated.protocols[0], still.protocols[0]
        rows.extend((a.load_x - b.load_x)[1:] / truth["noise_sd"])
    assert np.allclose(sd, 0.0006)
    assert kstest(z, norm.cdf).pvalue > 1e-3
    assert kstest(rows, norm.cdf).pvalue > 1e-3


@pytest.mark.long
@pytest.mark.parametrize("mounting_stretch", ["shared", "per-protocol"])
def test_residuals_of_simulated_readings_have_the_covariance_of_the_likelihood(mounting_stretch):
    """Two protocols, with mounted states that their readings share and do not."""
    one = media(21)
    p = one.protocols[0]
    second = replace(p, name="2", stretch_x=1.0 + 0.5 * (p.stretch_x - 1.0))
    specimen = replace(one, protocols=(p, second))
    the_study = study(specimen, noise="correlated", mounting_stretch=mounting_stretch)
    model, rng = the_study.model(), np.random.default_rng(9)
    truth, _ = draw_truth(model, rng)
    table = pd.DataFrame([truth])
    residuals = []
    for _ in range(400):
        simulated = simulate_specimen(model, truth, rng)
        posterior = type(model)(
            simulated, **model.options(), fit=model.fit, misfit_fit=model.misfit_fit
        )
        residuals.append(posterior.residuals(table)[0])
    found = np.array(residuals)
    misfit, points = model.misfit, model.misfit.points
    terms, weight = misfit.terms, np.exp(misfit.terms.log_weight)
    # every reading, and sums of readings with random weights, in which the correlations count
    sums = np.vstack([np.eye(found.shape[1]), rng.standard_normal((100, found.shape[1]))])

    def variances(covariance: np.ndarray) -> np.ndarray:
        of_readings = misfit.reading @ covariance @ misfit.reading.T
        return np.einsum("di,ij,dj->d", sums, of_readings, sums)

    of_structures = np.array([variances(h.covariance(points, points)) for h in misfit.structures])
    toe = TOE_SHAPE.matrix(points, points) * np.outer(points.toe_scale, points.toe_scale)
    variance = terms.amplitude[:, None] ** 2 * of_structures[terms.structure]
    variance += terms.toe[:, None] ** 2 * variances(toe)
    variance += terms.friction[:, None] ** 2 * variances(points.friction_covariance(points))
    variance += terms.noise[:, None] ** 2 * (sums**2 @ misfit.noise_sd**2)
    # each sum is normal in its term, so that its level in the mixture is uniform: the mean
    # square of 400 levels about 1/2 is 1/12, with an sd of 0.0037. 184 of them lie within 4.6 sds
    level = np.array([weight @ ndtr(sums @ r / np.sqrt(variance)) for r in found])
    np.testing.assert_allclose(((level - 0.5) ** 2).mean(axis=0), 1 / 12, atol=0.017)


# --- studies ---


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A study of two replications, one after the other in this process: outcome and folder."""
    folder = tmp_path_factory.mktemp("study") / "whole"
    return run_calibration(study(), folder, 2), folder


@pytest.fixture(scope="module")
def alone(whole):
    """Truth and rank of every quantity by replication, as in the study's file."""
    table = read_ranks(whole[1] / "ranks.csv").set_index("parameter")
    return {i: t[["truth", "rank"]].to_dict() for i, t in table.groupby("replication")}


@pytest.mark.long
def test_a_replication_is_determined_by_study_and_index(alone):
    a = pd.DataFrame(replicate(study(), 1)).set_index("parameter")
    assert a[["truth", "rank"]].to_dict() == alone[1]
    assert {"C1", "kappa", "mounting_stretch_y", "noise_sd", "log_likelihood"} <= set(a.index)
    assert a["rank"].between(0, 127).all()


@pytest.mark.long
def test_an_interrupted_study_continues_to_the_same_table(whole, tmp_path):
    calls, (outcome, folder) = [], whole

    def stop() -> bool:
        calls.append(1)
        return len(calls) > 1

    with pytest.raises(Interrupted, match="1 of 2"):
        run_calibration(study(), tmp_path / "parts", 2, stop=stop)
    parts = run_calibration(study(), tmp_path / "parts", 2, resume=True)
    pd.testing.assert_frame_equal(outcome.table, parts.table)
    a, b = (
        read_ranks(f / "ranks.csv").drop(columns="seconds") for f in (folder, tmp_path / "parts")
    )
    pd.testing.assert_frame_equal(a, b)
    for name in ("calibration.csv", "calibration.pdf", "calibration.png", "priors.toml"):
        assert (folder / name).stat().st_size > 0
    with pytest.raises(RunError, match="another calibration"):
        other = replace(study(), plan=replace(study().plan, seed=9))
        run_calibration(other, tmp_path / "parts", 2, resume=True)


@pytest.mark.long
def test_command_line(tmp_path, capsys):
    out = tmp_path / "study"
    words = ("--noise", "independent", "--out", out, "--fix", "kappa=0", "--ess", 200)
    study = ("calibrate", DATA / "donor2-media.csv", "--replications", 2, "--workers", 1)
    code, printed, _ = run(capsys, *study, *words)
    assert code == 0 and "2 replications" in printed
    table = pd.read_csv(out / "calibration.csv")
    assert "kappa" not in set(table["parameter"])
    assert json.loads((out / "calibration.json").read_text())["priors"]["kappa"] == 0.0
    assert read_priors(out / "priors.toml")["kappa"] == 0.0
    ranks = (out / "ranks.csv").read_bytes()
    for more in ((), ("--seed", 2)):
        code, _, err = run(capsys, *study, *words, *more)
        assert code == 2 and "already holds a calibration" in err
    code, _, err = run(capsys, *study, *words, "--seed", 2, "--resume")
    assert code == 2 and "holds another calibration" in err
    assert (out / "ranks.csv").read_bytes() == ranks
    assert run(capsys, *study, *words, "--resume")[0] == 0


def test_the_folder_of_another_kind_of_work_is_refused_and_untouched(tmp_path, capsys):
    (tmp_path / "runs").mkdir()
    (tmp_path / "study.json").write_text('{"done": {}}')
    words = ("--noise", "independent", "--out", tmp_path, "--replications", 2)
    code, _, err = run(capsys, "calibrate", DATA / "donor2-media.csv", *words)
    assert code == 2 and "not a calibration folder" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["runs", "study.json"]
    assert (tmp_path / "study.json").read_text() == '{"done": {}}'


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--mounting", "ignored"], "'ignored' is not one of 'noisy', 'exact', 'free'"),
        (["--replications", "0"], "at least 1"),
    ],
)
def test_what_cannot_be_studied_is_refused(arguments, problem, capsys, tmp_path):
    words = ("--noise", "independent", "--out", tmp_path / "s", *arguments)
    code, _, err = run(capsys, "calibrate", DATA / "donor2-media.csv", *words)
    assert code == 2 and problem in err


@pytest.mark.parametrize(
    ("replications", "p"), [(4, 0.6), (50, 0.6), (200, 0.6), (200, 1e-6), (4, 1e-6)]
)
def test_few_replications_conclude_nothing(tmp_path, replications, p):
    row = {"parameter": "C1", "uniformity_p": p, "inside_band": "yes"}
    row |= {f"coverage_{level}": 0.5 for level in (50, 80, 90, 95)}
    outcome = CalibrationResult(pd.DataFrame([row]), {"converged": replications}, p >= 0.05, p)
    message = closing_message(tmp_path, outcome)
    assert ("replications are too few" in message) == (replications < 50 and p >= 0.05)
    assert ("are uniform" in message) == (replications >= 50 and p >= 0.05)
    assert ("NOT uniform" in message) == (p < 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("broken", ["", "noise"])
def test_a_wrong_noise_sd_is_caught_and_the_right_one_is_not(broken, tmp_path):
    the_study = study(kind=BROKEN[broken])
    the_study = replace(the_study, plan=replace(the_study.plan, max_steps=2000))
    outcome = run_calibration(the_study, tmp_path / "s", 200, Processes(2))
    assert outcome.calibrated == (broken == "")


def test_a_calibration_can_be_broken_on_purpose():
    """Twenty per cent more noise in the readings, and a density that lacks the determinant."""
    right, wrong = study(media(101)), study(media(101), BROKEN["noise"])
    model = right.model()
    truth, _ = draw_truth(model, np.random.default_rng(2))
    still = right.simulated(model, truth | {"noise_sd": 0.0}, np.random.default_rng(3))
    errors = [
        made.simulated(model, truth, np.random.default_rng(3)).protocols[0].load_x[1:]
        - still.protocols[0].load_x[1:]
        for made in (right, wrong)
    ]
    np.testing.assert_allclose(errors[1], 1.2 * errors[0], rtol=1e-9)
    specimen = right.simulated(model, truth, np.random.default_rng(3))
    without = study(media(101), BROKEN["determinant"]).posterior(specimen)
    assert isinstance(without, PosteriorWithoutDeterminant)
    assert abs(without.log_density(truth) - right.posterior(specimen).log_density(truth)) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("broken", ["", "determinant"])
def test_a_missing_determinant_is_caught_where_the_readings_are_loose(broken, tmp_path):
    # With little noise the determinant hardly moves the posterior, and nothing could notice.
    the_study = study(media(101), BROKEN[broken])
    loose = {**the_study.priors, "noise_sd": Prior("lognormal", 0.3, 0.3)}
    plan = replace(the_study.plan, max_steps=2000)
    the_study = replace(the_study, priors=loose, plan=plan)
    outcome = run_calibration(the_study, tmp_path / "s", 200, Processes(2))
    assert outcome.calibrated == (broken == "")
