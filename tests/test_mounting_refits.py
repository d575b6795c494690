"""A mounting stretch that rests on a toe which the data contradict is not called identified."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.identifiability.mounting_refits import mounting_refits
from biaxbayes.identifiability.verdict import NOT_IDENTIFIED
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.reports.methods import closing_message, latex_table
from biaxbayes.reports.page import report_page
from biaxbayes.specimens.specimen import Specimen
from quick_posteriors import runs_without_figures, specimen

TISSUE = GOH(9.0, 20.0, 4.0, 42.0, 0.15)
MOUNTING = (1.01, 1.02)
NAMES = ("mounting_stretch_x", "mounting_stretch_y")


def concave(data: Specimen, share: float = 0.06) -> Specimen:
    """The specimen with a stress that is there after one per cent of stretch."""
    protocols = []
    for p in data.protocols:
        loads = []
        for stretch, load in ((p.stretch_x, p.load_x), (p.stretch_y, p.load_y)):
            loads.append(load + share * data.peak_load * np.tanh((stretch - 1.0) / 0.01))
        protocols.append(replace(p, load_x=loads[0], load_y=loads[1]))
    return replace(data, protocols=tuple(protocols))


@cache
def missed() -> Specimen:
    return concave(specimen(TISSUE, increments=30, noise_N=0.001))


def narrow_draws(posterior: Posterior, sd: float = 2e-4, n: int = 4000) -> pd.DataFrame:
    """Draws around the least-squares fit, as a posterior that believes the model."""
    rng = np.random.default_rng(1)
    fit = posterior.fit
    values = {
        "C1": fit.material.C1_kPa,
        "k1": fit.material.k1_kPa,
        "k2": fit.material.k2,
        "alpha": fit.material.alpha_deg,
        "kappa": fit.material.kappa,
    }
    table = {k: v * np.exp(0.01 * rng.standard_normal(n)) for k, v in values.items()}
    for i, label in enumerate(posterior.mounts):
        for axis, name in enumerate("xy"):
            tail = f"[{label}]" if label else ""
            reading = posterior.specimen.mounting_readings(shared=len(posterior.mounts) == 1)[0]
            lm = fit.mounting_stretch[i, axis]
            table[f"mounting_stretch_{name}{tail}"] = lm + sd * rng.standard_normal(n)
            table[f"mounting_force_{name}{tail}"] = np.full(n, reading[i, axis])
    return pd.DataFrame(table | {"noise_sd": np.full(n, 0.01), "log_likelihood": np.zeros(n)})


@pytest.mark.parametrize("seed", range(8))
def test_a_described_specimen_is_not_refitted(seed):
    data = specimen(TISSUE, increments=30, noise_N=0.004, seed=seed)
    assert mounting_refits(prepare(data)) is None


def test_the_range_of_the_refits_is_reported_and_holds_the_truth():
    posterior = prepare(missed())
    result = identify_draws(posterior, narrow_draws(posterior), "converged")
    for name, true in zip(NAMES, MOUNTING, strict=True):
        row = result[name]
        assert row.posterior_verdict == NOT_IDENTIFIED
        assert (
            not row.diagnostics.low <= true <= row.diagnostics.high
        )  # what the narrow interval is worth
        assert row.diagnostics.refits[0] < true < row.diagnostics.refits[1]
    assert result["C1"].posterior_verdict != NOT_IDENTIFIED


def test_an_interval_as_wide_as_the_refits_stands():
    posterior = prepare(missed())
    low, high = identify_draws(posterior, narrow_draws(posterior), "converged")[
        NAMES[0]
    ].diagnostics.refits
    wide = identify_draws(posterior, narrow_draws(posterior, sd=0.25 * (high - low)), "converged")
    assert wide[NAMES[0]].posterior_verdict != NOT_IDENTIFIED


def test_a_stretch_known_from_an_image_stands():
    seen = {
        name: {"distribution": "normal", "mean": m, "sd": 2e-4}
        for name, m in zip(NAMES, MOUNTING, strict=True)
    }
    posterior = prepare(missed(), priors=seen)
    draws = narrow_draws(posterior)
    for name, m in zip(NAMES, MOUNTING, strict=True):
        draws[name] += m - draws[name].mean()
    result = identify_draws(posterior, draws, "converged")
    assert result.mounting_ranges() == {}


def test_every_mounted_state_has_its_own_refits():
    posterior = prepare(missed(), mounting_stretch="per-protocol")
    result = identify_draws(posterior, narrow_draws(posterior), "converged")
    names = [f"{name}[{p.name}]" for p in missed().protocols for name in NAMES]
    assert {result[name].posterior_verdict for name in names} == {NOT_IDENTIFIED}
    back = result.to_frame().set_index("parameter")
    assert (back.loc[names, "refit_low"] < back.loc[names, "posterior_q05"]).all()
    assert back.loc[["C1", "kappa"], "refit_low"].isna().all()


@pytest.mark.parametrize("mounting", ["ignored", "zeroed"])
def test_what_was_not_inferred_is_not_refitted(mounting):
    assert mounting_refits(prepare(missed(), mounting=mounting)) is None


@pytest.mark.long
def test_a_mounting_stretch_that_the_data_contradict_is_reported_by_no_interval(tmp_path):
    with runs_without_figures():
        run = biaxbayes.sample(
            missed(), out=tmp_path / "run", ess=80, workers=1, noise="independent"
        )
    row = run.result[NAMES[0]]
    assert row.verdict == NOT_IDENTIFIED and np.isnan([row.low, row.high]).all()
    line = next(x for x in closing_message(run).splitlines() if x.startswith(NAMES[0]))
    assert NOT_IDENTIFIED in line and " to " not in line
    assert "The test did not identify" in latex_table(run) and "Refits" in report_page(run)
