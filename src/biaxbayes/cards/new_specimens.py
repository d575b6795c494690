"""Cards of a population: new specimens of a group, and its mean curve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.cards.export import made_cards, write_cards
from biaxbayes.errors import NotConverged
from biaxbayes.laws import law_named
from biaxbayes.parameters import mounting_names
from biaxbayes.populations.archive import new_materials
from biaxbayes.prediction.draws import chosen_draws
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

DEFAULT_NEW_SPECIMENS = 20
"""Cards where no number is given."""
MEAN_CURVE = "mean-curve"


def export_population_cards(
    folder: Path,
    group: str,
    out: Path,
    *,
    count: int | None = None,
    seed: int = 0,
    anyway: bool = False,
    **how: Any,
) -> pd.DataFrame:
    """Write cards of new specimens of a group; ``mean-curve`` has the one nearest the median."""
    table, attributes = new_materials(folder, group)
    if attributes["convergence"] == "unusable" and not anyway:
        raise NotConverged(
            f"{folder}: the chains of this population have not converged; sample longer, or add "
            "`anyway=True` to use them nevertheless"
        )
    law = law_named(str(attributes["law"]), fibre_switch=bool(attributes["fibre_switch"]))
    # Median equibiaxial curves of the group as a specimen.
    stretch = np.linspace(1.0, float(attributes["largest_stretch"]), 61)
    with np.errstate(over="ignore", invalid="ignore"):
        stress = law.material(table).cauchy(stretch[None], stretch[None])
    x, y = (np.median(np.nan_to_num(s, nan=np.inf), axis=0) for s in stress)
    curves = Protocol("equibiaxial", stretch, stretch, x, y)
    specimen = Specimen(group, (curves,), "cauchy", "unloaded")
    # Stretches are total ones: the unloaded state is the reference.
    table = table.assign(**dict.fromkeys(mounting_names("stretch"), 1.0))
    mean, _ = chosen_draws(table, specimen, law, at="median")
    count = min(count or DEFAULT_NEW_SPECIMENS, len(table))
    rows, _ = chosen_draws(table, specimen, law, count=count, seed=seed)
    origin = f"new specimen of {group}"
    manifest, files = made_cards(table, specimen, law, rows, out, origin=origin, **how)
    origin += " with the curves nearest the median curves"
    curve = out / MEAN_CURVE
    _, of_the_mean = made_cards(table, specimen, law, mean, curve, origin=origin, **how)
    write_cards(files | of_the_mean)
    return manifest
