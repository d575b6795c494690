"""Let tools answer the benchmark, then print the table.

    python benchmark/run.py                          every tool that is installed
    python benchmark/run.py biaxbayes plain-emcee    these
    python benchmark/run.py --only 08-3-noise-0.5    one specimen of each, into the folder --out

A tool is a function from a specimen to an :class:`Answer`; one that cannot answer a kind of test
returns None. Answers that are there are kept: delete a folder of submissions/ to remake it.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes import GOH
from biaxbayes.errors import BiaxbayesError
from biaxbayes.verbs.inputs import open_specimen

HERE = Path(__file__).resolve().parent
LEVELS = (0.05, 0.5, 0.95)
PLAN = {"ess": 200, "max_steps": 3000, "ensembles": 2, "walkers": 32, "population": 2048}
"""Half the ensembles and walkers of the command: the same posterior, in less time."""
NAMES = ("C1", "k1", "k2", "alpha", "kappa", "mounting_stretch_x", "mounting_stretch_y")
"""Of the unknowns of tools that fit GOH; units kPa and degrees."""


@dataclass
class Task:
    """A specimen: its files, and the path to predict, from the mounted (of a tube unloaded) state.

    Attributes
    ----------
    specimen : Specimen
        All pieces.
    path : ndarray, shape (n, 2)
    """

    files: list[Path]
    specimen: Any
    path: np.ndarray

    @property
    def is_square(self) -> bool:
        """Whether it is a square alone."""
        return len(self.files) == 1 and self.specimen.experiment.is_biaxial

    def stresses(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured stretches and nominal stresses (kPa) of all rows of a square, (n, 2)."""
        area = np.array([self.specimen.edge_y_mm, self.specimen.edge_x_mm])
        area = area * self.specimen.thickness_mm * 1e-3  # N / kPa
        stretch = np.vstack([p.stretch for p in self.specimen.protocols])
        load = np.vstack([np.column_stack([p.load_x, p.load_y]) for p in self.specimen.protocols])
        return stretch, load / area


@dataclass
class Answer:
    """Quantiles by parameter, and of the nominal stress on the path, (3, n, 2); NaN: not stated."""

    quantiles: dict[str, Any]
    loads: np.ndarray


def point(values: dict[str, float], task: Task) -> Answer:
    """The answer of a tool that states no intervals."""
    nothing = float("nan")
    lm = [values.get(name, 1.0) for name in NAMES[5:]]
    material = GOH(*(values[name] for name in NAMES[:5]))
    load = np.column_stack(material.piola(*(task.path * lm).T))
    missing = np.full(load.shape, nothing)
    quantiles = {name: (nothing, value, nothing) for name, value in values.items()}
    return Answer(quantiles, np.stack([missing, load, missing]))


# --- tools ---------------------------------------------------------------------------------------


def with_biaxbayes(task: Task) -> Answer:
    """The posterior with the tool's defaults; credible bands of the tissue."""
    from biaxbayes.model.draw import draw_posterior
    from biaxbayes.prediction.stress import predict_stress
    from biaxbayes.runs.archive import draw_table
    from biaxbayes.sampling.sampler import Plan

    posterior = biaxbayes.prepare(task.specimen)
    draws = draw_table(draw_posterior(posterior, Plan(**PLAN, workers=1)).quantities)
    state = "mounted" if task.specimen.experiment.is_mounted else "unloaded"
    table = predict_stress(posterior, draws, task.path, relative_to=state, stress="piola")
    columns = [
        [f"piola_{axis}_kPa_{part}" for axis in "xy"]
        for part in ("credible_low", "median", "credible_high")
    ]
    quantiles = {n: np.quantile(draws[n], LEVELS) for n in NAMES if n in draws}
    return Answer(quantiles, np.stack([table[c].to_numpy() for c in columns]))


def least_squares(task: Task) -> Answer:
    """GOH and the mounting stretch, the mounting force as one reading."""
    return _fit(task, "constrained")


def least_squares_without_mounting(task: Task) -> Answer | None:
    """GOH, the mounted state taken as unloaded."""
    return _fit(task, "standard") if task.is_square else None


