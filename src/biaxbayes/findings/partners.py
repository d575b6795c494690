"""What a parameter trades with: how narrow it would be if others were known.

The conditional spread is the residual spread of a polynomial regression of the parameter on the
others (all on their sampling scales): cubic in each, with all products of two. Partners are those
that alone tell much about the parameter (or it about them), since on a ridge all move together,
and those that are needed besides to explain its spread.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Partners", "find_partners"]

DRAWS = 3000
MOST_PARTNERS = 3
WORTH = 0.8  # another partner must shrink the remaining spread to this share, at least
TOGETHER = 0.6  # two parameters move together where one leaves this share of the other's spread
NEAR = 1.25  # partners suffice once the spread is this close to that given everything


@dataclass(frozen=True)
class Partners:
    """The parameters that one trades with.

    Attributes
    ----------
    names : tuple of str
        In the order of what they explain.
    spread_given_all : float
        Standard deviation given all other parameters, over the marginal one.
    spread_given_partners : float
        The same given the partners alone.
    """

    names: tuple[str, ...]
    spread_given_all: float
    spread_given_partners: float


def find_partners(values: np.ndarray, names: tuple[str, ...]) -> dict[str, Partners]:
    """Partners of every parameter.

    Parameters
    ----------
    values : ndarray, shape (n, d)
        Draws on the sampling scales.
    names : tuple of str, length d

    Returns
    -------
    dict of Partners
    """
    step = max(1, len(values) // DRAWS)
    few = values[::step]
    spread = few.std(axis=0)
    z = (few - few.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    z = np.clip(z, -6.0, 6.0)  # a far draw must not steer the polynomial
    d = len(names)
    pair = np.ones((d, d))
    for i in range(d):
        for j in range(d):
            if i != j and spread[i] > 0.0:
                pair[i, j] = _spread_given(z, i, [j])
    pair = np.minimum(pair, pair.T)
    return {name: _partners_of(z, j, names, pair[j]) for j, name in enumerate(names)}


def _partners_of(z: np.ndarray, target: int, names: tuple[str, ...], pair: np.ndarray) -> Partners:
    others = [j for j in range(len(names)) if j != target]
    if not others or not z[:, target].std() > 0.0:
        return Partners((), 1.0, 1.0)
    full = _spread_given(z, target, others)
    chosen = [j for j in sorted(others, key=lambda j: pair[j]) if pair[j] <= TOGETHER]
    chosen = chosen[:MOST_PARTNERS]
    spread = _spread_given(z, target, chosen) if chosen else 1.0
    while spread > NEAR * full and len(chosen) < MOST_PARTNERS:
        left = [j for j in others if j not in chosen]
        tried = [_spread_given(z, target, [*chosen, j]) for j in left]
        best = int(np.argmin(tried)) if tried else 0
        if not tried or tried[best] > WORTH * spread:
            break
        chosen.append(left[best])
        spread = tried[best]
    return Partners(tuple(names[j] for j in chosen), full, spread)


def _spread_given(z: np.ndarray, target: int, given: list[int]) -> float:
    """Residual spread of the regression over the marginal spread."""
    columns = [np.ones(len(z))]
    for i, a in enumerate(given):
        columns += [z[:, a], z[:, a] ** 2, z[:, a] ** 3]
        columns += [z[:, a] * z[:, b] for b in given[:i]]
    features = np.column_stack(columns)
    y = z[:, target]
    # Normal equations with a whisper of ridge: neighbouring powers are nearly collinear.
    gram = features.T @ features
    gram[np.diag_indices_from(gram)] += 1e-9 * len(z)
    residual = y - features @ np.linalg.solve(gram, features.T @ y)
    freedom = max(len(z) - features.shape[1], 1)
    return float(min(np.sqrt((residual @ residual) / freedom) / y.std(), 1.0))
