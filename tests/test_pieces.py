"""Several pieces of one tissue: strips in files, forward model, fits, density and run folders."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes import GOH, Specimen, read_specimen, write_specimen
from biaxbayes.calibration.simulated_specimen import draw_truth, protocol_prior, simulate_specimen
from biaxbayes.derived.known import piece_stiffnesses
from biaxbayes.errors import InputError
from biaxbayes.fitting.constrained import FitSetup
from biaxbayes.fitting.residuals import BalancedMounting
from biaxbayes.forward import ForwardModel
from biaxbayes.laws import law_named
from biaxbayes.model import misfit
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import Settings
from biaxbayes.specimens.check import check_specimen
from plain_posterior import SMOOTH, TRUTH, PlainPosterior, some_terms, specimen_of, theta_of
from plain_strips import PlainStrip, PlainTissue, across_root, strip, strip_force
from quick_posteriors import stated_fit
from studies.pieces import stresses, virtual_tissue

THETA = theta_of(TRUTH)
GEOMETRY = pytest.mark.parametrize("geometry", ["unloaded", "mounted"])


def tissue(geometry="unloaded", stiffness=(1.1, 0.95), wide=1, **others) -> Specimen:
    """A square and two strips; the width of the one along the axis `wide` was measured."""
    square = specimen_of("force", geometry, noise=0.005, rows=12)
    unsure = {"thickness_sd_mm": 0.03, "load_offset_sd_N": 0.001}
    others |= {"geometry": geometry}
    strip_x = strip(0, THETA, stiffness=stiffness[0], width=wide == 0, **unsure, **others)
    strip_y = strip(1, THETA, stiffness=stiffness[1], width=wide == 1, **others)
    return replace(square, further=(strip_x, strip_y))


# --- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_strip_is_written_and_read_back_equal(axis, width, tmp_path):
    made = strip(axis, THETA, width=width)
    write_specimen(made, tmp_path / "strip.csv")
    text = (tmp_path / "strip.csv").read_text()
    along, across = "xy"[axis], "yx"[axis]
    assert f"# test: strip {along}" in text and f"force_{across}_N" not in text
    assert (f"stretch_{across}" in text) == width
    read = read_specimen(tmp_path / "strip.csv")
    np.testing.assert_array_equal(read.protocols[0].stretch, made.protocols[0].stretch)
    np.testing.assert_array_equal(read.load(read.protocols[0]), made.load(made.protocols[0]))
    assert (read.test, read.area[axis]) == (f"strip {along}", pytest.approx(3.3e-3))


HEADER = "# geometry: unloaded\n# thickness_mm: 1\n"
STRIP_X = f"{HEADER}# test: strip x\n# edge_y_mm: 3\n"
ROWS_OF_3 = "".join(f"{1 + 0.05 * i},{0.01 + 0.1 * i},{{}}\n" for i in range(6))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{STRIP_X}stretch_y,force_x_N\n1,0\n1.1,1\n", "stretch_x"),
        (f"{STRIP_X}stretch_x,force_y_N\n1,0\n1.1,1\n", "force_x_N"),
        (f"{STRIP_X}stretch_x,force_x_N,force_y_N\n" + ROWS_OF_3.format(*[0.1] * 6), "no load"),
        (f"{HEADER}# test: strip x\nstretch_x,force_x_N\n1,0\n1.1,1\n", "edge_y_mm"),
        (f"{HEADER}# edge_x_mm: 9\n# edge_y_mm: 9\nstretch_x,force_x_N\n1,0\n1.1,1\n", "stretch_y"),
        (f"{HEADER}# test: strip 30\nstretch_x,force_x_N\n1,0\n1.1,1\n", "strip x"),
    ],
)
def test_files_that_are_no_strip_are_refused_by_name(text, said, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_specimen(tmp_path / "a.csv")


@pytest.mark.parametrize("axis", [0, 1])
def test_strips_shorter_than_four_widths_are_warned_about(axis):
    long = strip(axis, THETA)
    assert "short-strip" not in {f.code for f in check_specimen(long)}
    short = replace(long, **{f"edge_{'xy'[axis]}_mm": 11.9})
    (found,) = [f for f in check_specimen(short) if f.code == "short-strip"]
    assert found.severity == "warning" and "11.9 mm long and 3 mm wide" in found.message
    unknown = replace(long, **{f"edge_{'xy'[axis]}_mm": None})
    assert "short-strip" not in {f.code for f in check_specimen(unknown)}


# --- the forward model ---------------------------------------------------------------------------


@GEOMETRY
@pytest.mark.parametrize("axis", [0, 1])
def test_neo_hookean_strip_in_closed_form(axis, geometry):
    """A strip has s = 2 C1 (l^2 - 1 / l) at the total stretch l."""
    made = strip(axis, THETA, geometry=geometry)
    forward = ForwardModel.from_specimen(made, Settings())
    matrix = {"C1": 7.0, "k1": 0.0, "k2": 1.0, "alpha": 30.0, "kappa": 0.1}
    values = matrix | {f"mounting_stretch_{'xy'[axis]}": 1.03, "stiffness": 1.2, "thickness": 0.9}
    measured = made.protocols[0].stretch
    total = 1.03 * measured[:, axis]
    by_hand = 1.2 * 0.9 * 3.3e-3 * 14.0 * (total**2 - 1.0 / total) / measured[:, axis]
    if geometry == "unloaded":
        by_hand = by_hand / 1.03
    load = forward.load(values, measured)[0]
    np.testing.assert_allclose(load[:, axis], by_hand, rtol=1e-9)
    assert not load[:, 1 - axis].any()


@GEOMETRY
@pytest.mark.parametrize("width", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
def test_goh_strip_has_the_root_that_scipy_brackets(axis, width, geometry):
    made = strip(axis, THETA, width=width, geometry=geometry)
    forward = ForwardModel.from_specimen(made, Settings())
    along, across = made.protocols[0].stretch.T[:: 1 if axis == 0 else -1]
    # a material that the strip was not made with: its measured width is not this one's
    other = TRUTH | {"alpha": 55.0, "kappa": 0.05}
    values = other | {f"mounting_stretch_{'xy'[axis]}": 1.04}
    load = forward.load(values, made.protocols[0].stretch)[0, :, axis]
    plain = strip_force(
        theta_of(other), axis, 1.04, along, across if width else None, 3.3e-3, geometry == "mounted"
    )
    np.testing.assert_allclose(load, plain, rtol=1e-9)
    mounted = forward.mounting_stretch(values)[0, 0]
    assert mounted[1 - axis] == pytest.approx(across_root(theta_of(other), axis, 1.04), rel=1e-9)


@GEOMETRY
@pytest.mark.parametrize("width", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
def test_response_has_the_derivatives_of_its_loads(axis, width, geometry):
    made = strip(axis, THETA, width=width, geometry=geometry)
    law = law_named("goh")
    forward = ForwardModel(law, made.area, geometry == "mounted", made.experiment)
    point, stretch = law.to_fit_coordinates(tuple(TRUTH.values())), made.protocols[0].stretch
    mounting = np.full(stretch.shape, 1.03)

    def load(point, logs):
        return forward.response(point, stretch, mounting * np.exp(logs)).load

    at, zero, h = forward.response(point, stretch, mounting), np.zeros(2), 1e-6
    for i, e in enumerate(np.eye(point.size)):
        step = h * max(abs(point[i]), 0.1) * e
        slope = (load(point + step, zero) - load(point - step, zero)) / (2.0 * step[i])
        np.testing.assert_allclose(at.by_fit_coordinate[..., i], slope, rtol=2e-6, atol=1e-9)
    for k, e in enumerate(np.eye(2)):
        slope = (load(point, h * e) - load(point, -h * e)) / (2.0 * h)
        np.testing.assert_allclose(at.by_log_mounting[..., k], slope, rtol=2e-6, atol=1e-9)
    if not width:
        assert not at.by_log_mounting[..., 1 - axis].any()


# --- fits ----------------------------------------------------------------------------------------


@GEOMETRY
@pytest.mark.parametrize("quantity", ["load", "cauchy"])
@pytest.mark.parametrize("first", ["square", "strip"])
def test_jacobian_of_the_fit_with_pieces(first, quantity, geometry):
    data = tissue(geometry)
    if first == "strip":
        data = replace(data.further[0], further=(data.further[1],))
    setup = FitSetup.from_options(data)
    assert setup.piece_sd == 0.1
    rows, count = setup.data.loaded(), len(data.pieces)
    scale = np.linspace(0.1, 0.3, count)
    point = setup.law.to_fit_coordinates(tuple(TRUTH.values()))
    problem = BalancedMounting(
        rows, quantity, point, setup.free, scale, np.ones_like(rows.mounting_load), setup.law,
        reading_sd=setup.data.mounting_sd, piece_sd=0.1,
    )  # fmt: skip
    # mounting forces: two of the square, one of each strip
    forces = 4 if first == "square" else 2
    assert problem.read.size == forces
    rng = np.random.default_rng(2)
    unknowns = np.concatenate([point, 0.5 * rng.standard_normal(forces + count - 1)])
    residual, jacobian = problem.evaluate(unknowns)
    assert np.isfinite(residual).all() and jacobian.shape == (residual.size, unknowns.size)
    for i, e in enumerate(np.eye(unknowns.size)):
        step = 1e-6 * max(abs(unknowns[i]), 0.1)
        ends = [problem.residual(unknowns + sign * step * e) for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(jacobian[:, i], slope, rtol=1e-5, atol=1e-6)


def test_the_fit_finds_the_stiffness_of_pieces():
    exact = tissue(stiffness=(1.12, 0.93), noise=1e-7)
    exact = replace(specimen_of("force", noise=1e-7), further=exact.further)
    fit = FitSetup.from_options(exact).fitted(4, seed=1)
    assert fit.stiffness == pytest.approx([1.0, 1.12, 0.93], rel=1e-3)
    assert fit.material.values == pytest.approx(tuple(TRUTH.values()), rel=1e-3)
    assert fit.mounting_stretch[1, 0] == pytest.approx(1.02, abs=1e-4)
    same = FitSetup.from_options(exact, piece_sd=1e-6).fitted(4, seed=1)
    assert same.stiffness == pytest.approx([1.0, 1.0, 1.0], abs=1e-3)
    assert same.rms > 100.0 * fit.rms


# --- the density ---------------------------------------------------------------------------------


@pytest.fixture
def all_eigenvectors(monkeypatch):
    monkeypatch.setattr(misfit, "LEAST_EIGENVALUE", 0.0)


def both(data: Specimen, mounting: str, noise: str) -> tuple[PlainTissue, Posterior]:
    """The second implementation, and the product's posterior."""
    smooth = {
        "mounting_stretch_x": 1.02, "mounting_stretch_y": 1.025,
        "mounting_stretch": 1.015, "stiffness": 0.97,
    } | SMOOTH  # fmt: skip
    alone, some = replace(data, further=()), some_terms(1, 0.2)
    plain = PlainTissue(
        PlainPosterior(alone, mounting, noise=noise, smooth=smooth, terms=some),
        [PlainStrip(piece, mounting, noise, 0.2, smooth, some) for piece in data.further],
    )
    stated = stated_fit(SMOOTH, [(1.02, 1.025), *[(1.015, 1.015)] * len(data.further)])
    # across a strip the stretch follows; what a fit says of it has no influence
    fit = replace(stated, stiffness=np.array([1.0, *[0.97] * len(data.further)]))
    options = {"mounting": mounting, "noise": noise, "toe": 0.2, "max_rows": "none"}
    options["terms"] = [np.array(some)] * len(data.pieces)
    return plain, Posterior(data, misfit_fit=fit, **options)


