"""Predicted bands and inflated tubes against quadrature, energy, sampling and hand calculation."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from biaxbayes.errors import InputError
from biaxbayes.laws.published import MATERIALS
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import start_parameters
from biaxbayes.prediction.bands import bands
from biaxbayes.prediction.draws import mounting_labels
from biaxbayes.prediction.inflation import (
    ThinTube,
    predict_diameter,
    predict_pressure,
    stretch_at_pressure,
)
from biaxbayes.prediction.percentiles import mixture_percentiles
from biaxbayes.prediction.stress import (
    BELOW,
    BEYOND,
    INSIDE,
    OFF_PATH,
    CoveredStretches,
    measured_stress,
    predict_stress,
    stretch_path,
)
from biaxbayes.specimens.specimen import Specimen
from goh_functions import GOH_LAW, at, strain_energy
from quick_posteriors import exact_specimen

MEDIA = MATERIALS["weisbecker-media"].material


def specimen(ratios=((1.0, 1.0),), geometry="unloaded") -> Specimen:
    made = exact_specimen(MEDIA, measured_stretch=1.2, ratios=ratios)
    return replace(made, geometry=geometry, load_noise=0.001)


def posterior(tested: Specimen | None = None, **options) -> Posterior:
    """Of a specimen that the law describes exactly, unless options say otherwise."""
    return Posterior(tested or specimen(), **{"noise": "independent", **options})


def draws(n=500, *, spread=0.1, noise=0.02, seed=1) -> pd.DataFrame:
    z = spread * np.random.default_rng(seed).standard_normal((7, n))
    columns = {
        **{"C1": 14.0 * np.exp(z[0]), "k1": 140.0 * np.exp(z[1]), "k2": 11.9 * np.exp(z[2])},
        "alpha": np.clip(38.4 + 20 * z[3], 0, 90),
        "kappa": np.clip(0.21 + 0.1 * z[4], 0, 1 / 3),
        "mounting_stretch_x": 1.01 + 0.01 * z[5],
        "mounting_stretch_y": 1.02 + 0.01 * z[6],
    }
    return pd.DataFrame(columns | {"noise_sd": np.full(n, noise)})


# --- percentiles ---


def test_mixture_percentile_has_the_given_mass():
    rng = np.random.default_rng(0)
    mean, sd = rng.normal(size=(300, 4)), rng.uniform(0.1, 2.0, size=(300, 4))
    for level, q in zip((0.05, 0.95), mixture_percentiles(mean, sd, (0.05, 0.95)), strict=True):
        np.testing.assert_allclose(norm.cdf(q, mean, sd).mean(axis=0), level, atol=1e-9)


# --- stress ---


def test_one_certain_draw_predicts_the_model():
    one = draws(1, spread=0.0)
    path = stretch_path(1.2, ratio=(1.0, 0.5), points=9)
    for stress, law in (("cauchy", MEDIA.cauchy), ("piola", MEDIA.piola)):
        table = predict_stress(posterior(), one, path, relative_to="unloaded", stress=stress)
        for name, expected in zip("xy", law(path[:, 0], path[:, 1]), strict=True):
            np.testing.assert_allclose(table[f"{stress}_{name}_kPa_median"], expected, rtol=1e-12)


def test_a_strip_takes_the_width_that_carries_nothing():
    one = draws(1, spread=0.0)
    path = stretch_path(1.2, points=5)
    table = predict_stress(posterior(), one, path, relative_to="unloaded", strip="y")
    for _, row in table.iterrows():

        def across(x, y=row["stretch_y"]):
            return float(MEDIA.cauchy(x, y)[0])

        width = brentq(across, 0.7, 1.1, xtol=1e-13)
        assert row["stretch_x"] == pytest.approx(width, rel=1e-8)
        stress = float(MEDIA.cauchy(width, row["stretch_y"])[1])
        assert row["cauchy_y_kPa_median"] == pytest.approx(stress, abs=1e-6)
    assert not any(column.startswith("cauchy_x") for column in table)


def test_measured_stretches_are_multiplied_by_each_draws_mounting_stretch():
    one = draws(1, spread=0.0)
    path = stretch_path(1.2, points=5)
    table = predict_stress(posterior(), one, path, relative_to="mounted", stress="piola")
    expected = MEDIA.piola(path[:, 0] * 1.01, path[:, 1] * 1.02)[0]
    np.testing.assert_allclose(table["piola_x_kPa_median"], expected, rtol=1e-12)
    np.testing.assert_allclose(table["total_stretch_y"], path[:, 1] * 1.02)
    assert (table["extrapolation"] == INSIDE).all()


def test_predictive_band_is_the_reading_noise_over_the_section():
    """0.02 N over 20 mm * 0.88 mm is 1.13636 kPa; 90 % of a normal is +-1.64485 sd."""
    frame = draws(1, spread=0.0)

    def half(column, values=frame, tested=None, **options):
        table = predict_stress(posterior(tested), values, [[1.1, 1.1]], **options)
        return float((table[f"{column}_predictive_high"] - table[f"{column}_median"])[0])

    plain = half("piola_x_kPa", stress="piola", relative_to="unloaded")
    assert plain == pytest.approx(1.6448536 * 1.1363636, rel=1e-6)
    # Cauchy stress is Piola stress times the total stretch, and so is its noise.
    assert half("cauchy_x_kPa", relative_to="unloaded") == pytest.approx(1.1 * plain, rel=1e-6)
    # Over the section of the unloaded specimen, whatever the file's dimensions are those of.
    options = {"relative_to": "mounted", "stress": "piola"}
    plain = half("piola_y_kPa", **options)
    mounted = half("piola_y_kPa", tested=specimen(geometry="mounted"), **options)
    assert mounted == pytest.approx(plain / 1.02, rel=1e-6)
    other = half("piola_y_kPa", frame.assign(edge_x=1.1, thickness=0.9), **options)
    assert other == pytest.approx(plain / (1.1 * 0.9), rel=1e-6)


def test_protocols_with_their_own_mounted_state_must_be_named():
    frame = draws(20)
    for name in ("1:1", "1:0.5"):
        for axis in "xy":
            frame[f"mounting_stretch_{axis}[{name}]"] = frame[f"mounting_stretch_{axis}"]
    frame = frame.drop(columns=["mounting_stretch_x", "mounting_stretch_y"])
    sample = specimen(((1.0, 1.0), (1.0, 0.5)))
    assert mounting_labels(frame, sample) == ("1:1", "1:0.5")
    path = stretch_path(1.15, points=4)
    with pytest.raises(InputError, match=r"name the protocol: 1:1, 1:0\.5"):
        predict_stress(posterior(sample), frame, path, relative_to="mounted")
    with pytest.raises(InputError, match="no protocol 'other'"):
        predict_stress(posterior(sample), frame, path, relative_to="mounted", protocol="other")
    named = predict_stress(posterior(sample), frame, path, relative_to="mounted", protocol="1:0.5")
    shared = predict_stress(posterior(sample), draws(20), path, relative_to="mounted")
    pd.testing.assert_frame_equal(named, shared)


@pytest.mark.parametrize(
    ("path", "options", "message"),
    [
        ([[1.0, -1.0]], {}, "positive"),
        ([[1.0, np.nan]], {}, "positive"),
        ([1.0, 1.1], {}, "in every row"),
        ([[1.1, 1.1]], {"probability": 1.0}, "between 0 and 1"),
        ([[1.1, 1.1]], {"stress": "kirchhoff"}, "cauchy or piola"),
        ([[40.0, 40.0]], {}, "overflows"),
    ],
)
def test_wrong_questions_are_named(path, options, message):
    with pytest.raises(InputError, match=message):
        predict_stress(posterior(), draws(3), path, **options)


def test_a_ratio_leads_with_its_larger_share():
    path = stretch_path(1.3, ratio=(0.5, 1.0), points=3)
    np.testing.assert_allclose(path, [[1.0, 1.0], [1.075, 1.15], [1.15, 1.3]])
    with pytest.raises(InputError, match="stretches nothing"):
        stretch_path(1.3, ratio=(0.0, 0.0))


# --- what was tested ---


def test_extrapolation_is_marked_row_by_row():
    sample = specimen(((1.0, 1.0), (1.0, 0.5)))
    region = CoveredStretches(sample)
    states = [(1.1, 1.1), (1.15, 1.1), (1.2, 1.2), (1.21, 1.2), (0.99, 1.0), (1.02, 1.18)]
    wanted = [INSIDE, INSIDE, INSIDE, BEYOND, BELOW, OFF_PATH]
    assert list(region.extrapolation(*np.transpose(states))) == wanted
    assert list(region.extrapolation([np.nan], [1.1])) == [BEYOND]


def test_a_single_protocol_is_a_line_not_an_area():
    region = CoveredStretches(specimen())
    assert len(region.hull) == 2
    assert list(region.extrapolation([1.1, 1.1], [1.1, 1.0])) == [INSIDE, OFF_PATH]


def test_total_stretches_below_the_mounted_state_are_marked():
    path = stretch_path(1.3, points=7)
    table = predict_stress(posterior(), draws(50), path, relative_to="unloaded")
    assert table["extrapolation"].tolist() == [BELOW, *[INSIDE] * 4, *[BEYOND] * 2]


# --- tubes ---


def test_pressure_and_diameter_tables_are_inverses_of_each_other():
    tube = ThinTube(9.0, 1.2, 1.05)
    frame = draws(400)
    at = predict_diameter(posterior(), frame, tube, [4.0, 13.3])
    for _, row in at.iterrows():
        back = predict_pressure(
            posterior(), frame, tube, [row["circumferential_stretch_credible_low"]]
        )
        # The stiffest 5 % of the draws are the narrowest 5 %.
        assert back["pressure_kPa_credible_high"][0] == pytest.approx(row["pressure_kPa"], rel=2e-3)
    assert (at["share_without_equilibrium"] == 0.0).all()


def test_pressure_bands_are_those_of_the_draws():
    tube = ThinTube(9.0, 1.2, 1.05, "y")
    frame = draws(300, noise=0.0)
    table = predict_pressure(posterior(), frame, tube, [1.1])
    each = [tube.loads(GOH_LAW.material(r._asdict()), 1.1)[0] for r in frame.itertuples()]
    assert table["pressure_kPa_median"][0] == pytest.approx(np.median(each))
    assert table["pressure_kPa_credible_low"][0] == pytest.approx(np.quantile(each, 0.05))


def test_the_residual_of_the_stress_widens_pressure_and_diameter():
    tube = ThinTube(9.0, 1.2)
    sample = posterior()
    certain = draws(2000, spread=0.0)
    p = predict_pressure(sample, certain, tube, [1.15])
    # p = P_t H / (R lt la), so sd_p = 1.13636 * 1.2 / (9 * 1.15) kPa; f = 2 pi R H P_a - pi r^2 p
    sd_kPa, around = 1.1363636, tube.wall(1.15)[0][0]
    sd_p = sd_kPa * 1.2 / (9.0 * around)
    half = p["pressure_kPa_predictive_high"] - p["pressure_kPa_median"]
    assert half[0] == pytest.approx(1.6448536 * sd_p, rel=0.01)
    sd_f = np.hypot(2.0 * np.pi * 9.0 * 1.2 * sd_kPa, np.pi * (9.0 * around) ** 2 * sd_p)
    half = p["axial_force_mN_predictive_high"] - p["axial_force_mN_median"]
    assert half[0] == pytest.approx(1.6448536 * sd_f, rel=0.01)
    d = predict_diameter(sample, certain, tube, p["pressure_kPa_median"], seed=5)
    assert d["circumferential_stretch_median"][0] == pytest.approx(1.15, rel=1e-9)
    assert d["outer_diameter_mm_predictive_low"][0] < d["outer_diameter_mm_credible_low"][0]
    # Where the pressure band's upper end meets the pressure, the diameter band has its lower one.
    low = d["circumferential_stretch_predictive_low"][0]
    highest = predict_pressure(sample, certain, tube, [low])["pressure_kPa_predictive_high"][0]
    assert highest == pytest.approx(p["pressure_kPa_median"][0], rel=0.02)  # 2000 residuals
    again = predict_diameter(sample, certain, tube, p["pressure_kPa_median"], seed=5)
    pd.testing.assert_frame_equal(d, again)


def test_draws_without_a_state_are_counted_and_left_out():
    frame = draws(10, spread=0.0)
    frame.loc[:3, "k1"] = 0.0
    frame.loc[:3, "C1"] = 1.0
    table = predict_diameter(posterior(), frame, ThinTube(9.0, 1.2), [15.0, 1e6])
    assert table["share_without_equilibrium"].tolist() == pytest.approx([0.4, 0.4])
    assert np.isfinite(table["outer_diameter_mm_median"]).all()
    soft = frame.iloc[:3]
    table = predict_diameter(posterior(), soft, ThinTube(9.0, 1.2), [15.0])
    assert np.isnan(table["outer_diameter_mm_median"][0])
    assert table["extrapolation"][0] == BEYOND


# --- with a smooth misfit of the law ---


def missed(share=0.03, ratios=((1.0, 1.0), (1.0, 0.5))) -> Posterior:
    """Of readings that the law misses by a smooth share of their load."""
    made = specimen(ratios)
    protocols = []
    for p in made.protocols:
        wave = 1.0 + share * np.sin(2.5 * np.pi * np.linspace(0.0, 1.0, p.rows))
        protocols.append(replace(p, load_x=p.load_x * wave, load_y=p.load_y * wave))
    return posterior(replace(made, protocols=tuple(protocols)), noise="correlated")


def near_the_fit(of: Posterior, n=60, spread=1e-3) -> pd.DataFrame:
    rng = np.random.default_rng(2)
    at = start_parameters(of)
    values = {k: v * (1.0 + spread * rng.standard_normal(n)) for k, v in at.items()}
    return pd.DataFrame(of.natural(of.coordinates(values)))


@pytest.fixture(scope="module")
def smooth():
    of = missed()
    return of, near_the_fit(of)


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("mounting_stretch", ["shared", "per-protocol"])
def test_on_a_tested_path_the_tissue_is_what_was_read(geometry, mounting_stretch):
    """The law misses by 3 %, law and misfit given the readings by no more than their noise."""
    made = missed().specimen
    made = replace(made, geometry=geometry, metadata={"load_offset_sd_N": 0.02})
    of = posterior(made, noise="correlated", mounting_stretch=mounting_stretch)
    drawn = near_the_fit(of, n=40).assign(load_offset_x=0.01, load_offset_y=-0.01)
    table = bands(of, drawn)
    after, noise = table[table["stretch"] > 1.02], made.noise_sd
    assert (after["law"] - after["measured"]).abs().max() > 5.0 * noise
    assert (after["predictive_q50"] - after["measured"]).abs().max() < 2.0 * noise
    width = after["predictive_q95"] - after["predictive_q05"]
    assert (width > 2 * 1.6 * noise).all()
    # draws have an offset that the readings do not have: where each curve has its own mounted
    # state friction explains it, which is in readings but not in the tissue
    if mounting_stretch == "shared":
        assert (after["credible_q50"] - after["measured"]).abs().max() < 2.0 * noise
        assert (after["credible_q95"] - after["credible_q05"] < width).all()
    else:
        assert (after["credible_q50"] - after["measured"]).abs().max() > 5.0 * noise


def test_a_stress_along_a_tested_path_is_that_of_the_readings(smooth):
    of, frame = smooth
    p = of.specimen.protocols[1]
    table = predict_stress(of, frame, p.stretch, relative_to="mounted", stress="piola")
    read = of.specimen.load(p) / of.specimen.area
    after = p.stretch[:, 0] > 1.02
    for axis, name in enumerate("xy"):
        error = (table[f"piola_{name}_kPa_median"] - read[:, axis])[after].abs()
        assert error.max() < 3.0 * of.specimen.noise_sd / of.specimen.area[axis]


THREE = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))


def test_between_the_paths_of_a_tissue_that_the_law_describes_it_is_known_well():
    """The tested curves have hardly any misfit, toe included: so has the one between them."""
    of = missed(0.0, THREE)
    path = stretch_path(1.19, ratio=(1.0, 0.75), points=7)[1:]
    table = predict_stress(of, near_the_fit(of), path, relative_to="mounted")
    for axis in "xy":
        width = table[f"cauchy_{axis}_kPa_credible_high"] - table[f"cauchy_{axis}_kPa_credible_low"]
        assert (width < 0.05 * table[f"cauchy_{axis}_kPa_median"]).all()


def test_a_tube_carries_the_misfit_of_its_wall(smooth):
    """The same draws, with the misfit and as if the law were the tissue."""
    of, frame = smooth
    tube, p = ThinTube(9.0, 1.2, 1.05), [4.0, 13.3]
    exact = of.replaced(noise="independent")
    alone = frame.assign(noise_sd=of.specimen.noise_sd)
    for predict, name, where in (
        (predict_diameter, "outer_diameter_mm", p),
        (predict_pressure, "pressure_kPa", [1.1, 1.15]),
    ):
        with_misfit, without = (predict(*a, tube, where) for a in ((of, frame), (exact, alone)))
        width = [
            t[f"{name}_credible_high"] - t[f"{name}_credible_low"] for t in (with_misfit, without)
        ]
        assert (width[0] > 2.0 * width[1]).all()
    again = predict_diameter(of, frame, tube, p)
    pd.testing.assert_frame_equal(again, predict_diameter(of, frame, tube, p))


@pytest.mark.long
def test_bands_hold_curves_of_the_very_model():
    """Misfits drawn from the prior, the law known: 90 % of the tissue's loads, and of readings."""
    of = missed(0.0)
    # the truth, as the draws have it
    frame = near_the_fit(of, n=400, spread=0.0)
    rng, held, read, seen = np.random.default_rng(9), 0.0, 0.0, 30
    noise = of.specimen.noise_sd
    counts = [p.rows for p in of.specimen.protocols]
    law = [of.forward.load(frame[:1], p.stretch, p.name)[0] for p in of.specimen.protocols]
    points = of.misfit.points.joined(
        [of.paths.tested(i, p.stretch) for i, p in enumerate(of.specimen.protocols)]
    )
    for _ in range(seen):
        delta, _, factor = of.misfit.draw(points, rng)
        protocols, curves, first = [], [], 0
        for p, loads, n in zip(of.specimen.protocols, law, counts, strict=True):
            curve = loads + delta[first : first + 2 * n].reshape(n, 2)
            first += 2 * n
            readings = curve + factor * noise * rng.standard_normal(curve.shape)
            protocols.append(replace(p, load_x=readings[:, 0], load_y=readings[:, 1]))
            curves.append(curve)
        made = replace(of.specimen, protocols=tuple(protocols), load_noise=noise)
        again = Posterior(made, misfit_fit=of.misfit_fit)
        table = bands(again, frame, max_rows=12)
        truth = np.concatenate([
            c[table.loc[table["protocol"] == p.name, "row"].unique()].T.ravel()
            for p, c in zip(made.protocols, curves, strict=True)
        ])  # fmt: skip
        held += ((truth >= table["credible_q05"]) & (truth <= table["credible_q95"])).mean()
        new = truth + factor * noise * rng.standard_normal(len(truth))
        read += ((new >= table["predictive_q05"]) & (new <= table["predictive_q95"])).mean()
    # points of a curve go together: some five independent ones each
    error = np.sqrt(0.9 * 0.1 / (5 * seen))
    assert abs(held / seen - 0.9) < 3.0 * error and abs(read / seen - 0.9) < 3.0 * error


