"""What strips of the same tissue add to a square: coverage, widths, identified parameters.

    python scripts/study.py pieces --workers 2

Virtual tissues with stresses and roots of their own, apart from the package: GOH drawn around soft
arteries, a misfit of 2 % in every curve, each piece with its own mounting stretch, and the
stiffnesses of strips off by factors of 10 %. The same tissues are tested as a square, as a square
with two strips, by three biaxial protocols, and by these with strips. The misfit is a smooth
random process or, in every other tissue, none: a polynomial, a wrong gain, or friction. Factors of
25 % are sampled with the 10 % that the prior states. Pieces left out are predicted from the others.
``docs/pieces.md`` quotes the tables.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from biaxbayes.errors import BiaxbayesError
from biaxbayes.forward import ForwardModel
from biaxbayes.identifiability.identify import identify_draws
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.model.readings import TestedPaths
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from studies.common import options_of, parser, print_table, run_all

FIRST_SEED = 65_000
PLAN = Plan(ess=150, max_steps=1500, ensembles=2, walkers=32, population=2048, first_block=64)
MISFIT, NOISE, PIECE_SD, ROWS = 0.02, 0.0015, 0.1, 40
MISFITS = ("process", "polynomial", "process", "gain", "process", "friction")
LENGTHS = (0.15, 0.25, 0.5, 1.0)
RATIOS = ((1.0, 1.0), (1.0, 0.6), (0.6, 1.0))
LEFT_OUT = {"square + strip x": "strip-y", "strips": "square", "three + strips": "tube"}
PARTS = (
    ("square", "square + strips"),
    ("square + strips, 25 %", "square + strip x", "strips"),
    ("three", "three + strips"),
)
"""Cases, in the order in which all tissues go through them."""
TRIAL = ("square", "square + strip x")
MATERIAL = ("C1", "k1", "k2", "alpha", "kappa")
PREDICTIONS = 200


# --- virtual tissues ----------------------------------------------------------------------------


def stresses(material: dict[str, float], x: Any, y: Any) -> tuple[Any, Any]:
    """Cauchy stresses of GOH at total stretches: both fibre families together, no radial stress."""
    c, s = np.cos(np.deg2rad(material["alpha"])) ** 2, np.sin(np.deg2rad(material["alpha"])) ** 2
    kappa, X, Y = material["kappa"], x * x, y * y
    Z = 1.0 / (X * Y)
    # E = kappa I1 + (1 - 3 kappa) I4 - 1
    E = kappa * (X + Y + Z) + (1.0 - 3.0 * kappa) * (c * X + s * Y) - 1.0
    # s = 2 C1 (X - Z) + 4 k1 E exp(k2 E^2) (E_X X - E_Z Z)
    fibre = 4.0 * material["k1"] * E * np.exp(material["k2"] * E * E)
    of_x, of_y = kappa + (1.0 - 3.0 * kappa) * c, kappa + (1.0 - 3.0 * kappa) * s
    matrix = 2.0 * material["C1"]
    return (
        matrix * (X - Z) + fibre * (of_x * X - kappa * Z),
        matrix * (Y - Z) + fibre * (of_y * Y - kappa * Z),
    )


def strip_stress(material: dict[str, float], axis: int, total: float) -> float:
    """Stress of a strip along an axis; its other stretch is the root of the stress across."""

    def both(across: float) -> tuple[Any, Any]:
        return stresses(material, *((total, across) if axis == 0 else (across, total)))

    across = brentq(lambda other: both(other)[1 - axis], 0.3, 1.5, xtol=1e-13)
    return float(both(across)[axis])


def with_misfit(kind: str, load: np.ndarray, root: np.ndarray, rng: np.random.Generator) -> Any:
    """Loads of the law (n, curves) with a misfit of about 2 % (rms)."""
    along, curves = np.linspace(0.0, 1.0, len(load)), load.shape[1]
    if kind == "process":
        return load * (1.0 + MISFIT * root @ rng.standard_normal((len(load), curves)))
    if kind == "polynomial":
        shape = np.polynomial.legendre.legval(
            2.0 * along - 1.0, np.vstack([np.zeros(curves), rng.standard_normal((3, curves))])
        ).T
        return load * (1.0 + MISFIT * shape / np.sqrt(np.mean(shape**2, axis=0)))
    if kind == "gain":
        return load * (1.0 + MISFIT * rng.standard_normal(curves))
    # friction of a carriage adds to the load as soon as it moves
    moves = 1.0 - np.exp(-along / 0.03)
    return load + MISFIT * np.abs(rng.standard_normal(curves)) * load.max(axis=0) * moves[:, None]


@dataclass(frozen=True)
class Tissue:
    """Pieces of one tissue, and their true values by the names that a run gives them."""

    square: Specimen  # of three protocols
    strips: tuple[Specimen, Specimen]
    tube: Specimen
    truth: dict[str, float]
    load: dict[str, np.ndarray]  # of the law alone, by name of the piece, rows (n, 2)
    misfit: str


def virtual_tissue(seed: int, factor_sd: float = PIECE_SD) -> Tissue:
    """A tissue with its pieces; only the stiffnesses of strips depend on ``factor_sd``."""
    rng = np.random.default_rng([seed, 57])
    kind = MISFITS[seed % len(MISFITS)]
    truth = {
        "C1": 8.0 * np.exp(rng.normal(0.0, 0.4)),
        "k1": 30.0 * np.exp(rng.normal(0.0, 0.5)),
        "k2": 8.0 * np.exp(rng.normal(0.0, 0.5)),
        "alpha": rng.uniform(15.0, 75.0),
        "kappa": rng.uniform(0.03, 0.28),
    }
    material = {name: float(value) for name, value in truth.items()}
    top, length = rng.uniform(1.12, 1.2), rng.choice(LENGTHS)
    along = np.linspace(0.0, 1.0, ROWS)
    correlation = np.exp(-0.5 * ((along[:, None] - along) / length) ** 2)
    root = np.linalg.cholesky(correlation + 1e-10 * np.eye(ROWS))
    lm = 1.0 + np.abs(rng.normal(0.015, 0.01, 2))
    truth["mounting_stretch_x"], truth["mounting_stretch_y"] = lm

    edge, thickness = 10.0, rng.uniform(1.0, 1.4)
    stretch, load, read = [], [], []
    for ratio in RATIOS:
        stretch.append(1.0 + along[:, None] * (top - 1.0) * np.array(ratio))
        total = stretch[-1] * lm
        stress = np.column_stack(stresses(material, *total.T))
        load.append(stress / total * edge * thickness * 1e-3)
        read.append(with_misfit(kind, load[-1], root, rng))
    noise = NOISE * float(np.max(read))
    protocols = [
        Protocol(f"{r[0]:g}:{r[1]:g}", *s.T, *(f + noise * rng.standard_normal(f.shape)).T)
        for r, s, f in zip(RATIOS, stretch, read, strict=True)
    ]
    size: dict[str, Any] = {"edge_x_mm": edge, "edge_y_mm": edge, "thickness_mm": thickness}
    square = Specimen("square", tuple(protocols), "force", load_noise=noise, **size)
    loads, strips = {"square": np.concatenate(load)}, []
    for axis, letter in enumerate("xy"):
        name = f"strip-{letter}"
        stiffness = float(np.exp(factor_sd * rng.standard_normal()))
        mounting = 1.0 + abs(rng.normal(0.015, 0.01))
        width, thickness = 3.0, rng.uniform(1.0, 1.4)
        measured = 1.0 + along * 1.2 * (top - 1.0)
        total = measured * mounting
        stress = np.array([strip_stress(material, axis, t) for t in total])
        law = stiffness * stress / total * width * thickness * 1e-3
        force = with_misfit(kind, law[:, None], root, rng)[:, 0]
        noise = NOISE * float(np.max(force))
        columns = np.full((2, ROWS), np.nan), np.zeros((2, ROWS))
        columns[0][axis], columns[1][axis] = measured, force + noise * rng.standard_normal(ROWS)
        size = {f"edge_{'yx'[axis]}_mm": width, "thickness_mm": thickness, "load_noise": noise}
        protocol = Protocol("1", *columns[0], *columns[1])
        strips.append(Specimen(name, (protocol,), "force", test=f"strip {letter}", **size))
        loads[name] = np.zeros((ROWS, 2))
        loads[name][:, axis] = law
        truth[f"stiffness[{name}]"] = stiffness
        truth[f"mounting_stretch_{letter}[{name}]"] = mounting
    known = {name: float(value) for name, value in truth.items()}
    tube, loads["tube"] = virtual_tube(material, top, kind, root, np.random.default_rng([seed, 59]))
    return Tissue(square, (strips[0], strips[1]), tube, known, loads, kind)


def virtual_tube(
    material: dict[str, float],
    top: float,
    kind: str,
    root: np.ndarray,
    rng: np.random.Generator,
) -> tuple[Specimen, np.ndarray]:
    """A tube that is inflated at a length of 1.1, and the pressures of the law alone, rows (n, 2).

    Its outer surface reaches 0.6 times the strain of the square, its inner one about as much.
    """
    outside, wall, axial, count = 5.0, 1.0, 1.1, 400
    around = 1.0 + np.linspace(0.0, 0.6, ROWS) * (top - 1.0)
    # (ro^2 - r^2) lz = B^2 - R^2
    outer = around[:, None] * outside
    inner = np.sqrt(outer**2 - (outside**2 - (outside - wall) ** 2) / axial)
    dr = (outer - inner) / count
    r = inner + dr * (np.arange(count) + 0.5)
    unloaded = np.sqrt(outside**2 - (outer**2 - r**2) * axial)
    # p = int (s_t - s_r) / r dr
    pressure = (stresses(material, r / unloaded, axial)[0] / r * dr).sum(axis=1)
    noise = NOISE * float(pressure.max())
    read = with_misfit(kind, pressure[:, None], root, rng)[:, 0]
    read += noise * rng.standard_normal(ROWS)
    nothing = np.zeros(ROWS)
    protocol = Protocol("1.1", around, np.full(ROWS, axial), read, nothing)
    size = {"unloaded_outer_diameter_mm": 2.0 * outside}
    tube = Specimen(
        "tube",
        (protocol,),
        "pressure",
        test="tube",
        thickness_mm=wall,
        load_noise=noise,
        metadata=size,
    )
    return tube, np.column_stack([pressure, nothing])


def pieces_of(tissue: Tissue, case: str) -> Specimen:
    """What a case knows of a tissue, as one specimen."""
    strip_x, strip_y = tissue.strips
    if case == "tube":
        return tissue.tube
    alone = tissue.square.only(tissue.square.protocols[0].name)
    first = tissue.square if case.startswith("three") else alone
    if case == "strips":
        return replace(strip_x, further=(strip_y,))
    further = {"square": (), "three": (), "square + strip x": (strip_x,)}
    return replace(first, further=further.get(case, tissue.strips))


# --- one case -----------------------------------------------------------------------------------


def one_case(case: str, seed: int) -> dict[str, Any]:
    """Intervals, verdicts and predictions of one case of one tissue."""
    tissue = virtual_tissue(seed, 0.25 if "25" in case else PIECE_SD)
    clock = time.perf_counter()
    try:
        posterior = prepare(pieces_of(tissue, case))
        draws = draw_posterior(posterior, PLAN)
    except BiaxbayesError as error:
        return {"state": str(error), "misfit": tissue.misfit, "rows": []}
    state = draws.convergence.state
    record: dict[str, Any] = {"state": state, "misfit": tissue.misfit}
    record["seconds"] = time.perf_counter() - clock
    table = pd.DataFrame({name: q.ravel() for name, q in draws.quantities.items()})
    verdicts = {r.name: r.verdict for r in identify_draws(posterior, table, state).reported}
    rows, truth = [], tissue.truth
    if case == "strips":  # stresses are those of the first piece
        stiffness = truth["stiffness[strip-x]"]
        truth = truth | {name: stiffness * truth[name] for name in ("C1", "k1")}
    for name, true in truth.items():
        # of strips alone the first piece has no stiffness; the square's names are not its own
        if name not in table or (case == "strips" and name not in MATERIAL):
            continue
        low, median, high = np.quantile(table[name], [0.05, 0.5, 0.95])
        row = {"parameter": name, "truth": true, "low": low, "median": median, "high": high}
        rows.append(row | {"verdict": verdicts.get(name, "")})
    if case in LEFT_OUT:
        record |= left_out(posterior, draws, tissue, LEFT_OUT[case], seed)
    return record | {"rows": rows}


def left_out(
    posterior: Posterior, draws: Draws, tissue: Tissue, name: str, seed: int
) -> dict[str, float]:
    """Shares of a piece that bands from the other pieces hold, and their widths.

    The piece has a stiffness of its own (10 %) and, if it is no tube, a mounting stretch that
    balances its reading of the mounting force, which the misfit and its toe may have moved.
    """
    alone = tissue.square.only(tissue.square.protocols[0].name)
    piece = next(p for p in (alone, *tissue.strips, tissue.tube) if p.name == name)
    rng = np.random.default_rng([seed, 58])
    law, axes = posterior.law, list(piece.experiment.axes)
    forward = ForwardModel.from_specimen(piece, posterior.settings)
    flat = {n: q.ravel() for n, q in draws.quantities.items()}
    chosen = rng.choice(flat["C1"].size, PREDICTIONS, replace=False)
    values = {n: flat[n][chosen] for n in law.names}
    stiffness = np.exp(PIECE_SD * rng.standard_normal(PREDICTIONS))
    values |= {"stiffness": stiffness}
    if piece.experiment.is_mounted:
        (reading,), (sd,) = piece.mounting_readings(shared=True)
        relative = np.hypot(posterior.settings.toe, MISFIT)
        p0 = reading + np.hypot(sd, relative * reading) * rng.standard_normal((PREDICTIONS, 2))
        p0 *= np.isin([0, 1], axes)
        points = [law.to_fit_coordinates(m) for m in zip(*map(values.get, law.names), strict=True)]
        lm = np.array(
            [
                forward.solve_mounting(point, (load / c)[None])[0]
                for point, load, c in zip(points, p0, stiffness, strict=True)
            ]
        )
        values |= {"mounting_stretch_x": lm[:, 0], "mounting_stretch_y": lm[:, 1]}
        values = {n: v[np.isfinite(lm).all(axis=1)] for n, v in values.items()}
    stretch = piece.protocols[0].stretch[1:]
    credible = forward.load(values, stretch)[..., axes]
    fitted = {n: np.median(v) for n, v in values.items()}
    curve = TestedPaths(piece, forward, fitted).tested(0, stretch)
    predictive = credible.copy()
    for draw in predictive:
        misfit, friction, factor = posterior.misfit.draw(curve, rng)
        misfit += friction
        draw += misfit.reshape(-1, 2)[:, axes]
        draw += factor * piece.noise_sd * rng.standard_normal(draw.shape)
    law_load = tissue.load[name][1:ROWS][:, axes]
    measured = piece.load(piece.protocols[0])[1:][:, axes]
    out: dict[str, float] = {"predictions": float(len(credible))}
    for kind, band, true in (
        ("credible", credible, law_load),
        ("predictive", predictive, measured),
    ):
        low, high = np.nanquantile(band, [0.05, 0.95], axis=0)
        out[kind] = float(np.mean((low <= true) & (true <= high)))
        out[f"{kind}_width"] = float(
            np.median((high - low)[len(true) // 2 :] / true[len(true) // 2 :])
        )
    return out


# --- tables -------------------------------------------------------------------------------------


def every_interval(records: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per case, tissue and parameter."""
    every = pd.DataFrame(
        [
            {"case": r["case"][0], "seed": r["case"][1]}
            | {"misfit": r["misfit"], "state": r["state"], **row}
            for r in records
            for row in r["rows"]
        ]
    )
    in_logs = every["parameter"].isin(("C1", "k1", "k2"))
    width = np.where(in_logs, np.log(every["high"] / every["low"]), every["high"] - every["low"])
    holds = (every["low"] <= every["truth"]) & (every["truth"] <= every["high"])
    kind = (
        every["parameter"]
        .str.replace(r"\[.*", "", regex=True)
        .str.replace("_[xy]$", "", regex=True)
    )
    return every.assign(width=width, holds=holds, kind=kind)


