"""Measured tissue from the machine's export to a posterior, where it is at hand."""

import os
from pathlib import Path

import numpy as np
import pytest

from biaxbayes import Specimen, read_specimen, sample
from biaxbayes.fitting.fit import fit
from biaxbayes.fitting.fit_quality import quick_fit, swapped_columns
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.sampling.convergence import effective_sample_size
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.check import check_specimen
from commands import exit_code, run
from quick_posteriors import runs_of_few_walkers

REAL = Path(os.environ.get("BIAXBAYES_REAL") or "absent")
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL.is_dir(), reason="BIAXBAYES_REAL does not name measured tissue"),
]
STRESSES = "stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa"
FORCES = "stretch_x=F11,stretch_y=F22,force_x_N=load1_gf,force_y_N=load2_gf"


def converted(capsys, out: Path, columns: str, *options: object) -> tuple[Specimen, str]:
    """The five protocols of an aorta, and what convert prints."""
    files = sorted((REAL / "aorta-tbad").glob("*.csv"))
    words = ("--machine", "generic", "--columns", columns, "--out", out, "--overwrite")
    code, printed, _ = run(capsys, "convert", *files, *words, *options)
    assert code == 0
    return read_specimen(out), printed


def test_an_aorta_of_five_protocols_is_converted_and_checked(tmp_path, capsys):
    aorta, printed = converted(capsys, tmp_path / "a.csv", STRESSES)
    assert "1526 rows in 5 protocols" in printed
    assert {p.rows for p in aorta.protocols} == {291, 331, 327, 272, 305}
    # The README of the data: |F12|, |F21| <= 0.036, reference 0.997 to 1.008.
    assert aorta.metadata["largest_shear"] == pytest.approx(0.036, abs=5e-4)
    findings = {f.code: f for f in check_specimen(aorta)}
    assert {"stretch-drift", "mounting-forces-differ", "stiff-start", "shear"} <= set(findings)
    assert "tared" not in findings and "unloading" not in findings
    assert not [f for f in findings.values() if f.severity == "error"]
    assert {"0.9973", "1.0079"} <= set(findings["stretch-drift"].message.split())
    assert swapped_columns(aorta, quick_fit(aorta).residuals) is None
    # Grams-force over the section: P / load is 0.291875 kPa per gf in every row.
    section = 9.80665e-3 / 0.291875 * 1e3
    sizes = ["--edge-x-mm", section, "--edge-y-mm", section, "--thickness-mm", 1]
    sizes += ["--geometry", "unloaded"]
    other, _ = converted(capsys, tmp_path / "f.csv", FORCES, *sizes)
    for p, q in zip(aorta.protocols, other.protocols, strict=True):
        np.testing.assert_allclose(aorta.load(p), other.load(q) / other.area, rtol=1e-9)


@pytest.mark.long
def test_one_protocol_of_an_aorta_is_fitted_and_sampled(tmp_path, capsys):
    aorta, _ = converted(capsys, tmp_path / "a.csv", STRESSES)
    (name,) = (p.name for p in aorta.protocols if p.name.endswith("1to1"))
    specimen = aorta.only(name)
    fitted = fit(specimen)
    # Least squares cannot come nearer than the tissue allows: about 2 kPa of 94 kPa.
    assert fitted.converged and 1.0 < fitted.rmse_kPa < 3.0
    with runs_of_few_walkers():
        made = sample(specimen, out=tmp_path / "run", workers=2)
    assert made.state == "converged"
    assert np.isfinite(made.summary["q50"]).all()
    # The misfit, not the load cell, sets the noise.
    assert "times the noise of the load cell" in made.result.fit


@pytest.mark.slow
def test_an_aorta_thinned_or_not_has_the_same_posterior(tmp_path, capsys):
    """Five protocols, 1,526 rows, readings that correlate: the same quantiles, much sooner."""
    aorta, _ = converted(capsys, tmp_path / "a.csv", STRESSES)
    whole, thinned = (
        draw_posterior(prepare(aorta, max_rows=t), Plan(ess=4000, workers=1, walkers=32))
        for t in ("none", "auto")
    )
    for name in whole.quantities.keys() - {"lp", "log_likelihood"}:
        for level in (0.05, 0.5, 0.95):
            quantile = np.quantile(whole.quantities[name], level)
            below = [(r.quantities[name] <= quantile).astype(float) for r in (thinned, whole)]
            # Monte Carlo error of both shares; four of them for 24 comparisons
            error = np.sqrt(sum(level * (1 - level) / effective_sample_size(b) for b in below))
            assert abs(below[0].mean() - level) < 4.0 * error, (name, level)
    assert thinned.seconds["sampling"] < whole.seconds["sampling"]


@pytest.mark.long
def test_a_tared_valve_that_goh_does_not_describe_is_warned_of(tmp_path, capsys):
    """Porcine aortic valve, resampled and tared: every verb says both."""
    raw, out = REAL / "valve-pymecht" / "biax-data.csv", tmp_path / "valve.csv"
    columns = "stretch_x=lambda_1,stretch_y=lambda_2,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa"
    columns += ",protocol=protocol"
    options = ["--machine", "generic", "--geometry", "unloaded", "--columns", columns]
    code, printed, _ = run(capsys, "convert", raw, *options, "--out", out)
    assert code == 0 and "350 rows in 7 protocols" in printed
    code, text, _ = run(capsys, "check", out)
    assert code == 0
    text = " ".join(text.split())
    assert "the load cell was tared" in text and "GOH does not describe this specimen" in text
    code, _, err = run(capsys, "fit", out)
    assert code == 0
    assert "a tared load cell" in err and "GOH does not describe this specimen" in err
    assert exit_code("sample", out, "--out", tmp_path / "run") == 2
    assert "tared" in capsys.readouterr().err
    zeroed = ["--mounting", "zeroed", "--ess", 100, "--workers", 1, "--out", tmp_path / "run"]
    code, text, _ = run(capsys, "sample", out, *zeroed)
    assert code == 0
    assert "GOH misses this record by" in text
    assert "`biaxbayes sample --law four-fibre` says what it changes" in text
