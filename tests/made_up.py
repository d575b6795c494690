"""Results that are made up, for pages and tables of several specimens, runs or laws."""

from dataclasses import replace

import numpy as np
import pandas as pd

from biaxbayes.comparison.law_comparison import (
    WHOLE,
    Prediction,
    left_out_parts,
    predicted_readings,
    without,
)
from biaxbayes.laws.goh import GOH
from biaxbayes.model.posterior import Posterior
from biaxbayes.studies.study_result import STUDY_COLUMNS
from quick_posteriors import specimen as specimen_of

SOFT, STIFF = GOH(10.0, 40.0, 8.0, 40.0, 0.1), GOH(25.0, 40.0, 8.0, 40.0, 0.1)

LAYERS = ("intima", "media", "<b>adventitia</b>")
QUANTITIES = {
    "C1": ("kPa", 10.0, "log"),
    "k1": ("kPa", 50.0, "log"),
    "k2": ("1", 12.0, "log"),
    "alpha": ("deg", 40.0, "linear"),
    "kappa": ("1", 0.15, "linear"),
    "mounting_stretch_x": ("1", 1.02, "linear"),
    "noise_sd": ("N", 0.002, "log"),
    "Hx": ("1", 0.4, "linear"),
    "stiffness_x at 1": ("kPa", 60.0, "log"),
}
VERDICTS = ("identified", "only in combination", "bounded", "not identified", "fixed")


def table(count: int) -> pd.DataFrame:
    rng = np.random.default_rng(3)
    rows = []
    for n in range(count):
        head = {
            "specimen": f"<img src=x onerror=alert(1)> {n}" if n == 1 else f"specimen {n}",
            "donor": f"D{n // 3} $x_1$ \N{RIGHT-TO-LEFT OVERRIDE}",
            "layer": LAYERS[n % 3],
            "file": f"s{n}.csv",
            "folder": f"runs/s{n}",
            "state": "tentative" if n == 4 else "converged",
            "reason": "",
        }
        if n == 2:
            failed = {"state": "failed", "reason": "s2.csv: is no table & <worse>"}
            rows.append(head | failed | {"kind": "parameter", "quantity": "C1"})
            continue
        for k, (name, (unit, middle, scale)) in enumerate(QUANTITIES.items()):
            low, median, high = np.sort(middle * np.exp(rng.normal(0.0, 0.2, 3)))
            curve = name in ("Hx", "stiffness_x at 1")
            verdict = "" if name == "noise_sd" else VERDICTS[(n + k) % len(VERDICTS)]
            rows.append(
                head
                | {"kind": "curve" if curve else "parameter", "quantity": name, "unit": unit}
                | {"verdict": "identified" if curve else verdict, "scale": scale}
                | {"q05": low, "q50": median, "q95": high, "scale_sd": 0.1}
            )
    return pd.DataFrame(rows, columns=list(STUDY_COLUMNS))


SD = 0.002


def predicted(geometry="unloaded", increments=8, **states):
    """Two laws that predict three protocols with one material each, the second 5 % too stiff."""
    made = specimen_of(GOH(14.0, 60.0, 8.0, 38.0, 0.1), increments=increments)
    specimen = replace(made, geometry=geometry)
    result = {}
    for law, k1, kappa in (("goh", 60.0, {"kappa": 0.1}), ("hgo", 63.0, {})):
        values = {"C1": 14.0, "k1": k1, "k2": 8.0, "alpha": 38.0, "noise_sd": SD, **kappa}
        values |= {"mounting_stretch_x": 1.01, "mounting_stretch_y": 1.02}
        state = states.get(law, "converged")
        reason = "" if state == "converged" else f"{state} for a reason"
        rmse_kPa = 0.1 if law == "goh" else 0.2
        table = pd.DataFrame([values] * 20)
        for part in (None, *left_out_parts(specimen)):
            shown = specimen if part is None else without(specimen, part)
            posterior = Posterior(shown, law=law, noise="independent")
            readings = (
                None if part is None else predicted_readings(posterior, table, specimen, part)
            )
            name = WHOLE if part is None else part.name
            result[law, name] = Prediction(state, reason, rmse_kPa, table, readings)
    return specimen, result