def points(posterior: Posterior, count: int, seed: int = 4) -> list[dict[str, float]]:
    """Values around the truth, of all unknowns."""
    rng = np.random.default_rng(seed)

    def value(name: str) -> float:
        stem, _, piece = name.partition("[")
        if stem.startswith("mounting_stretch"):
            return rng.uniform(1.01, 1.06)
        if stem.startswith("mounting_force"):
            axis, labels = "xy".index(stem[-1]), ["", "strip-x]", "strip-y]"]
            rows = posterior.pieces[labels.index(piece)].rows
            reading, sd = rows.mounting_load, rows.mounting_sd
            return reading[0, axis] + sd[0, axis] * rng.normal()
        if stem.startswith("load_offset"):
            return 0.001 * rng.standard_normal()
        if stem == "noise_sd":
            return 0.01 * np.exp(0.3 * rng.standard_normal())
        # a material's parameters, and factors
        return TRUTH.get(name, 1.0) * np.exp((0.1 if name in TRUTH else 0.05) * rng.normal())

    return [{name: value(name) for name in (*TRUTH, *posterior.free)} for _ in range(count)]


@pytest.mark.usefixtures("all_eigenvectors")
@GEOMETRY
@pytest.mark.parametrize(
    ("mounting", "noise"),
    [
        ("noisy", "correlated"),
        ("exact", "correlated"),
        ("free", "correlated"),
        ("ignored", "correlated"),
    ]
    + [("noisy", "independent"), ("free", "independent")],
)
def test_density_of_a_square_with_two_strips_is_the_plain_one(mounting, noise, geometry):
    wide = 0 if mounting in ("exact", "free") else 1
    plain, posterior = both(tissue(geometry, wide=wide), mounting, noise)
    assert set(posterior.free) == plain.names
    for values in points(posterior, 3):
        got, want = posterior.log_density(values), plain.log_density(values)
        assert np.isfinite(want) and got == pytest.approx(want, rel=1e-7, abs=1e-5)


