"""identifiability.csv: verdicts with their evidence, and the thresholds they depend on."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pandas as pd

from biaxbayes.findings.edges import BOUND_TAIL, EXPONENT_DISTANCE, PRIOR_TAIL, STIFFNESS_SHARE
from biaxbayes.findings.identifiability import Identifiability
from biaxbayes.findings.sloppiness import Sloppiness
from biaxbayes.output.annotated_table import write_annotated

__all__ = ["as_json", "write_identifiability"]

NOTES = (
    "near an edge: kappa nearer than *_edge_distance; k2 where k2 E^2 at the largest stretch is "
    f"below {EXPONENT_DISTANCE:g}; C1 and k1 where they carry less than {STIFFNESS_SHARE:g} of the "
    f"small-strain stiffness; a bound in the priors within {BOUND_TAIL:g} of the prior's mass; a "
    f"prior without bounds ends at its outer {PRIOR_TAIL:g}",
    "median, low_90, high_90, edges and distances are in the unit of the row; prior_sd and "
    "posterior_sd on its scale; contraction = 1 - (posterior_sd / prior_sd)^2",
    "*_edge_mass, *_edge_prior_mass: share of the draws and of the prior near the edge; "
    "*_edge_support: likelihood at the edge, everything else averaged out, over its maximum",
    "spread_given_all, spread_given_partners: sd with the others known over the marginal sd",
    "refit_low, refit_high: range of a mounting stretch in fits to parts of the record, where the "
    "model misses it smoothly",
    "*_sensitivity: power-scaling, cumulative Jensen-Shannon distance per doubling",
)


def write_identifiability(found: Identifiability, path: Path) -> None:
    """Write the table, whole or not at all.

    Lines that start with ``#`` hold the thresholds; read it with
    ``pandas.read_csv(path, comment="#")``.

    Parameters
    ----------
    found : Identifiability
    path : Path

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    thresholds = ", ".join(f"{name} = {value:g}" for name, value in found.thresholds.items())
    told = (
        f"identifiability of {found.draws} draws of a run that is {found.state}",
        f"thresholds: {thresholds}",
        *NOTES,
    )
    write_annotated(found.to_frame(), told, path)


def as_json(
    found: Identifiability,
    determined: pd.DataFrame | None = None,
    directions: Sloppiness | None = None,
) -> str:
    """The same as JSON: state, thresholds, one object a parameter without empty fields.

    Parameters
    ----------
    found : Identifiability
    determined : DataFrame, optional
        From :func:`biaxbayes.findings.determined.determined`.
    directions : Sloppiness, optional
    """
    told: dict[str, object] = {
        "state": found.state,
        "draws": found.draws,
        "thresholds": dict(found.thresholds.items()),
        "parameters": [
            {key: _plain(value) for key, value in row.record().items()} for row in found.parameters
        ],
    }
    if determined is not None:
        told["determined"] = [
            {str(key): _plain(value) for key, value in row.items()}
            for row in determined.to_dict("records")
        ]
    if directions is not None:
        told["directions"] = [
            {"spread": d.spread, "loadings": d.loadings, "in_words": d.words}
            for d in directions.directions
        ]
        told["same_curves"] = {
            "in_words": directions.words,
            "change_kPa": directions.path.change_kPa,
            "materials": directions.path.to_frame().to_dict("list"),
        }
    return json.dumps(told, indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: object) -> object:
    """JSON knows no infinity."""
    return value if not isinstance(value, float) or math.isfinite(value) else None
