"""Profile likelihoods against SciPy, theory and posteriors under flat priors."""

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.optimize import least_squares

from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.profiles.profile import profile_likelihood, profiles
from biaxbayes.profiles.profile_curve import THRESHOLD
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.verbs.profile import command
from goh_functions import PARAMETERS
from quick_posteriors import EQUIBIAXIAL, sampled, specimen

TRUTH = GOH(10.0, 40.0, 5.0, 40.0, 0.15)


@cache
def determined() -> Posterior:
    """Three ratios to high stretch: everything is known, so that theory has an answer."""
    return Posterior(specimen(TRUTH, total_stretch=1.25), noise="independent")


@cache
def traded() -> Posterior:
    data = specimen(TRUTH, ratios=EQUIBIAXIAL, noise_N=0.005)
    return Posterior(data, noise="independent")


@cache
def traded_kappa():
    return profile_likelihood(traded(), "kappa")


@cache
def profiled(name: str):
    return profile_likelihood(determined(), name)


def residuals(data, theta, lm) -> tuple[np.ndarray, np.ndarray]:
    """Loads minus model and mounting readings minus model over their sd; written afresh."""
    C1, k1, k2, alpha, kappa = theta

    def piola(lx, ly):
        # sums over the two fibre families; stress as force over unloaded area, sz = 0
        lz2 = 1.0 / (lx * ly) ** 2
        cos2, sin2 = np.cos(np.radians(alpha)) ** 2, np.sin(np.radians(alpha)) ** 2
        H = [kappa + (1 - 3 * kappa) * c for c in (cos2, sin2, 0.0)]
        E = H[0] * lx**2 + H[1] * ly**2 + H[2] * lz2 - 1.0
        e = 4.0 * k1 * E * np.exp(k2 * E**2)
        out = []
        for Hk, lk in ((H[0], lx), (H[1], ly)):
            out.append(((2 * C1 + Hk * e) * lk**2 - (2 * C1 + H[2] * e) * lz2) / lk)
        return out

    miss = []
    for p in data.protocols:
        P = piola(p.stretch_x[1:] * lm[0], p.stretch_y[1:] * lm[1])
        miss.append(np.column_stack([p.load_x, p.load_y])[1:] - np.column_stack(P) * data.area)
    reading, sd = data.mounting_readings(shared=True)
    z = (reading[0] - np.array(piola(*lm)) * data.area) / sd[0]
    return np.concatenate(miss, axis=None), z


def deviance(data, row) -> float:
    r, z = residuals(
        data, [row[n] for n in PARAMETERS], [row["mounting_stretch_x"], row["mounting_stretch_y"]]
    )
    return r.size * np.log(r @ r) + float(z @ z)