def test_a_strip_in_kpa_is_the_same_piece():
    """Units move the density by a constant: that of the readings and of the mounting force."""
    data = tissue()
    strip_x, strip_y = data.further
    area = 3.3e-3
    p = strip_x.protocols[0]
    in_kPa = Specimen(
        "strip-x", (replace(p, load_x=p.load_x / area),), "piola", test="strip x",
        load_noise=strip_x.load_noise / area, metadata={"load_offset_sd_kPa": 0.001 / area},
    )  # fmt: skip
    strip_x = replace(strip_x, metadata={"load_offset_sd_N": 0.001})
    _, newton = both(replace(data, further=(strip_x, strip_y)), "noisy", "correlated")
    _, kPa = both(replace(data, further=(in_kPa, strip_y)), "noisy", "correlated")
    apart = []
    for values in points(newton, 5):
        moved = dict(values)
        for name in ("mounting_force_x[strip-x]", "load_offset_x[strip-x]"):
            moved[name] = values[name] / area
        apart.append(newton.log_density(values) - kPa.log_density(moved))
    assert np.ptp(apart) < 1e-7
    assert abs(apart[0]) > 1.0


# --- simulation ----------------------------------------------------------------------------------


@pytest.mark.parametrize("mounting", ["noisy", "free"])
def test_simulated_pieces_have_the_errors_of_the_model(mounting):
    """Of rows as sampled, of mounting readings as the load cell; nothing across a strip."""
    data, options = tissue(), {"mounting": mounting, "noise": "independent"}
    model = Posterior(data, **options, priors=protocol_prior(data, Settings(**options)))
    rng, z = np.random.default_rng(7), []
    for _ in range(12):
        truth, _ = draw_truth(model, rng)
        simulated = simulate_specimen(model, truth, rng)
        posterior = Posterior(simulated, **options, priors=model.settings.priors)
        assert np.isfinite(posterior.log_density(truth))
        missed = posterior.residuals({n: np.array([v]) for n, v in truth.items()})[0]
        for i, name in enumerate(("", "[strip-x]", "[strip-y]")):
            own, piece = missed[posterior.of_piece(i)], posterior.pieces[i]
            sd = np.full(len(own), truth[f"noise_sd{name}"])
            sd[: piece.readings.mounting_count] = piece.mounting_sd
            z.append(own / sd)
        for k, piece in zip((1, 0), simulated.further, strict=True):
            assert not piece.load(piece.protocols[0])[:, k].any()
    z = np.concatenate(z)
    assert z.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * z.size))
    assert z.mean() == pytest.approx(0.0, abs=4.0 / np.sqrt(z.size))


