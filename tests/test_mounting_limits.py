"""Mounting stretches far from one, and what is said where they lie at the limits of the search."""

import numpy as np
import pytest

from biaxbayes.fitting.fit import fit
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.mounting import BRACKET
from biaxbayes.model.conflicts import bracket_findings
from biaxbayes.model.posterior import Posterior
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

VALUES = {"C1": 12.0, "k1": 8.0, "k2": 0.4, "alpha": 41.0, "kappa": 0.15}
MATERIAL = GOH(*VALUES.values())


@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("mounting", [(2.15, 1.80), (1.05, 2.6), (0.45, 1.7)])
def test_a_tissue_mounted_far_from_one_is_fitted_and_has_a_density(mounting, geometry):
    specimen, _ = virtual_specimen(
        MATERIAL,
        name="far",
        mounting_stretch=mounting,
        measured_stretch=1.15,
        ratios=((1, 1), (1, 0.5), (0.5, 1)),
        increments=40,
        machine=Machine(noise_N=0.0, geometry=geometry),
        seed=3,
    )
    posterior = Posterior(
        specimen, mounting="exact", noise="independent", mounting_sd=0.6, beta=1.0
    )
    values = {**VALUES, "noise_sd": 0.01 * specimen.peak_load}
    assert np.isfinite(posterior.log_density({name: values[name] for name in posterior.free}))
    found = fit(specimen, initial=MATERIAL)
    assert found.mounting_stretch[0] == pytest.approx(mounting, abs=0.02)
    assert found.material.values[:3] == pytest.approx([12.0, 8.0, 0.4], rel=0.1)


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
