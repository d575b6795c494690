"""The interval of the tissue's stress: the model's, with the error that the run inferred."""

import numpy as np
import pandas as pd
import pytest

from biaxbayes.identifiability.determined import (
    AT_MEASURED_STRETCH,
    determined,
    mounting_ratio,
)
from biaxbayes.laws.goh import GOH
from biaxbayes.options import Settings
from biaxbayes.specimens.specimen import Protocol, Specimen

TRUTH = GOH(9.0, 20.0, 4.0, 42.0, 0.15)
MOUNTING = (1.03, 1.05)


def stress_specimen(geometry: str = "unloaded") -> Specimen:
    """Two protocols without noise, loads as first Piola-Kirchhoff stress."""
    protocols = []
    for name, ratio in (("one", (1.0, 1.0)), ("two", (1.0, 0.5))):
        stretch = 1.0 + np.linspace(0.0, 0.15, 16)[:, None] * ratio
        total = stretch * MOUNTING
        cauchy = np.column_stack(TRUTH.cauchy(*total.T))
        load = cauchy / (total if geometry == "unloaded" else stretch)
        protocols.append(Protocol(name, *stretch.T, *load.T))
    return Specimen("made", tuple(protocols), "piola", geometry=geometry, load_noise=0.01)


def draws(rng: np.random.Generator, n: int = 4000, **columns) -> pd.DataFrame:
    values = {
        "C1": TRUTH.C1_kPa * np.exp(0.05 * rng.standard_normal(n)),
        "k1": np.full(n, TRUTH.k1_kPa),
        "k2": np.full(n, TRUTH.k2),
        "alpha": np.full(n, TRUTH.alpha_deg),
        "kappa": np.full(n, TRUTH.kappa),
        "mounting_stretch_x": np.full(n, MOUNTING[0]),
        "mounting_stretch_y": np.full(n, MOUNTING[1]),
        "noise_sd": np.full(n, 2.0),
    }
    return pd.DataFrame(values | columns)


@pytest.mark.parametrize("growth", [False, True])
@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_the_interval_is_that_of_simulated_stresses(geometry, growth):
    rng = np.random.default_rng(1)
    data = stress_specimen(geometry)
    table = draws(rng, **({"noise_growth": np.full(4000, 0.1)} if growth else {}))
    result = determined(table, data, Settings(noise_growth=growth)).set_index("quantity")
    C1 = table["C1"].to_numpy()
    area_ratio = MOUNTING[0] if geometry == "mounted" else 1.0
    for name in ("Cauchy stress x", f"nominal stress x{AT_MEASURED_STRETCH} of two"):
        row = result.loc[name].iloc[1]
        measured = AT_MEASURED_STRETCH in name
        total = np.array([row.stretch_x, row.stretch_y]) * (MOUNTING if measured else (1.0, 1.0))
        cauchy = np.array([GOH(c, 20.0, 4.0, 42.0, 0.15).cauchy(*total)[0] for c in C1])
        # The error is one of the load: s = l P (unloaded), s = l / lm P (mounted dimensions)
        load = cauchy / total[0] * area_ratio
        sd = np.hypot(2.0, 0.1 * load) if growth else 2.0
        model = load if measured else cauchy
        noisy = model * (1.0 + sd * rng.standard_normal((50, len(C1))) / load)
        expected = np.quantile(noisy, [0.05, 0.95])
        assert [row.tissue_low_90, row.tissue_high_90] == pytest.approx(expected, rel=0.01)
        assert [row.low_90, row.high_90] == pytest.approx(np.quantile(model, [0.05, 0.95]))


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_a_measured_stretch_is_reported_with_the_load_that_was_measured_there(geometry):
    data = stress_specimen(geometry)
    result = determined(draws(np.random.default_rng(2)), data, Settings())
    ends = result[result["quantity"].str.endswith(" of one")]
    assert len(ends) == 4
    last = data.protocols[0]
    for axis in (0, 1):
        row = ends.iloc[2 + axis]
        assert (row.stretch_x, row.stretch_y) == pytest.approx((1.15, 1.15))
        load = (last.load_x, last.load_y)[axis][-1]
        assert row["median"] == pytest.approx(load, rel=0.01)


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_a_mounting_stretch_that_is_not_identified_moves_the_curve(geometry):
    """At a total stretch the tissue may be anywhere that the range of refits puts its curve."""
    data, table = stress_specimen(geometry), draws(np.random.default_rng(4))
    table["noise_sd"] = 1e-6
    table["C1"] = TRUTH.C1_kPa
    span = {"mounting_stretch_x": (0.99, 1.07), "mounting_stretch_y": (1.05, 1.05)}
    result, wide = (
        determined(table, data, Settings(), refits=r).set_index("quantity") for r in (None, span)
    )
    row = wide.loc["Cauchy stress x"].iloc[1]
    ends = []
    for mounted in (1.07, 0.99):
        # What the machine read at this measured stretch, and the Cauchy stress from it
        measured = np.array([row.stretch_x / mounted, row.stretch_y / MOUNTING[1]])
        total = measured * MOUNTING
        force = TRUTH.cauchy(*total)[0] / (total if geometry == "unloaded" else measured)[0]
        ends.append(force * (row.stretch_x if geometry == "unloaded" else measured[0]))
    assert [row.tissue_low_90, row.tissue_high_90] == pytest.approx(ends, rel=0.02)
    assert row.low_90 == result.loc["Cauchy stress x"].iloc[1].low_90
    for kind in ("low", "high"):  # a load at a measured stretch does not care
        name = f"nominal stress x{AT_MEASURED_STRETCH} of one"
        assert (wide.loc[name, f"tissue_{kind}_90"] == result.loc[name, f"tissue_{kind}_90"]).all()


