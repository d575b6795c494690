r"""A square sheet in finite elements, of the GOH membrane under any in-plane deformation.

Plane stress and incompressibility leave the in-plane deformation gradient F as the only unknown,
lz = 1 / det F; F[i, J] = dx_i / dX_J has the tensor axes first. With shear the fibre families at
+alpha and -alpha each have their own strain, and Eq. 5 of Math. Comput. Appl. 2024, 29(4), 55 reads

    W   = C1 (I1 - 3) + k1 / (2 k2) sum_i (exp(k2 E_i^2) - 1),     I1 = F : F + (det F)^-2
    E_i = H_i : F^T F + kappa (det F)^-2 - 1,     H_i = kappa 1 + (1 - 3 kappa) M_i (x) M_i

with the in-plane part H_i of the structure tensor, whose xy terms have opposite signs in the two.
Without shear this is :mod:`biaxbayes.laws.goh`.

Mirroring x or y swaps the two families, and grips are symmetric: the quarter 0 <= X <= edge_x/2,
0 <= Y <= edge_y/2 with u_x = 0 on X = 0 and u_y = 0 on Y = 0 carries every symmetric solution (one
that buckles out of the symmetry is excluded).
Quadrilaterals are biquadratic with 3 x 3 Gauss points; the thickness follows, so nothing locks.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csc_matrix

from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH

# --- the GOH membrane under any in-plane deformation, shear included -----------------------------


def membrane_stress_and_tangent(material: GOH, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """P = dW/dF (2, 2, ...) and A[i, J, k, L] = d P[i, J] / d F[k, L], kPa, at gradients F."""
    C1, k1, k2, kappa = material.C1_kPa, material.k1_kPa, material.k2, material.kappa
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    az = 1.0 / (J * J)  # lz^2
    K = np.array([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]]) / J  # F^-T
    one = np.eye(2).reshape((2, 2) + (1,) * (F.ndim - 2))
    # d(lz^2 F^-T)_iJ/dF_kL = -lz^2 (2 K_iJ K_kL + K_iL K_kJ)
    bend = -az * (
        2.0 * np.einsum("iJ...,kL...->iJkL...", K, K) + np.einsum("iL...,kJ...->iJkL...", K, K)
    )
    # P = 2 C1 (F - lz^2 F^-T),  A = 2 C1 (1 (x) 1 - d(lz^2 F^-T)/dF)
    P = 2.0 * C1 * (F - az * K)
    A = 2.0 * C1 * (np.einsum("ik...,JL...->iJkL...", one, one) - bend)
    cos, sin = np.cos(material.theta[3]), np.sin(material.theta[3])
    for direction in ([cos, sin], [cos, -sin]):
        # H = kappa 1 + (1 - 3 kappa) M (x) M
        H = kappa * np.eye(2) + (1.0 - 3.0 * kappa) * np.outer(direction, direction)
        # E = H : F^T F + kappa lz^2 - 1
        E = np.einsum("iJ...,JL,iL...->...", F, H, F) + kappa * az - 1.0
        # dE/dF = 2 F H - 2 kappa lz^2 F^-T
        G = 2.0 * np.einsum("iL...,LJ->iJ...", F, H) - 2.0 * kappa * az * K
        # d2E/dF2 = 2 (1 (x) H - kappa d(lz^2 F^-T)/dF)
        curvature = 2.0 * (np.einsum("ik...,JL->iJkL...", one, H, optimize=False) - kappa * bend)
        # a family carries no load in compression with the switch
        exponential = np.exp(k2 * E * E) * (1.0 - material.fibre_switch * (E.real < 0.0))
        # dW/dE = k1 E exp(k2 E^2),  d2W/dE2 = k1 (1 + 2 k2 E^2) exp(k2 E^2)
        force = k1 * E * exponential
        stiffness = k1 * (1.0 + 2.0 * k2 * E * E) * exponential
        # A += W'' G (x) G + W' d2E/dF2
        P = P + force * G
        A = A + stiffness * np.einsum("iJ...,kL...->iJkL...", G, G) + force * curvature
    return P, A


# --- the sheet: one quarter of it, for load and material are symmetric ---------------------------


class Sheet:
    """Mesh, displacement space and assembly of a quarter of a rectangular sheet.

    Edges and the even number of elements along one are those of the whole unloaded sheet;
    ``serendipity`` elements have eight nodes, not nine; ``distortion`` moves inner mesh points at
    random by up to this fraction of an element, for patch tests. InputError without scikit-fem.
    """

    def __init__(
        self,
        edge_x_mm: float,
        edge_y_mm: float,
        *,
        elements: int = 20,
        serendipity: bool = False,
        distortion: float = 0.0,
    ) -> None:
        if elements < 2 or elements % 2:
            raise ValueError("elements must be an even number, so that a quarter can be meshed")
        self.edge = np.array([edge_x_mm, edge_y_mm], dtype=float)
        self.elements = elements
        try:
            import skfem
        except ImportError:
            problem = "finite elements need scikit-fem, which is not installed"
            raise InputError(problem, remedy="pip install 'biaxbayes[fe]'") from None
        lines = [np.linspace(0.0, length / 2.0, elements // 2 + 1) for length in self.edge]
        mesh = skfem.MeshQuad.init_tensor(*lines)
        if distortion:
            points, reach = mesh.p.copy(), distortion * self.edge / elements
            inner = np.setdiff1d(np.arange(points.shape[1]), mesh.boundary_nodes())
            move = np.random.default_rng(0).uniform(-1.0, 1.0, (2, inner.size))
            points[:, inner] += reach[:, None] * move
            mesh = skfem.MeshQuad(points, mesh.t)
        self._skfem = skfem
        element = skfem.ElementQuadS2() if serendipity else skfem.ElementQuad2()
        self.basis = skfem.Basis(mesh, skfem.ElementVector(element), intorder=5)
        self.position = self.basis.doflocs
        self.component = np.empty(self.basis.N, dtype=int)
        for local in range(self.basis.Nbfun):
            self.component[self.basis.element_dofs[local]] = local % 2
        # u_x = 0 on X = 0, u_y = 0 on Y = 0
        here = self.position[self.component, np.arange(self.basis.N)]
        self.free = np.flatnonzero(here > 1e-9 * self.edge.min())

    @cached_property
    def _gradient(self) -> np.ndarray:
        """Displacement gradient of the local functions, (elements, points, 4, functions)."""
        grads = [self.basis.basis[i][0].grad for i in range(self.basis.Nbfun)]
        stacked = np.stack(grads)  # functions, i, J, elements, points
        count, _, _, cells, points = stacked.shape
        return np.ascontiguousarray(stacked.reshape(count, 4, cells, points).transpose(2, 3, 1, 0))

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where entries of element matrices go: (used entries, target, row indices, pointers)."""
        number = np.full(self.basis.N, -1)
        number[self.free] = np.arange(self.free.size)
        local = number[self.basis.element_dofs.T]  # elements, functions
        rows = np.broadcast_to(local[:, :, None], (*local.shape, local.shape[1])).ravel()
        columns = np.broadcast_to(local[:, None, :], (*local.shape, local.shape[1])).ravel()
        used = np.flatnonzero((rows >= 0) & (columns >= 0))
        unique, target = np.unique(columns[used] * self.free.size + rows[used], return_inverse=True)
        pointers = np.searchsorted(unique, np.arange(self.free.size + 1) * self.free.size)
        return used, target, unique % self.free.size, pointers

    def displacement(self, free_values: np.ndarray) -> np.ndarray:
        """All displacement unknowns (symmetry included) from the free ones, mm."""
        u = np.zeros(self.basis.N)
        u[self.free] = free_values
        return u

    def deformation_gradient(self, free_values: np.ndarray) -> np.ndarray:
        """F at the Gauss points, shape (2, 2, elements, points)."""
        # F = 1 + sum_a u_a grad N_a
        field = self.basis.interpolate(self.displacement(free_values))
        return np.eye(2)[:, :, None, None] + field.grad

    def internal_force(
        self, material: GOH, free_values: np.ndarray
    ) -> tuple[np.ndarray, csc_matrix, float]:
        """Force per thickness (n,), kPa mm, tangent stiffness (n, n) and the smallest det F."""
        F = self.deformation_gradient(free_values)
        area_ratio = float((F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]).min())
        with np.errstate(all="ignore"):  # a wild trial step may overflow; the caller looks
            P, A = membrane_stress_and_tangent(material, F)
            B, dx = self._gradient, self.basis.dx
            cells, points = dx.shape
            # f_a = int P : grad N_a,   K_ab = int grad N_a : A : grad N_b
            stress = (P.reshape(4, cells, points) * dx).transpose(1, 2, 0)
            tangent = (A.reshape(4, 4, cells, points) * dx).transpose(2, 3, 0, 1)
            rows = B.reshape(cells, points * 4, -1)
            local_force = np.matmul(stress.reshape(cells, 1, points * 4), rows)[:, 0]
            product = np.matmul(tangent, B).reshape(cells, points * 4, -1)
            local_stiffness = np.matmul(rows.transpose(0, 2, 1), product)
        force = np.bincount(
            self.basis.element_dofs.T.ravel(), local_force.ravel(), minlength=self.basis.N
        )
        used, target, indices, pointers = self._pattern
        values = np.bincount(target, local_stiffness.ravel()[used], minlength=indices.size)
        size = self.free.size
        stiffness = csc_matrix((values, indices, pointers), shape=(size, size))
        return force[self.free], stiffness, area_ratio

    def displacement_at(self, x_mm: float, y_mm: float) -> np.ndarray:
        """Rows that give (u_x, u_y) at a material point from the free unknowns, shape (2, n)."""
        # Basis.probes does not take vector elements before scikit-fem 12
        mapping = self.basis.mapping
        point = np.array([[x_mm], [y_mm]])
        cell = self.basis.mesh.element_finder(mapping=mapping)(*point)
        local = mapping.invF(point[:, :, None], tind=cell)
        out = np.zeros((2, self.basis.N))
        for i, dof in enumerate(self.basis.element_dofs[:, cell[0]]):
            shape = self.basis.elem.gbasis(mapping, local, i, tind=cell)[0]
            out[:, dof] = np.asarray(shape)[:, 0, 0]
        return out[:, self.free]

    def load_vector(self, weight, direction: int) -> np.ndarray:
        """Integral of weight(X, Y), in mm, times the free displacement functions of a direction."""
        # A fine rule, once: the footprint of a hook is about as wide as an element.
        fine = self._skfem.Basis(self.basis.mesh, self.basis.elem, intorder=20)
        form = self._skfem.LinearForm(lambda v, w: weight(*w.x) * v[direction])
        return np.asarray(form.assemble(fine))[self.free]