def test_the_study_of_pieces_has_stresses_and_strips_of_its_own():
    found = virtual_tissue(3)
    material = {n: found.truth[n] for n in TRUTH}
    states = 1.02, 1.1
    own = stresses(material, *states)
    assert own == pytest.approx([float(s) for s in GOH(*material.values()).cauchy(*states)])
    for axis, piece in enumerate(found.strips):
        lm = found.truth[f"mounting_stretch_{'xy'[axis]}[{piece.name}]"]
        c = found.truth[f"stiffness[{piece.name}]"]
        along = piece.protocols[0].stretch[:, axis]
        section = c * piece.area[axis]
        plain = strip_force(theta_of(material), axis, lm, along, None, section, False)
        np.testing.assert_allclose(found.load[piece.name][:, axis], plain, rtol=1e-7)
    others = virtual_tissue(3, 0.25)
    ratio = np.log(others.truth["stiffness[strip-x]"]) / np.log(found.truth["stiffness[strip-x]"])
    assert ratio == pytest.approx(2.5)


# --- sampling ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("pieces") / "tissue"
    data = tissue()
    with quick_posteriors.runs_without_figures():
        biaxbayes.sample([replace(data, further=()), *data.further], out=out, ess=50, seed=2)
    return biaxbayes.open_run(out)


