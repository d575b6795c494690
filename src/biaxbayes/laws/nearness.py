"""How near to a physical edge counts as near: what laws share of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from biaxbayes.laws.response import Material, MaterialResponse

__all__ = ["LOAD_NEARNESS", "LOAD_SHARE", "amplitude_distances", "largest_at"]

LOAD_SHARE = 0.05
"""Of the stress at the largest stretch: what carries less is near to absent."""
LOAD_NEARNESS = f"where they carry less than {LOAD_SHARE:g} of the stress at the largest stretch"
"""The same in words, behind the names of amplitudes."""
LOWEST = 0.05
"""Draws from which a distance is taken: an amplitude trades with its exponent, so that a small one
may carry as much as a large one does."""


def largest_at(quantity: Callable[[Any, Any, Any], Any], tops: Sequence[np.ndarray]) -> np.ndarray:
    """Largest value of each draw at some total stretches, shape (n,).

    Parameters
    ----------
    quantity : callable
        Of squared stretches X, Y, Z of shape (n, 1); not negative.
    tops : sequence of ndarray, shape (n, 2)
    """
    largest = np.zeros(1)
    for top in tops:
        X, Y = top[:, :1] ** 2, top[:, 1:] ** 2
        largest = np.maximum(largest, np.asarray(quantity(X, Y, 1.0 / (X * Y)))[:, 0])
    return largest


def amplitude_distances(material: MaterialResponse, tops: Sequence[np.ndarray]) -> dict[str, float]:
    """Amplitudes that carry :data:`LOAD_SHARE` of the stress at the largest stretches.

    Medians over the draws in which the amplitude is smallest.

    Parameters
    ----------
    material : Material
        Of n draws; stresses are linear in the amplitudes of its law.
    tops : sequence of ndarray, shape (n, 2)
        Largest total stretches of each protocol.
    """
    law = material.law
    places = [law.names.index(name) for name in law.amplitudes]
    out = {}
    for i in places:
        alone = list(material.theta)
        for j in places:
            alone[j] = np.full_like(alone[j], float(i == j))
        # the amplitude that would carry all, in the protocol in which it carries most
        all_of_it = np.min(
            [_stress(material, top) / _stress(Material(law, tuple(alone)), top) for top in tops],
            axis=0,
        )
        size = np.broadcast_to(np.ravel(material.theta[i]), all_of_it.shape)
        smallest = np.argsort(size, kind="stable")[: max(1, round(LOWEST * size.size))]
        out[law.names[i]] = LOAD_SHARE * float(np.median(all_of_it[smallest]))
    return out


def _stress(material: MaterialResponse, top: np.ndarray) -> np.ndarray:
    """Sum of both Cauchy stresses of each draw, kPa, never zero."""
    x, y = material.cauchy(top[:, :1], top[:, 1:])
    return np.maximum((x + y)[:, 0], 1e-12)
