"""What sampling compiles, compiled ahead of its use: a first run can do it beside other work.

Compiled code is kept between runs (:mod:`biaxbayes.compilation`): a process that compiles it fills
the cache for every other.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
import numpy as np

from biaxbayes.sampling.population_monte_carlo import search
from biaxbayes.sampling.sampler import Plan, draw
from biaxbayes.sampling.target import Target

__all__ = ["are_compiled", "compile_kernels"]

LAST = "independence_move._accept"
"""The function that an example of sampling compiles last."""


def are_compiled() -> bool:
    """Whether an earlier run has left compiled code behind."""
    config: Any = numba.config
    return any(Path(config.CACHE_DIR).rglob(f"{LAST}-*.nbi"))


def compile_kernels() -> None:
    """Compile everything that :func:`search` and :func:`draw` call, by a small example."""
    target = Target(_half_normal, np.array([[0.0, np.inf], [-np.inf, np.inf]]))
    plan = Plan(ess=20, seed=0, max_steps=1)
    draw(target, search(target, np.array([[0.5, 0.0]]), np.ones(2), plan.search_rng()), plan)


def _half_normal(x: np.ndarray) -> np.ndarray:
    """Log density of independent normals, the first of them cut at zero; x of shape (n, 2)."""
    return np.where(x[:, 0] >= 0.0, -0.5 * (x**2).sum(axis=1), -np.inf)
