"""Credible and predictive bands of a run at the states that were measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen, evenly_spaced
from biaxbayes.forward import ForwardModel
from biaxbayes.laws import DEFAULT_LAW
from biaxbayes.model.posterior import Posterior
from biaxbayes.options import Settings
from biaxbayes.parameters import mounting_names
from biaxbayes.prediction.nearest_law import median_nearest_law
from biaxbayes.prediction.percentiles import QUANTILES
from biaxbayes.prediction.tissue import Tissue
from biaxbayes.specimens.specimen import Specimen


def bands(
    posterior: Posterior,
    draws: pd.DataFrame,
    *,
    piece: int = 0,
    max_rows: int | None = None,
    max_draws: int = 1000,
) -> pd.DataFrame:
    """Bands of the load at the measured stretches.

    The credible band holds the tissue's own load, that of the law and its misfit given the
    readings; the predictive band holds a new reading there, with the friction of this test.

    Parameters
    ----------
    draws : DataFrame
        One row per draw, columns as in ``summary.csv``.
    piece : int
        Index of the piece of the tissue.
    max_rows : int, optional
        Largest number of rows of a protocol, evenly chosen.
    max_draws : int
        Largest number of draws, evenly chosen.

    Returns
    -------
    DataFrame
        One row per protocol, direction and state: ``protocol``, ``direction``, ``row`` (of the
        protocol, from 0), ``stretch`` (measured, in that direction), ``measured`` and the
        quantiles ``credible_q05``, ``credible_q50``, ``credible_q95``, ``predictive_q05``,
        ``predictive_q50``, ``predictive_q95``, and ``law``, the load of the median nearest law, as
        on a card. Loads are in the unit of the file, a Cauchy file's as Cauchy stress.
    """
    tissue = Tissue(posterior, draws.iloc[evenly_chosen(len(draws), max_draws)], piece=piece)
    laws, row = median_nearest_law(posterior, draws)
    nearest = laws.loc[draws.index[[row]]]
    model, levels = posterior.pieces[piece], tuple(QUANTILES.values())
    specimen, offset = model.specimen, model.forward.offset(nearest)
    names = [f"{kind}_{q}" for kind in ("credible", "predictive") for q in QUANTILES] + ["law"]
    tables = []
    for i, protocol in enumerate(specimen.as_compared(posterior.settings.mounting).protocols):
        rows = evenly_spaced(protocol.rows, max_rows)
        stretch, measured = protocol.stretch[rows], specimen.load(protocol)[rows]
        scale = specimen.per_nominal(stretch)
        tested = tissue.tested(i, protocol.stretch, rows)
        law = model.forward.load(nearest, stretch, protocol.name) + offset
        quantiles = np.concatenate([*tested.percentiles(levels), law])
        for axis in specimen.experiment.axes:
            table = {
                "protocol": protocol.name,
                "direction": "xy"[axis],
                "row": rows,
                "stretch": stretch[:, axis],
                "measured": measured[:, axis] * scale[:, axis],
            }
            loads = quantiles[:, :, axis] * scale[:, axis]
            tables.append(pd.DataFrame(table | dict(zip(names, loads, strict=True))))
    return pd.concat(tables, ignore_index=True)


def true_loads(
    specimen: Specimen,
    truth: Mapping[str, float],
    *,
    settings: Settings | None = None,
    max_rows: int | None = None,
) -> np.ndarray:
    """Loads (rows,) of a known material and mounted state, at the rows of :func:`bands`.

    ``truth`` has material parameters, of the law of the run or else of the default one, and
    mounting stretches by the names of ``summary.csv``; InputError if one is missing. ``max_rows``
    is as in :func:`bands`. The loads are in the unit of the file, without noise.
    """
    settings = settings or Settings()
    if not set(settings.material_law.names) <= set(truth):
        settings = replace(settings, law=DEFAULT_LAW, fibre_switch=False)
    shared = mounting_names("stretch")
    own = [mounting_names("stretch", p.name) for p in specimen.protocols]
    states = [shared] if set(shared) <= set(truth) else own
    needed = (*settings.material_law.names, *(name for pair in states for name in pair))
    missing = [name for name in needed if name not in truth]
    if missing:
        raise InputError(
            f"the true values lack {', '.join(missing)[:200]}",
            remedy="bands need the whole material and its mounting stretches",
        )
    forward = ForwardModel.from_specimen(specimen, settings)
    values = {name: float(truth[name]) for name in needed}
    loads = []
    for protocol in specimen.protocols:
        stretch = protocol.stretch[evenly_spaced(protocol.rows, max_rows)]
        load = forward.load(values, stretch, protocol.name)[0] * specimen.per_nominal(stretch)
        if settings.mounting == "zeroed":
            load = load - load[0]
        loads.append(load.T.ravel())
    return np.concatenate(loads)
