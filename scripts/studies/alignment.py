"""What GOH becomes if the axes of the machine are not those of the tissue, and no shear is read.

    python scripts/study.py alignment [--quick]

`check` and docs/model.md quote the table: medians of least-squares fits to three
protocols of tissues whose fibre families lie at phi +- alpha to the machine's x, under diagonal
deformations, with noise of 0.2 % of the largest load.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.specimens.specimen import Specimen
from studies.common import options_of, parser, print_table

TISSUES, TURNED_DEG, NOISE = 12, (0.0, 5.0, 10.0), 0.002
RATIOS = [(1.0, 1.0), (1.0, 0.5), (0.5, 1.0)]


def turned_nominal(
    material: biaxbayes.GOH, total: np.ndarray, turned_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal stresses in x and y at total stretches (n, 2), kPa; the shear stress is not read."""
    x, y = total.T
    X, Y, Z = x**2, y**2, 1.0 / (x * y) ** 2
    C1, k1, k2, alpha, kappa = material.values
    sx, sy = 2.0 * C1 * (X - Z), 2.0 * C1 * (Y - Z)
    for angle in np.radians([turned_deg + alpha, turned_deg - alpha]):
        c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
        # W = k1 / (2 k2) (exp(k2 E^2) - 1),  E = kappa (I1 - 3) + (1 - 3 kappa) (I4 - 1)
        E = kappa * (X + Y + Z - 3.0) + (1.0 - 3.0 * kappa) * (c2 * X + s2 * Y - 1.0)
        by_E = 2.0 * k1 * E * np.exp(k2 * E**2)
        sx = sx + by_E * (kappa * (X - Z) + (1.0 - 3.0 * kappa) * c2 * X)
        sy = sy + by_E * (kappa * (Y - Z) + (1.0 - 3.0 * kappa) * s2 * Y)
    return sx / x, sy / y


def turned_specimen(
    material: biaxbayes.GOH, mounting: np.ndarray, turned_deg: float, seed: int
) -> Specimen:
    """Three protocols of a tissue that is turned in the machine."""
    made, _ = biaxbayes.simulate(
        material=material, prestretch=tuple(mounting), measured_stretch=1.2, ratios=RATIOS,
        increments=40, noise_N=0.001,
    )  # fmt: skip
    loads = [
        np.column_stack(turned_nominal(material, p.stretch * mounting, turned_deg)) * made.area
        for p in made.protocols
    ]
    noise = NOISE * max(float(np.abs(load).max()) for load in loads)
    rng = np.random.default_rng(seed)
    noisy = [load + noise * rng.normal(size=load.shape) for load in loads]
    protocols = tuple(
        replace(p, load_x=load[:, 0], load_y=load[:, 1])
        for p, load in zip(made.protocols, noisy, strict=True)
    )
    return replace(made, protocols=protocols, load_noise=noise)


def fitted(tissue: int, turned_deg: float) -> dict[str, float]:
    """Errors of the parameters of GOH fitted to one turned tissue."""
    rng = np.random.default_rng(tissue)
    C1, k1, k2 = (m * np.exp(s * rng.normal()) for m, s in ((10.0, 0.3), (30.0, 0.5), (8.0, 0.4)))
    material = biaxbayes.GOH(C1, k1, k2, rng.uniform(20.0, 70.0), rng.uniform(0.02, 0.2))
    mounting = rng.uniform(1.0, 1.05, 2)
    specimen = turned_specimen(material, mounting, turned_deg, tissue)
    fit = biaxbayes.fit(specimen)
    found = dict(zip(("C1", "k1", "k2", "alpha", "kappa"), fit.material.values, strict=True))
    return {
        "turned_deg": turned_deg,
        "k1_ratio": found["k1"] / k1,
        "k2_ratio": found["k2"] / k2,
        "kappa_error": found["kappa"] - material.values[4],
        "alpha_error_deg": abs(found["alpha"] - material.values[3]),
        "stretch_error": float(np.abs(fit.mounting_stretch - mounting).max()),
        "misfit_per_noise": fit.rms / specimen.noise_sd,
    }


def main() -> None:
    """Fit every tissue at every angle, and print the medians."""
    options = options_of(parser(__doc__))
    tissues = range(3 if options.quick else TISSUES)
    errors = pd.DataFrame([fitted(t, turned) for turned in TURNED_DEG for t in tissues])
    print_table(
        f"medians of {len(tissues)} tissues", errors.groupby("turned_deg").median().reset_index()
    )
