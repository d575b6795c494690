"""Fits of records without noise: converged where nothing but the rounding of the file is left."""

from dataclasses import replace

import numpy as np
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes.fitting.fit import fit, fit_all
from biaxbayes.fitting.result import half_digits
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.specimen_file import read_specimen
from commands import exit_code

STIFF = ["16.1", "104.7", "10", "25.7", "0.017"]
STEEP = ["3.88", "17.08", "50", "5.47", "0.1833"]
TEST = ["--prestretch", "1.019", "1.02", "--total-stretch", "1.15", "--increments", "40"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("--goh", *STIFF, *TEST),
        ("--goh", *STEEP, *TEST, "--stress-pair", "cauchy"),
        ("--material", "donor2-intima"),
    ],
)
def test_what_is_simulated_without_noise_is_fitted_by_all_five(capsys, tmp_path, arguments):
    path = tmp_path / "virtual.csv"
    assert exit_code("simulate", *arguments, "--out", path) == 0
    capsys.readouterr()
    assert exit_code("fit", path) == 0
    shown = capsys.readouterr()
    assert "NO" not in shown.out and "not converged" not in shown.err


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_simulated_without_noise_is_sampled(tmp_path, seed):
    specimen, truth = biaxbayes.simulate(material="donor2-media", ratios=[(1.0, 1.0)])
    with quick_posteriors.runs_without_figures():
        run = biaxbayes.sample(specimen, out=tmp_path / "run", seed=seed, ess=500, workers=1)
    assert run.state == "converged"
    noise = run.provenance["noise"]
    assert noise["effective_readings"] == noise["readings"]  # rounding is no misfit
    table = run.summary.set_index("parameter")
    assert table.loc[["C1", "k1", "k2", "alpha"], "q50"].to_numpy() == pytest.approx(
        list(truth.material.values())[:4], rel=1e-3
    )
    judged = biaxbayes.identify(run)
    for name in mounting_names("stretch"):
        lm = getattr(truth, name)
        assert table.loc[name, "q50"] == pytest.approx(lm, abs=1e-5)
        stated = judged[name]
        assert stated.low - 1e-5 <= lm <= stated.high + 1e-5


def rounded(specimen, decimals: int):
    """The same record in a file of so many decimals."""
    curves = ("stretch_x", "stretch_y", "load_x", "load_y")
    return replace(
        specimen,
        protocols=tuple(
            replace(p, **{name: np.round(getattr(p, name), decimals) for name in curves})
            for p in specimen.protocols
        ),
    )


def test_few_digits_are_rounding_too():
    material = biaxbayes.GOH(*map(float, STIFF))
    specimen, _ = biaxbayes.simulate(
        material=material, prestretch=(1.019, 1.02), total_stretch=1.15, increments=40
    )
    for decimals in (8, 5):
        assert all(found.converged for found in fit_all(rounded(specimen, decimals)))


def test_a_fit_that_misses_more_than_the_digits_is_not_called_converged(monkeypatch, tmp_path):
    """The same file, the descent cut short: what is left is no rounding."""
    from biaxbayes.fitting import least_squares

    path = tmp_path / "virtual.csv"
    assert exit_code("simulate", "--goh", *STIFF, *TEST, "--out", path) == 0
    specimen = read_specimen(path)
    assert fit(specimen, "linden").converged
    whole = least_squares.descend
    monkeypatch.setattr(least_squares, "descend", lambda *a, **k: whole(*a, **{**k, "steps": 8}))
    assert not fit(specimen, "linden", starts=1).converged


def test_half_a_unit_of_the_last_digit():
    np.testing.assert_allclose(half_digits(np.array([1.0, 1.002, 1.25])), 5e-4)
    # Five significant digits: a small number is written finer.
    np.testing.assert_allclose(
        half_digits(np.array([12345.0, 1.2345e-3, -0.5])), [0.5, 5e-8, 5e-6], rtol=1e-12
    )
    np.testing.assert_allclose(half_digits(np.array([0.0, 0.013, 21.457])), 5e-4)
    assert half_digits(np.array([1.0 / 3.0]))[0] < 1e-14
    assert not half_digits(np.zeros(3)).any()
