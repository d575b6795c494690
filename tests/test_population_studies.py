"""The studies behind docs/population-evidence.md: truths, records and what is made of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from biaxbayes.populations.hierarchy import LEAST_INSIDE
from studies.population.calibration import GROUPS, PRIORS, Truths, values_of
from studies.population.study import pooling
from studies.population.virtual import CENTRES, PARAMETERS, Plan, made, on_scale


def test_truths_are_cut_as_the_model_cuts_them():
    values = values_of(PRIORS)
    drawn = [Truths(values, np.random.default_rng(seed)) for seed in range(120)]
    kappa = PARAMETERS.index("kappa")
    low, high = values[kappa].edges
    for t in drawn:
        assert t.theta.shape == (8, 5) and list(t.group[:3]) == [0, 1, 0]
        assert np.all((t.theta[:, kappa] >= low) & (t.theta[:, kappa] <= high))
        location = (t.mu[t.group] + t.effect[t.donor])[:, kappa]
        of = norm(location, t.sd[kappa])
        assert np.all(of.cdf(high) - of.cdf(low) >= LEAST_INSIDE)
        assert len(t.named()) == 5 * (len(GROUPS) + 2)
    # what is not cut keeps its prior: mean and sd of 240 means, sds half-normal
    C1 = np.array([t.mu[:, 0] for t in drawn]).ravel()
    assert abs(C1.mean() - values[0].mean) < 4 * values[0].mean_sd / np.sqrt(C1.size)
    assert C1.std() == pytest.approx(values[0].mean_sd, rel=0.2)
    sd = np.array([t.sd[0] for t in drawn])
    assert np.sqrt((sd**2).mean()) == pytest.approx(values[0].specimen_scale, rel=0.25)
    # specimens scatter about their location by the sd between specimens
    off = np.array([(t.theta - t.mu[t.group] - t.effect[t.donor])[:, 0] / t.sd[0] for t in drawn])
    assert off.std() == pytest.approx(1.0, rel=0.1)


def test_a_common_misfit_is_the_same_in_all_specimens():
    def factors(kind):
        plan = Plan(4, misfit=kind, noise_N=1e-9)
        plain = made(Plan(4, noise_N=1e-9), 3)
        out = []
        for a, b in zip(made(plan, 3), plain, strict=True):
            assert a.specimen.protocols[0].stretch_x[-1] == b.specimen.protocols[0].stretch_x[-1]
            out.append(a.specimen.protocols[1].load_y / b.specimen.protocols[1].load_y)
        return np.array(out)

    common, own = factors("common"), factors("own")
    assert np.ptp(common, axis=0).max() < 1e-3 < 0.005 < np.ptp(common, axis=1).max()
    assert np.ptp(own, axis=0).max() > 0.01
    assert 0.005 < (own - 1).std() < 0.06


def test_widths_coverage_and_errors_of_pooled_records():
    centre = on_scale(CENTRES["media"])
    truth = centre + np.array([[0.1] * 5, [-0.1] * 5])

    def intervals(middle, half):
        return (middle[:, None] + half * np.array([-1.0, 0.0, 1.0])[:, None]).tolist()

    record = {
        **{"truth": truth.tolist(), "protocols": [1, 3]},
        "single": intervals(truth + 0.2, 0.4),
        "pooled": intervals(truth + 0.2, 0.1),
        "mean": intervals(centre[None] + 0.05, 0.1)[0],
        "sd_specimens": [[0.1] * 5] * 3,
    }
    found = pooling([record] * 2)
    assert found["width_pooled_over_single"].to_numpy() == pytest.approx(0.25)
    assert (found["single_contains"] == 1.0).all() and (found["pooled_contains"] == 0.0).all()
    assert found["error_of_mean"].to_numpy() == pytest.approx(0.05)
    assert found["error_of_mean_of_medians"].to_numpy() == pytest.approx(0.2)
    assert (found["mean_contains"] == 1.0).all()
