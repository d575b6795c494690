"""Priors that contradict the data, and mounting stretches at the limits, are named."""

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.fitting.fit import fit
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.prior_checks import bracket_findings, prior_findings, radian_findings
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

VALUES = {"C1": 12.0, "k1": 60.0, "k2": 6.0, "alpha": 41.0, "kappa": 0.12}
SPECIMEN, _ = virtual_specimen(
    GOH(*VALUES.values()), name="exact", mounting_stretch=(1.02, 1.03), measured_stretch=1.15,
    ratios=((1, 1), (1, 0.5), (0.5, 1)), increments=49, machine=Machine(noise_N=0.005), seed=11,
)  # fmt: skip


def normal(mean, sd):
    return {"distribution": "normal", "mean": mean, "sd": sd}


@pytest.mark.parametrize(
    ("parameter", "prior"),
    [
        ("alpha", normal(0.7, 0.05)),
        ("k1", {"distribution": "lognormal", "median": 0.06, "sd_log": 0.2}),
        ("kappa", {"distribution": "uniform", "low": 0.30, "high": 0.33}),
        ("mounting_stretch_x", normal(1.12, 0.003)),
    ],
)
def test_a_prior_that_contradicts_the_data_is_named(parameter, prior):
    posterior = prepare(SPECIMEN, priors={parameter: prior})
    (finding,) = prior_findings(posterior)
    assert (finding.code, finding.severity) == ("prior-contradicts-data", "warning")
    assert f"the prior of {parameter}, {prior['distribution']}" in finding.message
    fitted = float(finding.message.split("which alone give ")[1].split(":")[0])
    truth = VALUES.get(parameter, 1.02)
    assert fitted == pytest.approx(truth, rel=0.15)


def test_free_mounting_stretches_need_an_error_of_the_mounting_force(tmp_path):
    stretch = np.linspace(1.0, 1.2, 40)
    load = np.round(50.0 * (stretch - 0.98), 4)
    record = Protocol("1to1", stretch, stretch, load, load)
    specimen = Specimen("smooth", (record,), "piola", "unloaded")
    with pytest.raises(InputError, match="`mounting=free` needs an error of the mounting force"):
        biaxbayes.sample(specimen, out=tmp_path / "run", mounting="free", noise="independent")


@pytest.mark.long
def test_no_parameter_is_reported_under_a_prior_that_contradicts_the_data(tmp_path):
    """With the angle 20 sd from its prior, the stiffness k1 is far from the truth in any run."""
    priors = {"alpha": normal(0.7, 0.05)}
    radians = pytest.warns(RuntimeWarning, match="radians")
    with radians, pytest.warns(RuntimeWarning, match="contradicts the data") as shown:
        run = biaxbayes.sample(SPECIMEN, out=tmp_path / "run", priors=priors, ess=100, seed=1)
    assert {warning.filename for warning in shown} == {__file__}  # of the caller
    assert run.state == "converged"
    low, high = run.summary.loc["k1", ["q05", "q95"]]
    assert not low < VALUES["k1"] < high
    for name in VALUES:
        row = run.result[name]
        assert (row.verdict, row.reason) == (
            "not identified",
            "the prior of alpha contradicts the data",
        )
    assert "prior of alpha" in run.result.advice


@pytest.mark.parametrize(
    "priors",
    [
        {},
        {"alpha": normal(41.0, 3.0)},
        {
            "alpha": normal(36.0, 5.0),
            "C1": {"distribution": "lognormal", "median": 8.0, "sd_log": 1},
        },
        {"k1": {"distribution": "loguniform", "low": 1.0, "high": 1000.0}},
    ],
)
def test_a_prior_that_agrees_is_not(priors):
    assert prior_findings(prepare(SPECIMEN, priors=priors)) == []


@pytest.mark.parametrize(
    ("priors", "said"),
    [
        ({"alpha": normal(0.7, 0.05)}, "40.11, 2.865"),
        ({"alpha": {"distribution": "uniform", "low": 0.6, "high": 0.8}}, "34.38, 45.84"),
        ({"kappa": {"distribution": "uniform", "low": 0.0, "high": 0.2}}, ""),
        ({"alpha": normal(41.0, 3.0)}, ""),
    ],
)
def test_an_angle_in_radians_is_named_in_priors(priors, said):
    found = [f.message for f in radian_findings(prepare(SPECIMEN, priors=priors))]
    assert said in found[0] if said else not found


FAR_VALUES = {"C1": 12.0, "k1": 8.0, "k2": 0.4, "alpha": 41.0, "kappa": 0.15}
FAR = GOH(*FAR_VALUES.values())


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("mounting", [(2.15, 1.80), (1.05, 2.6), (0.45, 1.7)])
def test_a_tissue_mounted_far_from_one_is_fitted_and_has_a_density(mounting, geometry):
    specimen, _ = virtual_specimen(
        FAR, name="far", mounting_stretch=mounting, measured_stretch=1.15,
        ratios=((1, 1), (1, 0.5), (0.5, 1)), increments=40,
        machine=Machine(noise_N=0.0, geometry=geometry), seed=3,
    )  # fmt: skip
    posterior = Posterior(specimen, mounting="exact", noise="independent", mounting_sd=0.6)
    values = {**FAR_VALUES, "noise_sd": 0.01 * specimen.peak_load}
    assert np.isfinite(posterior.log_density({name: values[name] for name in posterior.free}))
    result = fit(specimen, initial=FAR)
    assert result.mounting_stretch[0] == pytest.approx(mounting, abs=0.02)
    assert result.material.values[:3] == pytest.approx([12.0, 8.0, 0.4], rel=0.1)


def test_draws_at_the_limits_of_the_search_are_named():
    rng = np.random.default_rng(1)
    middle = rng.normal(1.02, 0.02, (2, 100, 30))
    high = np.minimum(rng.normal(3.9, 0.3, (2, 100, 30)), BRACKET[1] - 1e-6)
    low = np.maximum(rng.normal(0.32, 0.02, (2, 100, 30)), BRACKET[0] + 1e-6)
    assert bracket_findings({"mounting_stretch_x": middle}) == []
    for draws, limit in ((high, "lie at 4"), (low, "lie at 0.3")):
        (finding,) = bracket_findings({"mounting_stretch_x": middle, "mounting_stretch_y": draws})
        assert finding.severity == "warning"
        assert "mounting_stretch_y" in finding.message and limit in finding.message
