"""The forward model and independent errors: the compiled density, SciPy and loads by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from biaxbayes.forward import ForwardModel
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.normal_errors import log_likelihood, simulate
from biaxbayes.options import Settings
from quick_posteriors import specimen

MATERIAL = {"C1": 9.0, "k1": 20.0, "k2": 4.0, "alpha": 42.0, "kappa": 0.15}


def measured(geometry: str = "unloaded"):
    made = specimen(GOH(*MATERIAL.values()), noise_N=0.002, increments=30)
    known = {"edge_sd_mm": "0.5", "thickness_sd_mm": "0.05", "load_offset_sd_N": "0.01"}
    return replace(made, geometry=geometry, metadata={**made.metadata, **known})


def values_of(posterior: Posterior) -> dict[str, float]:
    at = {**MATERIAL, "noise_sd": 0.003, "thickness": 0.9}
    at |= {"edge_x": 1.05, "edge_y": 0.97, "load_offset_x": 0.02, "load_offset_y": -0.015}
    shift = iter(np.linspace(0.0, 0.02, len(posterior.free)))
    return {n: at[n] if n in at else 1.01 + next(shift) for n in posterior.free}


@pytest.mark.parametrize("mounting_stretch", ["shared", "per-protocol"])
@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_readings_have_the_likelihood_of_the_compiled_density(geometry, mounting_stretch):
    """A reading is a load with the zero of its cell, the mounting readings among them."""
    options = {"mounting": "free", "mounting_stretch": mounting_stretch}
    posterior = Posterior(measured(geometry), noise="independent", **options)
    natural = posterior.natural(posterior.coordinates(values_of(posterior)))
    rows, forward, offset = posterior.rows, posterior.forward, posterior.forward.offset(natural)[0]
    total = 0.0
    for i, name in enumerate(rows.names):
        at = rows.protocol == i
        load = forward.load(natural, rows.stretch[at], name)[0] + offset
        total += norm.logpdf(rows.load[at], load, 0.003).sum()
    reading, sd = measured(geometry).mounting_readings(shared=mounting_stretch == "shared")
    for m, state in enumerate(posterior.mounts):
        load = forward.mounting_load(natural, state)[0] + offset[0]
        total += norm.logpdf(reading[m], load, sd[m]).sum()
    assert total == pytest.approx(float(natural["log_likelihood"][0]), rel=1e-9)


def test_loads_are_stress_times_section_in_either_geometry():
    table = pd.DataFrame([{**MATERIAL, "mounting_stretch_x": 1.1, "mounting_stretch_y": 1.2}] * 3)
    table["edge_y"], table["thickness"] = [1.0, 1.1, 1.0], [1.0, 1.0, 0.8]
    stretch = np.array([[1.0, 1.0], [1.1, 1.05]])
    for geometry in ("unloaded", "mounted"):
        made = measured(geometry)
        load = ForwardModel.from_specimen(made, Settings()).load(table, stretch)
        stress = np.column_stack(GOH(*MATERIAL.values()).cauchy(*(stretch * [1.1, 1.2]).T))
        sections = made.edge_y_mm * made.thickness_mm, made.edge_x_mm * made.thickness_mm
        factors = np.array([[1.0, 1.0], [1.1, 1.0], [0.8, 0.8]])[:, None]
        by_hand = stress * sections * 1e-3 / stretch * factors
        if geometry == "unloaded":
            by_hand = by_hand / [1.1, 1.2]
        np.testing.assert_allclose(load, by_hand, rtol=1e-12)
        at_rest = ForwardModel.from_specimen(made, Settings()).mounting_load(table)
        np.testing.assert_allclose(at_rest, load[:, 0], rtol=1e-12)


LOAD = np.array([0.0, 0.1, 0.4, 1.0])
MEASURED = np.array([0.03, 0.08, 0.45, 0.9])


def test_likelihood_and_simulation_are_those_of_normal_errors():
    sd = np.array([0.05, 0.05, 0.2, 0.01])
    expected = norm.logpdf(MEASURED, LOAD, sd)
    np.testing.assert_allclose(log_likelihood(LOAD, sd, MEASURED), expected, rtol=1e-12)
    readings = simulate(np.tile(LOAD, (20_000, 1)), sd, np.random.default_rng(3))
    error = readings - LOAD
    assert np.all(np.abs(error.mean(axis=0)) < 5.0 * sd / np.sqrt(20_000))
    np.testing.assert_allclose(error.std(axis=0), sd, rtol=5.0 / np.sqrt(2 * 20_000))
