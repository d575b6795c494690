"""What must not change the posterior: the name of an axis, a unit, the order of protocols."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from biaxbayes.model.posterior import Posterior
from biaxbayes.model.priors import Prior
from biaxbayes.specimens.specimen import Protocol, Specimen
from quick_posteriors import stated_fit

POINTS = 12
few = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def smooth(specimen, options, scale=1.0, turned=False):
    """Smooth loads that a misfit is relative to, turned and scaled as the specimen is."""
    shared = options["mounting_stretch"] == "shared"
    states = 1 if shared else len(specimen.protocols)
    pair = (1.02, 1.03) if turned else (1.03, 1.02)
    alpha = 52.0 if turned else 38.0
    values = {"C1": 0.7 * scale, "k1": 1.2 * scale, "k2": 1.1, "alpha": alpha, "kappa": 0.12}
    return stated_fit(values, [pair] * states, fibre_switch=options["fibre_switch"])


@st.composite
def cases(draw):
    """A random specimen of any kind, options of the model, and random parameters."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pair = draw(st.sampled_from(["force", "piola", "cauchy"]))
    protocols = []
    for i in range(draw(st.integers(1, 3))):
        path = np.linspace(0, 1, draw(st.sampled_from([2, 3, 15])))
        x, y = (1 + path * rng.uniform(0.02, 0.4) for _ in "xy")
        load = rng.uniform(0.02, 0.2, 2)[:, None] + np.outer(rng.uniform(0.2, 2, 2), path**2)
        protocols.append(Protocol(f"p{i}", x, y, *load))
    specimen = Specimen(
        "wild", tuple(protocols), pair, draw(st.sampled_from(["unloaded", "mounted"])),
        edge_x_mm=rng.uniform(5, 30), edge_y_mm=rng.uniform(5, 30),
        thickness_mm=rng.uniform(0.3, 3), load_noise=0.01,
    )  # fmt: skip
    options = {
        "mounting": draw(st.sampled_from(["noisy", "exact", "free", "ignored", "zeroed"])),
        "mounting_stretch": draw(st.sampled_from(["shared", "per-protocol"])),
        "fibre_switch": draw(st.booleans()),
        "noise": draw(st.sampled_from(["correlated", "independent"])),
    }
    posterior = Posterior(specimen, misfit_fit=smooth(specimen, options), **options)
    values = {}
    for name in posterior.free:
        stem = name.split("[")[0]
        low, high = {
            "alpha": (0, 90), "kappa": (0, 1 / 3), "mounting_stretch_x": (0.97, 1.1),
            "mounting_stretch_y": (0.97, 1.1), "mounting_force_x": (0.02, 0.2),
            "mounting_force_y": (0.02, 0.2),
        }.get(stem, (0.05, 5.0))  # fmt: skip
        values[name] = rng.uniform(low, high, POINTS)
    return specimen, options, posterior, values


def same(a, b, shift=0.0):
    """Equal log densities but for a constant; zero density where the other has it."""
    assert np.array_equal(np.isfinite(a), np.isfinite(b))
    there = np.isfinite(a)
    np.testing.assert_allclose(a[there], b[there] + shift, rtol=1e-9, atol=1e-6)


def exchanged(name):
    axis = {"x": "y", "y": "x"}
    stem, bracket, label = name.partition("[")
    if stem.startswith("mounting"):
        stem = stem[:-1] + axis[stem[-1]]
    return stem + bracket + label


@pytest.mark.long
@few
@given(case=cases())
def test_axes_may_be_exchanged(case):
    """x for y, with alpha to 90 - alpha."""
    specimen, options, posterior, values = case
    turned = replace(
        specimen,
        protocols=tuple(
            Protocol(p.name, p.stretch_y, p.stretch_x, p.load_y, p.load_x)
            for p in specimen.protocols
        ),
        edge_x_mm=specimen.edge_y_mm,
        edge_y_mm=specimen.edge_x_mm,
    )
    there = {exchanged(k): 90.0 - v if k == "alpha" else v for k, v in values.items()}
    fit = smooth(turned, options, turned=True)
    other = Posterior(turned, misfit_fit=fit, **options)
    same(posterior.log_density(values), other.log_density(there))


@pytest.mark.long
@few
@given(case=cases(), factor=st.sampled_from([1e-3, 0.3, 7.0, 1e3]))
def test_units_of_load_may_be_changed(case, factor):
    """All loads and stiffnesses times a factor, and the priors that speak of them."""
    specimen, options, posterior, values = case
    scaled = replace(
        specimen,
        protocols=tuple(
            replace(p, load_x=factor * p.load_x, load_y=factor * p.load_y)
            for p in specimen.protocols
        ),
        load_noise=factor * specimen.load_noise,
    )
    priors = {}
    for name in ("C1", "k1"):
        own = posterior.priors[name]
        assert isinstance(own, Prior)
        table = own.as_table()
        priors[name] = table | {"median": factor * table["median"]}
    scales = ("C1", "k1", "noise_sd", "mounting_force")
    there = {k: factor * v if k.startswith(scales) else v for k, v in values.items()}
    fit = smooth(scaled, options, scale=factor)
    other = Posterior(scaled, misfit_fit=fit, **options, priors=priors).log_density(there)
    # Every reading, and every mounting force that is sampled or read, is a density per load.
    rows = sum(p.rows - p.rest_rows for p in specimen.protocols)
    mounts = len(posterior.mounts) if options["mounting"] in ("noisy", "free", "exact") else 0
    # noisy: a reading and, by the determinant, a prior of each force; free: a reading; exact: the
    # determinant alone.
    each = {"noisy": 2, "free": 1, "exact": 1}.get(options["mounting"], 0)
    same(
        posterior.log_density(values), other, shift=(2 * rows + 2 * mounts * each) * np.log(factor)
    )


@pytest.mark.long
@few
@given(case=cases(), seed=st.integers(0, 1000))
def test_protocols_may_come_in_any_order(case, seed):
    specimen, options, posterior, values = case
    order = np.random.default_rng(seed).permutation(len(specimen.protocols))
    shuffled = replace(specimen, protocols=tuple(specimen.protocols[i] for i in order))
    other = Posterior(shuffled, misfit_fit=posterior.misfit_fit, **options)
    same(posterior.log_density(values), other.log_density(values))
