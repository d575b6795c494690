"""Make the specimens of the benchmark, their truths and their held-out paths.

    python benchmark/make.py

Squares and strips come from the generator of the study of coverage, whose stresses, roots and
misfits share no code with biaxbayes; the tube is one of ``biaxbayes.virtual_specimen``. The seeds
were written down before anything was fitted and have not been changed since.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "scripts"))

from biaxbayes import GOH, write_specimen
from biaxbayes.specimens.virtual_specimen import virtual_inflation
from studies.coverage import specimens as virtual

SQUARES = [
    (protocols, family)
    for protocols, families in {
        1: ("noise-0.5", "misfit-0.25", "misfit-1", "toe", "plane", "four-fibre", "fung"),
        3: (
            *("noise-0.5", "misfit-0.25", "alike", "toe", "plane", "gain"),
            *("exponent-2.6", "four-fibre", "recruited", "far-layers"),
        ),
    }.items()
    for family in families
]
"""Protocols and kind of each square: load noise alone, a misfit, or tissue of another law."""
LABELS = ["{:g}to{:g}".format(*ratio) for ratio in virtual.RATIOS]
FORCES = ("force_x_N", "force_y_N")
STRIPS = ("misfit-0.25", "gain")
FIRST_SEED = 7001
HELD_OUT_ROWS = slice(3, None, 4)
STIFFNESS_SD = 0.1
"""Of the log of a strip's stiffness over that of the square, as pieces of one tissue differ."""


def drawn_tissue(family: str, rng: np.random.Generator) -> virtual.Tissue:
    """A tissue that can be tested as planned."""
    kind, far = family.removeprefix("far-"), family in virtual.FAR
    while True:
        try:
            other = kind in virtual.TISSUES
            made = virtual.other_tissue(rng, kind, far=far) if other else virtual.goh_tissue(rng)
            virtual.check_tissue(made)
            return made
        except (virtual.Unsuitable, np.linalg.LinAlgError):
            continue


def square(name: str, family: str, protocols: int, tissue: Any, rng: np.random.Generator) -> dict:
    """Write a square and return its truth; the last path, which the file lacks, is held out."""
    edges, thickness = rng.uniform(9.0, 11.0, 2), float(rng.uniform(0.8, 1.2))
    section = edges[::-1] * thickness * 1e-3  # N / kPa
    ratios = (*virtual.RATIOS[:protocols], virtual.LEFT_OUT)
    paths = [virtual.stretches(tissue.strain, ratio) for ratio in ratios]
    errors = virtual.misfits(family, paths, rng) or [np.zeros(p.shape) for p in paths]
    loads = [tissue.load(p) * (1.0 + e) for p, e in zip(paths, errors, strict=True)]
    share = virtual.NOISES.get(family, virtual.NOISE)
    sd = share * max(float((load * section).max()) for load in loads[:-1])
    readings = [load * section + sd * rng.standard_normal(load.shape) for load in loads]
    head = {"edge_x_mm": edges[0], "edge_y_mm": edges[1], "thickness_mm": thickness}
    measured = [np.hstack(pair) for pair in zip(paths[:-1], readings[:-1], strict=True)]
    write(name, head | {"load_noise_N": sd}, ["stretch_x", "stretch_y", *FORCES], measured)
    mounting = zip(("mounting_stretch_x", "mounting_stretch_y"), tissue.mounting, strict=True)
    return {
        "family": family,
        "files": [f"{name}.csv"],
        "parameters": tissue.parameters | {n: float(v) for n, v in mounting},
        "held_out": held_out(paths[-1], loads[-1]),
    }


