"""The files of a study: tables, figure and page."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.output.study_result import StudyResult
from biaxbayes.specimens.text_file import atomic_write_bytes, atomic_write_text

__all__ = ["write_study"]

TABLE, PAGE = "study", "study.html"


def write_study(result: StudyResult) -> list[Path]:
    """Write every file of a study into its folder.

    Parameters
    ----------
    result : StudyResult

    Returns
    -------
    list of Path
        What was written; ``study.parquet`` only where pyarrow is installed.
    """
    from biaxbayes.output.figures.study import study_figure
    from biaxbayes.output.report.study_page import FIGURE, study_page
    from biaxbayes.output.style import save_figure

    folder = result.folder
    written = []
    tables = {
        TABLE: result.table,
        "study-groups": result.groups,
        "study-contrasts": result.contrasts,
        "study-distances": result.distances,
    }
    for stem, table in tables.items():
        path = folder / f"{stem}.csv"
        if table.empty and stem != TABLE:
            path.unlink(missing_ok=True)
            continue
        atomic_write_text(path, table.to_csv(index=False, float_format="%.8g", lineterminator="\n"))
        written.append(path)
    parquet = _parquet(result.table)
    if parquet is not None:
        path = folder / f"{TABLE}.parquet"
        atomic_write_bytes(path, parquet)
        written.append(path)
    for suffix in ("pdf", "png"):
        path = folder / f"{FIGURE}.{suffix}"
        if np.isfinite(result.table["q50"].astype(float)).any():
            save_figure(study_figure(result.table), path)
            written.append(path)
        else:
            path.unlink(missing_ok=True)
    page = folder / PAGE
    atomic_write_text(page, study_page(result))
    return [*written, page]


def _parquet(table: pd.DataFrame) -> bytes | None:
    """The table with typed columns, where pyarrow is there to write it."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        return None
    typed = table.convert_dtypes()
    buffer = io.BytesIO()
    typed.to_parquet(buffer, engine="pyarrow", index=False)
    return buffer.getvalue()
