"""Leave one protocol out, and see whether the posterior of the others predicts it.

The mounted state of the protocol that is left out is shared with the others, or, where each
protocol has its own, root-found for every draw from the protocol's own mounting reading, which a
user has before anything is stretched. A load-cell reading is drawn for every draw.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.findings.bands import bands, evenly_chosen
from biaxbayes.inference.assemble import mounting_names
from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, draw
from biaxbayes.mechanics.goh import structure_tensor
from biaxbayes.mechanics.mounting import solve_balance
from biaxbayes.specimens.specimen import Specimen

__all__ = ["leave_out", "leave_out_each", "with_own_mounting"]

MAX_DRAWS = 1000


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
        As in :class:`~biaxbayes.inference.posterior.Posterior`.

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
    posterior = Posterior(specimen.without(name), **options)
    found = draw(posterior, plan or Plan())
    table = pd.DataFrame({k: v.ravel() for k, v in found.quantities.items()})
    table = table.iloc[evenly_chosen(len(table), MAX_DRAWS)].reset_index(drop=True)
    settings = posterior.settings
    if settings.mounting_stretch == "per-protocol" and settings.infers_mounting:
        seed = 0 if plan is None else plan.seed
        table = with_own_mounting(
            table, specimen, name, np.random.default_rng([seed, 77]), settings.fibre_switch
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
    fibre_switch: bool = False,
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
    fibre_switch : bool

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
        Hx, Hy, Hz = structure_tensor(np.deg2rad(row["alpha"]), row["kappa"])
        C1, k1, k2 = row["C1"], row["k1"], row["k2"]
        ok, x, y, *_ = solve_balance(C1, k1, k2, Hx, Hy, Hz, float(fibre_switch), px, py, mounted)
        if ok:
            stretch[i] = np.exp([x, y])
    others = [c for c in draws if str(c).startswith("mounting_")]
    names = mounting_names("stretch", name)
    out = draws.drop(columns=others).assign(**dict(zip(names, stretch.T, strict=True)))
    return out[np.isfinite(stretch).all(axis=1)].reset_index(drop=True)


def _offset(row: Mapping[Any, float]) -> np.ndarray:
    return np.array([row.get("load_offset_x", 0.0), row.get("load_offset_y", 0.0)])


def _section(specimen: Specimen, row: Mapping[Any, float]) -> np.ndarray:
    edges = np.array([row.get("edge_y", 1.0), row.get("edge_x", 1.0)])
    return specimen.area * edges * row.get("thickness", 1.0)


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