def strip(name: str, axis: int, tissue: Any, rng: np.random.Generator) -> str:
    """Write a strip along x or y with a mounting stretch and a stiffness of its own."""
    width, thickness = 3.0, float(rng.uniform(0.8, 1.2))
    lm, stiffness = 1.0 + rng.uniform(0.01, 0.04), np.exp(STIFFNESS_SD * rng.standard_normal())
    stretch = 1.0 + 1.2 * tissue.strain * np.linspace(0.0, 1.0, virtual.ROWS)

    def total(along: float, across: float) -> np.ndarray:
        return np.array([[along, across] if axis == 0 else [across, along]])

    def load(along: float) -> float:
        def free_side(across: float) -> float:
            return float(virtual.piola(tissue.energy, total(along, across))[0, 1 - axis])

        across = brentq(free_side, 0.4, 1.2, xtol=1e-13)
        return float(virtual.piola(tissue.energy, total(along, across))[0, axis])

    s = np.linspace(0.0, 1.0, virtual.ROWS)[:, None]
    error = virtual.MISFIT * virtual.gaussian_process(s, 0.25, rng)
    force = stiffness * np.array([load(lm * v) for v in stretch]) * width * thickness * 1e-3
    force = force * (1.0 + error)
    sd = virtual.NOISE * force.max()
    force = force + sd * rng.standard_normal(len(force))
    letter, side = "xy"[axis], "yx"[axis]
    head = {"test": f"strip {letter}", f"edge_{side}_mm": width, "thickness_mm": thickness}
    columns = [f"stretch_{letter}", f"force_{letter}_N"]
    write(name, head | {"load_noise_N": sd}, columns, [np.column_stack([stretch, force])])
    return f"{name}.csv"


def write(name: str, head: dict[str, Any], columns: list[str], tables: list[np.ndarray]) -> None:
    """Write a specimen file of protocols with these columns; dimensions are unloaded ones."""
    head = {"specimen": name, "geometry": "unloaded"} | head
    lines = [f"# {k}: {v if isinstance(v, str) else format(v, '.6g')}" for k, v in head.items()]
    lines.append(",".join(["protocol", *columns]))
    for label, table in zip(LABELS, tables, strict=False):
        lines += [",".join([label, *(f"{v:.8g}" for v in row)]) for row in table]
    path = HERE / "specimens" / f"{name}.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def tube(name: str, seed: int) -> dict:
    """Write a tube at two axial stretches; nominal wall stresses at a third one are held out."""
    material = GOH(C1_kPa=12.0, k1_kPa=35.0, k2=6.0, alpha_deg=42.0, kappa=0.12)
    specimen, _ = virtual_inflation(
        material, "tube", name=name, thickness_mm=0.9,
        header={"unloaded_outer_diameter_mm": 8.0, "missing_sector_deg": 120.0},
        largest_stretch=1.3, axial_stretches=(1.15, 1.3), increments=60,
        noise={"kPa": 0.05, "N": 0.003}, misfit=virtual.MISFIT, seed=seed,
    )  # fmt: skip
    write_specimen(specimen, HERE / "specimens" / f"{name}.csv")
    around = np.linspace(1.02, 1.25, 100)
    path = np.column_stack([around, np.full(100, 1.22)])
    values = {"C1": 12.0, "k1": 35.0, "k2": 6.0, "alpha": 42.0, "kappa": 0.12}
    load = np.column_stack(material.piola(*path.T))
    return {
        "family": "tube",
        "files": [f"{name}.csv"],
        "parameters": values,
        "held_out": held_out(path, load),
    }


def held_out(path: np.ndarray, load: np.ndarray) -> dict[str, list[list[float]]]:
    """Stretches and nominal stresses (kPa) of a path."""
    return {
        "stretch": path[HELD_OUT_ROWS].round(8).tolist(),
        "piola_kPa": load[HELD_OUT_ROWS].round(6).tolist(),
    }


def main() -> None:
    """Write all specimens, ``truth.json`` and ``held-out.csv``."""
    (HERE / "specimens").mkdir(exist_ok=True)
    truths: dict[str, dict[str, Any]] = {}
    plans = [(*plan, False) for plan in SQUARES] + [(1, family, True) for family in STRIPS]
    for number, (protocols, family, strips) in enumerate(plans, start=1):
        rng = np.random.default_rng(FIRST_SEED + number)
        tissue = drawn_tissue(family, rng)
        name = f"{number:02}-{'strips' if strips else protocols}-{family}"
        truths[name] = square(name, family, protocols, tissue, rng)
        if strips:
            files = [strip(f"{name}-strip-{'xy'[k]}", k, tissue, rng) for k in (0, 1)]
            truths[name]["files"] += files
    name = f"{len(plans) + 1:02}-tube"
    truths[name] = tube(name, FIRST_SEED + len(plans) + 1)
    rows = [
        {"specimen": name, "row": row, "stretch_x": x, "stretch_y": y}
        for name, truth in truths.items()
        for row, (x, y) in enumerate(truth["held_out"]["stretch"])
    ]
    pd.DataFrame(rows).to_csv(HERE / "held-out.csv", index=False, lineterminator="\n")
    (HERE / "truth.json").write_text(json.dumps(truths, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