def test_nothing_is_reported_where_a_tenth_of_the_stretch_may_be_unmeasured():
    """By the refits or by the draws."""
    data, table = stress_specimen(), draws(np.random.default_rng(5))
    near = {"mounting_stretch_x": (0.99, 1.09)}
    far = {"mounting_stretch_x": (0.99, 1.11)}
    strong = table.assign(mounting_stretch_y=table["mounting_stretch_y"] + 0.07)
    for of, refits, reported in (
        (table, None, True),
        (table, near, True),
        (table, far, False),
        (strong, None, False),
    ):
        result = determined(of, data, Settings(), refits=refits)
        cauchy = result["quantity"].str.startswith("Cauchy stress")
        assert result.loc[cauchy, "tissue_low_90"].notna().all() == reported
        assert result.loc[cauchy, "tissue_high_90"].isna().all() != reported
        assert result.loc[cauchy, "low_90"].notna().all()
        nominal = result["quantity"].str.contains(AT_MEASURED_STRETCH, regex=False)
        assert result.loc[nominal, "tissue_low_90"].notna().all()


def test_stresses_hold_with_the_mounting_stretch_that_is_reported_as_a_value():
    """Its ends stand in the place of the refits and of the draws' own, however far they are."""
    data, table = stress_specimen(), draws(np.random.default_rng(5))
    cauchy = "Cauchy stress x"
    value, refits = {"mounting_stretch_x": (1.11, 1.13)}, {"mounting_stretch_x": (0.9, 1.3)}

    def ends(**ranges):
        result = determined(table, data, Settings(), **ranges)
        rows = result[result["quantity"] == cauchy].iloc[-1]
        return rows["tissue_low_90"], rows["tissue_high_90"]

    assert ends(values=value) == ends(values=value, refits=refits)
    near = {"mounting_stretch_x": (1.07, 1.09)}
    assert ends(values=near) == ends(refits=near)
    assert np.isnan(ends(refits=refits)).all()
    # of the other direction nothing is reported as a value, and it may lie far
    far = {"mounting_stretch_y": (1.0, 1.2)}
    assert np.isnan(ends(values=value, refits=far)).all()
    strong = table.assign(mounting_stretch_y=table["mounting_stretch_y"] + 0.07)
    result = determined(strong, data, Settings(), values=value)
    assert result.loc[result["quantity"] == cauchy, "tissue_low_90"].isna().all()


def test_what_is_no_stress_has_no_such_interval():
    result = determined(draws(np.random.default_rng(3)), stress_specimen(), Settings())
    stress = result["quantity"].str.contains("Cauchy stress|nominal stress")
    assert result.loc[stress, "tissue_low_90"].notna().all()
    assert (result.loc[stress, "tissue_low_90"] < result.loc[stress, "low_90"]).all()
    assert (result.loc[stress, "tissue_high_90"] > result.loc[stress, "high_90"]).all()
    assert result.loc[~stress, "tissue_low_90"].isna().all()


@pytest.mark.parametrize(("low", "high"), [(1.00, 1.08), (1.04, 1.10), (1.0395, 1.0405)])
def test_a_mounted_state_elsewhere_fills_its_range_with_90_percent(low, high):
    rng = np.random.default_rng(3)
    lm = np.column_stack([1.03 + 0.02 * rng.standard_normal(40_000), np.full(40_000, 1.05)])
    out = mounting_ratio(stress_specimen(), lm, {"mounting_stretch_x": (low, high)})
    np.testing.assert_array_equal(out[:, 1], 1.0)
    elsewhere = lm[:, 0] / out[:, 0]
    assert np.median(elsewhere) == pytest.approx(0.5 * (low + high), abs=1e-3)
    # the draws' own scatter, 3.29 times 0.02, is never taken away
    width = max(high - low, 3.29 * 0.02)
    # three standard errors of the width of 40,000 draws
    assert np.ptp(np.quantile(elsewhere, [0.05, 0.95])) == pytest.approx(width, rel=0.02)
