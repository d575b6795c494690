"""Specimens of a known tissue that GOH cannot represent, in three protocols and one held out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from biaxbayes.laws.dispersed_fibres import structure_tensor
from biaxbayes.laws.goh import GOH
from biaxbayes.mechanics.virtual_test import simulate_smooth_misfit
from biaxbayes.specimens.specimen import Protocol, Specimen

RATIOS = {"1to1": (1.0, 1.0), "1to0.5": (1.0, 0.5), "0.5to1": (0.5, 1.0)}
HELD_OUT = (0.75, 1.0)
ROWS = 40
Stress = Callable[[np.ndarray], np.ndarray]
"""Total stretches (n, 2) to Cauchy stress (n, 2), kPa."""


@dataclass(frozen=True)
class Case:
    """A specimen with its truth.

    Attributes
    ----------
    kind : str
    specimen, held_out : Specimen
        Three protocols to learn from, and one to predict.
    stress : callable
        True Cauchy stress (n, 2) at total stretches (n, 2), kPa.
    mounting, top : ndarray, shape (2,)
        Mounting stretch; largest total stretch.
    material : GOH or None
        Where the truth is one, but for its smooth misfit.
    """

    kind: str
    specimen: Specimen
    held_out: Specimen
    stress: Stress
    mounting: np.ndarray
    top: np.ndarray
    material: GOH | None = None


def make_case(seed: int) -> Case:
    """The specimen of a seed; kinds take turns."""
    rng = np.random.default_rng([seed, 55])
    kind = list(TRUTHS)[seed % len(TRUTHS)]
    mounting = rng.uniform(1.0, 1.08, 2)
    if (seed // len(TRUTHS)) % 3 == 2:  # strongly stretched on mounting
        mounting = rng.uniform(1.1, 1.3) + rng.uniform(-0.03, 0.03, 2)
    top = mounting * (1.0 + rng.uniform(0.08, 0.2))
    stress = TRUTHS[kind](rng, mounting, top)
    peak = float(np.max(stress(top[None]) / top))
    noise = float(rng.uniform(0.001, 0.003)) * peak
    factors = {n: np.ones((ROWS + 1, 2)) for n in (*RATIOS, "held")}
    if kind == "smooth misfit":
        sd = rng.uniform(0.02, 0.06)
        s = np.linspace(0.0, 1.0, ROWS + 1)
        for value in factors.values():
            for k in range(2):
                value[:, k] += simulate_smooth_misfit(s, sd, rng)
    protocols = [
        _protocol(name, ratio, stress, mounting, top, factors[name], noise, rng)
        for name, ratio in RATIOS.items()
    ]
    held = _protocol("held", HELD_OUT, stress, mounting, top, factors["held"], noise, rng)
    return Case(
        kind,
        Specimen(f"{kind} {seed}", tuple(protocols), "piola", load_noise=noise),
        Specimen(f"{kind} {seed}", (held,), "piola", load_noise=noise),
        stress,
        mounting,
        top,
        getattr(stress, "material", None),
    )


def path(case_top: np.ndarray, mounting: np.ndarray, ratio, shares) -> np.ndarray:
    """Total stretches on a protocol's way from the mounted state, (n, 2)."""
    measured = 1.0 + np.asarray(shares)[:, None] * (case_top / mounting - 1.0) * np.array(ratio)
    return measured * mounting


def _protocol(name, ratio, stress, mounting, top, factor, noise, rng) -> Protocol:
    total = path(top, mounting, ratio, np.linspace(0.0, 1.0, ROWS + 1))
    load = stress(total) / total * factor
    load = load + noise * rng.standard_normal(load.shape)
    return Protocol(name, *(total / mounting).T, *load.T)


# --- tissues -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _GOHStress:
    material: GOH

    def __call__(self, total: np.ndarray) -> np.ndarray:
        return np.column_stack(self.material.cauchy(*total.T))


def _goh(rng: np.random.Generator, top: np.ndarray, *, alpha=None, kappa=None) -> Stress:
    """A random GOH tissue, its curvature stated at the largest stretch."""
    C1 = float(np.exp(rng.uniform(np.log(3.0), np.log(20.0))))
    angle = np.deg2rad(rng.uniform(20.0, 70.0) if alpha is None else alpha)
    spread = float(rng.uniform(0.05, 0.28)) if kappa is None else kappa
    H = structure_tensor(angle, spread)
    ax, ay = top**2
    E = max(H[0] * ax + H[1] * ay + H[2] / (ax * ay) - 1.0, 0.02)
    q = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    ratio = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))  # fibres to matrix at the top
    k1 = ratio * C1 * 0.5 / (E * np.exp(q))
    return _GOHStress(GOH(C1, k1, q / E**2, float(np.rad2deg(angle)), spread))


def four_families(rng, mounting, top) -> Stress:
    diagonal = _goh(rng, top, kappa=0.0)
    parts = [_goh(rng, top, alpha=a, kappa=0.0) for a in (0.0, 90.0)]
    weight = rng.uniform(0.3, 1.0, 2)
    return lambda t: diagonal(t) + weight[0] * parts[0](t) + weight[1] * parts[1](t)


def two_layers(rng, mounting, top) -> Stress:
    # The layers are not free of stress at the same state: the second is a little longer.
    inner, outer = _goh(rng, top), _goh(rng, top)
    share, slack = rng.uniform(0.3, 0.7), 1.0 + rng.uniform(0.0, 0.03)
    return lambda t: (
        share * inner(t) + (1.0 - share) * (outer(t / slack) - outer(0 * t + 1 / slack))
    )


def recruited(rng, mounting, top) -> Stress:
    """Fibres that straighten gradually: E enters as a softplus of width d beyond E0."""
    C1 = float(np.exp(rng.uniform(np.log(3.0), np.log(20.0))))
    H = structure_tensor(np.deg2rad(rng.uniform(20.0, 70.0)), rng.uniform(0.05, 0.28))
    ax, ay = top**2
    last = max(H[0] * ax + H[1] * ay + H[2] / (ax * ay) - 1.0, 0.02)
    E0, width = last * rng.uniform(0.2, 0.5), last * rng.uniform(0.05, 0.15)
    ratio = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
    k1 = 0.5 * ratio * C1 / (last - E0)

    def stress(total: np.ndarray) -> np.ndarray:
        a = np.column_stack([total**2, 1.0 / (total[:, 0] * total[:, 1]) ** 2])
        z = (a @ np.array(H) - 1.0 - E0) / width
        e = width * np.logaddexp(0.0, z)
        # W = k1 e^2: s_k = 2 (C1 + 2 k1 e de/dE H_k) a_k - (the same in z)
        fibre = 2.0 * k1 * e / (1.0 + np.exp(-z))
        full = 2.0 * (C1 + fibre[:, None] * np.array(H)) * a
        return full[:, :2] - full[:, 2:]

    return stress


def stiff_start(rng, mounting, top) -> Stress:
    """GOH and a share of stress that is there after one per cent of stretch: a concave start."""
    base = _goh(rng, top)
    extra = rng.uniform(0.02, 0.08) * base(top[None])[0]
    return lambda t: base(t) + extra * np.tanh((t / mounting - 1.0) / 0.01)


def smooth(rng, mounting, top) -> Stress:
    return _goh(rng, top)  # the misfit is put on the loads of each protocol


TRUTHS = {
    "four families": four_families,
    "two layers": two_layers,
    "recruited fibres": recruited,
    "stiff start": stiff_start,
    "smooth misfit": smooth,
}
