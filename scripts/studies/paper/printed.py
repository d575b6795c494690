"""The paper's tables as printed, digits and all; text, so that a printed 1.10 stays 1.10."""

from __future__ import annotations

from dataclasses import dataclass

PARAMETERS = ("C1", "k1", "k2", "alpha", "kappa")


def unit(printed: str) -> float:
    """One unit of the last printed digit."""
    return 10.0 ** -len(printed.partition(".")[2])


@dataclass(frozen=True)
class Row:
    """A printed row: texts of C1, k1, k2, alpha, kappa; what follows depends on the table."""

    method: str
    theta: tuple[str, ...]
    mounting: tuple[str, ...] = ()
    mae: str = ""
    r2: str = ""

    @property
    def values(self) -> tuple[float, float, float, float, float]:
        """The five parameters as numbers."""
        C1, k1, k2, alpha, kappa = (float(text) for text in self.theta)
        return C1, k1, k2, alpha, kappa

    @property
    def mounting_stretch(self) -> tuple[float, float]:
        """The mounting stretches as numbers."""
        return float(self.mounting[0]), float(self.mounting[1])


def _rows(text: str) -> dict[tuple[str, str], Row]:
    """Lines of ``method prestretch C1 k1 k2 alpha kappa MAE R2``."""
    rows = {}
    for line in text.strip().splitlines():
        method, prestretch, *theta, mae, r2 = line.split()
        rows[method, prestretch] = Row(method, tuple(theta), mae=mae, r2=r2)
    return rows


TRUTH = {
    "smoljkic-m55": ("59.7", "36.3", "11.38", "58.9", "0.243"),
    "weisbecker-media": ("14.0", "140", "11.90", "38.4", "0.210"),
}

VIRTUAL = {
    "smoljkic-m55": _rows("""
        standard 1.005 64.9 2.47 8.12 56.9 0 467.9 0.993
        standard 1.010 69.3 1.62 16.3 90.0 0.1 533.0 0.970
        standard 1.015 71.9 2.6 1.23 90.0 0 710.5 0.879
        standard 1.020 74.6 2.89 0 90.0 0 739.6 0.868
        zeroed 1.005 58.7 39.9 12.06 59.0 0.246 37.9 0.999
        zeroed 1.010 57.7 43.7 12.77 59.1 0.248 76.7 0.998
        zeroed 1.015 56.7 47.7 13.54 59.2 0.250 117.6 0.997
        zeroed 1.020 55.8 51.9 14.36 59.3 0.251 159.3 0.995
    """),
    "weisbecker-media": _rows("""
        standard 1.005 10.3 43.9 4.93 41.45 0 523.2 0.981
        standard 1.010 14.3 41.1 5.57 41.16 0 466.3 0.916
        standard 1.015 18.4 38.3 6.30 40.84 0 515.0 0.781
        standard 1.020 22.7 35.6 7.12 40.48 0 564.6 0.537
        zeroed 1.005 14.0 147.9 12.49 38.47 0.209 22.5 0.987
        zeroed 1.010 14.6 157.6 13.21 38.49 0.209 57.2 0.932
        zeroed 1.015 14.2 169.4 14.07 38.48 0.211 82.7 0.852
        zeroed 1.020 14.4 183.7 15.11 38.41 0.214 125.9 0.701
    """),
}
"""Tables 3 and 4, by material; keys (method, printed prestretch)."""


def _specimens(text: str) -> dict[str, dict[str, Row]]:
    """Lines of ``specimen method C1 k1 k2 alpha kappa lm_x lm_y R2``; a dash is no entry."""
    found: dict[str, dict[str, Row]] = {}
    for line in text.strip().splitlines():
        name, method, *theta, lm_x, lm_y, r2 = line.split()
        mounting = () if lm_x == "-" else (lm_x, lm_y)
        found.setdefault(name, {})[method] = Row(method, tuple(theta), mounting, r2=r2)
    return found


TABLE5 = _specimens("""
    1 linden 5.1 20.2 2.110 89.98 0.263 1.077 1.058 -
    1 fip 5.1 20.1 2.154 85.76 0.263 1.077 1.059 -
    2 linden 8.0 43.5 1.057 90.00 0.295 1.063 1.042 -
    2 fip 8.0 44.0 1.138 90.00 0.298 1.060 1.044 -
    3 linden 1.0 18.6 0.029 46.86 0.059 1.066 1.043 -
    3 fip 2.4 21.3 0.039 46.60 0.120 1.056 1.052 -
    4 linden 6.8 41.0 0.322 90.00 0.277 1.074 1.037 -
    4 fip 6.7 41.7 0.281 90.00 0.279 1.075 1.039 -
    5 linden 4.4 19.9 0.538 54.39 0.096 1.092 1.027 -
    5 fip 3.8 18.8 0.475 54.00 0.067 1.104 1.021 -
""")

TABLE6 = _specimens("""
    donor1 standard 14.51 4.255 127.87 90.00 0.210 - - <0
    donor1 zeroed 11.55 0.768 39.07 61.00 0 - - <0
    donor1 fip 12.21 0.37 31.35 60.88 0 1.003 1.028 0.99
    donor2 standard 30.53 57.85 171.20 90.00 0.239 - - <0
    donor2 zeroed 24.90 65.80 174.57 90.00 0.243 - - <0
    donor2 fip 25.87 39.78 139.88 90.00 0.241 1.009 1.016 0.99
    donor2-intima standard 3.78 4.68 76.73 90.00 0.003 - - <0
    donor2-intima zeroed 2.13 39.65 374.63 90.00 0.221 - - 0.87
    donor2-intima fip 2.14 26.88 268.30 90.00 0.206 1.017 1.004 0.99
    donor2-media standard 5.28 10.21 2.57 37.74 0 - - 0.96
    donor2-media zeroed 2.78 13.35 2.06 39.26 0 - - 0.98
    donor2-media fip 2.98 12.47 1.88 39.00 0 1.009 1.010 0.99
    donor2-adventitia standard 2.70 0.41 31.04 52.40 0 - - <0
    donor2-adventitia zeroed 1.99 0.62 27.77 51.32 0 - - <0
    donor2-adventitia fip 2.10 0.41 23.85 51.21 0 1.009 1.019 0.99
""")
