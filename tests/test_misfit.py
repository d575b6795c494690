"""The smooth misfit of a law against the covariances of the second implementation."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from biaxbayes.laws.goh import GOH
from biaxbayes.model import misfit
from biaxbayes.model.misfit import CurvePoints, SmoothMisfit
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import start_parameters
from plain_posterior import AMPLITUDES, Places, amplitude_weights, correlations
from plain_posterior import NOISE as NOISE_FACTORS
from quick_posteriors import exact_specimen

NOISE = 0.01


@pytest.fixture(autouse=True)
def all_eigenvectors(monkeypatch):
    """Those too, in which the largest misfit adds next to nothing to the noise."""
    monkeypatch.setattr(misfit, "LEAST_EIGENVALUE", 0.0)


def curves(protocols=2, count=5, first=0.0, *, others=False) -> CurvePoints:
    """Points of stiffening curves; ``others`` lie on a path that was not tested."""
    s = np.linspace(first, 1.0, count)
    parts = []
    for p in range(protocols):
        for axis in (0, 1):
            peak = 1.0 + 0.3 * p + 0.2 * axis
            parts.append(
                CurvePoints(
                    protocol=np.full(count, -1 if others else p),
                    axis=np.full(count, axis),
                    path=s,
                    plane=np.column_stack([s, s / (1 + p)]) * (0.8 if others else 1.0),
                    load=peak * (0.05 + 0.95 * s**2),
                    peak=np.full(count, peak),
                )
            )
    return CurvePoints.joined(parts)


def places(points: CurvePoints) -> Places:
    place = zip(points.protocol, points.axis, points.path, *points.plane.T, strict=True)
    return Places([*place], points.load, points.peak)


def made(protocols=2, count=5, toe=0.4) -> SmoothMisfit:
    """The first reading is the mean of the mounted states of all protocols in x."""
    points = curves(protocols, count)
    start = (points.axis == 0) & (points.path == 0.0)
    reading = np.vstack([start / start.sum(), np.eye(len(start))[points.path > 0.0]])
    sd = NOISE * np.linspace(1.0, 2.0, len(reading))
    return SmoothMisfit(points, reading, sd, toe, protocols)


def hypotheses(model: SmoothMisfit, at: CurvePoints):
    """(weight, covariance of readings, of readings with points, of points) of each."""
    own, other = places(model.points), places(at)
    known = correlations(model.protocols)
    blocks = ((own, own), (own, other), (other, other))
    toe = [one.toe(model.toe, two) for one, two in blocks]
    for correlation in known:
        smooth = [one.smooth(correlation, two) for one, two in blocks]
        for factor, share in NOISE_FACTORS:
            noise = np.diag((factor * model.noise_sd) ** 2)
            for weight, a in zip(amplitude_weights(), AMPLITUDES, strict=True):
                readings, cross, points = (a**2 * k + t for k, t in zip(smooth, toe, strict=True))
                yield (
                    weight * share / len(known),
                    model.reading @ readings @ model.reading.T + noise,
                    model.reading @ cross,
                    points,
                )


def residuals(model: SmoothMisfit, n: int, seed: int = 1) -> np.ndarray:
    """Readings less loads of the law, drawn from the model itself."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(n):
        drawn, factor = model.draw(model.points, rng)
        noise = factor * model.noise_sd * rng.standard_normal(len(model.noise_sd))
        out.append(model.reading @ drawn + noise)
    return np.array(out)


@pytest.mark.parametrize("toe", [0.4, 0.05, 0.0])
@pytest.mark.parametrize("protocols", [1, 3])
def test_the_likelihood_is_a_mean_of_multivariate_normals(protocols, toe):
    model = made(protocols, toe=toe)
    r = residuals(model, 6) * np.geomspace(0.01, 100, 6)[:, None]
    logs = [
        np.log(weight) + multivariate_normal(cov=covariance).logpdf(r)
        for weight, covariance, *_ in hypotheses(model, model.points)
    ]
    np.testing.assert_allclose(model.log_likelihood(r), logsumexp(logs, axis=0), rtol=1e-8)


def test_without_a_misfit_to_speak_of_the_readings_are_independent():
    """Where the smooth loads are nothing, noise is all there is, of one of four sizes."""
    points = curves()
    nothing = CurvePoints(
        points.protocol, points.axis, points.path, points.plane, 0 * points.load, 0 * points.peak
    )
    sd = np.full(len(points.path), NOISE)
    model = SmoothMisfit(nothing, np.eye(len(sd)), sd, protocols=2)
    r = NOISE * np.random.default_rng(1).standard_normal((4, len(sd)))
    logs = [
        np.log(share) + multivariate_normal(cov=np.diag((factor * sd) ** 2)).logpdf(r)
        for factor, share in NOISE_FACTORS
    ]
    np.testing.assert_allclose(model.log_likelihood(r), logsumexp(logs, axis=0), rtol=1e-10)


