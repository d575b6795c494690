"""The law nearest to a drawn tissue, which a simulation should use."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.prediction.nearest_law import (
    TO_READINGS,
    TO_TISSUE,
    drawn_distances,
    median_nearest_law,
    nearest_laws,
    simulation_table,
)
from biaxbayes.reports.page import page_html
from biaxbayes.reports.run_page import _simulation

TRUTH = {"C1": 8.0, "k1": 30.0, "k2": 6.0, "alpha": 40.0, "kappa": 0.1}
NAMES = list(TRUTH)


@pytest.fixture(scope="module")
def posterior():
    specimen, _ = biaxbayes.simulate(
        material=biaxbayes.GOH(*TRUTH.values()), prestretch=(1.02, 1.03), total_stretch=1.2,
        ratios=[(1, 1), (1, 0.5)], increments=15, noise_N=0.001, misfit=0.02, seed=3,
    )  # fmt: skip
    return biaxbayes.prepare(specimen)


@pytest.fixture(scope="module")
def draws(posterior):
    """Materials about the fit, off the readings by several percent."""
    rng = np.random.default_rng(5)
    values = dict(zip(NAMES, posterior.fit.material.values, strict=True))
    table = {name: value * np.exp(rng.normal(0.0, 0.1, 4)) for name, value in values.items()}
    table |= {f"mounting_stretch_{a}": 1.02 + 0.003 * rng.normal(size=4) for a in "xy"}
    return pd.DataFrame(table, index=[3, 5, 8, 9]).assign(alpha=lambda t: t["alpha"].clip(1, 89))


def test_it_is_nearer_to_the_readings_than_the_drawn_law_and_a_minimum(posterior, draws):
    near = nearest_laws(posterior, draws)
    assert list(near.index) == list(draws.index)
    drawn = drawn_distances(posterior, draws)
    assert (near[TO_READINGS] < 0.5 * drawn).all() and (near[TO_READINGS] < 0.05).all()
    same = [n for n in draws if n not in NAMES]
    pd.testing.assert_frame_equal(near[same], draws[same])
    # no parameter that is moved alone comes nearer to the readings by more than rounding
    least = near[TO_TISSUE].to_numpy()
    assert (least <= near[TO_READINGS] + 0.02).all()
    for name in NAMES:
        for factor in (0.97, 1.03):
            moved = near.assign(**{name: near[name] * factor})[list(draws)]
            again = nearest_laws(posterior, moved)
            # the tissue of a draw hardly changes: law and misfit share it
            np.testing.assert_allclose(again[TO_TISSUE], least, rtol=0.3, atol=2e-3)


def test_a_law_without_misfit_is_its_own_nearest(posterior, draws):
    independent = posterior.replaced(noise="independent").replaced(priors={})
    table = draws.assign(noise_sd=0.001)
    near = nearest_laws(independent, table)
    np.testing.assert_allclose(near[NAMES], draws[NAMES], rtol=1e-4)
    assert (near[TO_TISSUE] < 1e-7).all()
    np.testing.assert_allclose(near[TO_READINGS], drawn_distances(independent, table), rtol=1e-4)


def test_the_spread_is_that_of_the_draws(posterior, draws):
    """Uniform parameters of a law that is its own nearest: ends within 3 sd of those of 120."""
    rng, count = np.random.default_rng(7), 240
    levels = {name: rng.permutation(np.linspace(0.0, 1.0, count)) for name in ("C1", "k1", "k2")}
    many = draws.iloc[np.zeros(count, dtype=int)].reset_index(drop=True).assign(noise_sd=0.001)
    many = many.assign(**{name: draws[name].iloc[0] * (1.0 + at) for name, at in levels.items()})
    independent = posterior.replaced(noise="independent").replaced(priors={})
    table = simulation_table(independent, many).set_index("quantity")
    for name in levels:
        ends = table.loc[name, ["q05", "q95"]].to_numpy(dtype=float) / draws[name].iloc[0] - 1.0
        np.testing.assert_allclose(ends, [0.05, 0.95], atol=3.0 * (0.05 * 0.95 / 240) ** 0.5)


def test_a_fixed_parameter_stays(posterior, draws):
    fixed = posterior.replaced(priors={"kappa": 0.1})
    near = nearest_laws(fixed, draws.assign(kappa=0.1))
    np.testing.assert_allclose(near["kappa"], 0.1)
    assert near["k1"].std() > 0.0


def test_the_median_law_is_one_of_them(posterior, draws):
    laws, row = median_nearest_law(posterior, draws.reset_index(drop=True))
    assert row in laws.index
    table = simulation_table(posterior, draws).set_index("quantity")
    assert list(table.index) == [*NAMES, TO_TISSUE, TO_READINGS]
    assert (table["q05"] <= table["median_card"]).all()
    assert table.loc["k1", "unit"] == "kPa"
    result = SimpleNamespace(simulation=table.reset_index())
    run = SimpleNamespace(result=result, law=posterior.law, quantities=posterior.quantities)
    run.settings = posterior.settings
    (section,) = _simulation(run)
    page = page_html("report", "a", "b", [section], [])
    off = 100.0 * table.loc[TO_READINGS, "median_card"]
    assert f"off the readings by {off:.2g} %" in page and "k1: " in page and "export RUN" in page
    assert "misfit" in page
    run.settings = posterior.replaced(noise="independent").settings
    (section,) = _simulation(run)
    assert "misfit" not in page_html("report", "a", "b", [section], [])
