"""The ledger of treatments, against mechanics that states what ignoring a mounting stretch does."""

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import biaxbayes
from biaxbayes.comparison import mounting_bias
from biaxbayes.comparison.mounting_bias import MOUNTING_MODELS, ledger, sample_mounting_model
from biaxbayes.errors import InputError
from biaxbayes.identifiability.determined import largest_equibiaxial
from biaxbayes.laws.goh import GOH
from biaxbayes.prediction.stress import BEYOND
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.verbs.ledger import command
from quick_posteriors import specimen

MATERIAL = GOH(15.0, 60.0, 8.0, 42.0, 0.1)


@pytest.fixture(scope="module")
def tested():
    return specimen(MATERIAL, increments=10)


@pytest.fixture(scope="module")
def variants(tested):
    plan = Plan(ess=150, seed=1, workers=2, walkers=32)
    base = {"noise": "independent"}
    modes = dict(zip(MOUNTING_MODELS, ("noisy", "ignored", "zeroed"), strict=True))
    return {
        name: sample_mounting_model(tested, base | {"mounting": mode}, plan)
        for name, mode in modes.items()
    }


def test_inferred_holds_the_true_stress_and_the_mistakes_do_not(variants):
    result = ledger(variants, [1.1])
    assert "\n" not in repr(result) and len(repr(result)) < 320
    truth = MATERIAL.cauchy(1.1, 1.1)
    for (_, row), true in zip(result.stresses.iterrows(), truth, strict=True):
        assert abs(row["inferred_median"] - true) < 4.0 * row["inferred_sd"]
        # A mounted state taken as the reference makes every total stretch too small.
        assert row["ignored_q05"] > true
        assert row["shift_ignored_sd"] > 5.0
        assert row["shift_zeroed_sd"] < row["shift_ignored_sd"]


def test_shift_is_in_standard_deviations_on_the_sampling_scale(variants):
    result = ledger(variants)
    rows = result.parameters.set_index("quantity")
    inferred, ignored = (np.log(variants[n].draws["C1"]) for n in ("inferred", "ignored"))
    expected = (ignored.median() - inferred.median()) / inferred.std()
    assert rows.loc["C1", "shift_ignored_sd"] == pytest.approx(expected, rel=0.02)
    lm = variants["inferred"].draws["mounting_stretch_y"]
    expected = (1.0 - lm.median()) / lm.std()
    assert rows.loc["mounting_stretch_y", "shift_zeroed_sd"] == pytest.approx(expected, rel=0.02)


def test_default_stretches_end_at_the_largest_tested_one(variants):
    result = ledger(variants)
    at = sorted(set(result.stresses["total_stretch"]))
    assert len(at) == 5
    inferred = variants["inferred"]
    reached = largest_equibiaxial(inferred.draws, inferred.posterior.specimen)
    # three decimals, and never beyond what was tested
    assert at[-1] == np.floor(1e3 * reached) / 1e3 == pytest.approx(1.2, abs=2e-3)
    np.testing.assert_allclose(np.diff([1.0, *at]), (at[-1] - 1.0) / 5, atol=2e-6)
    assert ledger(variants, [1.5]).stresses["extrapolation"].unique() == [BEYOND]
    with pytest.raises(InputError, match="unloaded"):
        ledger(variants, [1.0])


def test_parameters_are_those_of_every_draw(variants, monkeypatch):
    monkeypatch.setattr(mounting_bias, "MAX_STRESS_DRAWS", 50)  # stresses are those of some
    table = ledger(variants, [1.1]).parameters.set_index("quantity")
    for name, result in (("k1", "inferred"), ("k1", "ignored"), ("C1", "zeroed")):
        expected = np.quantile(variants[result].draws[name], [0.05, 0.5, 0.95])
        columns = [f"{result}_{at}" for at in ("q05", "median", "q95")]
        np.testing.assert_allclose(table.loc[name, columns].astype(float), expected, rtol=1e-12)


def test_command_writes_table_and_figure(tested, tmp_path):
    path = tmp_path / "tissue.csv"
    write_specimen(tested, path)
    out = tmp_path / "out"
    arguments = [str(path), "--out", str(out), "--ess", "50", "--stretch", "1.1"]
    done = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert done.exception is None
    assert done.return_value in (0, 3)
    table = pd.read_csv(out / "ledger.csv")
    assert list(table["quantity"][-2:]) == ["cauchy_x", "cauchy_y"]
    assert (out / "ledger.pdf").stat().st_size > 5000
    refused = CliRunner().invoke(command, [str(path), "--mounting", "ignored"])
    assert refused.exit_code == 2
    assert "'--mounting': 'ignored' is not one of 'noisy', 'exact', 'free'" in refused.output
    with pytest.raises(InputError, match="mounting must be one of noisy, exact, free"):
        biaxbayes.ledger(path, mounting="ignored")
