"""Stresses to report: those of the tissue, the law and its misfit given the readings."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from biaxbayes.derived.determined import AT_MEASURED_STRETCH, determined
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import start_parameters
from biaxbayes.specimens.specimen import Protocol, Specimen
from plain_posterior import theta_of
from plain_strips import strip

TRUTH = GOH(9.0, 20.0, 4.0, 42.0, 0.15)
MOUNTING = (1.03, 1.05)


def stress_specimen(geometry: str = "unloaded") -> Specimen:
    """Two protocols without noise, loads as stress per unloaded or mounted section."""
    protocols = []
    for name, ratio in (("one", (1.0, 1.0)), ("two", (1.0, 0.5))):
        stretch = 1.0 + np.linspace(0.0, 0.15, 16)[:, None] * ratio
        total = stretch * MOUNTING
        cauchy = np.column_stack(TRUTH.cauchy(*total.T))
        load = cauchy / (total if geometry == "unloaded" else stretch)
        protocols.append(Protocol(name, *stretch.T, *load.T))
    return Specimen("made", tuple(protocols), "piola", geometry=geometry, load_noise=0.01)


def draws(n: int = 4000) -> pd.DataFrame:
    values = {"k1": TRUTH.k1_kPa, "k2": TRUTH.k2, "alpha": TRUTH.alpha_deg, "kappa": TRUTH.kappa}
    values |= {
        "mounting_stretch_x": MOUNTING[0],
        "mounting_stretch_y": MOUNTING[1],
        "noise_sd": 2.0,
    }
    C1 = TRUTH.C1_kPa * np.exp(0.05 * np.random.default_rng(1).standard_normal(n))
    return pd.DataFrame({"C1": C1} | values)


def exact(geometry: str = "unloaded") -> Posterior:
    return Posterior(stress_specimen(geometry), noise="independent")


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_where_the_law_is_the_tissue_the_interval_is_that_of_its_stresses(geometry):
    """Of the tissue, whatever the noise of a reading; of every 4th draw."""
    table = draws()
    result = determined(exact(geometry), table).set_index("quantity")
    C1 = table["C1"].to_numpy()[::4]
    for name in ("Cauchy stress x", f"nominal stress x{AT_MEASURED_STRETCH} of two"):
        row = result.loc[name].iloc[1]
        measured = AT_MEASURED_STRETCH in name
        total = np.array([row.stretch_x, row.stretch_y]) * (MOUNTING if measured else (1.0, 1.0))
        law = [GOH(c, 20.0, 4.0, 42.0, 0.15) for c in C1]
        stress = [(m.piola if measured else m.cauchy)(*total)[0] for m in law]
        wanted = np.quantile(stress, [0.5, 0.05, 0.95])
        assert [row["median"], row.low, row.high] == pytest.approx(wanted, rel=1e-9)
        assert row.relative_width == pytest.approx((row.high - row.low) / row["median"])


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_a_nominal_stress_is_the_force_that_was_read_over_the_unloaded_section(geometry):
    data = stress_specimen(geometry)
    result = determined(exact(geometry), draws())
    ends = result[result["quantity"].str.match("nominal stress .* of one$")]
    assert len(ends) == 4
    last = data.protocols[0]
    for axis in (0, 1):
        row = ends.iloc[2 + axis]
        assert (row.stretch_x, row.stretch_y) == pytest.approx((1.15, 1.15))
        load = (last.load_x, last.load_y)[axis][-1]
        # the section of the mounted specimen is that of the unloaded one over its stretch
        expected = load / MOUNTING[axis] if geometry == "mounted" else load
        assert row["median"] == pytest.approx(expected, rel=0.01)


def missed(geometry: str) -> Posterior:
    """Of readings that a material fits badly: a wave of 4 % on every curve."""
    made, protocols = stress_specimen(geometry), []
    for p in made.protocols:
        wave = 1.0 + 0.04 * np.sin(2.5 * np.pi * np.linspace(0.0, 1.0, p.rows))
        protocols.append(replace(p, load_x=p.load_x * wave, load_y=p.load_y * wave))
    return Posterior(replace(made, protocols=tuple(protocols)))


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_a_stress_at_a_measured_stretch_is_that_of_the_reading_though_the_law_misses_it(geometry):
    posterior = missed(geometry)
    rng = np.random.default_rng(3)
    values = start_parameters(posterior)
    values = {k: v * (1.0 + 1e-4 * rng.standard_normal(400)) for k, v in values.items()}
    table = pd.DataFrame(posterior.natural(posterior.coordinates(values)))
    result = determined(posterior, table)
    assert result["quantity"].str.startswith("Hx").any()
    missed_by = []
    for p in posterior.specimen.protocols:
        rows = result[result["quantity"].str.match(f"nominal stress .* of {p.name}$")]
        assert len(rows) == 4
        lm = table[["mounting_stretch_x", "mounting_stretch_y"]].median().to_numpy()
        for k, row in enumerate(rows.itertuples()):
            axis = k % 2
            reading = (p.load_x, p.load_y)[axis][15 if k > 1 else 8]
            reading /= lm[axis] if geometry == "mounted" else 1.0
            if k > 1:  # half-way lies between two rows
                assert row.low < reading < row.high
                assert row.median == pytest.approx(reading, rel=0.01)
            law = posterior.law.material(table[:1]).piola(*(p.stretch[15] * lm))[axis][0, 0]
            missed_by.append(abs(law / (row.median if k > 1 else law) - 1.0))
    assert max(missed_by) > 0.01  # the law alone does not say it


def test_at_total_stretches_what_lies_off_the_tested_paths_is_known_less_well():
    posterior = missed("unloaded")
    values = {k: np.full(300, v) for k, v in start_parameters(posterior).items()}
    table = pd.DataFrame(posterior.natural(posterior.coordinates(values)))
    lm = table[["mounting_stretch_x", "mounting_stretch_y"]].median().to_numpy()
    tested = tuple(float(v) for v in np.array([1.15, 1.15]) * lm)
    beside = tuple(float(v) for v in np.array([1.15, 1.11]) * lm)
    result = determined(posterior, table, stretches=[tested, beside]).set_index("quantity")
    on, off = result.loc["Cauchy stress x", "relative_width"].to_numpy()
    assert on < 0.5 * off
    # quantities of the law have the spread of the draws alone, which is none here
    assert result.loc["tangent stiffness xx", "relative_width"].to_numpy() == pytest.approx(0.0)


@pytest.mark.parametrize("width", [False, True])
def test_of_a_strip_the_end_is_where_its_sides_were_and_the_stress_the_one_read(width):
    """Not at the width of the start, the largest of all, which it left at once."""
    theta = theta_of({"C1": 9.0, "k1": 20.0, "k2": 4.0, "alpha": 42.0, "kappa": 0.15})
    made = strip(0, theta, width=width, noise=1e-4)
    posterior = Posterior(made, noise="independent")
    values = {k: np.full(300, v) for k, v in start_parameters(posterior).items()}
    result = determined(posterior, pd.DataFrame(posterior.natural(posterior.coordinates(values))))
    ends = result[result["quantity"] == f"nominal stress x{AT_MEASURED_STRETCH}"]
    known = strip(0, theta, width=True).protocols[0].stretch
    np.testing.assert_allclose(ends["stretch_x"], [1.15, 1.3], atol=1e-4)
    sides = np.interp([1.15, 1.3], *known.T)
    assert sides[1] < 0.9
    np.testing.assert_allclose(ends["stretch_y"], sides, atol=0.05)
    read = made.load(made.protocols[0])[-1, 0] / made.area[0]
    assert ends["median"].iloc[1] == pytest.approx(read, rel=0.01)
