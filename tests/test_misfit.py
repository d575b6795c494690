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
from plain_posterior import (
    AMPLITUDES,
    FRICTIONS,
    Places,
    amplitude_weights,
    correlations,
    errors,
    mixture,
    roots,
    toes,
)
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


def covariances(model: SmoothMisfit, one: CurvePoints, two: CurvePoints, only=None):
    """Weight, covariance of misfit and toe at points, and that of the noise and friction.

    (terms,), (terms, one, two), (terms, one, one), the last for readings.
    """
    own, a, b = places(model.points), places(one), places(two)
    known, steps = correlations(model.protocols), np.array(errors(model.toe)).T
    number = np.arange(len(known) * steps.shape[1])
    number = number if only is None else np.array(only)
    of, index = divmod(number, steps.shape[1])
    amplitude, factor, t, u, weight = steps[:, index, None, None]
    smooth = np.array([a.smooth(c, b) for c in known])[of]
    friction = model.reading @ own.friction() @ model.reading.T
    noise = factor**2 * np.diag(model.noise_sd**2) + u**2 * friction
    return weight.ravel() / len(known), amplitude**2 * smooth + t**2 * a.toe(b), noise


def of_readings(model: SmoothMisfit, only=None):
    """Weights and covariances of the readings."""
    weight, between, noise = covariances(model, model.points, model.points, only)
    return weight, model.reading @ between @ model.reading.T + noise