# --- readings along a path ---


def test_readings_are_those_of_the_protocols_along_the_path():
    tested, one = specimen(((1.0, 1.0), (1.0, 0.5))), draws(1, spread=0.0)
    of = Posterior(tested, noise="independent")
    lm = one[["mounting_stretch_x", "mounting_stretch_y"]].to_numpy()[0]
    for p in tested.protocols:
        stretch = np.column_stack([p.stretch_x, p.stretch_y])
        result = measured_stress(of, one, stretch, relative_to="mounted", stress="piola")
        assert set(result["protocol"]) == {p.name}
        np.testing.assert_allclose(result[["stretch_x", "stretch_y"]], stretch)
        model = MEDIA.piola(*(stretch * lm).T)
        for axis, name in enumerate("xy"):
            stress = tested.load(p)[:, axis] / tested.area[axis]
            np.testing.assert_allclose(result[f"piola_{name}_kPa"], stress, rtol=1e-12)
            missed = result[f"piola_{name}_kPa_residual"]
            np.testing.assert_allclose(missed, stress - model[axis], atol=1e-9)
    aside = 1.0 + np.linspace(0.0, 0.2, 9)[:, None] * np.array([-0.5, 1.0])
    assert measured_stress(of, one, aside).empty


def test_an_offset_of_the_load_cell_is_taken_off_the_readings():
    tested = replace(specimen(((1.0, 1.0),)), metadata={"load_offset_sd_N": 0.02})
    offset = np.array([0.01, -0.02])
    one = draws(1, spread=0.0).assign(load_offset_x=offset[0], load_offset_y=offset[1])
    (p,) = tested.protocols
    of = Posterior(tested, noise="independent")
    result = measured_stress(of, one, p.stretch, stress="piola")
    stress = (tested.load(p) - offset) / tested.area
    np.testing.assert_allclose(result[["piola_x_kPa", "piola_y_kPa"]], stress, rtol=1e-12)


