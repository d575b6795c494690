"""Check that a written card gives the stress of the draw it was made from.

The card is read back from its text and the program's own strain energy is evaluated in three
dimensions, differentiated by complex steps, with the pressure from plane stress: a route that
shares nothing with :mod:`biaxbayes.laws.goh`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from biaxbayes.laws.goh import GOH
from biaxbayes.laws.materials import MaterialResponse

STEP = 1e-30


def biaxial_stress(
    energy: Callable[[np.ndarray], np.ndarray], stretch_x, stretch_y
) -> tuple[np.ndarray, np.ndarray]:
    """Cauchy stresses (n,) of an incompressible planar biaxial state of an energy of F (n, 3, 3).

    ArithmeticError if the state needs a shear stress: the card is not symmetric about the axes.
    """
    x, y = np.atleast_1d(stretch_x).astype(float), np.atleast_1d(stretch_y).astype(float)
    F = np.zeros((x.size, 3, 3))
    F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = x, y, 1.0 / (x * y)
    P = np.empty_like(F)
    for i in range(3):
        for j in range(3):
            perturbed = F.astype(complex)
            perturbed[:, i, j] += 1j * STEP
            # P_ij = dU/dF_ij
            P[:, i, j] = energy(perturbed).imag / STEP
    # s = P F^T / J, less the pressure that frees the faces: s_zz = 0
    s = P @ np.swapaxes(F, -1, -2)
    s = s - s[:, 2, 2, None, None] * np.eye(3)
    shear = np.abs(s - s * np.eye(3)).max(initial=0.0)
    if shear > 1e-9 * np.abs(s).max(initial=1e-300):
        raise ArithmeticError("the card needs a shear stress in a state without shear")
    return s[:, 0, 0], s[:, 1, 1]


def relative_deviation(
    energy: Callable[[np.ndarray], np.ndarray],
    per_kPa: float,
    material: MaterialResponse,
    stretch_x: np.ndarray,
    stretch_y: np.ndarray,
) -> float:
    """Largest deviation of a card's stress from the draw's, relative to the state's stress.

    ``material`` is the draw, without any change made for export; GOH is compared with the fibre
    switch, which both programs have. States with less than a millionth of the largest stress are
    left out.
    """
    card = np.array(biaxial_stress(energy, stretch_x, stretch_y)) / per_kPa
    if isinstance(material, GOH):
        material = replace(material, fibre_switch=True)
    fitted = np.array(material.cauchy(np.asarray(stretch_x), np.asarray(stretch_y)))
    size = np.abs(fitted).max(axis=0)
    counted = size > 1e-6 * size.max(initial=0.0)
    if not counted.any():
        return 0.0
    return float((np.abs(card - fitted).max(axis=0)[counted] / size[counted]).max())