def coverage(every: pd.DataFrame) -> pd.DataFrame:
    """Coverage of 90 % intervals, identified parameters per specimen, by case and misfit."""
    rows = []
    for (case, misfit), part in every.groupby(["case", "misfit"], sort=False):
        seeds = part["seed"].nunique()
        row: dict[str, Any] = {"case": case, "misfit": misfit, "tissues": seeds}
        row["converged"] = part[part["state"] == "converged"]["seed"].nunique()
        for title, kinds in (("parameters", MATERIAL), ("mounting", ("mounting_stretch",))):
            of_kind = part[part["kind"].isin(kinds)]
            row[title] = f"{int(of_kind['holds'].sum())} of {len(of_kind)}"
        stiffness = part[part["kind"] == "stiffness"]
        row["stiffness"] = f"{int(stiffness['holds'].sum())} of {len(stiffness)}"
        known = part[part["verdict"] == "identified"]
        row["identified ones"] = f"{int(known['holds'].sum())} of {len(known)}"
        material = part[part["kind"].isin(MATERIAL)]
        row["identified of 5"] = (material["verdict"] == "identified").sum() / seeds
        row["only in combination"] = (material["verdict"] == "only in combination").sum() / seeds
        # away from one: the 90 % interval of the stiffness does not hold it
        away = (stiffness["low"] > 1.0) | (stiffness["high"] < 1.0)
        row["stiffness away from 1"] = f"{int(away.sum())} of {len(stiffness)}"
        rows.append(row)
    return pd.DataFrame(rows)


