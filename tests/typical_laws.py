"""Materials of every law, for tests that need some."""

import numpy as np

from biaxbayes.laws import law_named
from biaxbayes.laws.materials import cauchy_stress, squared_stretches


def stress_at_point(law, point, stretch_x, stretch_y):
    """Cauchy stresses at fit coordinates and total stretches."""
    squared = squared_stretches(stretch_x, stretch_y)
    return cauchy_stress(law.constants_from_fit(*point), *squared)


STRESSES = [
    # law, parameters, stretches, Cauchy stress in kPa, by complex step of the energy
    ("goh", (3.82, 996.6, 524.6, 49.98, 0.226), (1.1, 1.05), (470.86264, 510.21336)),
    ("goh", (1.5, 2.3632, 0.8393, 29.0, 0.0), (1.2, 1.2), (8.263157, 4.529338)),
    ("goh-exponential", (5.0, 8.0, 40.0, 6.0, 35.0, 0.1), (1.1, 1.1), (30.14671, 21.68879)),
    ("goh-exponential", (5.0, 8.0, 40.0, 6.0, 35.0, 0.1), (1.2, 1.1), (105.68881, 62.25862)),
    ("hgo", (1.5, 2.3632, 0.8393, 29.0), (1.2, 1.2), (8.263157, 4.529338)),
    ("holzapfel-2005", (1.27, 21.60, 8.21, 20.61, 0.25), (1.1, 1.1), (21.58439, 4.977273)),
    ("may-newman", (0.0, 10.0, 10.0, 10.0, 0.0), (1.2, 1.1), (6.829236, 4.779061)),
    ("fung", (10.0, 5.0, 8.0, 5.0, 2.0), (1.1, 1.1), (18.20173, 15.90313)),
    ("fung", (10.0, 5.0, 8.0, 5.0, 2.0), (1.2, 1.1), (41.53337, 22.68735)),
    (
        "four-fibre",
        (18.536, 16.593, 0.108, 25.37, 0.036, 0.078, 1.719, 61.2146),
        (1.2, 1.2),
        (28.52023, 34.04556),
    ),
    (
        "four-fibre",
        (18.536, 16.593, 0.108, 25.37, 0.036, 0.078, 1.719, 61.2146),
        (1.4, 1.6),
        (70.36408, 168.36646),
    ),
    (
        "four-fibre",
        (20.652, 7.593, 1.285, 1.074, 3.821, 0.109, 7.154, 55.2902),
        (1.2, 1.2),
        (26.12810, 21.57816),
    ),
    ("lee-sacks", (5.0, 10.0, 10.0, 6.0, 0.4, 35.0), (1.2, 1.1), (90.485174, 48.330623)),
    ("lee-sacks", (0.0, 10.0, 10.0, 10.0, 0.5, 0.0), (1.1, 1.1), (45.53019, 6.036425)),
]
TYPICAL = {law: parameters for law, parameters, _, _ in reversed(STRESSES)} | {
    "may-newman": (8.0, 10.0, 4.0, 60.0, 30.0)
}
"""Values of each law's parameters, for tests that need some."""
RECOVERED = TYPICAL | {
    "goh": (9.0, 20.0, 4.0, 42.0, 0.15),
    "four-fibre": (18.0, 16.0, 3.0, 25.0, 2.0, 40.0, 6.0, 40.0),
}
"""The same for tests that stretch as far as soft tissue does."""


def random_materials(name: str, size: int) -> list:
    """Materials around the typical one, a factor of two and more either way."""
    law, rng = law_named(name), np.random.default_rng(3)
    made = []
    while len(made) < size:
        values = []
        for p, v in zip(law.parameters, TYPICAL[name], strict=True):
            if p.logarithmic:
                values.append(v * float(np.exp(0.5 * rng.standard_normal())))
            elif p.bounded:
                values.append(float(rng.uniform(p.low, p.high)))
            else:
                values.append(v * float(rng.uniform(-1.0, 1.0)))
        if law.is_admissible(dict(zip(law.names, values, strict=True))):
            made.append(law.material_at(values))
    return made