def test_readings_along_a_tested_path_lie_on_the_tissue_where_the_law_misses(smooth):
    """By the noise, as their band is that of the law and its misfit; the law misses by 3 %."""
    of, frame = smooth
    p = of.specimen.protocols[0]
    result = measured_stress(of, frame, p.stretch, stress="piola")
    law = predict_stress(
        of.replaced(noise="independent"), frame.assign(noise_sd=1e-3), p.stretch, stress="piola"
    )
    for axis, name in enumerate("xy"):
        noise = of.specimen.noise_sd / of.specimen.area[axis]
        after = result["stretch_x"] > 1.02
        assert result[f"piola_{name}_kPa_residual"][after].abs().max() < 4.0 * noise
        missed = result[f"piola_{name}_kPa"] - law[f"piola_{name}_kPa_median"]
        assert missed[after].abs().max() > 5.0 * noise


# --- thin-walled inflation against energy, hand calculation and its own inverse ---


@pytest.mark.parametrize("circumferential", ["x", "y"])
@pytest.mark.parametrize("axial", [1.0, 1.15])
def test_pressure_and_force_are_derivatives_of_the_energy(circumferential, axial):
    """Virtual work of a thin wall, with V inside its middle: p dV = dW, f = d(W - p V) / dL."""
    tube, h = ThinTube(9.0, 0.045, axial, circumferential), 1e-30
    p, f = tube.loads(at(*MEDIA.theta), 1.13)
    around = tube.wall(1.13)[0][0]
    wall = 2.0 * np.pi * 9.0 * 0.045  # per unit of unloaded length

    def energy(around, along):
        x, y = (around, along) if circumferential == "x" else (along, around)
        return wall * strain_energy(*MEDIA.theta, x, y)

    def volume(around, along):
        return np.pi * (around * 9.0) ** 2 * along

    wider = complex(around, h)
    assert p == pytest.approx(energy(wider, axial).imag / volume(wider, axial).imag, rel=1e-4)
    longer = complex(axial, h)
    force_mN = (energy(around, longer) - p * volume(around, longer)).imag / h
    assert 1e3 * f == pytest.approx(force_mN, rel=1e-3)


