"""Tubes: closed forms, an independent integration, the file, the likelihood and the fit."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

import biaxbayes
from biaxbayes.calibration.simulated_specimen import draw_truth, protocol_prior, simulate_specimen
from biaxbayes.errors import InputError, load_text
from biaxbayes.experiments.tube import MMHG_PER_KPA, Tube
from biaxbayes.figures.bands import bands_figure
from biaxbayes.figures.specimen import fits_figure, specimen_figure
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.residuals import BalancedMounting
from biaxbayes.identifiability.identify import identify_run
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import Settings
from biaxbayes.prediction.stress import predict_stress
from biaxbayes.runs.run_result import run_result
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import parse_specimen, read_specimen, write_specimen
from quick_posteriors import sampled, specimen
from virtual_tubes import ARTERY, HEADER, MATERIAL, MATRIX, readings, states, virtual_tube


def test_a_thin_neo_hookean_tube_is_a_membrane():
    """p = mu H / R (lt^2 - 1 / (lt lz)^2) / (lt^2 lz), f = 2 pi r h s_z - pi r^2 p."""
    radius, wall, mu, lz = 10.0, 0.001, 2.0 * MATRIX["C1"], 1.2
    around = np.linspace(1.05, 1.5, 7)
    p, force = readings(Tube(radius, wall), np.column_stack([around, 0 * around + lz]), MATRIX).T
    hoop, axial = around**2 - (around * lz) ** -2.0, lz**2 - (around * lz) ** -2.0
    np.testing.assert_allclose(p, mu * wall / radius * hoop / (around**2 * lz), rtol=1e-3)
    membrane = 2.0 * np.pi * radius * wall / lz * mu * axial - np.pi * (around * radius) ** 2 * p
    np.testing.assert_allclose(1e3 * force, membrane, rtol=2e-3)


def test_a_thick_neo_hookean_tube_has_its_closed_form():
    """With k = (ro^2 lz - B^2) / lz:  lt^2 = r^2 / (lz (r^2 - k)),  r dr integrates in logs."""
    outside, wall, mu, lz = 5.0, 2.0, 2.0 * MATRIX["C1"], 1.3
    inside = outside - wall
    around = np.array([0.98, 1.1, 1.3, 1.6])
    tube = Tube(outside, wall, points_through_wall=12)
    p, force = readings(tube, np.column_stack([around, 0 * around + lz]), MATRIX).T
    ro = around * outside
    ri = np.sqrt(ro**2 - (outside**2 - inside**2) / lz)
    k = ro**2 - outside**2 / lz  # R^2 = lz (r^2 - k)

    def hoop(r):  # integral of lt^2 dr / r = r dr / (lz (r^2 - k))
        return np.log(r**2 - k) / (2.0 * lz)

    def radial(r):  # integral of lr^2 dr / r = (r^2 - k) / (lz r^3) dr
        return (np.log(r) + 0.5 * k / r**2) / lz

    pressure = mu * ((hoop(ro) - hoop(ri)) - (radial(ro) - radial(ri)))
    np.testing.assert_allclose(p, pressure, rtol=1e-9)

    def moment(r):  # integral of (2 lz^2 - lt^2 - lr^2) r dr
        lt2 = 0.5 * (r**2 + k * np.log(r**2 - k)) / lz
        lr2 = (0.5 * r**2 - k * np.log(r)) / lz
        return lz**2 * r**2 - lt2 - lr2

    np.testing.assert_allclose(1e3 * force, np.pi * mu * (moment(ro) - moment(ri)), rtol=1e-9)


@pytest.mark.parametrize("sector_deg", [0.0, 140.0])
def test_a_tube_with_residual_stress_is_in_equilibrium(sector_deg):
    """By quadrature over the wall of the opened sector: r^2 - ri^2 = (R^2 - A^2) / (c lz)."""
    tube = replace(ARTERY, missing_sector_deg=sector_deg)
    c = 360.0 / (360.0 - sector_deg)
    mid, wall = (4.0 - 0.45) * c, 0.9
    A, B = mid - 0.5 * wall, mid + 0.5 * wall
    goh = GOH(*MATERIAL.values())
    for around, lz in ((1.02, 1.1), (1.2, 1.25)):
        ri = np.sqrt((4.0 * around) ** 2 - (B**2 - A**2) / (c * lz))

        def stresses(R, ri=ri, lz=lz):
            r = np.sqrt(ri**2 + (R**2 - A**2) / (c * lz))
            dr = R / (c * lz * r)
            s = goh.cauchy(np.array([c * r / R]), np.array([lz]))
            return r, dr, float(s[0][0]), float(s[1][0])

        def pressure(R, at=stresses):
            r, dr, hoop, _ = at(R)
            return hoop / r * dr

        def force(R, at=stresses):
            r, dr, hoop, axial = at(R)
            return np.pi * (2.0 * axial - hoop) * r * dr

        p, f = readings(tube, np.array([[around, lz]]), MATERIAL)[0]
        assert p == pytest.approx(quad(pressure, A, B)[0], rel=2e-4)
        assert 1e3 * f == pytest.approx(quad(force, A, B)[0], rel=2e-4)


def test_gauss_points_are_enough():
    stretch = np.vstack(states(1.1, 1.3))
    fine = readings(replace(ARTERY, points_through_wall=40), stretch, MATERIAL)
    few = readings(ARTERY, stretch, MATERIAL)
    assert np.abs(few - fine).max(axis=0) / np.abs(fine).max(axis=0) == pytest.approx(0, abs=1e-4)


FILE = """# test: tube
# unloaded_outer_diameter_mm: 8
# unloaded_length_mm: 30
# thickness_mm: 0.9
# opening_angle_fung_deg: 70
outer_diameter_mm,length_mm,pressure_mmHg,axial_force_N
8.4,36,30,0.20
9.2,36,80,0.25
10.0,37.5,120,0.30
"""


def parsed(text: str) -> Specimen:
    from pathlib import Path

    return parse_specimen(text.split("\n"), Path("artery.csv"))


def test_a_file_of_lengths_and_mmHg_is_read(tmp_path):
    tube = parsed(FILE)
    (p,) = tube.protocols
    np.testing.assert_allclose(p.stretch, [[1.05, 1.2], [1.15, 1.2], [1.25, 1.25]])
    np.testing.assert_allclose(p.load_x, np.array([30, 80, 120]) / MMHG_PER_KPA)
    assert tube.units == ("kPa", "N") and p.rest_rows == 0
    # Fung's angle is half the missing sector
    assert tube.experiment == Tube(4.0, 0.9, 140.0)
    write_specimen(tube, tmp_path / "artery.csv")
    assert read_specimen(tmp_path / "artery.csv") == replace(tube, name="artery")


def test_a_protocol_of_a_tube_can_be_taken_alone():
    # it has no mounted state, and so no rows at rest
    tube = virtual_tube(1.1, 1.2)
    (taken,) = tube.only(tube.protocols[-1].name).protocols
    assert np.array_equal(taken.recorded_load, tube.protocols[-1].recorded_load)


def test_a_pressure_alone_is_enough():
    lines = FILE.replace(",axial_force_N", "").splitlines()
    text = "\n".join(line.rpartition(",")[0] if line[0].isdigit() else line for line in lines)
    tube = parsed(text + "\n")
    assert tube.experiment.axes == (0,)
    assert Posterior(tube).readings.weight.size == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("9.2,36", "2.2,36", r"row 8.*outer_diameter_mm.*no lumen"),
        ("9.2,36", "92,36", r"row 8.*outer_diameter_mm.*11.5 is out of range"),
        ("# thickness_mm: 0.9\n", "", "a pressure file must state thickness_mm"),
        ("0.9\n", "4.5\n", r"row 4.*leaves no lumen"),
        ("# unloaded_length_mm: 30\n", "", "length_mm.*needs the unloaded_length_mm"),
        ("# test: tube\n", "", "missing column.*'# test: ...' .*tube"),
        ("length_mm,p", "stretch_q,p", "unknown column"),
        ("# unloaded_length", "# edge_x_mm: 3\n# unloaded_length", "edge_x_mm does not belong"),
        ("# unloaded_length", "# missing_sector_deg: 3\n# unloaded_length", "given twice"),
        ("# unloaded_length", "# opening_angle_deg: 3\n# unloaded_length", "unknown header key"),
        ("120,", "120000,", "more than soft tissue bears"),
    ],
)
def test_what_is_no_tube_is_refused_by_its_row(old, new, message):
    assert old in FILE
    with pytest.raises(InputError, match=message):
        parsed(FILE.replace(old, new, 1))


@pytest.mark.parametrize("noise", ["correlated", "independent"])
def test_a_tube_beside_a_square_has_the_likelihood_of_its_readings(noise):
    """The compiled density against loads in NumPy, and each reading in its own unit."""
    square = specimen(GOH(*MATERIAL.values()), increments=8)
    tube = virtual_tube(1.15)
    tissue = replace(square, further=(tube,))
    posterior = Posterior(tissue, noise=noise)
    start = {**MATERIAL, "noise_sd": 0.003, "noise_sd[tube]": 0.05, "stiffness[tube]": 1.1}
    start |= {"mounting_force_x": 0.1, "mounting_force_y": 0.15}
    u = posterior.coordinates(start)
    natural = posterior.natural(u)
    own = posterior.of_piece(1)
    residual = posterior.residuals(natural)
    compiled = posterior.evaluate(posterior.assembly.problem, u)[2].residual
    np.testing.assert_allclose(compiled, residual, rtol=0, atol=1e-10)
    if noise == "independent":
        (p,) = tube.protocols
        model = 1.1 * readings(ARTERY, p.stretch, MATERIAL)
        measured = tube.load(p)
        np.testing.assert_allclose(residual[0, own], (measured - model).ravel(), atol=1e-10)
    assert np.isfinite(natural["log_likelihood"]).all()


def test_the_unit_of_the_force_does_not_matter():
    """Tubes ten times as large at ten times thicker walls: pressures equal, forces 100 times."""
    small = virtual_tube(1.1, 1.2)
    large = replace(
        small,
        thickness_mm=9.0,
        metadata=HEADER | {"unloaded_outer_diameter_mm": 80.0, "axial_force_noise_N": 0.3},
        protocols=tuple(replace(p, load_y=100.0 * p.load_y) for p in small.protocols),
    )
    for noise in ("correlated", "independent"):
        one, other = (Posterior(s, noise=noise) for s in (small, large))
        values = {**MATERIAL, "C1": np.array([14.0, 16.0, 18.0]), "noise_sd": 0.1}
        a, b = (p.natural(p.coordinates(values))["log_likelihood"] for p in (one, other))
        np.testing.assert_allclose(np.diff(a), np.diff(b), rtol=1e-6)
    assert one.fit.material.values == pytest.approx(other.fit.material.values, rel=1e-6)


def test_stresses_of_a_thin_wall_are_those_of_the_law():
    """Around and along, from pressure and the force on the closed end; by s_t / 2 without force."""
    goh = GOH(*MATERIAL.values())
    tube, (stretch,) = Tube(10.0, 0.01), states(1.15)
    wall = tube.stresses(stretch, readings(tube, stretch, MATERIAL))
    law = np.column_stack(goh.cauchy(*stretch.T))
    assert np.ptp(law[:, 1]) > 10.0  # kPa
    np.testing.assert_allclose(wall, law, rtol=5e-3, atol=0.05)
    alone = replace(tube, reads_force=False)
    wall = alone.stresses(stretch, readings(alone, stretch, MATERIAL))
    np.testing.assert_allclose(wall, law[:, :1] * [[1.0, 0.5]], rtol=5e-3, atol=0.05)


def test_stresses_of_the_wall_follow_the_pressure_that_was_read():
    """The misfit of a pressure is one of the wall's stress, p r / h: thin wall, one known draw."""
    tube = Tube(10.0, 0.01, reads_force=False)
    (stretch,) = states(1.1)
    load = readings(tube, stretch, MATERIAL) * [[1.05, 0.0]]  # 5 % more than the law
    protocol = Protocol("1", *stretch.T, *load.T)
    known = {"unloaded_outer_diameter_mm": 20.0}
    made = Specimen(
        "thin",
        (protocol,),
        "pressure",
        thickness_mm=0.01,
        load_noise=1e-4,
        metadata=known,
        test="tube",
    )
    draws = pd.DataFrame([MATERIAL] * 40)
    table = predict_stress(Posterior(made), draws, stretch[8:])
    hoop = tube.stresses(stretch, load)[8:, 0]
    np.testing.assert_allclose(table["cauchy_x_kPa_median"], hoop, rtol=0.01)


