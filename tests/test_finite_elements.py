"""Finite elements against the closed form, energy balance and their own refinement."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from biaxbayes.errors import InputError, NotConverged
from biaxbayes.experiments import Strip
from biaxbayes.fem import sheet as sheet_module
from biaxbayes.fem.sheet import Sheet, membrane_stress_and_tangent
from biaxbayes.fem.sheet_tester import Hooks, SheetTester
from biaxbayes.forward import ForwardModel
from biaxbayes.laws import law_named
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.mounting import with_free_side
from studies.hooks import uniform_edges

MEDIA = GOH(2.98, 12.47, 1.88, 39.0, 0.0)
WEISBECKER = GOH(14.0, 140.0, 11.9, 38.4, 0.21)
DONOR2 = GOH(25.87, 39.78, 139.88, 90.0, 0.241)
THICKNESS = 0.88
MOST_ITERATIONS = 20


def hooked(material, *, elements=10, control="markers", **hooks):
    sheet = Sheet(20.0, 20.0, elements=elements)
    grips = Hooks(**hooks).on(sheet)
    return SheetTester(material, sheet, grips, thickness_mm=THICKNESS, control=control)


def test_elements_have_nine_nodes_unless_eight_are_asked_for():
    """A quarter of a sheet of 4 x 4 elements has 2 x 2, and two displacements a node."""
    assert Sheet(20.0, 15.0, elements=4).basis.N == 2 * 5 * 5
    assert Sheet(20.0, 15.0, elements=4, serendipity=True).basis.N == 2 * (5 * 5 - 4)


@pytest.mark.parametrize("control", ["markers", "grips"])
@pytest.mark.parametrize(("material", "top"), [(MEDIA, 1.2), (WEISBECKER, 1.18), (DONOR2, 1.15)])
def test_uniform_edges_agree_with_the_closed_form(material, top, control):
    # Distorted elements and unequal edges: nothing is homogeneous by construction.
    sheet = Sheet(20.0, 15.0, elements=6, distortion=0.4)
    tester = SheetTester(
        material, sheet, uniform_edges(sheet), thickness_mm=THICKNESS, control=control
    )
    mounted = tester.mount((1.02, 1.01))
    test = tester.stretch_to(mounted, (top, 1.0 + 0.7 * (top - 1.0)), increments=8)
    np.testing.assert_allclose(test.total[0], [1.02, 1.01], rtol=1e-9)
    np.testing.assert_allclose(test.total[:, 0], test.grip[:, 0], rtol=1e-9)
    Px, Py = material.piola(*test.total.T)
    np.testing.assert_allclose(test.force_N[:, 0], Px * 15.0 * THICKNESS * 1e-3, rtol=1e-6)
    np.testing.assert_allclose(test.force_N[:, 1], Py * 20.0 * THICKNESS * 1e-3, rtol=1e-6)
    F = sheet.deformation_gradient(test.states[-1].u)
    np.testing.assert_allclose(F[0, 0], test.total[-1, 0], rtol=1e-8)
    np.testing.assert_allclose(F[0, 1], 0.0, atol=1e-8)


def test_work_at_the_hooks_is_the_energy_in_the_sheet():
    tester = hooked(MEDIA, control="grips")
    test = tester.stretch_to(tester.unloaded, (1.2, 1.15), increments=40)
    travel = np.array([s.travel for s in test.states])
    force = test.force_N
    # Two opposite edges: N mm = mJ; Simpson's rule over the equal increments.
    weights = np.ones(41)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    work = 2.0 * (weights @ (force * (travel[1] - travel[0]))).sum() / 3.0
    F = tester.sheet.deformation_gradient(test.states[-1].u)
    energy = [energy_3d(MEDIA, F_of_point) for F_of_point in F.reshape(2, 2, -1).transpose(2, 0, 1)]
    quarter = np.dot(energy, tester.sheet.basis.dx.ravel())
    assert work == pytest.approx(4.0 * quarter * THICKNESS * 1e-3, rel=1e-5)


def test_directions_are_treated_equally():
    along = hooked(GOH(5.0, 20.0, 5.0, 20.0, 0.1), elements=6)
    across = hooked(GOH(5.0, 20.0, 5.0, 70.0, 0.1), elements=6)
    a = along.stretch_to(along.mount((1.02, 1.01)), (1.1, 1.06), increments=3)
    b = across.stretch_to(across.mount((1.01, 1.02)), (1.06, 1.1), increments=3)
    np.testing.assert_allclose(a.force_N[:, 0], b.force_N[:, 1], rtol=1e-8)
    np.testing.assert_allclose(a.grip[:, 1], b.grip[:, 0], rtol=1e-8)


def test_markers_reach_the_stretch_and_hooks_carry_less_than_uniform_edges():
    tester = hooked(MEDIA)
    test = tester.stretch_to(tester.mount((1.009, 1.010)), (1.2, 1.2), increments=10)
    np.testing.assert_allclose(test.measured[:, 0], np.linspace(1.0, 1.2, 11), rtol=1e-9)
    np.testing.assert_allclose(test.total[0], [1.009, 1.010], rtol=1e-9)
    nominal = MEDIA.piola(*test.total.T)[0] * 20.0 * THICKNESS * 1e-3
    share = test.force_N[:, 0] / nominal
    # The corners and the strips outside the hooks are idle, so the force falls short.
    assert np.all((share > 0.8) & (share < 0.97))


def test_a_step_too_large_is_halved_and_an_impossible_one_reported():
    tester = hooked(DONOR2, elements=6)
    in_one = tester.stretch_to(tester.unloaded, (1.15, 1.15), increments=1)
    in_many = tester.stretch_to(tester.unloaded, (1.15, 1.15), increments=15)
    assert in_one.force_N[-1, 0] == pytest.approx(in_many.force_N[-1, 0], rel=1e-7)
    with pytest.raises(NotConverged, match="no equilibrium"):
        tester.stretch_to(tester.unloaded, (0.3, 0.3), increments=1)


def test_without_scikit_fem_the_remedy_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(InputError, match=r"pip install 'biaxbayes\[fe\]'"):
        sheet_module.Sheet(20.0, 20.0)


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
    F = np.zeros((3, 3), dtype=F2.dtype)
    F[:2, :2] = F2
    F[2, 2] = 1.0 / np.linalg.det(F2)
    C = F.T @ F
    alpha = np.deg2rad(material.alpha_deg)
    W = material.C1_kPa * (np.trace(C) - 3.0)
    for sign in (1.0, -1.0):
        M = np.array([np.cos(alpha), sign * np.sin(alpha), 0.0])
        E = material.kappa * np.trace(C) + (1.0 - 3.0 * material.kappa) * M @ C @ M - 1.0
        if material.fibre_switch and E.real < 0.0:
            continue
        k2 = material.k2
        W += 0.5 * material.k1_kPa * (np.expm1(k2 * E**2) / k2 if k2 else E**2)
    return W


@pytest.mark.parametrize("material", MATERIALS)
def test_stress_and_tangent_are_derivatives(material, F):
    P, A = membrane_stress_and_tangent(material, F)
    h = 1e-30
    for k in range(2):
        for L in range(2):
            Z = F.astype(complex)
            Z[k, L] += 1j * h
            dW = [energy_3d(material, Z[:, :, n]).imag / h for n in range(F.shape[2])]
            dP = membrane_stress_and_tangent(material, Z)[0].imag / h
            np.testing.assert_allclose(P[k, L], dW, atol=1e-13 * np.abs(P).max())
            np.testing.assert_allclose(A[:, :, k, L], dP, atol=1e-13 * np.abs(A).max())
    np.testing.assert_allclose(A, A.transpose(2, 3, 0, 1, 4), atol=1e-13 * np.abs(A).max())


@pytest.mark.parametrize("material", MATERIALS)
def test_without_shear_it_is_the_closed_form(material):
    lx, ly = np.array([0.9, 1.1, 1.2]), np.array([1.0, 0.95, 1.25])
    F = np.zeros((2, 2, 3))
    F[0, 0], F[1, 1] = lx, ly
    P, _ = membrane_stress_and_tangent(material, F)
    np.testing.assert_allclose([P[0, 0], P[1, 1]], material.piola(lx, ly), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose([P[0, 1], P[1, 0]], 0.0, atol=1e-12)


def test_a_rotation_turns_the_stress(F):
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s], [s, c]])
    for material in MATERIALS:
        P, _ = membrane_stress_and_tangent(material, F)
        turned, _ = membrane_stress_and_tangent(material, np.einsum("ij,jKn->iKn", turn, F))
        np.testing.assert_allclose(turned, np.einsum("ij,jKn->iKn", turn, P), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("material", "top"), [(MEDIA, 1.2), (WEISBECKER, 1.12)])
def test_the_middle_of_a_long_clamped_strip_is_the_strip_of_the_likelihood(material, top):
    """Ten times as long as wide, clamped: force over stretch and width of its middle."""
    length, width = 30.0, 3.0
    sheet = Sheet(length, width, elements=16)
    at_clamp = np.isclose(sheet.position[0, sheet.free], 0.5 * length)
    pulled = at_clamp & (sheet.component[sheet.free] == 0)
    u, inside = np.zeros(sheet.free.size), np.flatnonzero(~at_clamp)
    measured = []
    for step in np.linspace(0.0, 0.5 * length * (top - 1.0), 11)[1:]:
        u[pulled] = step
        for _ in range(MOST_ITERATIONS):
            force, stiffness, _ = sheet.internal_force(material, u)
            change = spsolve(stiffness[inside][:, inside], -force[inside])
            u[inside] += change
            if np.abs(change).max() < 1e-9 * length:
                break
        else:
            pytest.fail("Newton's method does not converge")
        force, _, _ = sheet.internal_force(material, u)
        # the quarter holds half of the clamp
        pull = 2.0 * force[pulled].sum() * THICKNESS * 1e-3
        F = sheet.deformation_gradient(u)
        middle = np.argmin(np.hypot(*sheet.basis.mesh.p[:, sheet.basis.mesh.t].mean(axis=1)))
        measured.append((pull, F[0, 0, middle].mean(), F[1, 1, middle].mean()))
    pull, along, across = np.array(measured).T
    values = dict(zip(("C1", "k1", "k2", "alpha", "kappa"), material.values, strict=True))
    area = np.array([width * THICKNESS * 1e-3, 1.0])
    strip = ForwardModel(law_named("goh"), area, False, Strip(0))
    stretch = np.column_stack([along, np.full(along.size, np.nan)])
    loads = strip.load(values | {"mounting_stretch_x": 1.0}, stretch)[0]
    np.testing.assert_allclose(loads[:, 0], pull, rtol=2e-3)
    free = with_free_side(material.cauchy, stretch, 1)[:, 1]
    np.testing.assert_allclose(free, across, rtol=2e-3)
