"""Virtual specimens of the paper and the two numbers it judges fits by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from biaxbayes.laws.goh import GOH
from biaxbayes.laws.published import MATERIALS
from biaxbayes.mechanics.virtual_test import simulate_smooth_misfit, virtual_test
from biaxbayes.specimens.specimen import Protocol, Specimen

PRESTRETCHES = ("1.005", "1.010", "1.015", "1.020")
EDGE_MM = 20.0
ROWS = 101  # the mounted state and a hundred increments


def theta(material: GOH) -> np.ndarray:
    """(C1 kPa, k1 kPa, k2, alpha deg, kappa)."""
    return np.array(material.values)


def virtual_specimen(
    material: GOH,
    mounting: tuple[float, float],
    *,
    total: float | None = None,
    measured: float | None = None,
    thickness_mm: float = 1.35,
    name: str = "virtual",
) -> Specimen:
    """A noise-free equibiaxial test written as a force specimen.

    The thickness scales every force and no fitted parameter as long as nothing is noisy.
    """
    test = virtual_test(
        material,
        mounting_stretch=mounting,
        total_stretch=total,
        measured_stretch=measured,
        increments=ROWS - 1,
        thickness_mm=thickness_mm,
    )
    protocol = Protocol("1", *test.measured.T, *test.force_N.T)
    return Specimen(
        name,
        (protocol,),
        "force",
        edge_x_mm=EDGE_MM,
        edge_y_mm=EDGE_MM,
        thickness_mm=thickness_mm,
        load_noise=0.0,
    )


def table6_specimen(name: str) -> Specimen:
    """Noise-free virtual specimen of a printed ``fip`` row of Table 6."""
    row = MATERIALS[name]
    return virtual_specimen(
        row.material,
        row.mounting_stretch,
        measured=row.measured_stretch,
        thickness_mm=row.thickness_mm or 1.0,
        name=name,
    )


def noisy(
    specimen: Specimen, rng: np.random.Generator, *, noise_N: float = 6e-4, misfit: float = 0.02
) -> Specimen:
    """Load-cell noise and a smooth model error in proportion to the load."""
    protocols = []
    for p in specimen.protocols:
        path = p.stretch_x
        loads = [
            load * (1.0 + simulate_smooth_misfit(path, misfit, rng))
            + noise_N * rng.standard_normal(p.rows)
            for load in (p.load_x, p.load_y)
        ]
        protocols.append(replace(p, load_x=loads[0], load_y=loads[1]))
    return replace(specimen, protocols=tuple(protocols), load_noise=noise_N)


def total_path(mounting: tuple[float, float], *, total=None, measured=None) -> np.ndarray:
    """True total stretches of the test, shape (2, rows)."""
    lm = np.array(mounting)[:, None]
    top = np.full((2, 1), total) / lm if measured is None else np.full((2, 1), measured)
    return lm * (1.0 + np.linspace(0.0, 1.0, ROWS) * (top - 1.0))


def r2_truth(material: GOH, truth: GOH, path: np.ndarray) -> float:
    """R2 of a material's Cauchy stress against the true one at the true stretch.

    Both directions pooled with one mean, as the paper's tables turn out to do.
    """
    true = np.array(truth.cauchy(*path))
    miss = true - np.array(material.cauchy(*path))
    return float(1.0 - (miss**2).sum() / ((true - true.mean()) ** 2).sum())


def mae(values, truth) -> float:
    """Mean absolute error of the parameters relative to the truth, Eq. 8, in 1e-3."""
    values, truth = np.asarray(values), np.asarray(truth)
    return float(1e3 * np.mean(np.abs((truth - values) / truth)))