def test_the_derivatives_of_a_fit_are_right():
    tissue = replace(specimen(GOH(*MATERIAL.values()), increments=8), further=(virtual_tube(1.2),))
    setup = FitSetup.from_options(tissue)
    data = setup.data
    problem = BalancedMounting(
        data.loaded(), "load", setup.point, setup.free, data.peaks,
        np.ones_like(data.mounting_load), setup.law,
        np.where(data.is_mounted, data.mounting_sd, 0.0), piece_sd=0.1,
    )  # fmt: skip
    x = np.array([*setup.law.to_fit_coordinates(tuple(MATERIAL.values())), 0.3, -0.2, 0.4])
    jacobian = problem.evaluate(x)[1]
    for i in range(x.size):
        step = np.zeros_like(x)
        step[i] = 1e-5 * max(abs(x[i]), 1.0)
        numeric = (problem.residual(x + step) - problem.residual(x - step)) / (2.0 * step[i])
        scale = np.abs(jacobian[:, i]).max()
        np.testing.assert_allclose(jacobian[:, i], numeric, rtol=0, atol=1e-5 * scale)


def test_a_fit_finds_the_material_of_a_tube():
    exact = virtual_tube(1.1, 1.25, noise=(1e-7, 1e-9))
    fit = FitSetup.from_options(replace(exact, load_noise=None, metadata={**HEADER})).fitted()
    assert fit.converged
    assert fit.material.values == pytest.approx(tuple(MATERIAL.values()), rel=1e-3)


