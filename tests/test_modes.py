"""Modes, Laplace's approximation and ridges of densities that are known."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from biaxbayes.sampling.modes import (
    MAX_MODES,
    MIN_RISE,
    Mode,
    find_modes,
    local_mode,
    mode_clusters,
)
from biaxbayes.sampling.target import bounds_array

COVARIANCE = np.array([[1.0, 0.6, 0.0], [0.6, 0.5, -0.1], [0.0, -0.1, 0.09]])
FREE = bounds_array({}, 3)
WIDE = np.full(3, 20.0)


def mixture(*parts):
    """Log density of normals: (mass, mean, covariance)."""

    def log_density(x):
        each = [np.log(m) + multivariate_normal(at, c).logpdf(x) for m, at, c in parts]
        return np.logaddexp.reduce([np.atleast_1d(e) for e in each])

    return log_density


def scattered(*means, count=6, seed=1):
    rng = np.random.default_rng(seed)
    return np.vstack([np.asarray(m) + 0.8 * rng.standard_normal((count, 3)) for m in means])


def test_a_climb_ends_at_the_mode_with_the_covariance_of_a_normal():
    mean = np.array([3.0, -2.0, 0.5])
    at, factor = local_mode(mixture((1.0, mean, COVARIANCE)), mean + 1.5, WIDE, FREE)
    np.testing.assert_allclose(at, mean, atol=1e-3)
    np.testing.assert_allclose(factor @ factor.T, COVARIANCE, atol=1e-4)


def test_a_climb_follows_a_bent_ridge_to_its_mode():
    """Rosenbrock's function as a log density: no single Newton step reaches its mode (1, 1)."""

    def log_density(x):
        return -5.0 * (x[:, 1] - x[:, 0] ** 2) ** 2 - 0.5 * (1.0 - x[:, 0]) ** 2

    at, _ = local_mode(log_density, np.array([-1.5, 2.0]), np.full(2, 5.0), bounds_array({}, 2))
    assert log_density(at[None])[0] > -2 * MIN_RISE
    np.testing.assert_allclose(at, 1.0, atol=0.3)


def test_widths_are_limited_where_a_direction_is_not_determined():
    def log_density(x):
        return -0.5 * ((x[:, 0] - 1.0) / 0.1) ** 2 + 0.0 * x[:, 1]

    scale = np.array([5.0, 2.0])
    at, factor = local_mode(log_density, np.array([0.0, 0.7]), scale, bounds_array({}, 2))
    assert at == pytest.approx([1.0, 0.7], abs=1e-4)
    np.testing.assert_allclose(factor @ factor.T, np.diag([0.01, 4.0]), rtol=1e-3)


def test_a_climb_stops_at_a_bound():
    bounds = np.array([[0.0, np.inf], [-np.inf, np.inf]])

    def log_density(x):
        inside = -4.0 * x[:, 0] - 0.5 * (x[:, 1] - 2.0) ** 2
        return np.where(x[:, 0] >= 0.0, inside, -np.inf)

    at, _ = local_mode(log_density, np.array([1.5, 0.0]), np.full(2, 5.0), bounds)
    assert at == pytest.approx([1e-3, 2.0], abs=1e-3)


def test_all_starts_on_one_peak_find_one_mode_and_its_mass():
    mean = np.array([3.0, -2.0, 0.5])
    (mode,) = find_modes(mixture((1.0, mean, COVARIANCE)), scattered(mean, count=9), WIDE, FREE)
    # a climb that rises by less than a hundredth is good enough: 0.14 widths
    offset = mode.location - mean
    assert offset @ np.linalg.solve(COVARIANCE, offset) < 2 * MIN_RISE
    assert mode.log_mass == pytest.approx(0.0, abs=0.02)
    assert mode.height == pytest.approx(
        -0.5 * np.linalg.slogdet(2 * np.pi * COVARIANCE)[1], abs=0.02
    )


