"""Tuned quantities of a population's moves, and moves that draw specimens apart or together.

The moves do what an sd is slow to do one specimen at a time. Where single posteriors are long
ridges an sd between specimens and the places of all specimens on their ridges hold one another.
Along a direction g of all specimens together (a principal component of the warm-up) specimen i
stands at s_i; the deviations of the s_i from their mean over a group, or over a donor, are
stretched by one factor, and g carries the specimens there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes.sampling.proposal import TransportedMixture

MIN_SHARE = 1e-9
"""A specimen that takes less part in a direction, beside the one with most, is left out of it."""


def memberships(group: np.ndarray, donor: np.ndarray) -> list[np.ndarray]:
    """Whose mean a specimen deviates from: that of its group, that of its donor.

    Integers, shape (n,) each. Without donors that gave several specimens the group's alone; without
    groups of several, none.
    """
    return [of for of in (group, donor) if len(np.unique(of)) < len(of)]


@dataclass(frozen=True, eq=False)
class Spreading:
    """Tuning of these moves by the warm-up.

    Attributes
    ----------
    centre, sd : ndarray, shape (n, dmax)
        Of each specimen's coordinates.
    steps : ndarray, shape (memberships, L)
        Sds of the logs of the factors, by direction.
    """

    centre: np.ndarray
    sd: np.ndarray
    steps: np.ndarray

    def moved(
        self, u: np.ndarray, direction: np.ndarray, of: np.ndarray, log_factor: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates (C, n, dmax) drawn apart, and the log of the Jacobian, shape (C,).

        Parameters
        ----------
        u : ndarray, shape (C, n, dmax)
        direction : ndarray, shape (n, dmax)
        of : ndarray, shape (n,)
            Whose mean each specimen deviates from.
        log_factor : ndarray, shape (C,)
        """
        along = direction / np.where(self.sd > 0.0, self.sd, 1.0) ** 2
        share = (direction * along).sum(axis=1)
        taking = share > MIN_SHARE * share.max()
        share = np.where(taking, share, 0.0)
        of = np.unique(of, return_inverse=True)[1]
        cells = (of == np.arange(of.max() + 1)[:, None]).astype(float)
        weight = cells @ share
        projected = ((u - self.centre) * along).sum(axis=2) * taking
        mean = (projected @ cells.T) / np.where(weight > 0.0, weight, 1.0)
        s = projected / np.where(taking, share, 1.0)
        off = np.where(taking, s - mean[:, of], 0.0)
        by = np.expm1(log_factor)
        new = u + (by[:, None] * off)[..., None] * direction
        # deviations from a mean have one dimension less than there are specimens that take part
        dimensions = taking.sum() - np.count_nonzero(weight)
        return new, log_factor * float(dimensions)


@dataclass(frozen=True, eq=False)
class Tuning:
    """Results of the warm-up that the moves use; frozen afterwards.

    Attributes
    ----------
    archives : tuple of ndarray, shape (A, d)
        Coordinates of each specimen, for differential evolution.
    proposals : tuple of TransportedMixture
        Empty before the first fit.
    directions : ndarray, shape (L, n, dmax)
        Principal components times their sd; none before the first fit.
    steps : ndarray, shape (L,)
        How far a joint move goes along each.
    spreading : Spreading, optional
        For moves that draw specimens apart or together along them.
    """

    archives: tuple[np.ndarray, ...]
    proposals: tuple[TransportedMixture, ...]
    directions: np.ndarray
    steps: np.ndarray
    spreading: Spreading | None = None