def test_neo_hookean_tube_by_hand():
    """Outer radius 10.5 to 12 mm: the inner 9.5 to sqrt(144 - 110.25 + 90.25) = 11.1355 mm.

    r = 11.56776, R^2 = 110.25 - (144 - r^2), lt = r / R, s_t = 100 (lt^2 - lt^-2), p = s_t h / r.
    """
    tube = ThinTube(10.0, 1.0)
    p, _ = tube.loads(at(50.0, 0.0, 1.0, 0.5, 0.1), 12.0 / 10.5)
    inner = np.sqrt(144.0 - 110.25 + 90.25)
    r = 0.5 * (12.0 + inner)
    around = r / np.sqrt(110.25 - (144.0 - r**2))
    stress = 100.0 * (around**2 - around**-2)
    assert p == pytest.approx(stress * (12.0 - inner) / r, rel=1e-12)
    assert tube.outer_diameter_mm(12.0 / 10.5) == pytest.approx(24.0)
    with pytest.raises(InputError, match="no lumen"):
        predict_pressure(posterior(), draws(20), tube, [0.3])


def test_stretch_inverts_pressure_for_many_draws():
    low, high = np.array([[2.0, 40.0, 0.5, 0.3, 0.0], [30.0, 150.0, 30.0, 1.2, 0.3]])
    theta = np.random.default_rng(3).uniform(low, high, (200, 5)).T[..., None]
    tube, wanted = ThinTube(8.0, 1.5, 1.1, "y"), np.array([0.0, 2.0, 10.7, 16.0])
    stretch = stretch_at_pressure(at(*theta), tube, wanted)
    assert (np.diff(stretch, axis=1) > 0.0).all()
    back = tube.loads(at(*theta), stretch)[..., 0]
    np.testing.assert_allclose(back, np.broadcast_to(wanted, back.shape), rtol=1e-7, atol=1e-8)