@pytest.mark.long
def test_intervals_of_a_virtual_tube_hold_its_material():
    """With a misfit of 2 %, at two axial stretches; wide 98 % intervals, one fixed seed."""
    run = sampled(virtual_tube(1.1, 1.25, misfit=0.02), noise="correlated")
    assert run.state == "converged"
    assert not any(name.startswith("mounting") for name in run.draws)
    for name, true in MATERIAL.items():
        low, high = run.draws[name].quantile([0.01, 0.99])
        assert low < true < high, name
    assert run.draws["C1"].quantile(0.95) / run.draws["C1"].quantile(0.05) < 1.5
    # one misfit of pressures and forces: in the sentence on the fit, and in the table of laws
    judged = identify_run(run.target, run.draws, "converged")
    result = run_result(
        replace(judged, state="tentative"), run.target, run.draws, pd.DataFrame(), {}
    )
    rms = judged.fits["goh"].rms
    assert result.fit.startswith(f"GOH misses this record by {load_text(rms, 'kPa')} (root")


def test_pressure_and_force_have_axes_of_their_own():
    data = virtual_tube(1.1, 1.25)
    fit = biaxbayes.fit(data, "constrained", starts=1)
    for figure, per_reading in ((specimen_figure(data), 1), (fits_figure(data, [fit]), 2)):
        labels = [ax.get_ylabel() for ax in figure.axes if ax.get_ylabel()]
        assert labels[::per_reading] == ["pressure (kPa)", "axial force (N)"]
        ends = [np.ptp(ax.lines[0].get_ydata()) for ax in figure.axes]
        assert sum(end > 5.0 for end in ends) == 2  # pressures, one of each protocol
    draws = pd.DataFrame([MATERIAL | {"noise_sd": 0.05}] * 20)
    figure = bands_figure(Posterior(data, noise="independent"), draws)
    under = {ax.get_xlabel() for ax in figure.axes if ax.get_xlabel()}
    assert under == {"measured circumferential stretch"}


