"""Materials: a law with values of its parameters, and its stresses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.response import STEP, cauchy_stress, energy, plain, squared_stretches
from biaxbayes.parameters import DEGREE


class MaterialResponse:
    """Stress and energy of what has a ``law`` and natural values ``theta`` of its parameters."""

    law: Any
    theta: Any

    @property
    def constants(self) -> Any:
        """Constants of the law, a ``NamedTuple``."""
        return self.law.constants(*self.theta)

    @property
    def values(self) -> tuple[Any, ...]:
        """Values in the parameters' own units and order."""
        return tuple(
            np.rad2deg(v) if p.unit == DEGREE else v
            for p, v in zip(self.law.parameters, self.theta, strict=True)
        )

    def strain_energy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Strain energy per reference volume in kPa at total stretches."""
        return energy(self.constants, *squared_stretches(stretch_x, stretch_y))

    def cauchy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches."""
        return cauchy_stress(self.constants, *squared_stretches(stretch_x, stretch_y))

    def piola(self, stretch_x: Any, stretch_y: Any) -> Any:
        """First Piola-Kirchhoff stresses (P_x, P_y) in kPa at total stretches."""
        sx, sy = self.cauchy(stretch_x, stretch_y)
        # P_k = s_k / l_k
        return sx / np.asarray(stretch_x), sy / np.asarray(stretch_y)

    def cauchy_by_log_stretch(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Derivatives (2, 2, ...) of (s_x, s_y) by (ln l_x, ln l_y), kPa, by complex step."""
        lx, ly = plain(stretch_x), plain(stretch_y)
        # d l / d ln l = l
        by_x = MaterialResponse.cauchy(self, lx * (1.0 + 1j * STEP), ly)
        by_y = MaterialResponse.cauchy(self, lx, ly * (1.0 + 1j * STEP))
        xx, yx, xy, yy = np.broadcast_arrays(*by_x, *by_y)
        return np.imag(np.array([[xx, xy], [yx, yy]])) / STEP

    def cauchy_by_parameter(self, stretch_x: Any, stretch_y: Any) -> np.ndarray:
        """Derivatives (2, p, ...) of (s_x, s_y) by the parameters, kPa per unit or radian."""
        columns = []
        for i in range(len(self.theta)):
            moved = [complex(v) for v in self.theta]
            moved[i] += 1j * STEP
            stepped = Material(self.law, tuple(moved)).cauchy(stretch_x, stretch_y)
            columns.append(np.imag(np.array(stepped)) / STEP)
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class Material(MaterialResponse):
    """A law with values of its parameters, numbers or arrays: one material, or one per draw."""

    law: Any
    # natural values in their order, angles in radians; broadcast against the stretches
    theta: tuple[Any, ...]


class CheckedMaterial(Material):
    """A material that a user has given: a stress that cannot be computed is an error."""

    def cauchy(self, stretch_x: Any, stretch_y: Any) -> Any:
        """Cauchy stresses (s_x, s_y) in kPa at total stretches; InputError if not finite."""
        with np.errstate(all="ignore"):
            stress = super().cauchy(stretch_x, stretch_y)
        bad = ~np.isfinite(np.sum(np.broadcast_arrays(*stress), axis=0))
        if bad.any():
            i = int(np.argmax(bad))
            at = [np.ravel(np.broadcast_to(v, bad.shape))[i] for v in (stretch_x, stretch_y)]
            raise InputError(
                f"the law {self.law.name} has no finite stress at stretches {at[0]:g}, {at[1]:g}",
                remedy="stretches are positive numbers, 1 where unloaded",
            )
        return stress
