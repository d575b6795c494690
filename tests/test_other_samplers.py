"""The densities that other samplers run on are the compiled one: checked with NumPy in JAX's place.

JAX itself comes with the extra ``bench`` and need not be there.
"""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
import scipy.special

from biaxbayes.laws.dispersed_fibres import chart_from_angles
from biaxbayes.specimens.specimen_file import read_specimen
from studies.benchmark.natural_density import NaturalDensity
from studies.benchmark.nuts import jax_log_density
from studies.benchmark.structural import Structural
from studies.common import DATA


@pytest.fixture(autouse=True)
def numpy_as_jax(monkeypatch):
    """What these functions ask JAX for, NumPy and SciPy have under the same names."""
    jax = ModuleType("jax")
    jax.__dict__.update(numpy=np, nn=ModuleType("jax.nn"), scipy=scipy)
    jax.nn.__dict__.update(sigmoid=scipy.special.expit)
    named = {"jax": jax, "jax.numpy": np, "jax.nn": jax.nn, "jax.scipy": scipy}
    for name, module in (named | {"jax.scipy.special": scipy.special}).items():
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture(scope="module")
def density() -> NaturalDensity:
    return NaturalDensity(read_specimen(DATA / "donor2-media.csv"), 0.3)


@pytest.fixture(scope="module")
def points(density) -> np.ndarray:
    return density.starts(6, np.random.default_rng(0), 0.05)


def test_the_density_in_jax_is_the_compiled_one(density, points):
    compiled = density(points)
    assert np.ptp(compiled) > 1000.0  # points that differ
    other = [jax_log_density(density)(point) for point in points]
    assert np.ptp(compiled - other) < 1e-8 * np.ptp(compiled)  # up to a constant


def test_the_angles_of_the_structural_coordinates_are_those_of_the_chart():
    rng = np.random.default_rng(1)
    softening = 0.2
    structural = object.__new__(Structural)
    structural._softening = softening
    for alpha, kappa in zip(rng.uniform(0.1, 1.4, 20), rng.uniform(0.02, 0.3, 20), strict=True):
        d, v = chart_from_angles(alpha, kappa, softening)
        found = structural._angles(np.array([d, scipy.special.ndtri(v)]))
        np.testing.assert_allclose(found, [alpha, kappa], rtol=1e-9)