def by_parameter(every: pd.DataFrame) -> pd.DataFrame:
    """Coverage and median width over that of the square alone, of each parameter and case."""
    own = every[~every["parameter"].str.contains(r"\[", regex=True)]
    square = own[own["case"] == "square"].set_index(["seed", "parameter"])["width"]
    relative = own.join(square.rename("alone"), on=["seed", "parameter"])
    relative = relative.assign(relative=relative["width"] / relative["alone"])
    grouped = relative.groupby(["case", "kind"], sort=False)
    return grouped.agg(
        coverage=("holds", "mean"), relative_width=("relative", "median")
    ).reset_index()


def main() -> None:
    """Sample every case of every tissue and print what the intervals did."""
    arguments = parser(__doc__)
    arguments.add_argument("--tissues", type=int, default=40)
    arguments.add_argument("--cases", nargs="+", metavar="CASE", help="(default: all)")
    options = options_of(arguments)
    tissues = 1 if options.quick else options.tissues
    chosen = TRIAL if options.quick else options.cases
    parts = [[case for case in part if case in (chosen or part)] for part in PARTS]
    cases = [(case, FIRST_SEED + k) for part in parts for k in range(tissues) for case in part]
    records = run_all(one_case, cases, options.records / "pieces.jsonl", options.workers)
    every = every_interval(records)
    print_table("cases", coverage(every))
    print_table("parameters", by_parameter(every))
    predicted = [{"from": r["case"][0], **r} for r in records if "credible" in r]
    if predicted:
        columns = ["credible", "credible_width", "predictive", "predictive_width"]
        means = pd.DataFrame(predicted).groupby("from", sort=False)[columns].mean()
        print_table("left out", means.reset_index())
    seconds = pd.DataFrame([{"case": r["case"][0], "seconds": r.get("seconds")} for r in records])
    print_table("seconds", seconds.groupby("case", sort=False).median().reset_index())


if __name__ == "__main__":
    main()
