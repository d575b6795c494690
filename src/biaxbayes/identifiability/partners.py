"""Correlated parameters: how narrow a parameter would be if others were known.

The conditional sd is the residual sd of a polynomial regression of the parameter on the
others (all on their sampling scales): cubic in each, with all products of two. Partners are those
that alone explain much of the parameter (or it of them), and the fewest that are needed besides.
Every set of up to three is tried: two may explain nothing alone and much together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

MAX_REGRESSION_DRAWS = 3000
MAX_PARTNERS = 3
MAX_SPREAD_RATIO = 0.8  # partners must reduce the sd to this fraction, at least
PAIR_SPREAD_RATIO = 0.6  # two move together where one leaves this fraction of the other's sd
NEAR_ALL = 1.25  # partners suffice once the sd is within this factor of that given all others
NEAR_THREE = 1.1  # or, where no three reach that, of that given the best three


@dataclass(frozen=True)
class Partners:
    """The parameters that a parameter is correlated with."""

    names: tuple[str, ...]  # those that explain much alone first
    spread_given_all: float  # sd given all other parameters, over the marginal one
    spread_given_partners: float  # the same given the partners alone


def find_partners(values: np.ndarray, names: tuple[str, ...]) -> dict[str, Partners]:
    """Partners of every parameter, from draws (n, d) on the sampling scales."""
    thinned = values[:: max(1, len(values) // MAX_REGRESSION_DRAWS)]
    sd = thinned.std(axis=0)
    z = (thinned - thinned.mean(axis=0)) / np.where(sd > 0.0, sd, 1.0)
    # an outlying draw must not determine the polynomial
    residual_sd = _regressions(np.clip(z, -6.0, 6.0))
    pair = np.ones((len(names), len(names)))
    for i, j in permutations(range(len(names)), 2):
        pair[i, j] = residual_sd(i, (j,))
    pair = np.minimum(pair, pair.T)
    out = {}
    for i, name in enumerate(names):
        # the fewest that explain about as much of it as all others, or as any three
        others = [j for j in range(len(names)) if j != i]
        if not others:
            out[name] = Partners((), 1.0, 1.0)
            continue
        full = residual_sd(i, others)
        near = sorted(others, key=lambda j, row=pair[i]: row[j])  # type: ignore[misc]
        together = [j for j in near if pair[i, j] <= PAIR_SPREAD_RATIO][:MAX_PARTNERS]
        remaining = [j for j in others if j not in together]
        best: list[tuple[float, list[int]]] = []  # of each size
        for more in range(min(MAX_PARTNERS - len(together), len(remaining)) + 1):
            tried = [[*together, *added] for added in combinations(remaining, more)]
            best.append(min((residual_sd(i, given), given) for given in tried))
        enough = max(NEAR_ALL * full, NEAR_THREE * best[-1][0])
        sd_given_chosen, chosen = next(candidate for candidate in best if candidate[0] <= enough)
        if sd_given_chosen > MAX_SPREAD_RATIO and not together:
            sd_given_chosen, chosen = 1.0, []
        out[name] = Partners(tuple(names[j] for j in chosen), full, sd_given_chosen)
    return out


def _regressions(z: np.ndarray) -> Callable[[int, Sequence[int]], float]:
    """Residual sd of a parameter given others, over its marginal sd, of standardised draws (n, d).

    Every regression follows from the sums of products of all terms: one, the first three powers of
    each parameter, products of two.
    """
    n, d = z.shape
    product = np.zeros((d, d), dtype=int)  # their columns
    columns = [np.ones(n), *z.T, *(z**2).T, *(z**3).T]
    for i, j in combinations(range(d), 2):
        product[i, j] = product[j, i] = len(columns)
        columns.append(z[:, i] * z[:, j])
    terms = np.array(columns)
    sums = terms @ terms.T
    power = 1 + np.arange(d)[:, None] + d * np.arange(3)  # (d, 3): columns of the powers

    def residual_sd(response: int, given: Sequence[int]) -> float:
        y = power[response, 0]
        total = sums[y, y] - sums[0, y] ** 2 / n
        if not total > 0.0:
            return 1.0
        used = [0, *power[list(given)].ravel()]
        used += [product[i, j] for i, j in combinations(given, 2)]
        gram, with_y = sums[np.ix_(used, used)], sums[used, y]
        # normal equations with a ridge penalty: neighbouring powers are nearly collinear
        c = np.linalg.solve(gram + 1e-9 * n * np.eye(len(used)), with_y)
        # |y - F c|^2 = y.y - 2 c.F'y + c.F'F c
        residual = max(sums[y, y] - 2.0 * c @ with_y + c @ gram @ c, 0.0)
        freedom = max(n - len(used), 1)
        return float(min(np.sqrt(residual / freedom * n / total), 1.0))

    return residual_sd
