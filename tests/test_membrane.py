"""The sheared membrane against Eq. 5 in three dimensions and against complex-step derivatives."""

import numpy as np
import pytest

from biaxbayes.fem.sheet import membrane_energy, membrane_stress, membrane_stress_and_tangent
from biaxbayes.laws.goh import GOH

MATERIALS = [
    GOH(2.98, 12.47, 1.88, 39.0, 0.0),
    GOH(14.0, 140.0, 11.9, 38.4, 0.21),
    GOH(5.0, 10.0, 0.0, 90.0, 1.0 / 3.0),
    GOH(5.0, 10.0, 3.0, 0.0, 0.1),
    GOH(5.0, 10.0, 3.0, 30.0, 0.1, fibre_switch=True),
]


@pytest.fixture
def F():
    rng = np.random.default_rng(3)
    return np.eye(2)[:, :, None] + 0.15 * rng.standard_normal((2, 2, 40))


def energy_3d(material, F2):
    """Eq. 5 with three-dimensional tensors, one deformation gradient."""
    F = np.zeros((3, 3))
    F[:2, :2] = F2
    F[2, 2] = 1.0 / np.linalg.det(F2)
    C = F.T @ F
    alpha = np.deg2rad(material.alpha_deg)
    W = material.C1_kPa * (np.trace(C) - 3.0)
    for sign in (1.0, -1.0):
        M = np.array([np.cos(alpha), sign * np.sin(alpha), 0.0])
        E = material.kappa * np.trace(C) + (1.0 - 3.0 * material.kappa) * M @ C @ M - 1.0
        if material.fibre_switch and E < 0.0:
            continue
        k2 = max(material.k2, 1e-9)
        W += material.k1_kPa / (2.0 * k2) * np.expm1(k2 * E**2)
    return W


@pytest.mark.parametrize("material", MATERIALS)
def test_energy_is_eq5(material, F):
    expected = [energy_3d(material, F[:, :, n]) for n in range(F.shape[2])]
    np.testing.assert_allclose(membrane_energy(material, F), expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("material", MATERIALS)
def test_stress_and_tangent_are_derivatives(material, F):
    P, A = membrane_stress_and_tangent(material, F)
    h = 1e-30
    for k in range(2):
        for L in range(2):
            Z = F.astype(complex)
            Z[k, L] += 1j * h
            dW = membrane_energy(material, Z).imag / h
            dP = membrane_stress(material, Z).imag / h
            np.testing.assert_allclose(P[k, L], dW, atol=1e-13 * np.abs(P).max())
            np.testing.assert_allclose(A[:, :, k, L], dP, atol=1e-13 * np.abs(A).max())
    np.testing.assert_allclose(A, A.transpose(2, 3, 0, 1, 4), atol=1e-13 * np.abs(A).max())


@pytest.mark.parametrize("material", MATERIALS)
def test_without_shear_it_is_the_closed_form(material):
    lx, ly = np.array([0.9, 1.1, 1.2]), np.array([1.0, 0.95, 1.25])
    F = np.zeros((2, 2, 3))
    F[0, 0], F[1, 1] = lx, ly
    P = membrane_stress(material, F)
    np.testing.assert_allclose([P[0, 0], P[1, 1]], material.piola(lx, ly), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose([P[0, 1], P[1, 0]], 0.0, atol=1e-12)


def test_rotation_costs_no_energy(F):
    c, s = np.cos(0.4), np.sin(0.4)
    rotated = np.einsum("ij,jKn->iKn", np.array([[c, -s], [s, c]]), F)
    for material in MATERIALS:
        np.testing.assert_allclose(
            membrane_energy(material, rotated), membrane_energy(material, F), rtol=1e-10
        )
