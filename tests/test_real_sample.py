"""Measured tissue through the main job, where it is at hand."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from biaxbayes import read_specimen, sample, write_specimen
from biaxbayes.fitting.fit import fit
from biaxbayes.specimens.specimen import Protocol, Specimen
from quick_posteriors import runs_of_few_walkers

REAL = os.environ.get("BIAXBAYES_REAL")

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL, reason="BIAXBAYES_REAL does not name measured tissue"),
]


@pytest.mark.long
def test_equibiaxial_protocol_of_an_aorta_is_fitted_and_sampled(tmp_path: Path) -> None:
    raw = pd.read_csv(next(Path(str(REAL)).glob("aorta-tbad/*ratio_1to1.csv")))
    protocol = Protocol("1", raw.F11, raw.F22, raw.P11_kPa, raw.P22_kPa)
    write_specimen(Specimen("aorta", (protocol,), "piola"), tmp_path / "aorta.csv")
    specimen = read_specimen(tmp_path / "aorta.csv")
    found = fit(specimen)
    # Least squares cannot come nearer than the tissue allows: about 2 kPa of 94 kPa.
    assert found.converged
    assert 1.0 < found.rmse_kPa < 3.0
    with runs_of_few_walkers():
        run = sample(specimen, out=tmp_path / "run", workers=2)
    assert run.state == "converged"
    table = run.summary.set_index("parameter")
    assert np.isfinite(table["q50"]).all()
    # The misfit, not the load cell, sets the noise.
    assert table.loc["noise_sd", "q50"] > 10.0 * specimen.noise_sd
    for name in ("corner.pdf", "corner.png", "stress-bands.pdf", "stress-bands.png"):
        assert (run.path / name).stat().st_size > 1000
