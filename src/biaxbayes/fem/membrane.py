r"""The GOH membrane under any in-plane deformation, shear included.

Plane stress and incompressibility leave the in-plane deformation gradient F (2 x 2) as the only
unknown: lz = 1 / det F. With shear the two fibre families at +alpha and -alpha no longer share
one strain, so each keeps its own, and Eq. 5 of Math. Comput. Appl. 2024, 29(4), 55 reads

    W   = C1 (I1 - 3) + k1 / (2 k2) sum_i (exp(k2 E_i^2) - 1),     I1 = F : F + (det F)^-2
    E_i = H_i : F^T F + kappa (det F)^-2 - 1,     H_i = kappa 1 + (1 - 3 kappa) M_i (x) M_i

with the in-plane part H_i of the structure tensor, its xy terms of opposite sign in the two
families. Without shear this is :mod:`biaxbayes.laws.goh`.

Arrays of deformation gradients have the two tensor axes first: F[i, J] = dx_i / dX_J.
"""

from __future__ import annotations

import numpy as np

from biaxbayes.laws.goh import GOH

__all__ = ["membrane_energy", "membrane_stress", "membrane_stress_and_tangent"]


def membrane_energy(material: GOH, F: np.ndarray) -> np.ndarray:
    """Strain energy per reference volume.

    Parameters
    ----------
    material : GOH
    F : ndarray, shape (2, 2, ...)
        In-plane deformation gradients, real or complex.

    Returns
    -------
    ndarray, shape (...)
        kPa.
    """
    az, _ = _thickness(F)
    # W = C1 (F : F + lz^2 - 3) + k1/(2 k2) sum (exp(k2 E^2) - 1)
    energy = material.C1_kPa * ((F * F).sum(axis=(0, 1)) + az - 3.0)
    k1, k2 = material.k1_kPa, material.k2
    for H in _structure_tensors(material):
        E = _fibre_strain(material, H, F, az)
        fibre = np.expm1(k2 * E * E) / k2 if k2 > 0.0 else E * E
        energy = energy + 0.5 * k1 * fibre * _active(material, E)
    return energy


def membrane_stress(material: GOH, F: np.ndarray) -> np.ndarray:
    """First Piola-Kirchhoff stress P = dW/dF, kPa; shapes as in :func:`membrane_energy`."""
    az, K = _thickness(F)
    # d lz^2/dF = -2 lz^2 F^-T
    P = 2.0 * material.C1_kPa * (F - az * K)
    for H in _structure_tensors(material):
        E = _fibre_strain(material, H, F, az)
        P = P + _fibre_energy_slope(material, E) * _fibre_strain_by_F(material, H, F, az, K)
    return P


def membrane_stress_and_tangent(material: GOH, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stress and consistent tangent of the membrane.

    Parameters
    ----------
    material : GOH
    F : ndarray, shape (2, 2, ...)

    Returns
    -------
    P : ndarray, shape (2, 2, ...)
        First Piola-Kirchhoff stress dW/dF, kPa.
    A : ndarray, shape (2, 2, 2, 2, ...)
        A[i, J, k, L] = d P[i, J] / d F[k, L], kPa; symmetric in the pairs.
    """
    az, K = _thickness(F)
    one = np.eye(2).reshape((2, 2) + (1,) * (F.ndim - 2))
    # d(lz^2 F^-T)_iJ/dF_kL = -lz^2 (2 K_iJ K_kL + K_iL K_kJ),  K = F^-T
    bend = -az * (
        2.0 * np.einsum("iJ...,kL...->iJkL...", K, K) + np.einsum("iL...,kJ...->iJkL...", K, K)
    )
    P = 2.0 * material.C1_kPa * (F - az * K)
    # A = 2 C1 (1 (x) 1 - d(lz^2 F^-T)/dF)
    identity = np.einsum("ik...,JL...->iJkL...", one, one)
    A = 2.0 * material.C1_kPa * (identity - bend)
    k1, k2 = material.k1_kPa, material.k2
    for H in _structure_tensors(material):
        E = _fibre_strain(material, H, F, az)
        force = _fibre_energy_slope(material, E)
        # d2W/dE2 = k1 (1 + 2 k2 E^2) exp(k2 E^2) of one family
        stiffness = k1 * (1.0 + 2.0 * k2 * E * E) * np.exp(k2 * E * E) * _active(material, E)
        G = _fibre_strain_by_F(material, H, F, az, K)
        P = P + force * G
        # d2E/dF2 = 2 (1 (x) H - kappa d(lz^2 F^-T)/dF)
        curvature = 2.0 * (
            np.einsum("ik...,JL->iJkL...", one, H, optimize=False) - material.kappa * bend
        )
        # A += W'' G (x) G + W' d2E/dF2
        A = A + stiffness * np.einsum("iJ...,kL...->iJkL...", G, G) + force * curvature
    return P, A


def _structure_tensors(material: GOH) -> tuple[np.ndarray, np.ndarray]:
    """In-plane structure tensors of the families at +alpha and -alpha, shape (2, 2)."""
    alpha, kappa = material.theta[3], material.kappa
    c, s = np.cos(alpha), np.sin(alpha)
    # H = kappa 1 + (1 - 3 kappa) M (x) M
    spread, aligned = kappa * np.eye(2), 1.0 - 3.0 * kappa
    plus, minus = np.array([c, s]), np.array([c, -s])
    return spread + aligned * np.outer(plus, plus), spread + aligned * np.outer(minus, minus)


def _thickness(F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared thickness stretch lz^2 and K = F^-T."""
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    K = np.array([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]]) / J
    return 1.0 / (J * J), K


def _fibre_strain(material: GOH, H: np.ndarray, F: np.ndarray, az: np.ndarray) -> np.ndarray:
    # E = H : F^T F + kappa lz^2 - 1
    return np.einsum("iJ...,JL,iL...->...", F, H, F) + material.kappa * az - 1.0


def _fibre_strain_by_F(material, H, F, az, K) -> np.ndarray:
    # dE/dF = 2 F H - 2 kappa lz^2 F^-T
    return 2.0 * np.einsum("iL...,LJ->iJ...", F, H) - 2.0 * material.kappa * az * K


def _fibre_energy_slope(material: GOH, E: np.ndarray) -> np.ndarray:
    """dW/dE of one family."""
    # dW/dE = k1 E exp(k2 E^2)
    return material.k1_kPa * E * np.exp(material.k2 * E * E) * _active(material, E)


def _active(material: GOH, E: np.ndarray) -> np.ndarray:
    """Share of a family that carries load: none in compression with the switch."""
    return 1.0 - material.fibre_switch * (E.real < 0.0)
