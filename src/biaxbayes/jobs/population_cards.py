"""Material cards of a population: of new specimens of a group, and of its mean curve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError, NotConverged, RunError
from biaxbayes.jobs.population_files import read_population
from biaxbayes.laws.law import Law
from biaxbayes.parameters import mounting_names
from biaxbayes.runs.archive import SuspiciousArchive, check_archive
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

__all__ = ["export_population"]


MEAN_CURVE = "mean-curve"


def export_population(
    folder: Path,
    group: str,
    program: str,
    *,
    out: Path,
    draws: int,
    units: str,
    bulk_ratio: float | None,
    seed: int,
    overwrite: bool,
    anyway: bool = False,
) -> pd.DataFrame:
    """Cards of new specimens of a group, and in a folder of its own that of the mean curve.

    The mean curve is that of the new specimen whose curves are nearest the median curves: means
    of parameters one by one are no material of the group.

    Parameters
    ----------
    folder : Path
        Of a finished population.
    group : str
    program : {"abaqus", "febio"}
    out : Path
    draws : int
        Number of new specimens.
    units, bulk_ratio, seed, overwrite
        As in :func:`biaxbayes.cards.export.export_cards`.
    anyway : bool
        Even where the population is unusable.

    Returns
    -------
    DataFrame
        Manifest of the new specimens.
    """
    from biaxbayes.cards.export import export_cards
    from biaxbayes.laws import law_named
    from biaxbayes.prediction.draws import chosen_draws

    state = read_population(folder).state
    if state == "unusable" and not anyway:
        raise NotConverged(
            f"{folder}: the chains of this population have not converged; sample longer, or add "
            "--anyway to use them all the same"
        )
    table, about = _materials(folder, group)
    law = law_named(str(about["law"]), fibre_switch=bool(about["fibre_switch"]))
    specimen = _equibiaxial(group, law, table, float(about["largest_stretch"]))
    # stretches are total ones: the unloaded state is the reference
    table = table.assign(**dict.fromkeys(mounting_names("stretch"), 1.0))
    mean, _ = chosen_draws(table, specimen, law, at="median")
    rows, _ = chosen_draws(table, specimen, law, count=min(draws, len(table)), seed=seed)
    kind: dict[str, Any] = {
        "program": program,
        "units": units,
        "bulk_ratio": bulk_ratio,
        "overwrite": overwrite,
    }
    manifest = export_cards(
        table, specimen, law, rows, out, origin=f"new specimen of {group}", **kind
    )
    export_cards(
        table,
        specimen,
        law,
        mean,
        out / MEAN_CURVE,
        origin=f"new specimen of {group} with the curves nearest the median curves",
        **kind,
    )
    return manifest


def _materials(folder: Path, group: str) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Materials of new specimens of a group, and what the archive says of them."""
    import xarray as xr

    path = folder / "population.nc"
    try:
        check_archive(path)
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            found = tree["new_specimens"]["material"].load()
            about = {str(k): v for k, v in tree.attrs.items()}
        groups = [str(g) for g in found["group"].to_numpy()]
        names = [str(n) for n in found["parameter"].to_numpy()]
        values = found.to_numpy()
    except (OSError, KeyError, ValueError, SuspiciousArchive) as error:
        raise RunError(f"{path}: cannot be read as a population ({type(error).__name__})") from None
    if group not in groups:
        raise InputError(
            f"no group {group[:60]!r} in this population", remedy=f"groups are {', '.join(groups)}"
        )
    return pd.DataFrame(values[groups.index(group)], columns=names), about


def _equibiaxial(group: str, law: Law, table: pd.DataFrame, top: float) -> Specimen:
    """A record of the group's median curves, whose states the cards are checked at."""
    stretch = np.linspace(1.0, top, 61)
    with np.errstate(over="ignore", invalid="ignore"):
        stress = law.material(table).cauchy(stretch[None], stretch[None])
    x, y = (np.median(np.nan_to_num(s, nan=np.inf), axis=0) for s in stress)
    return Specimen(group, (Protocol("equibiaxial", stretch, stretch, x, y),), "cauchy", "unloaded")
