"""summary.csv: one row a quantity, and only numbers that can be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.csv_tables import write_csv
from biaxbayes.errors import RunError
from biaxbayes.parameters import Quantities
from biaxbayes.sampling.convergence import Convergence

__all__ = ["COLUMNS", "read_summary", "summarise", "with_verdicts", "write_summary"]

COLUMNS = (
    "parameter",
    "unit",
    "mean",
    "sd",
    "q05",
    "q50",
    "q95",
    "ess_bulk",
    "ess_tail",
    "rhat",
    "verdict",
)
TEXT = ("parameter", "unit", "verdict")


def summarise(
    quantities: dict[str, np.ndarray],
    names: tuple[str, ...],
    known: Quantities,
    convergence: Convergence,
) -> pd.DataFrame:
    """Summary table.

    Where the chains are ``tentative`` the effective sample sizes are left empty, where they are
    ``unusable`` every number but R-hat is.

    Parameters
    ----------
    quantities : dict of ndarray, shape (ensembles, steps, walkers)
    names : tuple of str
        Rows, in order.
    known : Quantities
        What each name is.
    convergence : Convergence
    """
    position = {name: i for i, name in enumerate(convergence.names)}
    rows = []
    for name in names:
        draws = quantities[name]
        row: dict[str, object] = dict.fromkeys(COLUMNS, np.nan)
        row |= {"parameter": name, "unit": known[name].unit}
        i = position.get(name)
        if convergence.state != "unusable" and draws.size:
            q05, q50, q95 = np.quantile(draws, [0.05, 0.5, 0.95])
            sd = draws.std(ddof=1) if i is not None else 0.0
            row |= {"mean": draws.mean(), "sd": sd, "q05": q05, "q50": q50, "q95": q95}
        if i is not None:
            row["rhat"] = convergence.rhat[i]
            if convergence.state == "converged":
                row["ess_bulk"] = np.floor(convergence.ess_bulk[i])
                row["ess_tail"] = np.floor(convergence.ess_tail[i])
        rows.append(row)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def with_verdicts(table: pd.DataFrame, verdicts: Mapping[str, str]) -> pd.DataFrame:
    """The same table with what the data say of each parameter.

    Parameters
    ----------
    table : DataFrame
    verdicts : mapping of str to str
        By parameter; a quantity that is not judged has none.
    """
    told = [verdicts.get(str(name), np.nan) for name in table["parameter"]]
    return table.assign(verdict=pd.Series(told, dtype=object))


def write_summary(path: Path, table: pd.DataFrame) -> None:
    """Write summary.csv with eight significant digits."""
    write_csv(path, table, digits=8)


def read_summary(path: Path) -> pd.DataFrame:
    """Read summary.csv.

    Raises
    ------
    RunError
        If it is not a summary.
    """
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(TEXT, str), keep_default_na=True)
        numbers = [name for name in COLUMNS if name not in TEXT]
        table[numbers] = table[numbers].astype(float)
        if "verdict" not in table:  # of before verdicts stood here
            table["verdict"] = np.nan
    except (OSError, ValueError, KeyError, TypeError, OverflowError, MemoryError) as error:
        raise RunError(
            f"{path}: cannot be read as the summary of a run ({type(error).__name__})"
        ) from None
    return table
