"""Bulge tests: the pole of a balloon, of a clamped membrane and of finite elements."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize
from scipy.spatial import Delaunay

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.experiments.tube import MMHG_PER_KPA
from biaxbayes.forward import ForwardModel
from biaxbayes.laws.goh import GOH
from biaxbayes.specimens.specimen_file import parse_specimen, read_specimen, write_specimen
from quick_posteriors import sampled, specimen

SOFT = {"C1": 5.0, "k1": 20.0, "k2": 4.0, "alpha": 45.0, "kappa": 1.0 / 3.0}
"""Isotropic: W = C1 (I1 - 3) + k1 / k2 (exp(k2 ((I1 - 3) / 3)^2) - 1)."""


def energy_slopes(m: float, c: float) -> tuple[float, float]:
    """dW/dlm and dW/dlc of :data:`SOFT` by hand, m along a meridian, c around the axis."""
    E = (m**2 + c**2 + (m * c) ** -2 - 3.0) / 3.0
    by_I1 = SOFT["C1"] + 2.0 / 3.0 * SOFT["k1"] * E * np.exp(SOFT["k2"] * E**2)
    return by_I1 * (2.0 * m - 2.0 / (m**3 * c**2)), by_I1 * (2.0 * c - 2.0 / (c**3 * m**2))


def inflated(pole: float) -> tuple[float, float]:
    """Pressure and radius of curvature of the pole of a membrane clamped at R = 1, for T = 1.

    From the pole outwards: force along the axis 2 t_m sin(phi) = p r, along the meridian
    d(t_m r) = t_c dr. The radius is that of the shape, z = r^2 / (2 rho) near the axis.
    """

    def shape(pressure: float):
        last = [pole]

        def slopes(R, y):
            r, _, tension = y
            c = r / R

            def error(m):
                return energy_slopes(m, c)[0] / c - tension

            last[0] = m = brentq(error, 0.8 * last[0], 1.2 * last[0], xtol=1e-13)
            sine = min(pressure * r / (2.0 * tension), 1.0)
            dr = m * np.sqrt(1.0 - sine**2)
            return [dr, m * sine, (energy_slopes(m, c)[1] / m - tension) * dr / r]

        start = [1e-4 * pole, 0.0, energy_slopes(pole, pole)[0] / pole]
        at = np.linspace(1e-4, 1.0, 101)
        return solve_ivp(slopes, (1e-4, 1.0), start, t_eval=at, rtol=1e-8, atol=1e-11)

    tension = energy_slopes(pole, pole)[0] / pole
    pressure = brentq(lambda p: shape(p).y[0, -1] - 1.0, 0.1 * tension, 1.9 * tension, xtol=1e-9)
    r, z, _ = shape(pressure).y
    near = r < 0.3
    fit = np.linalg.lstsq(np.column_stack([r**0, r**2, r**4])[near], z[near], rcond=None)[0]
    return pressure, 0.5 / fit[1]


FILE = """# test: bulge
# thickness_mm: 0.5
# load_noise_kPa: 0.05
stretch_x,stretch_y,pressure_mmHg,radius_mm
1.00,1.00,0,40
1.05,1.05,30,22
1.10,1.10,70,14
1.15,1.14,120,11
"""


def tension(stretch: np.ndarray, values: dict[str, float]) -> np.ndarray:
    made = parsed(FILE)
    forward = ForwardModel.from_specimen(made, biaxbayes.options.Settings())
    return forward.load(values, stretch)[0, :, 0]


def parsed(text: str):
    return parse_specimen(text.split("\n"), Path("dome.csv"))


def test_a_neo_hookean_balloon_has_its_closed_form():
    """p = 2 mu T / R (1 / l - 1 / l^7), and the radius of curvature is R l."""
    mu, T, R, l = 12.0, 0.5, 30.0, np.linspace(1.01, 1.6, 9)  # noqa: E741
    pressure = 2.0 * mu * T / R * (1.0 / l - l**-7)
    values = {"C1": 0.5 * mu, "k1": 0.0, "k2": 1.0, "alpha": 45.0, "kappa": 0.0}
    read = tension(np.column_stack([l, l]), values)
    np.testing.assert_allclose(read, pressure * R * l / (2.0 * T), rtol=1e-12)


@pytest.mark.parametrize("pole", [1.05, 1.2])
def test_the_pole_of_a_clamped_membrane_follows_laplace(pole):
    """A membrane integrated from pole to clamp, curvature from its shape."""
    pressure, radius = inflated(pole)
    read = tension(np.full((1, 2), pole), SOFT)[0]
    assert read == pytest.approx(0.5 * pressure * radius, rel=2e-3)


def domed(values: dict[str, float], pressure: float, rings: int = 16) -> tuple[np.ndarray, float]:
    """Stretches of the pole, and mean curvature there, of a clamped disc of GOH of radius 1, T = 1.

    Linear membrane triangles on a quarter of it; least potential energy.
    """
    polar = [
        (i / rings, 0.25 * np.pi * j / i) for i in range(1, rings + 1) for j in range(2 * i + 1)
    ]
    X = np.array([(0.0, 0.0), *((r * np.cos(a), r * np.sin(a)) for r, a in polar)])
    X[np.abs(X) < 1e-12] = 0.0
    triangles = Delaunay(X).simplices
    edges = (X[triangles[:, 1:]] - X[triangles[:, :1]]).transpose(0, 2, 1)
    size = np.linalg.det(edges)
    triangles, edges, size = (v[size > 1e-9] for v in (triangles, edges, size))
    inverse = np.linalg.inv(edges)
    slope = np.stack([-inverse.sum(axis=1), inverse[:, 0], inverse[:, 1]], axis=1)
    held = np.column_stack([X == 0.0, np.zeros(len(X), dtype=bool)])
    held[np.hypot(*X.T) > 1.0 - 1e-9] = True
    kappa, angle = values["kappa"], np.radians(values["alpha"])
    fibres = np.array([[np.cos(angle), np.sin(angle)], [np.cos(angle), -np.sin(angle)]])
    x = np.column_stack([X, 0.3 * (1.0 - (X**2).sum(axis=1))])

    def energy(free):
        x[~held] = 0.01 * free  # the first step of the search is one
        F = np.einsum("mai,maj->mij", x[triangles], slope)
        C = np.einsum("mij,mik->mjk", F, F)
        det = np.linalg.det(C)
        I1 = np.trace(C, axis1=1, axis2=2) + 1.0 / det
        dI1 = np.eye(2) - np.linalg.inv(C) / det[:, None, None]
        W, dW = values["C1"] * (I1 - 3.0), values["C1"] * dI1
        for f in fibres:
            E = kappa * I1 + (1.0 - 3.0 * kappa) * np.einsum("i,mij,j->m", f, C, f) - 1.0
            grown = np.exp(np.minimum(values["k2"] * E**2, 50.0))
            W = W + values["k1"] / (2.0 * values["k2"]) * (grown - 1.0)
            dE = kappa * dI1 + (1.0 - 3.0 * kappa) * np.outer(f, f)
            dW = dW + (values["k1"] * E * grown)[:, None, None] * dE
        force = np.einsum("m,mij,mjk,mak->mai", size, F, dW, slope)
        corners = x[triangles]
        volume = np.einsum("mi,mi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        out = np.zeros_like(x)
        for k in range(3):
            across = np.cross(corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]) / 6.0
            np.add.at(out, triangles[:, k], force[:, k] - pressure * across)
        return 0.5 * (size * W).sum() - pressure * volume, 0.01 * out[~held]

    options = {"maxiter": 20_000, "maxfun": 40_000, "ftol": 0.0, "gtol": 1e-8, "maxcor": 40}
    minimize(energy, 100.0 * x[~held], jac=True, method="L-BFGS-B", options=options)
    near = np.hypot(*X.T) < 0.35
    a, b, z = x[near].T
    terms = np.column_stack([a**0, a**2, b**2, a**4, a**2 * b**2, b**4])
    curvatures = -2.0 * np.linalg.lstsq(terms, z, rcond=None)[0][1:3]
    stretch = []
    for k in range(2):
        own = near & (X[:, k] > 0.0)
        terms = np.column_stack([np.ones(own.sum()), X[own] ** 2])
        stretch.append(np.linalg.lstsq(terms, x[own, k] / X[own, k], rcond=None)[0][0])
    return np.array(stretch), float(curvatures.mean())


@pytest.mark.long
def test_the_pole_of_anisotropic_finite_elements_follows_laplace():
    """Stresses differ by half and curvatures by a tenth; the mesh stiffens the curvature by 2 %."""
    values = {"C1": 10.0, "k1": 40.0, "k2": 5.0, "alpha": 30.0, "kappa": 0.1}
    stretch, curvature = domed(values, 8.0)
    assert tension(stretch[None], values)[0] == pytest.approx(0.5 * 8.0 / curvature, rel=0.03)


def test_pressure_and_radius_are_read_as_tension(tmp_path):
    dome = parsed(FILE)
    (p,) = dome.protocols
    np.testing.assert_allclose(
        p.load_x, np.array([0, 30, 70, 120]) / MMHG_PER_KPA * [40, 22, 14, 11]
    )
    assert not p.load_y.any() and p.rest_rows == 0 and dome.experiment.axes == (0,)
    write_specimen(dome, tmp_path / "dome.csv")
    assert read_specimen(tmp_path / "dome.csv") == dome


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("# thickness_mm: 0.5\n", "", "radius_mm: needs the thickness_mm"),
        ("pressure_mmHg", "time_s", "radius_mm: needs the pressure_kPa; add that column"),
        ("radius_mm", "time_s", "no column of loads; give pole_tension_kPa, or radius_mm"),
        ("radius_mm", "outer_diameter_mm", "a bulge test has no such column; state '# test: tube'"),
        ("# load", "# edge_x_mm: 3\n# load", "row 3: edge_x_mm does not belong to a bulge test"),
    ],
)
def test_what_is_no_bulge_test_is_refused(old, new, message):
    with pytest.raises(InputError, match=message):
        parsed(FILE.replace(old, new, 1))


@pytest.mark.long
def test_a_dome_beside_a_square_runs_through_the_program(tmp_path):
    material = GOH(12.0, 30.0, 4.0, 40.0, 0.15)
    dome, _ = biaxbayes.simulate(
        material=material, test="bulge", total_stretch=1.2, increments=30, thickness=0.5,
        noise_kPa=0.05, name="dome", seed=2,
    )  # fmt: skip
    alone = biaxbayes.fit(dome, "constrained", starts=2)
    assert alone.rms < 0.1
    square = specimen(material, increments=12, noise_N=0.002)
    run = sampled(square.with_pieces([dome]), noise="correlated")
    assert run.state == "converged"
    for name, true in (("C1", 12.0), ("k1", 30.0)):
        low, high = run.draws[name].quantile([0.01, 0.99])
        assert low < true < high, name
    low, high = run.draws["stiffness[dome]"].quantile([0.01, 0.99])
    assert low < 1.0 < high