def test_truths_of_a_tube_are_drawn_at_the_stress_of_its_wall():
    data = virtual_tube(1.2)
    prior = protocol_prior(data, Settings())
    # the wall carries p r / h, several times the pressure
    pressure = replace(data, metadata={**HEADER, "unloaded_outer_diameter_mm": 16.0})
    wider = protocol_prior(pressure, Settings())
    assert wider["C1"].location > 1.8 * prior["C1"].location
    model = Posterior(data, priors=prior)
    truth, rejected = draw_truth(model, np.random.default_rng(1))
    assert rejected < 50 and not any(name.startswith("mounting_force") for name in truth)
    # pressure and force have noise of their own
    loud = replace(data, load_noise=2.0, metadata={**HEADER, "axial_force_noise_N": 0.1})
    model = Posterior(loud, priors=prior)
    made = [simulate_specimen(model, truth, np.random.default_rng(seed)) for seed in range(20)]
    ratio = [s.high_frequency_scatter(0) / s.high_frequency_scatter(1) for s in made]
    assert np.median(ratio) == pytest.approx(20.0, rel=0.2)
    np.testing.assert_allclose(made[0].noise_sds, [2.0, 0.1])


def test_a_square_has_no_opening_angle_and_no_pressure():
    square = "# test: biaxial\nstretch_x,stretch_y,piola_x_kPa,piola_y_kPa,pressure_kPa\n1,1,1,1,1"
    with pytest.raises(InputError, match="a biaxial test has no such column; state '# test: tube'"):
        parsed(f"{square}\n1.1,1.1,2,2,2\n")
    made = specimen(GOH(*MATERIAL.values()))
    with pytest.raises(InputError, match="missing_sector_deg does not belong to a biaxial test"):
        replace(made, metadata={"missing_sector_deg": 20.0})