def test_the_deviance_is_that_of_the_likelihood():
    table = profiled("kappa").table
    data = determined().specimen
    result = np.array([deviance(data, row) for _, row in table.iterrows()])
    np.testing.assert_allclose(result - result.min(), table["deviance"], atol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("end", ["first", "last"])
def test_no_other_fit_beats_a_point_of_the_profile(end):
    table = traded_kappa().table
    data = traded().specimen
    row = table.iloc[3 if end == "first" else -4]
    sd = row["noise_sd"]

    def unknown(x):
        r, z = residuals(data, [*np.exp(x[:3]), x[3], row["kappa"]], x[4:])
        return np.concatenate([r / sd, z])

    stiffness = np.log(row[["C1", "k1", "k2"]].to_numpy(dtype=float)) + 0.02
    start = [*stiffness, row["alpha"] - 0.5, row["mounting_stretch_x"], row["mounting_stretch_y"]]
    other = least_squares(unknown, start, xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac")
    moved = row.copy()
    moved[["C1", "k1", "k2"]] = np.exp(other.x[:3])
    moved[["alpha", "mounting_stretch_x", "mounting_stretch_y"]] = other.x[3:]
    assert deviance(data, moved) > deviance(data, row) - 1e-4


@pytest.mark.long
def test_a_sharp_profile_is_the_parabola_of_the_fisher_information():
    data = determined().specimen
    best = profiled("kappa").table
    best = best.iloc[int(best["deviance"].argmin())]
    names = [*PARAMETERS, "mounting_stretch_x", "mounting_stretch_y"]
    x = best[names].to_numpy(dtype=float)

    def scaled(v):
        r, z = residuals(data, v[:5], v[5:])
        return np.concatenate([r / best["noise_sd"], z])

    steps = np.diag(1e-5 * np.abs(x))
    J = np.column_stack([(scaled(x + s) - scaled(x - s)) / (2.0 * s.sum()) for s in steps])
    sd = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    for name in PARAMETERS:
        result = profiled(name)
        assert result.kind == "finite"
        half = 0.5 * (result.high - result.low)
        assert half == pytest.approx(np.sqrt(THRESHOLD) * sd[names.index(name)], rel=0.05)


FLAT = {
    name: {"distribution": "uniform", "low": low, "high": high}
    for name, low, high in (("C1", 5.0, 20.0), ("k1", 10.0, 90.0), ("k2", 1.0, 12.0))
}


@pytest.mark.long
def test_profile_and_flat_prior_posterior_agree():
    made = sampled(determined().specimen, ess=400.0, priors=FLAT)
    assert made.state == "converged"
    for name in PARAMETERS:
        result = profiled(name)
        low, high = np.quantile(made.draws[name], [0.05, 0.95])
        width = result.high - result.low
        assert abs(result.low - low) < 0.08 * width
        assert abs(result.high - high) < 0.08 * width
        truth = dict(zip(PARAMETERS, (10.0, 40.0, 5.0, 40.0, 0.15), strict=True))[name]
        assert result.low - 0.5 * width < truth < result.high + 0.5 * width


@pytest.mark.long
def test_no_draw_of_a_posterior_with_misfit_lies_above_the_profile():
    made = sampled(determined().specimen, priors=FLAT, noise="correlated")
    posterior = made.posterior()  # it sums the terms that the draws were made with
    for name in ("C1", "kappa", "mounting_stretch_x"):
        table = profile_likelihood(posterior, name).table
        best = table.iloc[[int(table["deviance"].argmin())]]
        largest = posterior.misfit.log_likelihood(posterior.residuals(best))[0]
        inside = made.draws[name].between(table["value"].min(), table["value"].max())
        draws = made.draws[inside]
        # the root of the deviance is nearly linear between points
        signed = np.sign(table["value"] - best["value"].item()) * np.sqrt(table["deviance"])
        profile = np.interp(draws[name], table["value"], signed) ** 2
        assert (2.0 * (largest - draws["log_likelihood"]) > profile - 0.1).all()


@pytest.mark.long
def test_the_misfit_is_averaged_out_of_the_likelihood_that_is_profiled():
    posterior = Posterior(determined().specimen)
    result = profile_likelihood(posterior, "kappa")
    assert "noise_sd" not in result.table
    residual = posterior.residuals(result.table)
    deviance = -2.0 * posterior.misfit.log_likelihood(residual)
    np.testing.assert_allclose(deviance - deviance.min(), result.table["deviance"], atol=1e-5)
    assert result.high - result.low > 1.2 * (profiled("kappa").high - profiled("kappa").low)


def test_the_angle_of_an_isotropic_material_is_structurally_unidentifiable():
    posterior = Posterior(determined().specimen, noise="independent", priors={"kappa": 1.0 / 3.0})
    result = profile_likelihood(posterior, "alpha")
    assert result.kind == "structural"
    assert (result.low, result.high) == (0.0, 90.0)
    assert result.table["deviance"].max() < 1e-6
    assert "structurally" in result.in_words()


@pytest.mark.long
def test_one_ratio_leaves_the_dispersion_open():
    result = traded_kappa()
    assert result.kind == "practical" and result.open_low
    assert result.low == 0.0
    alpha = result.table["alpha"].to_numpy()
    inside = (result.table["deviance"] < THRESHOLD).to_numpy()
    assert np.ptp(alpha[inside]) > 20.0  # the angle follows


def test_aligned_fibres_are_open_towards_zero_only():
    data = specimen(GOH(10.0, 20.0, 5.0, 40.0, 0.0))
    result = profile_likelihood(Posterior(data, noise="independent"), "kappa")
    assert result.kind == "practical" and result.open_low and not result.open_high
    assert result.high < 0.05
    assert "open towards 0" in result.in_words()


@pytest.mark.long
def test_an_angle_at_a_mirror_is_closed():
    data = specimen(GOH(10.0, 20.0, 5.0, 90.0, 0.15), total_stretch=1.25)
    result = profile_likelihood(Posterior(data, noise="independent"), "alpha")
    assert result.kind == "finite"
    assert result.high == 90.0 and 70.0 < result.low < 90.0


@cache
def low_stretch():
    data = specimen(GOH(10.0, 50.0, 5.0, 40.0, 0.2), total_stretch=1.05)
    return profile_likelihood(Posterior(data, noise="independent"), "k2")


@pytest.mark.long
def test_the_exponent_goes_to_zero_exactly():
    result = low_stretch()
    assert result.open_low and result.low == 0.0
    assert result.table["k2"].iloc[0] == 0.0
    assert (np.diff(result.table["value"]) > 0.0).all()


@pytest.mark.long
def test_a_branch_that_continuation_would_miss_is_followed():
    # With kappa on its bound the fit at low k2 is bad, with kappa inside it is good.
    table = low_stretch().table
    low = table[table["value"] < 10.0]
    assert (low["deviance"] < THRESHOLD).all()
    assert (low["kappa"] > 0.0).all()
    # the sampling coordinates reach the bound at infinity
    assert (table["kappa"] < 1e-3).any()
    # without jumps: neighbours lie close
    assert np.abs(np.diff(table["deviance"])).max() < 2.0


def test_mounting_stretches_have_profiles():
    result = profiled("mounting_stretch_y")
    assert result.kind == "finite"
    assert result.low < 1.02 < result.high
    exact = Posterior(determined().specimen, mounting="exact", noise="independent")
    with pytest.raises(InputError, match="follows from the material"):
        profile_likelihood(exact, "mounting_stretch_y")


@pytest.mark.long
def test_an_exact_mounting_force_is_balanced_at_every_point():
    data = traded().specimen
    result = profile_likelihood(Posterior(data, mounting="exact", noise="independent"), "kappa")
    load = data.mounting_readings(shared=True)[0][0]
    for _, row in result.table.iterrows():
        lm = (row["mounting_stretch_x"], row["mounting_stretch_y"])
        P = np.array(GOH(*(row[n] for n in PARAMETERS)).piola(*lm))
        np.testing.assert_allclose(P * data.area, load, rtol=1e-8)


def test_the_only_unknown_has_a_profile():
    """With nothing else to fit, the likelihood itself."""
    others = dict(zip(PARAMETERS[1:], (40.0, 5.0, 40.0, 0.15), strict=True))
    posterior = Posterior(determined().specimen, mounting="exact", priors=others)
    result = profile_likelihood(posterior, "C1")
    assert result.kind == "finite" and result.low < 10.0 < result.high
    # the ends are not read off between points that are far apart: one is close to each
    rise = result.table["deviance"] - result.table["deviance"].min()
    for side in (result.table["C1"] < 10.0, result.table["C1"] > 10.0):
        assert np.abs(rise[side] - THRESHOLD).min() < 0.02


def test_fixed_and_unknown_parameters_are_refused():
    fixed = Posterior(determined().specimen, noise="independent", priors={"kappa": 0.1})
    for name, text in (("kappa", "fixed"), ("gamma", "unknown parameter")):
        with pytest.raises(InputError, match=text):
            profiles(fixed, [name])


@pytest.mark.long
def test_the_command_writes_curves_intervals_and_figure(tmp_path):
    path = tmp_path / "virtual.csv"
    write_specimen(traded().specimen, path)
    out = tmp_path / "out"
    options = ["--parameter", "kappa", "--noise", "independent", "--out", str(out)]
    printed = CliRunner().invoke(command, [str(path), *options, "--json"])
    assert printed.exit_code == 0, printed.output
    record = json.loads(printed.output)[0]
    back = pd.read_csv(out / "profile.csv")
    np.testing.assert_allclose(back["deviance"], record["curve"]["deviance"], rtol=1e-6, atol=1e-6)
    ends = pd.read_csv(out / "profile-intervals.csv")
    assert ends["kind"][0] == record["kind"] == "practical"
    assert bool(ends["open_low"][0])
    message = json.loads((out / "profile-provenance.json").read_text())
    assert message["deviance_of_90_percent"] == pytest.approx(2.71, abs=0.01)
    assert (out / "profile.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.long
def test_the_command_profiles_a_run_with_its_own_model(small_run, tmp_path):
    arguments = [str(small_run.path), "--parameter", "C1", "--json", "--out", str(tmp_path)]
    printed = CliRunner().invoke(command, arguments)
    assert printed.exit_code == 0, printed.output
    (expected,) = profiles(small_run.posterior(), ["C1"])
    assert json.loads(printed.output)[0]["estimate"] == pytest.approx(expected.estimate, rel=1e-6)
    about = json.loads((tmp_path / "profile-provenance.json").read_text())["about"]
    assert f"mounting {small_run.settings.mounting}" in about