def test_eigenvectors_that_are_left_out_change_next_to_nothing(monkeypatch):
    """ln(1 + e) - z^2 e / (1 + e) with z^2 about one; e < 0.1 at the largest amplitude, 0.4."""
    r, logs, columns = residuals(made(3, 12), 200), [], []
    for least in (0.0, 0.1):
        monkeypatch.setattr(misfit, "LEAST_EIGENVALUE", least)
        model = made(3, 12)
        logs.append(model.log_likelihood(r))
        columns.append(sum(c.columns.shape[1] for c in model.components))
    assert columns[1] < 0.8 * columns[0]
    difference = logs[1] - logs[0]
    # sd of (1 - z^2) / 2 times e over at most n vectors; amplitudes are below 0.1, two prior sd
    e, n = 0.1 * (0.1 / 0.4) ** 2, len(model.noise_sd)
    assert np.abs(difference).max() < 5.0 * e * np.sqrt(n / 2.0)


def test_the_amplitude_is_found_on_average():
    """The mean over data of the posterior mean is the prior mean, whatever the model says."""
    model = made(2, 8)
    r = residuals(model, 1500)
    found = np.array([model.amplitude(one[None]) for one in r])
    expected = amplitude_weights() @ AMPLITUDES
    assert abs(found.mean() - expected) < 4.0 * found.std() / np.sqrt(len(r))
    assert found.std() > 0.3 * expected  # and it is found, not the prior repeated


@pytest.mark.parametrize("index", [1, 4, 7])
def test_a_known_amplitude_is_recovered(index):
    model, rng = made(3, 12), np.random.default_rng(2)
    truth = AMPLITUDES[index]
    structure = misfit.structures(3)[2]  # along the path, length 0.6
    covariance = truth**2 * structure.covariance(model.points, model.points)
    drawn = rng.multivariate_normal(np.zeros(len(covariance)), covariance, 40, method="eigh")
    r = drawn @ model.reading.T + model.noise_sd * rng.standard_normal((40, len(model.noise_sd)))
    found = np.array([model.amplitude(one[None]) for one in r])
    assert AMPLITUDES[max(index - 1, 0)] < np.median(found) < 1.5 * truth + 0.01


