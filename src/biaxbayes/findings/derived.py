"""What a material does, draw by draw: structure tensor, stiffness and stress at stated stretches.

These are what a biaxial test sees. Draws that disagree in every parameter may agree in all of
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.findings.material_draws import mounting_labels, parameters, protocol_mounting
from biaxbayes.mechanics.goh import (
    cauchy_stress,
    cauchy_stress_by_log_stretch,
    structure_tensor,
)
from biaxbayes.specimens.specimen import Specimen

__all__ = ["Derived", "derived_quantities", "largest_equibiaxial", "median_mounting"]

STRESS, STIFFNESS, TENSOR = "stress", "stiffness", "structure tensor"


@dataclass(frozen=True)
class Derived:
    """A quantity that follows from the material parameters.

    Attributes
    ----------
    kind : {"stress", "stiffness", "structure tensor"}
    name : str
        ``Hx``, ``cauchy_x``, ``stiffness_x`` and the like.
    unit : str
        Empty for pure numbers.
    stretch : float or None
        Total equibiaxial stretch it is taken at.
    values : ndarray, shape (n,)
    """

    kind: str
    name: str
    unit: str
    stretch: float | None
    values: np.ndarray

    @property
    def key(self) -> str:
        """Name with the stretch, unique among the quantities of a run."""
        return self.name if self.stretch is None else f"{self.name} at {self.stretch:g}"


def derived_quantities(
    draws: pd.DataFrame,
    stress_at: Sequence[float],
    stiffness_at: Sequence[float] = (),
    *,
    tensor: bool = True,
    fibre_switch: bool = False,
) -> list[Derived]:
    """Quantities of every draw.

    Parameters
    ----------
    draws : DataFrame
        Columns C1, k1 (kPa), k2, alpha (degrees), kappa.
    stress_at, stiffness_at : sequence of float
        Total equibiaxial stretches. The stress is the Cauchy stress; the stiffness is
        d s_x / d ln l_x at constant l_y (y alike), kPa. At a stretch of one that is the
        small-strain stiffness.
    tensor : bool
        Whether to give the structure tensor.
    fibre_switch : bool

    Returns
    -------
    list of Derived
    """
    C1, k1, k2, alpha, kappa = (v[:, 0] for v in parameters(draws))
    out = []
    if tensor:
        H = structure_tensor(alpha, kappa)
        out += [
            Derived(TENSOR, f"H{k}", "", None, np.asarray(v)) for k, v in zip("xyz", H, strict=True)
        ]
    theta = (C1, k1, k2, alpha, kappa)
    with np.errstate(over="ignore", invalid="ignore"):
        for stretch in stiffness_at:
            jacobian = cauchy_stress_by_log_stretch(
                *theta, stretch, stretch, fibre_switch=fibre_switch
            )
            for i, axis in enumerate("xy"):
                out.append(Derived(STIFFNESS, f"stiffness_{axis}", "kPa", stretch, jacobian[i, i]))
        for stretch in stress_at:
            stress = cauchy_stress(*theta, stretch, stretch, fibre_switch=fibre_switch)
            for axis, values in zip("xy", stress, strict=True):
                out.append(Derived(STRESS, f"cauchy_{axis}", "kPa", stretch, np.asarray(values)))
    return out


def median_mounting(draws: pd.DataFrame, specimen: Specimen) -> np.ndarray:
    """Median mounting stretch of every protocol, shape (protocols, 2); one where not inferred."""
    if not mounting_labels(draws):
        return np.ones((len(specimen.protocols), 2))
    return np.array([np.median(protocol_mounting(draws, p), axis=0) for p in specimen.protocols])


def largest_equibiaxial(draws: pd.DataFrame, specimen: Specimen) -> float:
    """Largest total stretch that the test reached in both directions, at the median mounting."""
    lm = median_mounting(draws, specimen)
    top = [
        np.array([p.stretch_x.max(), p.stretch_y.max()]) * m
        for p, m in zip(specimen.protocols, lm, strict=True)
    ]
    return float(np.max(top, axis=0).min())
