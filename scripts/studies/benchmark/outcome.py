"""What a sampler achieved, and in which time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from biaxbayes.sampling.convergence import assess

LEVELS = (0.05, 0.5, 0.95)


@dataclass
class Outcome:
    """One sampler on one posterior."""

    ess: float  # of the worst parameter
    evaluations: int  # of the density (gradients for NUTS) behind it, warm-up left out
    seconds: float  # wall time on one core, as the next
    warmup_seconds: float
    rhat: float  # largest over the parameters; NaN where it has no meaning
    # (chains, steps, walkers), to compare quantiles; ``weight`` holds weights where there are
    # some
    draws: dict[str, np.ndarray]
    note: str = ""
    log_evidence: tuple[float, float] | None = None
    extra: dict[str, float] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        """Effective draws a second, warm-up excluded."""
        return self.ess / self.seconds


def judged(draws: dict[str, np.ndarray]) -> tuple[float, float]:
    """(effective sample size of the worst parameter, largest R-hat), one estimator for all.

    The bulk ESS, as the peers report it.
    """
    found = assess(draws, target_ess=1.0)
    return float(found.ess_bulk.min()), found.worst_rhat


def weighted_quantiles(
    values: np.ndarray, weight: np.ndarray, levels: tuple[float, ...] = LEVELS
) -> np.ndarray:
    """Quantiles of weighted draws."""
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    return np.interp(levels, cumulative / cumulative[-1], values[order])
