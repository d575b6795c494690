"""Leave one protocol out, and see whether the posterior of the others predicts it.

    biaxbayes convert ... --out aorta.csv
    python scripts/study.py leave_out aorta.csv [--page docs/model-error.md]

The mounted state of the protocol that is left out is shared with the others, or, where each
protocol has its own, root-found for every draw from the protocol's own mounting reading, which a
user has before anything is stretched. A load-cell reading is drawn for every draw.

Prints the tables of docs/model-error.md, for every error model. Rows are thinned with each, which
for independent errors too leaves the posterior as it is (biaxbayes.specimens.path).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from biaxbayes import read_specimen
from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.mechanics.mounting import sections, solve_balance
from biaxbayes.model.layout import mounting_names
from biaxbayes.model.preparation import prepare
from biaxbayes.model.search import draw_posterior
from biaxbayes.prediction.bands import bands, evenly_chosen
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen
from studies.page import put, table

__all__ = ["leave_out", "leave_out_each", "with_own_mounting"]

MAX_DRAWS = 1000
MODELS: dict[str, dict[str, Any]] = {
    "effective": {},
    "independent": {"noise": "independent"},
    "effective, growing": {"noise_growth": True},
    "effective, per-protocol mounting": {"mounting_stretch": "per-protocol"},
    "systematic, growing": {"noise": "systematic", "noise_growth": True},
    "systematic, growing, per-protocol mounting": {
        "noise": "systematic",
        "noise_growth": True,
        "mounting_stretch": "per-protocol",
    },
}


def leave_out_each(
    specimen: Specimen, *, plan: Plan | None = None, probability: float = 0.9, **options: Any
) -> pd.DataFrame:
    """Leave out every protocol in turn; see :func:`leave_out`."""
    if len(specimen.protocols) < 2:
        raise InputError("a specimen of one protocol has none to leave out", file=specimen.name)
    names = [p.name for p in specimen.protocols]
    tables = [leave_out(specimen, n, plan=plan, probability=probability, **options) for n in names]
    return pd.concat(tables, ignore_index=True)


def leave_out(
    specimen: Specimen,
    name: str,
    *,
    plan: Plan | None = None,
    probability: float = 0.9,
    **options: Any,
) -> pd.DataFrame:
    """Sample without a protocol, and compare the protocol with what is predicted of it.

    Parameters
    ----------
    specimen : Specimen
    name : str
        The protocol to leave out.
    plan : Plan, optional
        Of the sampler.
    probability : float
        Content of the bands.
    **options
        As in :class:`~biaxbayes.model.posterior.Posterior`.

    Returns
    -------
    DataFrame
        One row a direction: ``protocol``, ``direction``, ``readings``, ``inside`` (share of
        them inside the predictive band), ``below`` and ``above`` it, ``rms`` and ``largest``
        (reading minus predicted median, in the unit of the file), ``peak``, ``width`` (mean, of
        the band), ``state`` of the sampling.

    Raises
    ------
    InputError
        If the specimen has no such protocol, or no other.
    """
    if name not in [p.name for p in specimen.protocols]:
        raise InputError(f"no protocol {name!r}", file=specimen.name)
    posterior = prepare(specimen.without(name), **options)
    found = draw_posterior(posterior, plan or Plan())
    table = pd.DataFrame({k: v.ravel() for k, v in found.quantities.items()})
    table = table.iloc[evenly_chosen(len(table), MAX_DRAWS)].reset_index(drop=True)
    settings = posterior.settings
    if settings.mounting_stretch == "per-protocol" and settings.infers_mounting:
        seed = 0 if plan is None else plan.seed
        table = with_own_mounting(
            table, specimen, name, np.random.default_rng([seed, 77]), posterior.law
        )
    held = specimen.only(name)
    predicted = bands(held, table, settings=settings, probability=probability, max_draws=MAX_DRAWS)
    kept = predicted[predicted["row"] >= held.protocols[0].rest_rows]
    rows = [_judged(part) for _, part in kept.groupby("direction", sort=True)]
    return pd.DataFrame(rows).assign(state=found.convergence.state)


def with_own_mounting(
    draws: pd.DataFrame,
    specimen: Specimen,
    name: str,
    rng: np.random.Generator,
    law: Law,
) -> pd.DataFrame:
    """Draws with the mounting stretch of a protocol that was not sampled.

    Every draw balances the protocol's own mounting reading, less an error of the load cell.
    Draws without a stable mounted state are left out.

    Parameters
    ----------
    draws : DataFrame
    specimen : Specimen
        With the protocol.
    name : str
    rng : numpy.random.Generator
    law : Law

    Returns
    -------
    DataFrame
        With ``mounting_stretch_x[name]`` and ``mounting_stretch_y[name]`` in place of all others.
    """
    index = [p.name for p in specimen.protocols].index(name)
    reading, sd = specimen.mounting_readings(shared=False)
    error = rng.standard_normal((len(draws), 2))
    stretch = np.full((len(draws), 2), np.nan)
    mounted = specimen.geometry == "mounted"
    for i, row in enumerate(draws.to_dict(orient="records")):
        p0 = reading[index] - _offset(row) - sd[index] * error[i]
        px, py = p0 / _section(specimen, row)
        ok, x, y, *_ = solve_balance(law.material(row).constants, px, py, mounted)
        if ok:
            stretch[i] = np.exp([x, y])
    others = [c for c in draws if str(c).startswith("mounting_")]
    names = mounting_names("stretch", name)
    out = draws.drop(columns=others).assign(**dict(zip(names, stretch.T, strict=True)))
    return out[np.isfinite(stretch).all(axis=1)].reset_index(drop=True)


def _offset(row: Mapping[Any, float]) -> np.ndarray:
    return np.array([row.get("load_offset_x", 0.0), row.get("load_offset_y", 0.0)])


def _section(specimen: Specimen, row: Mapping[Any, float]) -> np.ndarray:
    factors = (row.get(name, 1.0) for name in ("edge_x", "edge_y", "thickness"))
    return np.array(sections(specimen.area, *factors))


def _judged(part: pd.DataFrame) -> dict[str, Any]:
    columns = [c for c in part if str(c).startswith("predictive_")]
    low, middle, high = (part[c].to_numpy() for c in columns)
    measured = part["measured"].to_numpy()
    miss = measured - middle
    return {
        "protocol": part["protocol"].iloc[0],
        "direction": part["direction"].iloc[0],
        "readings": len(part),
        "inside": float(np.mean((measured >= low) & (measured <= high))),
        "below": float(np.mean(measured < low)),
        "above": float(np.mean(measured > high)),
        "rms": float(np.sqrt(np.mean(miss**2))),
        "largest": float(miss[np.argmax(np.abs(miss))]),
        "peak": float(np.abs(measured).max()),
        "width": float(np.mean(high - low)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("specimen", type=Path)
    parser.add_argument("--out", type=Path, default=Path("leave-out.csv"))
    parser.add_argument("--ess", type=float, default=400.0)
    parser.add_argument("--page", type=Path, help="Put the table into this page.")
    options = parser.parse_args()
    specimen = read_specimen(options.specimen)
    done = pd.read_csv(options.out) if options.out.exists() else pd.DataFrame()
    for model, chosen in MODELS.items():
        for protocol in specimen.protocols:
            if len(done) and ((done.model == model) & (done.protocol == protocol.name)).any():
                continue
            clock = time.process_time()
            plan = Plan(ess=options.ess, workers=1, max_steps=8000)
            found = leave_out(specimen, protocol.name, plan=plan, **{"thin": 100, **chosen})
            found.insert(0, "model", model)
            found["cpu_s"] = round(time.process_time() - clock, 1)
            done = pd.concat([done, found], ignore_index=True)
            done.to_csv(options.out, index=False)
            print(found.to_string(header=False), flush=True)
    text = report(done, specimen.unit)
    print(text)
    if options.page:
        put(options.page, "leave-out", text)


def report(done: pd.DataFrame, unit: str) -> str:
    """Share of each curve inside its predictive band, and means over the curves."""
    curves = done.assign(curve=done["protocol"] + " " + done["direction"])
    models = [m for m in MODELS if m in set(done["model"])]
    wide = curves.pivot(index="curve", columns="model", values="inside")[models]
    rows = [[curve, *(f"{v:.2f}" for v in row)] for curve, row in wide.iterrows()]
    rows.append(["**mean**", *(f"**{v:.2f}**" for v in wide.mean())])
    for label, column in ((f"rms miss, {unit}", "rms"), (f"width of the band, {unit}", "width")):
        means = curves.groupby("model")[column].mean()[models]
        rows.append([label, *(f"{v:#.2g}".rstrip(".") for v in means)])
    return table(["share inside the band", *models], rows)


if __name__ == "__main__":
    main()
