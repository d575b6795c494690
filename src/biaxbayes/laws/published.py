"""Published GOH materials by name.

Values are facts from Math. Comput. Appl. 2024, 29(4), 55: the two literature materials of
Table 1 and the fitted rows of Tables 5 and 6, with the test conditions of Table 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from biaxbayes.laws.goh import GOH


@dataclass(frozen=True)
class PublishedMaterial:
    """A material with the test that it was determined from; None where the paper prints nothing."""

    material: Any
    source: str
    mounting_stretch: tuple[float, float] = (1.0, 1.0)
    thickness_mm: float | None = None
    measured_stretch: float | None = None


_TABLE1 = {
    "smoljkic-m55": (59.7, 36.3, 11.38, 58.9, 0.243),
    "weisbecker-media": (14.0, 140.0, 11.90, 38.4, 0.210),
}
_TABLE5 = {
    "sheep1-linden": (5.1, 20.2, 2.110, 89.98, 0.263, 1.077, 1.058),
    "sheep1-fip": (5.1, 20.1, 2.154, 85.76, 0.263, 1.077, 1.059),
    "sheep2-linden": (8.0, 43.5, 1.057, 90.0, 0.295, 1.063, 1.042),
    "sheep2-fip": (8.0, 44.0, 1.138, 90.0, 0.298, 1.060, 1.044),
    "sheep3-linden": (1.0, 18.6, 0.029, 46.86, 0.059, 1.066, 1.043),
    "sheep3-fip": (2.4, 21.3, 0.039, 46.60, 0.120, 1.056, 1.052),
    "sheep4-linden": (6.8, 41.0, 0.322, 90.0, 0.277, 1.074, 1.037),
    "sheep4-fip": (6.7, 41.7, 0.281, 90.0, 0.279, 1.075, 1.039),
    "sheep5-linden": (4.4, 19.9, 0.538, 54.39, 0.096, 1.092, 1.027),
    "sheep5-fip": (3.8, 18.8, 0.475, 54.00, 0.067, 1.104, 1.021),
}
# Table 6 with the thickness (mm) and the measured stretch of Table 2
_TABLE6 = {
    "donor1": (12.21, 0.37, 31.35, 60.88, 0.0, 1.003, 1.028, 1.93, 1.15),
    "donor2": (25.87, 39.78, 139.88, 90.0, 0.241, 1.009, 1.016, 1.35, 1.15),
    "donor2-intima": (2.14, 26.88, 268.30, 90.0, 0.206, 1.017, 1.004, 0.27, 1.05),
    "donor2-media": (2.98, 12.47, 1.88, 39.00, 0.0, 1.009, 1.010, 0.88, 1.20),
    "donor2-adventitia": (2.10, 0.41, 23.85, 51.21, 0.0, 1.009, 1.019, 0.54, 1.15),
}

MATERIALS: dict[str, PublishedMaterial] = {
    **{n: PublishedMaterial(GOH(*v), "Table 1") for n, v in _TABLE1.items()},
    **{n: PublishedMaterial(GOH(*v[:5]), "Table 5", (v[5], v[6])) for n, v in _TABLE5.items()},
    **{
        n: PublishedMaterial(GOH(*v[:5]), "Table 6, fip", (v[5], v[6]), *v[7:])
        for n, v in _TABLE6.items()
    },
}
"""Name to material; rows of Table 6 are those of the method that infers the prestretch."""