def _fit(task: Task, method: str) -> Answer:
    found: Any = biaxbayes.fit(task.specimen, method)
    values = dict(zip(NAMES[:5], map(float, found.material.values), strict=True))
    if task.specimen.experiment.is_mounted and method != "standard":
        values |= dict(zip(NAMES[5:], map(float, found.mounting_stretch[0]), strict=True))
    return point(values, task)


def plain_emcee(task: Task, walkers: int = 32, steps: int = 6000) -> Answer | None:
    """Independent errors of unknown sd, flat priors in ranges, emcee's stretch move.

    The script that one writes first: stresses of GOH in NumPy, started about least squares.
    """
    import emcee

    if not task.is_square:
        return None
    stretch, stress = task.stresses()
    # ln C1, ln k1, ln k2, alpha, kappa, mounting stretches, ln sd
    low = np.array([*np.log([1e-2, 1e-2, 1e-2]), 0.0, 0.0, 0.9, 0.9, np.log(1e-4)])
    high = np.array([*np.log([1e3, 1e4, 1e3]), 90.0, 1.0 / 3.0, 2.0, 2.0, np.log(1e3)])

    def model(u: np.ndarray, at: np.ndarray) -> np.ndarray:
        C1, k1, k2 = np.exp(u[:, :3, None]).transpose(1, 0, 2)
        c, kappa = np.cos(np.deg2rad(u[:, 3, None])) ** 2, u[:, 4, None]
        x, y = u[:, 5, None] * at[:, 0], u[:, 6, None] * at[:, 1]
        X, Y, Z = x * x, y * y, 1.0 / (x * x * y * y)
        Hx, Hy = kappa + (1.0 - 3.0 * kappa) * c, kappa + (1.0 - 3.0 * kappa) * (1.0 - c)
        # W = C1 (I1 - 3) + k1 / k2 (exp(k2 E^2) - 1),  E = H : C - 1
        E = Hx * X + Hy * Y + kappa * Z - 1.0
        f = 4.0 * k1 * E * np.exp(k2 * E * E)
        Px = (2.0 * C1 * (X - Z) + f * (Hx * X - kappa * Z)) / x
        Py = (2.0 * C1 * (Y - Z) + f * (Hy * Y - kappa * Z)) / y
        return np.stack([Px, Py], axis=-1)

    def log_density(u: np.ndarray) -> np.ndarray:
        inside = np.all((low < u) & (u < high), axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            square = ((model(u, stretch) - stress) ** 2).sum(axis=(1, 2))
            out = -0.5 * square / np.exp(2.0 * u[:, 7]) - stress.size * u[:, 7]
        return np.where(inside & np.isfinite(out), out, -np.inf)

    start: Any = biaxbayes.fit(task.specimen)
    values = np.array(start.material.values, dtype=float)
    rms = np.log(np.std(model(_unknowns(values, start.mounting_stretch[0]), stretch)[0] - stress))
    centre = np.append(_unknowns(values, start.mounting_stretch[0])[0, :7], rms)
    rng = np.random.default_rng(1)
    width = np.array([0.05, 0.05, 0.05, 1.0, 0.01, 0.002, 0.002, 0.1])
    first = centre + width * rng.standard_normal((walkers, 8))
    first = low + np.abs(first - low)  # reflected at bounds, where least squares may end
    first = high - np.abs(high - first)
    sampler = emcee.EnsembleSampler(walkers, 8, log_density, vectorize=True)
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(first, steps)
    draws = sampler.get_chain(discard=steps // 2, thin=10, flat=True)
    natural = np.column_stack([np.exp(draws[:, :3]), draws[:, 3:7]])
    quantiles = dict(zip(NAMES, np.quantile(natural, LEVELS, axis=0).T, strict=True))
    return Answer(quantiles, np.quantile(model(draws, task.path), LEVELS, axis=0))


def _unknowns(material: np.ndarray, mounting: np.ndarray) -> np.ndarray:
    """A row of plain emcee's unknowns, without the sd of the errors."""
    return np.array([[*np.log(np.maximum(material[:3], 1e-2)), *material[3:], *mounting, 0.0]])


OF_PYMECHT: dict[str, Callable[[Any], Any]] = {
    "C1": lambda p: p["mu_0"] / 2.0,
    "k1": lambda p: p["k1_1"],
    "k2": lambda p: p["k2_1"],
    "alpha": lambda p: p["alpha"],
    "kappa": lambda p: p["k3_1"],
    "mounting_stretch_x": lambda p: 1.0 / p["L10"],
    "mounting_stretch_y": lambda p: 1.0 / p["L20"],
}
"""The unknowns, of the parameters of pyMechT's model."""


def pymecht_fit(task: Task) -> Answer | None:
    """PyMechT's fit of squares, reference lengths free, from two fibre angles."""
    if not task.is_square:
        return None
    _, params, _ = _fitted_by_pymecht(task)
    values = params._val()
    return point({name: float(value(values)) for name, value in OF_PYMECHT.items()}, task)


def pymecht_chain(task: Task, steps: int = 6000) -> Answer | None:
    """PyMechT's Markov chain of squares, from its fit, with independent errors and flat priors.

    The sd of its proposal is half of what the readings leave to a parameter while the others stay:
    steps of a twentieth of the range, its default and here the most, are hardly ever accepted. Its
    accepted states are taken as draws, as it gives them.
    """
    import pymecht

    if not task.is_square:
        return None
    simulated, params, fit = _fitted_by_pymecht(task)
    stress = task.stresses()[1]
    variance = 2.0 * fit.cost / (stress.size - fit.x.size)

    def density(values: dict[str, float]) -> tuple[float, None]:
        square = ((simulated(values) - stress) ** 2).sum()
        return float(np.exp(np.minimum(0.5 * (2.0 * fit.cost - square) / variance, 700.0))), None

    np.random.seed(1)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        chain = pymecht.MCMC(density, params)
        curvature = (fit.jac**2).sum(axis=0) / variance  # 0 where a parameter has no effect
        chain.std = np.minimum(chain.std, 0.5 / np.sqrt(np.maximum(curvature, 1e-300)))
        chain.run(steps)
    accepted = chain.get_samples_pandas()
    draws = np.column_stack([value(accepted) for value in OF_PYMECHT.values()])
    loads = [np.column_stack(GOH(*u[:5]).piola(*(task.path * u[5:]).T)) for u in draws]
    quantiles = dict(zip(NAMES, np.quantile(draws, LEVELS, axis=0).T, strict=True))
    return Answer(quantiles, np.quantile(loads, LEVELS, axis=0))


def _fitted_by_pymecht(task: Task) -> tuple[Callable[[Any], Any], Any, Any]:
    """The simulated stresses of pyMechT's model, its parameters at the best fit, and the fit."""
    import pymecht

    stretch, stress = task.stresses()
    material = pymecht.MatModel("nh", "goh")

    def turned(alpha: float) -> None:
        c, s = np.cos(np.deg2rad(alpha)), np.sin(np.deg2rad(alpha))
        material.models[1].fiber_dirs = [np.array([c, s, 0.0]), np.array([c, -s, 0.0])]

    turned(45.0)
    sample = pymecht.PlanarBiaxialExtension(material, "length", "1pk")

    def simulated(p: dict[str, float]) -> np.ndarray:
        turned(p["alpha"])
        return sample.disp_controlled(stretch, p)

    ends = []
    for alpha in (30.0, 60.0):
        params = copy.deepcopy(sample.parameters)
        for name, value, low, high in (
            *(("mu_0", 10.0, 1e-2, 1e3), ("k1_1", 20.0, 1e-2, 1e4), ("k2_1", 5.0, 1e-2, 1e3)),
            *(("k3_1", 0.1, 0.0, 1.0 / 3.0), ("L10", 0.97, 0.5, 1.1), ("L20", 0.97, 0.5, 1.1)),
        ):
            params[name] = pymecht.Param(value, low, high)
        params["thick"].fix(1.0)
        params["alpha"] = pymecht.Param(alpha, 0.0, 90.0)
        with contextlib.redirect_stdout(io.StringIO()):
            ends.append((pymecht.ParamFitter(simulated, stress, params).fit(), params))
    fit, params = min(ends, key=lambda end: end[0].cost)
    return simulated, params, fit


TOOLS: dict[str, Callable[[Task], Answer | None]] = {
    "biaxbayes": with_biaxbayes,
    "least-squares": least_squares,
    "least-squares-without-mounting": least_squares_without_mounting,
    "plain-emcee": plain_emcee,
    "pymecht": pymecht_fit,
    "pymecht-chain": pymecht_chain,
}


# --- submissions ---------------------------------------------------------------------------------


def tasks(only: str | None = None) -> dict[str, Task]:
    """The specimens by name, without their truths."""
    paths = pd.read_csv(HERE / "held-out.csv").groupby("specimen")[["stretch_x", "stretch_y"]]
    truths = json.loads((HERE / "truth.json").read_text(encoding="utf-8"))
    found = {}
    for name, path in paths:
        if only in (None, name):
            files = [HERE / "specimens" / file for file in truths[name]["files"]]
            found[str(name)] = Task(files, open_specimen(list(files), None), path.to_numpy())
    return found


def submit(tool: str, folder: Path, wanted: dict[str, Task]) -> None:
    """Write the answers of a tool."""
    quantiles, loads, seconds = [], [], []
    for name, task in wanted.items():
        clock = time.process_time()
        try:
            answer = TOOLS[tool](task)
        except BiaxbayesError as error:
            print(f"{tool}, {name}: {error}", flush=True)
            continue
        if answer is None:
            continue
        seconds.append({"specimen": name, "seconds": time.process_time() - clock})
        for parameter, values in answer.quantiles.items():
            row = dict(zip(("q05", "q50", "q95"), map(float, values), strict=True))
            quantiles.append({"specimen": name, "parameter": parameter, **row})
        columns = [f"{axis}_{q}" for q in ("q05", "q50", "q95") for axis in "xy"]
        table = pd.DataFrame(np.hstack(list(answer.loads)), columns=columns)
        loads.append(table.assign(specimen=name, row=range(len(table))))
        print(f"{tool}, {name}: {seconds[-1]['seconds']:.1f} s", flush=True)
    if not seconds:
        print(f"{tool}: treats none of {', '.join(wanted)}")
        return
    folder.mkdir(parents=True)
    out = {"quantiles": pd.DataFrame(quantiles), "held-out": pd.concat(loads)}
    for stem, table in (out | {"seconds": pd.DataFrame(seconds)}).items():
        first = ["specimen", *(c for c in ("row",) if c in table)]
        table = table[[*first, *table.columns.difference(first, sort=False)]]
        path = folder / f"{stem}.csv"
        table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")


def main() -> int:
    """Answer with each tool, and print the table."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("tools", nargs="*", help=f"of {', '.join(TOOLS)}")
    arguments.add_argument("--only", metavar="SPECIMEN", help="one specimen; needs --out")
    arguments.add_argument("--out", type=Path, default=HERE / "submissions")
    options = arguments.parse_args()
    if unknown := [tool for tool in options.tools if tool not in TOOLS]:
        arguments.error(f"no tool {unknown[0]}; there are {', '.join(TOOLS)}")
    wanted = tasks(options.only)
    if not wanted:
        arguments.error(f"no specimen {options.only}; held-out.csv names them")
    if options.only and options.out == HERE / "submissions":
        arguments.error("--only needs a folder --out of its own: submissions are of all specimens")
    for tool in options.tools or TOOLS:
        if (options.out / tool).is_dir():
            print(f"{tool}: kept, {options.out / tool} is there")
            continue
        try:
            submit(tool, options.out / tool, wanted)
        except ModuleNotFoundError as error:
            print(f"{tool}: left out, {error}; README.md says what each tool needs")
    folders = [str(p) for p in sorted(options.out.glob("*/"))]
    if not folders:
        return 2
    return subprocess.call([sys.executable, str(HERE / "score.py"), *folders])


if __name__ == "__main__":
    raise SystemExit(main())
