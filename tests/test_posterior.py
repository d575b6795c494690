"""The compiled density against the model written down a second time, in plain Python and SciPy.

Nothing here uses the product's mechanics or its priors: stresses are complex-step derivatives of
the printed energy, the mounted state is found by SciPy, and densities come from scipy.stats.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import root
from scipy.stats import lognorm, norm, truncnorm, uniform

from biaxbayes.errors import InputError
from biaxbayes.inference.assemble import assemble
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.priors import Prior
from biaxbayes.inference.settings import Settings
from biaxbayes.specimens.specimen import Protocol, Specimen

STEP = 1e-30
EDGES = {"edge_x_mm": 20.0, "edge_y_mm": 17.0, "thickness_mm": 1.1}
TRUTH = {"C1": 8.0, "k1": 20.0, "k2": 3.0, "alpha": 40.0, "kappa": 0.12}


# --- the model, a second time ----------------------------------------------------------------


def energy(C1, k1, k2, alpha, kappa, lx, ly, lz, switch):
    """Eq. 5; the limit k1 E^2 where k2 is 0."""
    I1 = lx * lx + ly * ly + lz * lz
    I4 = (lx * np.cos(alpha)) ** 2 + (ly * np.sin(alpha)) ** 2
    E = kappa * I1 + (1 - 3 * kappa) * I4 - 1
    fibre = np.expm1(k2 * E * E) / k2 if k2 > 0 else E * E
    if switch:
        fibre = fibre * (np.real(E) >= 0)
    return C1 * (I1 - 3) + k1 * fibre


def piola(theta, lx, ly, switch=False):
    """P_k = dW/dl_k with lz = 1/(lx ly); complex stretches give derivatives of P as well."""
    h = 1e-6
    out = []
    for dx, dy in ((1, 0), (0, 1)):
        if np.iscomplexobj(lx) or np.iscomplexobj(ly):
            up = energy(
                *theta, lx + h * dx, ly + h * dy, 1 / ((lx + h * dx) * (ly + h * dy)), switch
            )
            dn = energy(
                *theta, lx - h * dx, ly - h * dy, 1 / ((lx - h * dx) * (ly - h * dy)), switch
            )
            out.append((up - dn) / (2 * h))
        else:
            zx, zy = lx + 1j * STEP * dx, ly + 1j * STEP * dy
            out.append(energy(*theta, zx, zy, 1 / (zx * zy), switch).imag / STEP)
    return np.array(out)


def carried(theta, lm, measured, section, mounted, switch):
    """Load at measured stretches, (2, n): section times P, mounted sections shrunk by lm."""
    total = [lm[k] * np.asarray(measured[k]) for k in (0, 1)]
    force = section[:, None] * piola(theta, *total, switch).reshape(2, -1)
    return force * np.asarray(lm)[:, None] if mounted else force


def load_slope(theta, lm, section, mounted, switch):
    """d p0 / d lm, (2, 2), by central differences of complex-step stresses."""
    h = 1e-5
    columns = []
    for e in np.eye(2):
        ends = [
            carried(theta, lm + s * h * e, ([1.0], [1.0]), section, mounted, switch)[:, 0]
            for s in (1, -1)
        ]
        columns.append((ends[0] - ends[1]) / (2 * h))
    return np.array(columns).T


def mounting_root(theta, p0, section, mounted, switch):
    start = np.array([1.0, 1.0])
    for share in (0.25, 0.5, 0.75, 1.0):  # follow the load from nothing
        found = root(
            lambda lm, s=share: (
                (carried(theta, lm, ([1.0], [1.0]), section, mounted, switch)[:, 0] - s * p0)
                / np.abs(p0).max()
            ),
            start,
            tol=1e-13,
        )
        start = found.x
    assert found.success
    return start


def log_prior(prior, x, *, in_logs):
    """Log density of a prior at natural x; in ln x where the parameter is sampled so."""
    family, a, b, *limits = prior
    low, high = (*limits, *(-math.inf, math.inf)[len(limits) :])
    if family == "normal":
        low = max(low, 0.0) if in_logs else low
        out = truncnorm.logpdf(x, (low - a) / b, (high - a) / b, a, b)
    elif family == "lognormal":
        cut = lognorm.cdf(high, b, scale=a) - lognorm.cdf(max(low, 0.0), b, scale=a)
        inside = low <= x <= high
        out = lognorm.logpdf(x, b, scale=a) - math.log(cut) if inside else -math.inf
    elif family == "uniform":
        out = uniform.logpdf(x, a, b - a)
    else:
        out = -math.log(x * math.log(b / a)) if a <= x <= b else -math.inf
    return out + (math.log(x) if in_logs else 0.0)


IN_LOGS = ("C1", "k1", "k2", "noise_sd", "noise_growth")


def default_priors(specimen):
    return {
        "C1": ("lognormal", 10.0, 2.0),
        "k1": ("lognormal", 30.0, 2.5),
        "k2": ("lognormal", 10.0, 2.0),
        "alpha": ("uniform", 0.0, 90.0),
        "kappa": ("uniform", 0.0, 1 / 3),
        "noise_sd": ("lognormal", 0.005 * specimen.peak_load, 1.5),
        "noise_growth": ("lognormal", 0.03, 1.0),
        "mounting_stretch_x": ("normal", 1.0, 0.1, 0.0),
        "mounting_stretch_y": ("normal", 1.0, 0.1, 0.0),
    }


@dataclass
class Model:
    """Options of the second implementation."""

    mounting: str = "noisy"
    per_protocol: bool = False
    growth: bool = False
    switch: bool = False
    beta: float = 1.0
    determinant: bool = True


def second_opinion(specimen, model, values, priors, sampled):
    """Log density at natural ``values``; ``sampled`` names the unknowns with a prior."""
    v = {"edge_x": 1.0, "edge_y": 1.0, "thickness": 1.0, "load_offset_x": 0.0, "load_offset_y": 0.0}
    v |= values
    theta = (v["C1"], v["k1"], v["k2"], np.deg2rad(v["alpha"]), v["kappa"])
    total = 0.0
    for name in sampled:
        if not name.startswith("mounting"):
            total += log_prior(priors[name], v[name], in_logs=name in IN_LOGS)
            if name == "alpha":
                total += math.log(180 / math.pi)  # stated per degree, a density in radians
    area = np.ones(2)
    if specimen.stress_pair == "force":
        area = np.array([specimen.edge_y_mm, specimen.edge_x_mm]) * specimen.thickness_mm / 1000
    section = area * [v["edge_y"] * v["thickness"], v["edge_x"] * v["thickness"]]
    mounted = specimen.geometry == "mounted"
    offset = np.array([v["load_offset_x"], v["load_offset_y"]])

    def readings(p):
        pair = np.array([p.load_x, p.load_y])
        return pair / [p.stretch_x, p.stretch_y] if specimen.stress_pair == "cauchy" else pair

    first = [readings(p)[:, : p.rest_rows].mean(axis=1) for p in specimen.protocols]
    s0 = [specimen.load_noise / math.sqrt(p.rest_rows) for p in specimen.protocols]
    states = range(len(specimen.protocols) if model.per_protocol else 1)
    lms = []
    for m in states:
        if model.mounting in ("ignored", "zeroed"):
            lms.append(np.ones(2))
            continue
        tail = f"[{specimen.protocols[m].name}]" if model.per_protocol else ""
        if model.per_protocol or len(first) == 1:
            f0, sd = first[m], np.full(2, s0[m])
        else:  # the mean of the protocols' readings; their scatter counts where it is larger
            f0 = np.mean(first, axis=0)
            sd = np.full(2, math.sqrt(sum(s * s for s in s0)) / len(s0))
            sd = np.maximum(sd, np.std(first, axis=0, ddof=1) / math.sqrt(len(first)))
        if model.mounting == "free":
            lm = np.array([v[f"mounting_stretch_{k}{tail}"] for k in "xy"])
            p0 = carried(theta, lm, ([1.0], [1.0]), section, mounted, model.switch)[:, 0]
        else:
            p0 = (
                f0 - offset
                if model.mounting == "exact"
                else np.array([v[f"mounting_force_{k}{tail}"] for k in "xy"])
            )
            lm = mounting_root(theta, p0, section, mounted, model.switch)
            if model.determinant:
                slope = load_slope(theta, lm, section, mounted, model.switch)
                total -= math.log(abs(np.linalg.det(slope)))
        for k, axis in enumerate("xy"):
            total += log_prior(priors[f"mounting_stretch_{axis}"], lm[k], in_logs=False)
            if model.mounting in ("noisy", "free"):
                total += norm.logpdf(f0[k], p0[k] + offset[k], sd[k])
        lms.append(lm)
    for i, p in enumerate(specimen.protocols):
        lm = lms[i if model.per_protocol else 0]
        load = readings(p)
        if model.mounting == "zeroed":
            load = load - first[i][:, None]
        measured = (p.stretch_x[p.rest_rows :], p.stretch_y[p.rest_rows :])
        mean = carried(theta, lm, measured, section, mounted, model.switch)
        sd = np.full(mean.shape, v["noise_sd"])
        if model.growth:
            sd = np.sqrt(v["noise_sd"] ** 2 + (v["noise_growth"] * mean) ** 2)
        logs = norm.logpdf(load[:, p.rest_rows :], mean + offset[:, None], sd)
        total += model.beta * logs.sum()
    return total


# --- specimens -------------------------------------------------------------------------------


def specimen_of(
    pair="force", geometry="unloaded", *, protocols=1, rest=1, rows=14, noise=0.01, seed=3, **extra
):
    """A specimen made with the second implementation."""
    rng = np.random.default_rng(seed)
    theta = (TRUTH["C1"], TRUTH["k1"], TRUTH["k2"], np.deg2rad(TRUTH["alpha"]), TRUTH["kappa"])
    lm = np.array([1.03, 1.05])
    area = np.array([EDGES["edge_y_mm"], EDGES["edge_x_mm"]]) * EDGES["thickness_mm"] / 1000
    section = area if pair == "force" else np.ones(2)
    made = []
    for i in range(protocols):
        path = np.concatenate([np.zeros(rest), np.linspace(0.02, 1, rows - rest)])
        x, y = 1 + 0.25 * path, 1 + 0.2 * path / (i + 1)
        load = carried(theta, lm, (x, y), section, geometry == "mounted", False)
        if pair == "cauchy":
            load = load * [x, y]
        load = load + noise * rng.standard_normal(load.shape)
        made.append(Protocol(f"p{i}", x, y, *load, rest_rows=rest))
    return Specimen("test", tuple(made), pair, geometry, load_noise=noise, metadata=extra, **EDGES)


def random_values(specimen, model, rng, labels=("",)):
    """Natural parameters around the truth, with everything that a model may ask for."""
    out = {
        "C1": TRUTH["C1"] * np.exp(0.3 * rng.standard_normal()),
        "k1": TRUTH["k1"] * np.exp(0.3 * rng.standard_normal()),
        "k2": TRUTH["k2"] * np.exp(0.3 * rng.standard_normal()),
        "alpha": rng.uniform(5, 85),
        "kappa": rng.uniform(0.01, 0.32),
        "noise_sd": 0.05 * specimen.peak_load * np.exp(0.5 * rng.standard_normal()),
        "noise_growth": 0.05 * np.exp(0.3 * rng.standard_normal()),
        "edge_x": rng.normal(1, 0.02),
        "edge_y": rng.normal(1, 0.02),
        "thickness": rng.normal(1, 0.03),
        "load_offset_x": 0.01 * rng.standard_normal(),
        "load_offset_y": 0.01 * rng.standard_normal(),
    }
    reading, sd = specimen.mounting_readings(shared=labels == ("",))
    for m, label in enumerate(labels):
        tail = f"[{label}]" if label else ""
        for k, axis in enumerate("xy"):
            out[f"mounting_force_{axis}{tail}"] = reading[m, k] + sd[m, k] * rng.standard_normal()
            out[f"mounting_stretch_{axis}{tail}"] = rng.uniform(1.01, 1.07)
    return out


def compare(specimen, model=None, *, priors=None, stated=None, fixed=(), count=6, **options):
    """The product's density must be the second one's, constant and all."""
    model = model or Model()
    posterior = Posterior(
        specimen,
        mounting=model.mounting,
        noise="independent",
        mounting_stretch="per-protocol" if model.per_protocol else "shared",
        noise_growth=model.growth,
        fibre_switch=model.switch,
        beta=model.beta,
        determinant=model.determinant,
        priors=priors or {},
        **options,
    )
    rng = np.random.default_rng(17)
    prior_table = default_priors(specimen) | (stated or {})
    checked = 0
    for _ in range(count):
        values = random_values(specimen, model, rng, posterior.mounts)
        for name, value in dict(fixed).items():
            values[name] = value(values) if callable(value) else value
        used = {n: values[n] for n in posterior.free}
        got = posterior.log_density(used)
        if not np.isfinite(got):
            continue  # no stable mounted state there
        active = {k: v for k, v in values.items() if k in posterior.free or k in dict(fixed)}
        for name in ("C1", "k1", "k2", "alpha", "kappa", "noise_sd"):
            active.setdefault(name, values[name])
        want = second_opinion(specimen, model, active, prior_table, posterior.free)
        assert got == pytest.approx(want, rel=1e-7, abs=1e-5)
        checked += 1
    assert checked >= count // 2
    return posterior


# --- the compiled density --------------------------------------------------------------------


@pytest.mark.parametrize("mounting", ["noisy", "exact", "free", "ignored", "zeroed"])
@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
@pytest.mark.parametrize("pair", ["force", "piola", "cauchy"])
def test_density_is_that_of_the_second_implementation(pair, geometry, mounting):
    noise = 0.005 if pair == "force" else 0.2
    compare(specimen_of(pair, geometry, noise=noise), Model(mounting))


@pytest.mark.parametrize("mounting", ["noisy", "exact", "free", "zeroed"])
@pytest.mark.parametrize("per_protocol", [False, True])
@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_density_of_several_protocols(geometry, per_protocol, mounting):
    specimen = specimen_of("force", geometry, protocols=3, rest=3, noise=0.005)
    posterior = compare(specimen, Model(mounting, per_protocol=per_protocol))
    names = [n for n in posterior.free if n.startswith("mounting")]
    expected = (6 if per_protocol else 2) if mounting in ("noisy", "free") else 0
    assert len(names) == expected


@pytest.mark.parametrize("mounting", ["noisy", "exact", "free"])
@pytest.mark.parametrize("geometry", ["unloaded", "mounted"])
def test_density_of_measured_dimensions_and_offsets(geometry, mounting):
    extra = {"edge_sd_mm": 0.4, "thickness_sd_mm": 0.05, "load_offset_sd_N": 0.01}
    specimen = specimen_of("force", geometry, noise=0.005, **extra)
    stated = {
        "edge_x": ("normal", 1.0, 0.4 / 20.0, 0.0),
        "edge_y": ("normal", 1.0, 0.4 / 17.0, 0.0),
        "thickness": ("normal", 1.0, 0.05 / 1.1, 0.0),
        "load_offset_x": ("normal", 0.0, 0.01),
        "load_offset_y": ("normal", 0.0, 0.01),
    }
    posterior = compare(specimen, Model(mounting), stated=stated)
    assert {"edge_x", "edge_y", "thickness", "load_offset_x", "load_offset_y"} <= set(
        posterior.free
    )


def test_density_with_growing_noise_temper_and_switch():
    specimen = specimen_of(noise=0.005)
    compare(specimen, Model(growth=True))
    compare(specimen, Model(beta=0.17))
    compare(specimen, Model(growth=True, beta=0.3, mounting="free"))
    squeezed = [
        replace(p, stretch_x=p.stretch_x, stretch_y=2.0 - p.stretch_y) for p in specimen.protocols
    ]
    specimen = replace(specimen, protocols=tuple(squeezed))
    compare(specimen, Model(switch=True))
    compare(specimen, Model(switch=False))


def test_density_without_its_determinant_is_another_one():
    specimen = specimen_of(noise=0.005)
    compare(specimen, Model(determinant=False))
    values = random_values(specimen, Model(), np.random.default_rng(1))
    densities = [
        Posterior(specimen, noise="independent", determinant=flag).log_density(values)
        for flag in (True, False)
    ]
    assert abs(densities[0] - densities[1]) > 0.1


PRIORS = {
    "C1": [
        ("lognormal", 7.0, 0.5),
        ("lognormal", 7.0, 0.5, 3.0, 30.0),
        ("normal", 9.0, 6.0),
        ("normal", 9.0, 6.0, 1.0, 40.0),
        ("uniform", 0.0, 50.0),
        ("loguniform", 0.5, 80.0),
    ],
    "k2": [("normal", 2.0, 4.0), ("uniform", 0.0, 60.0), ("loguniform", 0.01, 500.0)],
    "alpha": [("normal", 41.0, 25.0, 0.0, 90.0), ("uniform", 2.0, 88.0)],
    "kappa": [("normal", 0.1, 0.1, 0.0, 1 / 3), ("uniform", 0.0, 1 / 3)],
    "noise_sd": [("loguniform", 1e-4, 10.0), ("uniform", 0.0, 10.0)],
    "mounting_stretch": [("normal", 1.02, 0.03, 0.0), ("uniform", 0.9, 1.3)],
}
KEYS = {
    "normal": ("mean", "sd", "low", "high"),
    "lognormal": ("median", "sd_log", "low", "high"),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
}


@pytest.mark.parametrize(
    ("name", "prior"), [(n, p) for n, choices in PRIORS.items() for p in choices]
)
def test_density_with_priors_of_every_family(name, prior):
    family, *numbers = prior
    table = {"distribution": family} | dict(zip(KEYS[family], numbers, strict=False))
    names = [f"{name}_x", f"{name}_y"] if name == "mounting_stretch" else [name]
    for mounting in ("noisy", "free"):
        compare(
            specimen_of(noise=0.005),
            Model(mounting),
            priors={name: table},
            stated=dict.fromkeys(names, prior),
            count=4,
        )


@pytest.mark.parametrize(
    ("priors", "fixed"),
    [
        ({"kappa": 0.0}, {"kappa": 0.0}),
        ({"kappa": 1 / 3}, {"kappa": 1 / 3}),
        ({"alpha": 41.0, "k2": 0.0}, {"alpha": 41.0, "k2": 0.0}),
        ({"alpha": 90.0}, {"alpha": 90.0}),
        ({"k1": 0.0}, {"k1": 0.0}),
        ({"C1": 6.0, "noise_sd": 0.03}, {"C1": 6.0, "noise_sd": 0.03}),
        ({"k1": "2.5 * C1"}, {"k1": lambda v: 2.5 * v["C1"]}),
        ({"C1": "0.2 * k1", "k2": 4.0}, {"C1": lambda v: 0.2 * v["k1"], "k2": 4.0}),
    ],
)
def test_density_with_fixed_and_tied_parameters(priors, fixed):
    posterior = compare(specimen_of(noise=0.005), priors=priors, fixed=fixed)
    assert not set(fixed) & set(posterior.free)


def test_density_with_tied_mounting_stretches():
    specimen = specimen_of(noise=0.005)
    tie = {"mounting_stretch_y": "mounting_stretch_x"}
    posterior = Posterior(specimen, mounting="free", noise="independent", priors=tie)
    assert "mounting_stretch_y" not in posterior.free
    rng = np.random.default_rng(5)
    values = random_values(specimen, Model("free"), rng)
    values = {n: values[n] for n in posterior.free}
    values["mounting_stretch_y"] = values["mounting_stretch_x"]
    want = second_opinion(specimen, Model("free"), values, default_priors(specimen), posterior.free)
    # the tied stretch has no prior of its own
    want -= norm.logpdf(values["mounting_stretch_x"], 1.0, 0.1)
    assert posterior.log_density(values) == pytest.approx(want, rel=1e-7)


def test_free_and_noisy_differ_by_the_change_of_variables_alone():
    """pi(theta, p0) |det dp0/dlm| = pi(theta, lm) wherever either is positive."""
    for geometry in ("unloaded", "mounted"):
        specimen = specimen_of(geometry=geometry, noise=0.005)
        free = Posterior(specimen, mounting="free", noise="independent")
        noisy = Posterior(specimen, mounting="noisy", noise="independent")
        rng = np.random.default_rng(9)
        met = 0
        for _ in range(200):
            v = random_values(specimen, Model("free"), rng)
            lm = rng.uniform(0.85, 1.4, 2)
            v["mounting_stretch_x"], v["mounting_stretch_y"] = lm
            section = specimen.area
            theta = (v["C1"], v["k1"], v["k2"], np.deg2rad(v["alpha"]), v["kappa"])
            mounted = geometry == "mounted"
            p0 = carried(theta, lm, ([1.0], [1.0]), section, mounted, False)[:, 0]
            v["mounting_force_x"], v["mounting_force_y"] = p0
            a, b = free.log_density(v), noisy.log_density(v)
            slope = load_slope(theta, lm, section, mounted, False)
            if np.isfinite(a) and a > -1e5:
                met += 1
                assert b + np.log(np.linalg.det(slope)) == pytest.approx(a, rel=1e-6, abs=1e-4)
            elif not np.isfinite(a):
                # no stable state at lm: noisy may hold another, stable one for the same load
                assert np.linalg.eigvalsh(0.5 * (slope + slope.T)).min() < 1e-6 or mounted
        assert met > 20


# --- arrays, names, invariances --------------------------------------------------------------


def test_log_density_broadcasts_and_names_what_is_missing():
    specimen = specimen_of(noise=0.005)
    posterior = Posterior(specimen, noise="independent")
    values = random_values(specimen, Model(), np.random.default_rng(2))
    one = posterior.log_density(values)
    assert isinstance(one, float)
    alphas, kappas = np.linspace(5, 85, 4)[:, None], np.linspace(0.01, 0.3, 3)
    grid = posterior.log_density(values | {"alpha": alphas, "kappa": kappas})
    assert grid.shape == (4, 3)
    single = posterior.log_density(values | {"alpha": alphas[2, 0], "kappa": kappas[1]})
    assert grid[2, 1] == single
    for name in posterior.free:
        with pytest.raises(InputError, match=name):
            posterior.log_density({k: v for k, v in values.items() if k != name})
    assert posterior.log_density(values | {"kappa": 0.4}) == -np.inf
    assert posterior.log_density(values | {"alpha": -1.0}) == -np.inf
    assert posterior.log_density(values | {"C1": 0.0}) == -np.inf
    assert posterior.log_density(values | {"C1": -2.0}) == -np.inf
    assert posterior.log_density(values | {"k2": np.nan}) == -np.inf


@pytest.mark.parametrize("mounting", ["noisy", "free", "exact"])
def test_exchanged_axes_leave_the_density(mounting):
    specimen = specimen_of(noise=0.005, protocols=2)
    swapped = replace(
        specimen,
        protocols=tuple(
            replace(
                p, stretch_x=p.stretch_y, stretch_y=p.stretch_x, load_x=p.load_y, load_y=p.load_x
            )
            for p in specimen.protocols
        ),
        edge_x_mm=specimen.edge_y_mm,
        edge_y_mm=specimen.edge_x_mm,
    )
    here, there = (
        Posterior(s, mounting=mounting, noise="independent") for s in (specimen, swapped)
    )
    rng = np.random.default_rng(3)
    for _ in range(20):
        v = random_values(specimen, Model(mounting), rng)
        w = v | {"alpha": 90.0 - v["alpha"]}
        for what in ("force", "stretch"):
            w[f"mounting_{what}_x"], w[f"mounting_{what}_y"] = (
                v[f"mounting_{what}_y"],
                v[f"mounting_{what}_x"],
            )
        a, b = here.log_density(v), there.log_density(w)
        assert a == pytest.approx(b, rel=1e-9) or (a == b == -np.inf)


@pytest.mark.parametrize("mounting", ["noisy", "free", "exact"])
def test_units_change_the_density_by_a_constant(mounting):
    square = replace(specimen_of(noise=0.005), edge_x_mm=18.0, edge_y_mm=18.0)
    area = 18.0 * 1.1 / 1000  # N per kPa
    stress = replace(
        square,
        stress_pair="piola",
        load_noise=square.load_noise / area,
        protocols=tuple(
            replace(p, load_x=p.load_x / area, load_y=p.load_y / area) for p in square.protocols
        ),
    )
    force_posterior, stress_posterior = (
        Posterior(s, mounting=mounting, noise="independent") for s in (square, stress)
    )
    rng = np.random.default_rng(3)
    shifts = []
    for _ in range(20):
        v = random_values(square, Model(mounting), rng)
        w = v | {k: v[k] / area for k in ("noise_sd", "mounting_force_x", "mounting_force_y")}
        a, b = force_posterior.log_density(v), stress_posterior.log_density(w)
        assert np.isfinite(a) == np.isfinite(b)
        if np.isfinite(a):
            shifts.append(a - b)
    # each reading and each mounting force scales with the area; ln w does not
    readings = 2 * 13 + (0 if mounting == "exact" else 2) + (2 if mounting != "free" else 0)
    np.testing.assert_allclose(shifts, -readings * np.log(area), rtol=1e-9)


# --- sampling coordinates --------------------------------------------------------------------


def in_sampled_scale(posterior, natural):
    """What :meth:`log_density` is a density in, as columns."""
    columns = []
    for name in posterior.free:
        x = natural[name]
        columns.append(np.log(x) if name in IN_LOGS else np.deg2rad(x) if name == "alpha" else x)
    return np.column_stack(columns)


@pytest.mark.parametrize(
    ("mounting", "priors"),
    [
        ("noisy", {}),
        ("free", {}),
        ("exact", {}),
        ("ignored", {}),
        ("noisy", {"kappa": 0.1}),
        ("noisy", {"k2": 2.0}),
        ("noisy", {"k1": 15.0}),
        ("noisy", {"k1": "2.0 * C1"}),
        ("noisy", {"C1": "0.4 * k1"}),
    ],
)
def test_sampling_density_is_the_natural_one_times_the_jacobian(mounting, priors):
    specimen = specimen_of(noise=0.005)
    posterior = Posterior(specimen, mounting=mounting, noise="independent", priors=priors)
    rng = np.random.default_rng(23)
    values = [random_values(specimen, Model(mounting), rng) for _ in range(12)]
    natural = {n: np.array([v[n] for v in values]) for n in posterior.free}
    u = posterior.coordinates(natural | {"alpha": natural.get("alpha", 0.0)})
    back = posterior.natural(u)
    for name in posterior.free:
        np.testing.assert_allclose(back[name], natural[name], rtol=1e-8)
    inside = np.isfinite(back["lp"])
    assert inside.sum() >= 6
    np.testing.assert_allclose(
        back["lp"][inside], posterior.log_density(natural)[inside], rtol=1e-9
    )
    h = 1e-6
    for i in np.flatnonzero(inside):
        d = posterior.dimension
        jacobian = np.empty((d, d))
        for j in range(d):
            e = np.zeros(d)
            e[j] = h * max(abs(u[i, j]), 1e-2)
            ends = in_sampled_scale(posterior, posterior.natural(np.array([u[i] + e, u[i] - e])))
            jacobian[:, j] = (ends[0] - ends[1]) / (2 * e[j])
        log_jacobian = np.linalg.slogdet(jacobian)[1]
        got = posterior.log_prob(u[i])[0] - posterior.log_density(natural)[i]
        assert got == pytest.approx(log_jacobian, abs=1e-3)


# --- never NaN -------------------------------------------------------------------------------


stretch_top = st.floats(1.0, 3.0)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    top_x=stretch_top,
    top_y=stretch_top,
    rows=st.sampled_from([2, 3, 40]),
    scale=st.sampled_from([1e-9, 1e-3, 1.0, 1e4]),
    noise=st.sampled_from([1e-12, 1e-3, 10.0]),
    geometry=st.sampled_from(["unloaded", "mounted"]),
    mounting=st.sampled_from(["noisy", "free", "exact", "ignored", "zeroed"]),
    growth=st.booleans(),
    switch=st.booleans(),
    structural=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_density_is_finite_or_minus_infinity(
    top_x, top_y, rows, scale, noise, geometry, mounting, growth, switch, structural, seed
):
    rng = np.random.default_rng(seed)
    path = np.linspace(0, 1, rows)
    x, y = 1 + (top_x - 1) * path, 1 + (top_y - 1) * path
    load = scale * (0.1 + np.array([path, path**2]) + 0.1 * rng.standard_normal((2, rows)))
    specimen = Specimen(
        "wild", (Protocol("p", x, y, *load),), "piola", geometry, load_noise=noise * scale
    )
    options = Settings(mounting, "independent", noise_growth=growth, fibre_switch=switch)
    from biaxbayes.inference import kernel
    from biaxbayes.inference.coordinates import ANGULAR, SHEAR

    chart = SHEAR if structural else ANGULAR
    assembly = assemble(specimen, options, chart=chart, structural=structural)
    d = len(assembly.free)
    # the whole box: near the middle, far out, on the edges and beyond, and no number at all
    u = rng.standard_normal((300, d)) * 10 ** rng.uniform(-2, 3, (300, 1))
    u[:100, 4] = rng.uniform(0, 1, 100)
    u[:20, 4] = rng.choice([0.0, 1.0, 1 / 3, 5e-324, -0.0], 20)
    u[20:40, 3] = rng.choice([0.0, np.pi / 2, np.pi / 4, 40.0, -40.0], 20)
    u[40:100, :3] = rng.uniform(-8, 8, (60, 3))
    u[290:295] = np.nan
    u[295:] = rng.choice([np.inf, -np.inf, 1e308, -1e308], (5, d))
    counts = np.zeros(4, dtype=np.int64)
    out = kernel.log_density(assembly.problem, u, counts)
    assert not np.isnan(out).any() and not np.isposinf(out).any()
    assert counts.sum() == len(u) and counts[0] == np.isfinite(out).sum()
    total, likelihood, natural = kernel.evaluate(assembly.problem, u)
    np.testing.assert_array_equal(total, out)
    assert not np.isnan(likelihood).any()
    assert np.isfinite(natural[np.isfinite(out)]).all()


def test_density_survives_exponents_in_the_hundreds():
    specimen = specimen_of(noise=0.005)
    posterior = Posterior(specimen, noise="independent")
    values = random_values(specimen, Model(), np.random.default_rng(2))
    top = posterior.log_density(values | {"k2": np.geomspace(1, 1e6, 200)})
    assert not np.isnan(top).any()
    assert np.isfinite(top[:50]).any() and (np.diff(top[np.isfinite(top)]) < 0).sum() > 20


def test_two_points_are_enough_for_a_density():
    specimen = specimen_of(noise=0.005, rows=2)
    compare(specimen)
    compare(specimen, Model("exact"))


def test_readings_at_rest_are_one_reading_of_the_mounting_force():
    """Rows at rest enter by their mean alone, with the load cell's sd over the root of n."""
    specimen = specimen_of(noise=0.005, rest=4)
    compare(specimen)
    assert isinstance(Posterior(specimen, noise="independent").priors["C1"], Prior)


def test_mounting_force_of_an_exact_run_is_the_reading_less_the_offset():
    specimen = specimen_of(noise=0.005, load_offset_sd_N=0.01)
    posterior = Posterior(specimen, mounting="exact", noise="independent")
    values = random_values(specimen, Model("exact"), np.random.default_rng(3))
    natural = posterior.natural(posterior.coordinates(values))
    reading, _ = specimen.mounting_readings(shared=True)
    for k, axis in enumerate("xy"):
        force = natural[f"mounting_force_{axis}"][0]
        assert force == pytest.approx(reading[0, k] - values[f"load_offset_{axis}"], rel=1e-12)
    theta = [values[n] for n in ("C1", "k1", "k2")] + [np.deg2rad(values["alpha"]), values["kappa"]]
    lm = [natural[f"mounting_stretch_{axis}"][0] for axis in "xy"]
    got = carried(theta, np.array(lm), ([1.0], [1.0]), specimen.area, False, False)[:, 0]
    np.testing.assert_allclose(got, [natural[f"mounting_force_{a}"][0] for a in "xy"], rtol=1e-8)