@pytest.mark.long
def test_a_run_of_pieces_reopens(run):
    assert [p.name for p in run.specimen.pieces] == ["test", "strip-x", "strip-y"]
    assert [p.test for p in run.specimen.pieces] == ["biaxial", "strip x", "strip y"]
    posterior = run.posterior()
    assert set(posterior.parameter_names) <= set(run.draws)
    known = set(run.quantities)
    assert {"stiffness[strip-x]", "mounting_stretch_y[strip-y]", "thickness[strip-x]"} <= known
    some = run.draws.iloc[:: max(len(run.draws) // 20, 1)]
    np.testing.assert_allclose(posterior.log_density(some), some["lp"], rtol=1e-8, atol=1e-6)
    stiffness = run.draws[["stiffness[strip-x]", "stiffness[strip-y]"]]
    assert (stiffness.std() > 0.01).all()


def test_two_pieces_of_one_name_are_refused(tmp_path):
    square, twin = tissue(), strip(0, THETA)
    with pytest.raises(InputError, match="two pieces are called 'strip-x'"):
        replace(square, further=(twin, twin))


@pytest.mark.parametrize(
    ("median", "low", "high", "differs"),
    [(1.28, 1.2, 1.35, True), (1.28, 0.99, 1.6, False), (0.8, 0.7, 0.9, True)],
)
def test_a_piece_that_differs_is_named_with_its_factor(median, low, high, differs):
    _, posterior = both(tissue(), "free", "correlated")
    first, *further = posterior.specimen.pieces
    shares = np.linspace(0.0, 1.0, 2001)
    draws = np.interp(shares, [0.05, 0.5, 0.95], [low, median, high])
    names = [f"stiffness[{piece.name}]" for piece in further]
    alike, different = piece_stiffnesses(posterior, pd.DataFrame(dict.fromkeys(names, draws)))
    named = different if differs else alike
    assert len(named) == len(further) and not (alike and different)
    for piece, text in zip(further, named, strict=True):
        assert text.startswith(f"piece {piece.name} is {median:.2f}") and first.name in text
        assert ("check its width" in text) == differs


def test_the_stiffness_is_of_its_own_piece():
    data = tissue()
    _, posterior = both(data, "free", "correlated")
    values = points(posterior, 1)[0]
    before = posterior.residuals({n: np.array([v]) for n, v in values.items()})[0]
    stiffer = values | {"stiffness[strip-x]": 2.0 * values["stiffness[strip-x]"]}
    after = posterior.residuals({n: np.array([v]) for n, v in stiffer.items()})[0]
    offset = values["load_offset_x[strip-x]"]
    for i in range(3):
        own = posterior.of_piece(i)
        load = posterior.pieces[i].measured - before[own]
        if i == 1:
            doubled = 2.0 * (load - offset) + offset
            np.testing.assert_allclose(posterior.pieces[i].measured - after[own], doubled)
        else:
            np.testing.assert_array_equal(after[own], before[own])
    assert posterior.log_density(stiffer) < posterior.log_density(values) - 20.0
