"""What pooling does to specimens and means, over many studies of one kind."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from studies.population.pooling import pool, sampled
from studies.population.virtual import PARAMETERS, PLANS, made, on_scale

LEVELS = (0.05, 0.5, 0.95)
MOST_SWEEPS = 1000
"""Kept: fewer than the sampler may ask for where specimens leave long ridges."""


def pooled_study(kind: str, seed: int) -> dict[str, Any]:
    """Intervals of the specimens alone and pooled, of the mean and of the sds, on the scale."""
    clock = time.process_time()
    plan = PLANS[kind]
    members = made(plan, seed)
    runs = {m.label: sampled(m.specimen, 1 + k, noise=plan.noise) for k, m in enumerate(members)}
    alone = time.process_time() - clock
    belong = [m.group for m in members], [m.donor for m in members]
    found = pool(runs, *belong, seed, max_steps=MOST_SWEEPS)
    hyper = found.hyper()
    theta = found.specimen_values(10**9)
    single = [on_scale(run.draws[list(PARAMETERS)].to_numpy()) for run in runs.values()]
    judged = found.sampled.convergence
    return {
        "state": found.state,
        "reason": found.reason,
        "ess": judged.worst_ess,
        "rhat": judged.worst_rhat,
        "sweeps": judged.steps,
        "singles": [run.state for run in runs.values()],
        "protocols": [len(m.specimen.protocols) for m in members],
        "truth": _rounded(np.array([m.theta for m in members])),
        "single": _rounded([np.quantile(x, LEVELS, axis=0) for x in single]),
        "pooled": _rounded(np.quantile(theta, LEVELS, axis=0).transpose(1, 0, 2)),
        "mean": _rounded(np.quantile(hyper.typical_median(0), LEVELS, axis=0)),
        "sd_donors": _rounded(np.quantile(hyper.sd_donors, LEVELS, axis=0)),
        "sd_specimens": _rounded(np.quantile(hyper.sd[:, 0], LEVELS, axis=0)),
        "cpu": [round(alone, 1), round(time.process_time() - clock, 1)],
    }


def _rounded(values: Any) -> Any:
    return np.round(np.array(values), 6).tolist()