def residuals(model: SmoothMisfit, n: int, seed: int = 1) -> np.ndarray:
    """Readings less loads of the law, drawn from the model itself."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(n):
        drawn, friction, factor = model.draw(model.points, rng)
        noise = factor * model.noise_sd * rng.standard_normal(len(model.noise_sd))
        out.append(model.reading @ (drawn + friction) + noise)
    return np.array(out)


@pytest.mark.parametrize("toe", [0.4, 0.05, 0.0])
@pytest.mark.parametrize("protocols", [1, 2])
def test_the_likelihood_is_a_mean_of_multivariate_normals(protocols, toe):
    model = made(protocols, 4, toe=toe)
    r = residuals(model, 6) * np.geomspace(0.01, 100, 6)[:, None]
    weight, covariance = of_readings(model)
    inverse = roots(covariance)
    exact = [mixture(np.log(weight), inverse, one) for one in r]
    np.testing.assert_allclose(model.log_likelihood(r), exact, rtol=1e-8)


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
        columns.append(sum(basis.shape[1] for basis in model.quadratics.bases))
    assert columns[1] < 0.8 * columns[0]
    difference = logs[1] - logs[0]
    # sd of (1 - z^2) / 2 times e over at most n vectors; amplitudes are below 0.1, two prior sd
    e, n = 0.1 * (0.1 / 0.4) ** 2, len(model.noise_sd)
    assert np.abs(difference).max() < 5.0 * e * np.sqrt(n / 2.0)


def test_the_amplitude_is_found_on_average():
    """The mean over data of the posterior mean is the prior mean, whatever the model says."""
    model = made(1, 8)
    share = model.shares(residuals(model, 800))
    steps, weights = zip(*toes(model.toe), strict=True)
    expected = amplitude_weights() @ AMPLITUDES, np.dot(steps, weights)
    for values, mean in zip((model.terms.amplitude, model.terms.toe), expected, strict=True):
        found = share @ values
        assert abs(found.mean() - mean) < 4.0 * found.std() / np.sqrt(len(found))
        assert found.std() > 0.3 * mean  # and it is found, not the prior repeated


@pytest.mark.parametrize("size", [0.02, 0.4])
def test_a_record_tells_how_well_the_law_is_right_at_its_start(size):
    """Of readings with a toe of 2 or 40 % the likelihood finds the amplitude to a step."""
    model, rng = made(3, 12, toe=0.2), np.random.default_rng(5)
    own = places(model.points)
    covariance = size**2 * own.toe(own)
    drawn = rng.multivariate_normal(np.zeros(len(covariance)), covariance, 40, method="eigh")
    noise = 0.1 * model.noise_sd
    quiet = SmoothMisfit(model.points, model.reading, noise, 0.2, 3)
    r = drawn @ model.reading.T + noise * rng.standard_normal((40, len(noise)))
    assert size / 2.2 < np.median(quiet.shares(r) @ quiet.terms.toe) < 2.2 * size


@pytest.mark.parametrize("index", [1, 4, 7])
def test_a_known_amplitude_is_recovered(index):
    model, rng = made(3, 12), np.random.default_rng(2)
    truth = AMPLITUDES[index]
    structure = misfit.structures(3)[2]  # along the path, length 0.6
    covariance = truth**2 * structure.covariance(model.points, model.points)
    drawn = rng.multivariate_normal(np.zeros(len(covariance)), covariance, 40, method="eigh")
    r = drawn @ model.reading.T + model.noise_sd * rng.standard_normal((40, len(model.noise_sd)))
    found = model.shares(r) @ model.terms.amplitude
    assert AMPLITUDES[max(index - 1, 0)] < np.median(found) < 1.5 * truth + 0.01


def test_what_is_chosen_given_readings_of_the_model_follows_the_prior():
    model = made(1, 5)
    r = residuals(model, 800)
    chosen = model.choose(r, np.random.default_rng(3))
    weight, _ = of_readings(model)
    number = np.arange(len(weight))
    steps = (misfit.structures(1), AMPLITUDES, NOISE_FACTORS, toes(model.toe), FRICTIONS)
    shape = tuple(map(len, steps))
    for key in np.unravel_index(number, shape):
        expected = np.bincount(key, weight)
        share = np.bincount(key[chosen], minlength=len(expected)) / len(r)
        error = np.sqrt(expected * (1.0 - expected) / len(r))
        assert np.abs((share - expected) / error).max() < 4.5


@pytest.mark.parametrize("others", [False, True])
@pytest.mark.parametrize("protocols", [1, 2])
def test_the_misfit_given_readings_is_the_conditional_normal(protocols, others):
    model, at = made(protocols), curves(protocols, 4, first=0.1, others=others)
    r = residuals(model, 12)
    chosen = np.random.default_rng(4).integers(0, len(model.terms.toe), len(r))
    chosen[-3:] = chosen[0]  # several draws of one hypothesis
    _, whole = of_readings(model, chosen)
    _, between, _ = covariances(model, model.points, at, chosen)
    _, of_points, _ = covariances(model, at, at, chosen)
    mean, sd = model.given(r, chosen, at)
    for i in range(len(r)):
        cross = model.reading @ between[i]
        gain = np.linalg.solve(whole[i], cross).T
        np.testing.assert_allclose(mean[i], gain @ r[i], rtol=1e-7, atol=1e-9)
        left = np.diag(of_points[i] - gain @ cross)
        np.testing.assert_allclose(sd[i] ** 2, left, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("protocols", [1, 2])
def test_misfit_and_friction_are_what_the_noise_leaves_of_a_reading(protocols):
    model = made(protocols)
    r = residuals(model, 12)
    chosen = np.random.default_rng(4).integers(0, len(model.terms.toe), len(r))
    _, whole = of_readings(model, chosen)
    mean, _ = model.given(r, chosen, model.points, friction=True)
    alone, _ = model.given(r, chosen, model.points)
    for i, term in enumerate(chosen):
        noise = (model.terms.noise[term] * model.noise_sd) ** 2
        expected = r[i] - noise * np.linalg.solve(whole[i], r[i])
        np.testing.assert_allclose(model.reading @ mean[i], expected, rtol=1e-6, atol=1e-9)
    assert (np.abs(mean - alone).max(axis=1) > 0.0).tolist() == [
        u > 0.0 for u in model.terms.friction[chosen]
    ]


def test_on_a_path_that_was_not_tested_one_protocol_tells_the_toe_alone():
    """Its structures end with the path: without a toe the prior remains."""
    model, at = made(1, toe=0.0), curves(1, 4, first=0.1, others=True)
    r = residuals(model, 5)

    def found(model):
        chosen = model.choose(r, np.random.default_rng(6))
        _, of_points, _ = covariances(model, at, at, chosen)
        return *model.given(r, chosen, at), np.diagonal(of_points, axis1=1, axis2=2)

    mean, sd, prior = found(model)
    assert not mean.any()
    np.testing.assert_allclose(sd**2, prior, rtol=1e-10)
    mean, sd, prior = found(made(1))
    assert mean.any() and (sd**2 < prior).all()


def test_draws_have_the_covariance_of_the_prior():
    model = made(2, 4)
    rng = np.random.default_rng(7)
    parts = [model.draw(model.points, rng) for _ in range(6000)]
    drawn, frictions, factors = (np.array(part) for part in zip(*parts, strict=True))
    for factor, share in NOISE_FACTORS:
        error = np.sqrt(share * (1.0 - share) / len(factors))
        assert abs(np.mean(np.array(factors) == factor) - share) < 4.0 * error
    weight, between, _ = covariances(model, model.points, model.points)
    of_misfit = np.tensordot(weight, between, 1)
    of_friction = np.dot(*np.array(FRICTIONS).T ** [[2], [1]]) * places(model.points).friction()
    for values, expected in ((drawn, of_misfit), (frictions, of_friction)):
        products = values[:, :, None] * values[:, None, :]
        error = products.std(axis=0) / np.sqrt(len(values))
        assert np.abs((products.mean(axis=0) - expected) / np.maximum(error, 1e-12)).max() < 5.0
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