def test_what_is_chosen_given_readings_of_the_model_follows_the_prior():
    model = made(2, 6)
    r = residuals(model, 4000)
    chosen = model.choose(r, np.random.default_rng(3))
    weight = np.array([w for w, *_ in hypotheses(model, model.points)])
    number = np.arange(len(weight))
    amplitudes = len(AMPLITUDES)
    noises = len(NOISE_FACTORS)
    for key in (number % amplitudes, number // amplitudes % noises, number // amplitudes // noises):
        expected = np.bincount(key, weight)
        share = np.bincount(key[chosen], minlength=len(expected)) / len(r)
        error = np.sqrt(expected * (1.0 - expected) / len(r))
        assert np.abs((share - expected) / error).max() < 4.5


@pytest.mark.parametrize("others", [False, True])
@pytest.mark.parametrize("protocols", [1, 2])
def test_the_misfit_given_readings_is_the_conditional_normal(protocols, others):
    model, at = made(protocols), curves(protocols, 4, first=0.1, others=others)
    r = residuals(model, 12)
    joint = list(hypotheses(model, at))
    chosen = np.random.default_rng(4).integers(0, len(joint), len(r))
    chosen[-3:] = chosen[0]  # several draws of one hypothesis
    mean, sd = model.given(r, chosen, at)
    for i, index in enumerate(chosen):
        _, of_readings, cross, of_points = joint[index]
        gain = np.linalg.solve(of_readings, cross).T
        np.testing.assert_allclose(mean[i], gain @ r[i], rtol=1e-7, atol=1e-9)
        left = np.diag(of_points - gain @ cross)
        np.testing.assert_allclose(sd[i] ** 2, left, rtol=1e-6, atol=1e-10)


def test_on_a_path_that_was_not_tested_one_protocol_tells_the_toe_alone():
    """Its structures end with the path: without a toe the prior remains."""
    model, at = made(1, toe=0.0), curves(1, 4, first=0.1, others=True)
    joint = list(hypotheses(model, at))
    r = residuals(model, 5)
    chosen = model.choose(r, np.random.default_rng(6))
    mean, sd = model.given(r, chosen, at)
    assert not mean.any()
    np.testing.assert_allclose(sd**2, [np.diag(joint[c][3]) for c in chosen], rtol=1e-10)
    model = made(1)
    chosen = model.choose(r, np.random.default_rng(6))
    mean, sd = model.given(r, chosen, at)
    prior = [np.diag(list(hypotheses(model, at))[c][3]) for c in chosen]
    assert mean.any() and (sd**2 < np.array(prior)).all()


def test_draws_have_the_covariance_of_the_prior():
    model = made(2, 4)
    rng = np.random.default_rng(7)
    drawn, factors = zip(*(model.draw(model.points, rng) for _ in range(6000)), strict=True)
    drawn = np.array(drawn)
    for factor, share in NOISE_FACTORS:
        error = np.sqrt(share * (1.0 - share) / len(factors))
        assert abs(np.mean(np.array(factors) == factor) - share) < 4.0 * error
    expected = sum(weight * block for weight, _, _, block in hypotheses(model, model.points))
    products = drawn[:, :, None] * drawn[:, None, :]
    error = products.std(axis=0) / np.sqrt(len(drawn))
    assert np.abs((products.mean(axis=0) - expected) / error).max() < 5.0
    assert np.abs(drawn.mean(axis=0) / (drawn.std(axis=0) / np.sqrt(len(drawn)))).max() < 4.5


@pytest.fixture(scope="module")
def posterior():
    ratios = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
    made = exact_specimen(GOH(14.0, 60.0, 8.0, 38.0, 0.1), ratios=ratios, increments=40,
                          noise_N=0.002)  # fmt: skip
    return Posterior(made)


def test_a_path_along_a_protocol_has_its_places(posterior):
    for i, p in enumerate(posterior.specimen.protocols):
        stretch = p.stretch[5:]
        along, own = posterior.paths.path(stretch), posterior.paths.tested(i, p.stretch)
        own = own.take(np.arange(10, 2 * p.rows))
        for name, values in vars(along).items():
            np.testing.assert_allclose(values, getattr(own, name), atol=1e-3, err_msg=name)


def test_a_path_beside_the_protocols_is_no_protocols(posterior):
    beside = 1.0 + np.linspace(0.0, 0.15, 9)[:, None] * [1.0, 0.75]
    points = posterior.paths.path(beside)
    assert set(points.protocol) == {-1}
    assert points.path[0] == 0.0 and (np.diff(points.path[::2]) > 0.0).all()
    np.testing.assert_allclose(points.plane[::2], points.plane[1::2])


def test_loads_of_the_fit_are_where_a_misfit_is_relative_to(posterior):
    fit = posterior.fit
    lm = fit.mounting_stretch[0]
    for i, p in enumerate(posterior.specimen.protocols):
        load = np.column_stack(fit.material.piola(*(p.stretch * lm).T)) * posterior.specimen.area
        points = posterior.paths.tested(i, p.stretch)
        np.testing.assert_allclose(points.load, load.ravel(), rtol=1e-9)
        np.testing.assert_allclose(points.peak, np.tile(np.abs(load).max(axis=0), p.rows))


def test_readings_are_means_of_neighbouring_rows(posterior):
    """40 rows of three protocols: 21 readings of each curve, of one or two rows."""
    rows, readings = posterior.rows, posterior.readings
    means = readings.means(rows.load)
    assert not means[: readings.mounting_count].any() and readings.mounting_count == 2
    assert len(means) == 2 + 3 * 2 * 21
    for i in range(3):
        load = rows.load[rows.protocol == i]
        own = means[2 + 42 * i : 44 + 42 * i].reshape(21, 2)
        weight = readings.weight[2 + 42 * i : 44 + 42 * i : 2]
        assert weight.sum() == len(load) and set(weight) == {1.0, 2.0}
        np.testing.assert_allclose(weight @ own, load.sum(axis=0), rtol=1e-12)


def test_residuals_are_readings_less_loads(posterior):
    values = start_parameters(posterior)
    natural = posterior.natural(posterior.coordinates(values))
    r = posterior.residuals(natural)
    inside = posterior.evaluate(posterior.assembly.problem, posterior.coordinates(values))[2]
    np.testing.assert_allclose(r, inside.residual, rtol=1e-7, atol=1e-10)
