"""Densities that treat one walker at a time: a script of today, and pyMechT's mechanics."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import root

from studies.benchmark.natural_density import NaturalDensity

__all__ = ["lab_script", "pymecht_density", "seconds_of"]


def lab_script(density: NaturalDensity) -> Callable[[np.ndarray], float]:
    """What a lab would write: NumPy stress, ``scipy.optimize.root`` for the mounting stretch.

    Points hold mounting *forces* in the places of the mounting stretches.
    """
    problem = density.problem
    stretch_x, stretch_y = np.sqrt(problem.X), np.sqrt(problem.Y)
    weight = float(np.mean(problem.beta))
    reading, sd = problem.reading[0], problem.reading_sd[0]

    def stress(C1, k1, k2, alpha, kappa, lx, ly):
        lz = 1.0 / (lx * ly)
        t = np.cos(alpha) ** 2
        Hx, Hy, Hz = kappa + (1 - 3 * kappa) * t, kappa + (1 - 3 * kappa) * (1 - t), kappa
        E = Hx * lx**2 + Hy * ly**2 + Hz * lz**2 - 1.0
        e = 4.0 * k1 * E * np.exp(k2 * E**2)
        return (
            2.0 * C1 * (lx**2 - lz**2) + e * (Hx * lx**2 - Hz * lz**2),
            2.0 * C1 * (ly**2 - lz**2) + e * (Hy * ly**2 - Hz * lz**2),
        )

    def log_density(x: np.ndarray) -> float:
        C1, k1, k2, alpha, kappa, px, py, w = x
        if min(C1, k1, k2, w) <= 0 or not (0 <= alpha <= np.pi / 2 and 0 <= kappa <= 1 / 3):
            return -np.inf

        def balance(lm):
            sx, sy = stress(C1, k1, k2, alpha, kappa, *lm)
            if problem.mounted:
                return problem.area[0] * sx - px, problem.area[1] * sy - py
            return problem.area[0] * sx / lm[0] - px, problem.area[1] * sy / lm[1] - py

        with np.errstate(all="ignore"):
            found = root(balance, (1.01, 1.01))
        if not found.success:
            return -np.inf
        lx, ly = found.x
        total = float(-0.5 * (((reading - (px, py)) / sd) ** 2).sum())
        loads = stress(C1, k1, k2, alpha, kappa, stretch_x * lx, stretch_y * ly)
        readings = (problem.fx, problem.fy)
        for k, (lm, own) in enumerate(((lx, stretch_x), (ly, stretch_y))):
            section = problem.area[k] * (1.0 if problem.mounted else 1.0 / lm)
            residual = readings[k] - section * loads[k] / own
            total += weight * float((-0.5 * (residual / w) ** 2 - np.log(w)).sum())
        return total

    return log_density


def pymecht_density(density: NaturalDensity) -> Callable[[np.ndarray], float]:
    """The likelihood with pyMechT's planar biaxial sample, GOH fibres and neo-Hookean matrix.

    Points are those of :class:`NaturalDensity`; pyMechT has no mounting stretch, so the total
    stretches are handed to it.
    """
    import pymecht

    problem = density.problem
    measured = np.column_stack([np.sqrt(problem.X), np.sqrt(problem.Y)])
    readings = np.column_stack([problem.fx, problem.fy])
    weight = float(np.mean(problem.beta))

    def log_density(x: np.ndarray) -> float:
        C1, k1, k2, alpha, kappa, lx, ly, w = x
        c, s = np.cos(alpha), np.sin(alpha)
        fibres = pymecht.GOH([np.array([c, s, 0.0]), np.array([c, -s, 0.0])])
        material = pymecht.MatModel(fibres, pymecht.NH())
        sample = pymecht.PlanarBiaxialExtension(material)
        parameters = sample.parameters
        names = list(parameters.keys())
        # one family of ours carries k1 each way, as theirs; NH: W = mu / 2 (I1 - 3)
        values = {"k1": k1, "k2": k2, "k3": kappa, "mu": 2.0 * C1}
        for name in names:
            stem = name.split("_")[0]
            if stem in values:
                parameters.set(name, values[stem])
        stress = np.asarray(sample.disp_controlled(measured * (lx, ly), parameters))
        section = problem.area * (1.0 if problem.mounted else 1.0 / np.array([lx, ly]))
        residual = readings - section * stress.reshape(-1, 2) / measured
        return weight * float((-0.5 * (residual / w) ** 2 - np.log(w)).sum())

    return log_density


def seconds_of(code: Callable[[np.ndarray], float], points: np.ndarray, *, least: float) -> float:
    """Seconds an evaluation, over the points as often as it takes."""
    for point in points[:2]:
        code(point)
    done, clock = 0, time.perf_counter()
    while (spent := time.perf_counter() - clock) < least:
        code(points[done % len(points)])
        done += 1
    return spent / done