def test_separate_peaks_are_modes_by_their_mass():
    left, right = np.zeros(3), np.array([9.0, 4.0, -3.0])
    parts = (0.3, left, COVARIANCE), (0.7, right, 0.04 * np.eye(3))
    result = find_modes(mixture(*parts), scattered(left, right), WIDE, FREE)
    assert [np.round(m.location).tolist() for m in result] == [right.tolist(), left.tolist()]
    assert [m.log_mass for m in result] == pytest.approx(np.log([0.7, 0.3]), abs=0.03)


@pytest.mark.parametrize(
    ("log_mass", "variance", "count"), [(-8.0, 1.0, 2), (-11.0, 1.0, 1), (-11.0, 0.01, 2)]
)
def test_a_peak_of_little_mass_counts_where_it_is_high(log_mass, variance, count):
    """A narrow peak of e^-11 of the mass has a height within e^-9 of the main one."""
    main, far = np.zeros(3), np.array([9.0, 0.0, 0.0])
    density = mixture((1.0, main, np.eye(3)), (np.exp(log_mass), far, variance * np.eye(3)))
    starts = scattered(main, far) if variance == 1.0 else [*scattered(main), far + 0.05]
    assert len(find_modes(density, np.array(starts), WIDE, FREE)) == count


def test_the_heaviest_modes_are_kept_and_no_start_of_positive_density_gives_none():
    masses = np.array([0.05, 0.2, 0.1, 0.15, 0.12, 0.13, 0.17, 0.08])
    means = [np.array([12.0 * k, 0.0, 0.0]) for k in range(len(masses))]
    parts = [(m, at, 0.25 * np.eye(3)) for m, at in zip(masses, means, strict=True)]
    result = find_modes(mixture(*parts), np.vstack(means) + 0.1, WIDE, FREE)
    heaviest = np.argsort(-masses)[:MAX_MODES]
    assert [round(m.location[0] / 12.0) for m in result] == heaviest.tolist()

    def nowhere(x):
        return np.full(len(x), -np.inf)

    assert find_modes(nowhere, np.zeros((4, 3)), WIDE, FREE) == []


@pytest.mark.parametrize(("apart", "count"), [(1.9, 1), (2.1, 2)])
def test_modes_nearer_than_two_local_widths_are_one(apart, count):
    """Two peaks of one height, each of them a start, so many widths apart in each dimension."""
    width = 0.5

    def log_density(x):
        # locally normal around the nearer of two points, of the same height
        near = np.minimum(((x - means[0]) ** 2).sum(axis=1), ((x - means[1]) ** 2).sum(axis=1))
        return -0.5 * near / width**2

    means = np.array([[0.0, 0.0], [apart * width] * 2])
    result = find_modes(log_density, means, np.full(2, 20.0), bounds_array({}, 2))
    assert len(result) == count


def mode_at(log_density, at):
    at = np.asarray(at, dtype=float)
    return Mode(at, np.eye(at.size), 0.0, float(log_density(at[None])[0]))


def test_modes_are_of_one_ridge_where_the_density_between_them_hardly_falls():
    def bent(x):  # a ridge along a circle of radius 5
        return -0.5 * ((np.hypot(*x.T) - 5.0) / 0.8) ** 2

    def on(degrees):
        return 5.0 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])

    first, near, next_, far = (mode_at(bent, on(a)) for a in (0.0, 50.0, 100.0, 200.0))
    # the line over 50 degrees falls by 0.5 (5 (1 - cos 25) / 0.8)^2 = 0.17, over 100 by 2.5,
    # over 200 by 13
    groups = mode_clusters(bent, [first, far])
    assert [len(g) for g in groups] == [1, 1]
    assert groups[0][0] is first
    # one that joins two groups makes them one, the first mode first
    (group,) = mode_clusters(bent, [first, far, near, next_])
    assert group[0] is first and len(group) == 4
    # also where the joining mode comes last
    (group,) = mode_clusters(bent, [first, next_, near])
    assert group[0] is first and group[1] is next_ and group[2] is near
    # below the lower of two modes of unlike height
    low = Mode(far.location, far.factor, 0.0, -12.0)
    assert len(mode_clusters(bent, [first, low])) == 1