def test_a_soft_tube_has_no_state_at_a_high_pressure():
    # Neo-Hookean: p = 2 C1 H/R (1 - lt^-4) la^-1 never reaches 2 C1 H / R = 1 kPa of a thin wall
    tube = ThinTube(10.0, 0.01)
    around = stretch_at_pressure(at(500.0, 0.0, 1.0, 0.5, 0.1), tube, [0.5, 1.1])
    assert around[0, 0] == pytest.approx(0.5**-0.25, rel=1e-3)
    assert np.isnan(around[0, 1])


def test_stiff_exponential_overflow_is_a_wall_not_a_warning():
    stretch = stretch_at_pressure(at(2.0, 30.0, 4000.0, 0.7, 0.2), ThinTube(10.0, 1.0), [16.0])
    assert 1.0 < stretch[0, 0] < 1.2


def test_beside_the_tested_paths_the_tissue_is_known_less_well(smooth):
    of, frame = smooth
    beside = stretch_path(1.15, ratio=(1.0, 0.75), points=6)[1:]
    p = of.specimen.protocols[0]
    along = p.stretch[[20, 40, 60, 80, 99]]
    wide, narrow = (
        predict_stress(of, frame, path, relative_to="mounted") for path in (beside, along)
    )

    def relative(table):
        width = table["cauchy_x_kPa_credible_high"] - table["cauchy_x_kPa_credible_low"]
        return width / table["cauchy_x_kPa_median"]

    assert relative(wide).iloc[-1] > 2.0 * relative(narrow).iloc[-1]


def test_all_paths_begin_at_one_mounted_state():
    """The force there was read, whatever path follows."""
    of = missed(0.0, THREE)
    frame = near_the_fit(of)
    tested = of.specimen.protocols[0].stretch
    beside = stretch_path(1.19, ratio=(1.0, 0.75), points=7)
    first = [
        predict_stress(of, frame, path, relative_to="mounted").iloc[0] for path in (tested, beside)
    ]
    width = [t["cauchy_x_kPa_credible_high"] - t["cauchy_x_kPa_credible_low"] for t in first]
    assert width[1] < 2.0 * width[0]
