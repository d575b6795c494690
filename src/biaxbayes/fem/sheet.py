r"""A square sheet in finite elements, of the GOH membrane under any in-plane deformation.

Plane stress and incompressibility leave the in-plane deformation gradient F (2 x 2) as the only
unknown: lz = 1 / det F. With shear the two fibre families at +alpha and -alpha no longer share
one strain, so each keeps its own, and Eq. 5 of Math. Comput. Appl. 2024, 29(4), 55 reads

    W   = C1 (I1 - 3) + k1 / (2 k2) sum_i (exp(k2 E_i^2) - 1),     I1 = F : F + (det F)^-2
    E_i = H_i : F^T F + kappa (det F)^-2 - 1,     H_i = kappa 1 + (1 - 3 kappa) M_i (x) M_i

with the in-plane part H_i of the structure tensor, its xy terms of opposite sign in the two
families. Without shear this is :mod:`biaxbayes.laws.goh`.

Arrays of deformation gradients have the two tensor axes first: F[i, J] = dx_i / dX_J.

Mirroring x or y swaps the two fibre families and leaves the material as it is; grips are placed
symmetrically. So the quarter 0 <= X <= edge_x/2, 0 <= Y <= edge_y/2 with u_x = 0 on X = 0 and
u_y = 0 on Y = 0 carries every symmetric solution, at a quarter of the unknowns, and no rigid
motion is left. (A solution that buckles out of the symmetry is excluded.)

Elements are quadrilaterals with biquadratic displacement (serendipity to compare) and 3 x 3
Gauss points. In plane stress the thickness follows the sheet, so nothing locks and no pressure
unknown is needed.
Needs scikit-fem.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csc_matrix

from biaxbayes.errors import InputError
from biaxbayes.laws.goh import GOH

# --- the GOH membrane under any in-plane deformation, shear included -----------------------------


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
    """Fraction of a family that carries load: none in compression with the switch."""
    return 1.0 - material.fibre_switch * (E.real < 0.0)


# --- the sheet: one quarter of it, for load and material are symmetric ---------------------------


class Sheet:
    """Mesh, displacement space and assembly of a quarter of a rectangular sheet.

    Parameters
    ----------
    edge_x_mm, edge_y_mm : float
        Unloaded edges of the whole sheet.
    elements : int
        Elements along an edge of the whole sheet, an even number.
    serendipity : bool
        Elements of eight nodes instead of nine.
    distortion : float
        Moves inner mesh points at random by up to this fraction of an element: for patch tests.

    Raises
    ------
    InputError
        If scikit-fem is not installed.
    ValueError
        If ``elements`` is odd or below two.
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
            raise InputError(
                "finite elements need scikit-fem, which is not installed",
                remedy="pip install 'biaxbayes[fe]'",
            ) from None
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
        """Internal force, tangent stiffness and the smallest area ratio.

        Parameters
        ----------
        material : GOH
        free_values : ndarray, shape (n,)
            Free displacement unknowns, mm.

        Returns
        -------
        force : ndarray, shape (n,)
            Per unit of thickness, kPa mm.
        stiffness : csc_matrix, shape (n, n)
            Its derivative with respect to the free unknowns, kPa.
        area_ratio : float
            Smallest det F over the Gauss points; the step is unusable if not positive.
        """
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
        return (
            force[self.free],
            csc_matrix((values, indices, pointers), shape=(size, size)),
            area_ratio,
        )

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
        """Integral of weight(X, Y) times the displacement functions of one direction.

        Parameters
        ----------
        weight : callable
            Of arrays X, Y in mm.
        direction : {0, 1}

        Returns
        -------
        ndarray, shape (n,)
            Over the free unknowns.
        """
        # A fine rule, once: the footprint of a hook is about as wide as an element.
        fine = self._skfem.Basis(self.basis.mesh, self.basis.elem, intorder=20)
        form = self._skfem.LinearForm(lambda v, w: weight(*w.x) * v[direction])
        return np.asarray(form.assemble(fine))[self.free]
