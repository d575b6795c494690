"""Quantities whose spread a further measurement is to shrink."""

from __future__ import annotations

import numpy as np
import pandas as pd

from biaxbayes.findings.derived import STRESS, derived_quantities, largest_equibiaxial
from biaxbayes.findings.sampling_scale import judged_scales
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior

__all__ = ["targets"]


def targets(
    posterior: Posterior, draws: pd.DataFrame, stretch: float | None = None
) -> dict[str, np.ndarray]:
    """Quantities whose spread is to shrink, on the scales of the verdicts.

    Free material parameters and mounting stretches (C1, k1 and k2 in logs), the in-plane
    structure tensor, and in logs the small-strain stiffness and the stress at a total equibiaxial
    stretch (the largest tested one where none is given).
    """
    out = {}
    for scale in judged_scales(posterior.priors, draws):
        if isinstance(scale.prior, Prior):
            out[scale.name] = scale.of(draws[scale.name].to_numpy(dtype=float))
    top = round(stretch or largest_equibiaxial(draws, posterior.specimen), 3)
    switch = posterior.settings.fibre_switch
    for d in derived_quantities(draws, [top], [1.0], fibre_switch=switch):
        if d.name != "Hz":
            logs = d.kind == STRESS or bool(d.unit)
            out[d.key] = np.log(np.maximum(d.values, 1e-300)) if logs else d.values
    return {name: v for name, v in out.items() if np.ptp(v) > 0.0}
