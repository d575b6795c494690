"""Effective number of independent readings of a curve.

Neighbouring residuals of a real specimen are nearly equal, because the error of the
model, not of the load cell, dominates. A curve of n residuals with autocorrelation rho(t) carries

    n_eff = n / (1 + 2 sum rho(t))

independent pieces of information; its log likelihood is weighted by beta = n_eff / n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MIN_EFFECTIVE_SIZE = 2.0  # smallest n_eff of a curve, or its sd would be undefined
MAX_SIGN_CHANGE_Z = 3.0  # standard deviations of the sign changes of independent errors


def effective_size(residual: np.ndarray) -> float:
    """Effective number of independent readings, 2 to n, of residuals (n,) along a path.

    Geyer's initial positive sequence: autocorrelations are summed in pairs while the sum of a
    pair is positive. The mean is not removed, since a constant residual is misfit too.
    """
    n = residual.size
    if n < 4:
        return float(n)
    power = float(residual @ residual)
    if power == 0.0:
        return float(n)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(residual, size)
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[:n] / power
    total = 0.0
    for lag in range(0, n - 1, 2):
        pair = rho[lag] + rho[lag + 1]
        if pair <= 0.0:
            break
        total += pair
    # 1 + 2 sum_{t>=1} rho(t) = 2 sum over pairs - 1
    return float(np.clip(n / max(2.0 * total - 1.0, 1.0), min(MIN_EFFECTIVE_SIZE, n), n))


@dataclass(frozen=True)
class EffectiveReadings:
    """Numbers of readings and of the independent ones that they are equivalent to, (p, 2)."""

    count: np.ndarray
    effective: np.ndarray

    @property
    def beta(self) -> float:
        """The weight n_eff / n of the log likelihood, at most one."""
        return float(min(self.effective.sum() / self.count.sum(), 1.0))

    @property
    def total(self) -> float:
        """n_eff over all curves."""
        return float(self.effective.sum())


def effective_readings(
    residuals: Sequence[np.ndarray], scale: Sequence[np.ndarray] | None = None
) -> EffectiveReadings:
    """Effective readings of residuals (n_p, 2) per protocol; ``scale`` are sds up to a factor."""
    count = np.array([[len(r), len(r)] for r in residuals], dtype=float)
    effective = np.array(
        [
            [effective_size(r[:, k] if scale is None else r[:, k] / scale[i][:, k]) for k in (0, 1)]
            for i, r in enumerate(residuals)
        ]
    )
    return EffectiveReadings(count, effective)


def has_smooth_misfit(residuals: Sequence[np.ndarray]) -> bool:
    """True if the signs of residuals (n_p, 2) change too seldom for independent errors."""
    changes = steps = 0
    for part in residuals:
        if not part.any():
            continue
        above = part > 0.0
        changes += int(np.count_nonzero(above[1:] != above[:-1]))
        steps += 2 * max(len(part) - 1, 0)
    # Signs of independent errors change at every step with probability 1/2.
    return changes - 0.5 * steps < -MAX_SIGN_CHANGE_Z * 0.5 * np.sqrt(steps)
