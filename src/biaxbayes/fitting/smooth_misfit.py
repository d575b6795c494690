r"""Effect of a smooth misfit of the law on a least-squares fit.

Residuals of a curve are noise of sd s and a model discrepancy (Kennedy and O'Hagan, J. R. Stat.
Soc. B 63, 2001): a Gaussian process g with squared-exponential kernel along the path, times the
load f,

    r_i = s e_i + b f_i g(t_i),     cov(g(t), g(t')) = exp(-(t - t')^2 / (2 l^2)),

with the normalised arc length t from 0 at the mounted state to 1 at the end of the curve, and
l = 0.25. A fit absorbs the smoothest part of the discrepancy, so b and s are estimated from what a
fit with the Jacobian J can leave: restricted likelihood (Patterson and Thompson, Biometrika 58,
1971), averaged over a grid. The least-squares estimate x = -A r with A = (J^T J)^-1 J^T then has
the covariance

    A (s^2 I + b^2 F K F^T) A^T.

A posterior whose rows are weighted by n_eff / n has the curvature of J alone: n_eff is
estimated from residuals that have lost the smoothest part of the discrepancy.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.fitting.residuals import Readings

CORRELATION_LENGTH = 0.25
"""Correlation length of the discrepancy, as a fraction of the path."""
N_DISCREPANCY_SDS = 50  # grid points of b, from a hundredth of the noise to the load itself
N_NOISE_SDS = 12  # grid points of s, from a third of the load cell's sd to the rms


def smooth_misfit(
    data: Readings,
    residual: np.ndarray,
    jacobian: np.ndarray,
    scale: float,
    noise_sd: float,
    reading_sd: np.ndarray | None,
) -> tuple[float, np.ndarray]:
    """Relative sd b of the discrepancy, and the covariance of the unknowns inside their bounds.

    ``residual`` (2 n + 2 m,) of the rows over ``scale``, then of the mounting readings over
    ``reading_sd`` (2, m; None where they were not data); ``jacobian`` with
    respect to the unknowns inside their bounds.
    """
    rows = 2 * data.group.size
    root = discrepancy_root(data, residual[:rows], scale, reading_sd)
    peak = data.peak / scale
    b2, s2 = _variances(residual[:rows], jacobian[:rows], root[:rows], noise_sd / scale, peak)
    A = pseudo_inverse(jacobian)
    noise = np.ones(residual.size)
    noise[:rows] = s2
    A_root = A @ root
    # A (s^2 I + b^2 F K F^T) A^T
    return float(np.sqrt(b2)), (A * noise) @ A.T + b2 * A_root @ A_root.T


def discrepancy_root(
    data: Readings, residual: np.ndarray, scale: float, reading_sd: np.ndarray | None
) -> np.ndarray:
    """Root of F K F^T, one row per residual; mounting readings have the discrepancy at t = 0."""
    n, groups = data.group.size, data.mounting_load.shape[1]
    load = (data.load.ravel() + residual * scale) / scale
    readings = 0 if reading_sd is None else 2 * groups
    columns = []
    for part in data.rows:
        # normalised arc length from the mounted state, and K(t, t')
        stretch = np.column_stack([np.ones(2), data.stretch[:, part]])
        t = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(stretch, axis=1)))])
        t /= t[-1] if t[-1] > 0.0 else 1.0
        values, vectors = np.linalg.eigh(
            np.exp(-0.5 * (np.subtract.outer(t, t) / CORRELATION_LENGTH) ** 2)
        )
        used = values > 1e-8 * values[-1]
        root = vectors[:, used] * np.sqrt(values[used])
        group = data.group[part.start] if part.stop > part.start else 0
        # one reading pools the protocols of its mounted state
        pooled = sum(1 for p in data.rows if p.stop > p.start and data.group[p.start] == group)
        for axis in (0, 1):
            column = np.zeros((2 * n + readings, root.shape[1]))
            at = slice(axis * n + part.start, axis * n + part.stop)
            column[at] = load[at, None] * root[1:]
            if reading_sd is not None:
                share = data.mounting_load[axis, group] / pooled / reading_sd[axis, group]
                column[2 * n + axis * groups + group] = share * root[0]
            columns.append(column)
    return np.hstack(columns)


def pseudo_inverse(jacobian: np.ndarray) -> np.ndarray:
    """(J^T J)^-1 J^T; columns are scaled first, as stiffnesses and angles differ by magnitudes."""
    norm = np.linalg.norm(jacobian, axis=0)
    norm = np.where(norm > 0.0, norm, 1.0)
    return np.linalg.pinv(jacobian / norm, rcond=1e-9) / norm[:, None]


def _variances(
    residual: np.ndarray, jacobian: np.ndarray, root: np.ndarray, noise_sd: float, peak: float
) -> tuple[float, float]:
    """Posterior means of b^2 and s^2 on a grid with a flat prior of ln b and ln s.

    With r and the root of F K F^T projected off the p columns of J, and U D V^T the latter's k
    singular vectors and values, the restricted log likelihood is

        -1/2 [sum_j ln(b^2 d_j^2 + s^2) + (u_j.r)^2 / (b^2 d_j^2 + s^2)
              + (n - p - k) ln s^2 + (|r|^2 - |U^T r|^2) / s^2].
    """
    norm = np.linalg.norm(jacobian, axis=0)
    q = np.linalg.qr(jacobian / np.where(norm > 0.0, norm, 1.0))[0]
    projected, r = root - q @ (q.T @ root), residual - q @ (q.T @ residual)
    u, d, _ = np.linalg.svd(projected, full_matrices=False)
    u, d = u[:, d > 1e-9 * d[0]], d[d > 1e-9 * d[0]]
    squares = (u.T @ r) ** 2
    rest = max(float(r @ r - squares.sum()), 0.0)
    count = max(residual.size - q.shape[1] - d.size, 0)
    rms = float(np.sqrt(residual @ residual / residual.size))
    largest_sd = max(rms, noise_sd, 1e-9)
    s2 = (
        np.geomspace(
            min(max(noise_sd / 3.0, 1e-3 * largest_sd), largest_sd), largest_sd, N_NOISE_SDS
        )[:, None]
        ** 2
    )
    b2 = np.geomspace(max(0.01 * largest_sd / peak, 1e-9), 1.0, N_DISCREPANCY_SDS)[None, :] ** 2
    variance = b2[..., None] * d**2 + s2[..., None]
    log_likelihood = -0.5 * (
        np.sum(np.log(variance) + squares / variance, axis=-1) + count * np.log(s2) + rest / s2
    )
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    return float(np.sum(weight * b2)), float(np.sum(weight * s2))
