"""The posterior predictive checks of a run, for everything that is written about it."""

from __future__ import annotations

import pandas as pd

from biaxbayes.findings.predictive_checks import path_warnings, predictive_checks
from biaxbayes.inference.settings import Settings
from biaxbayes.output.provenance import parse_options
from biaxbayes.output.report.names import cut
from biaxbayes.output.run import Run

__all__ = ["missed_paths", "model_checks"]

NAME_LENGTH = 60


def model_checks(run: Run) -> pd.DataFrame:
    """Checks of every curve, as by :func:`biaxbayes.findings.predictive_checks`.

    Parameters
    ----------
    run : Run
        Of a state that has a posterior.
    """
    settings = Settings(**parse_options(run.provenance["settings"]))
    table = predictive_checks(run.specimen, run.draws, settings=settings)
    return table.assign(protocol=[cut(name, NAME_LENGTH) for name in table["protocol"]])


def missed_paths(run: Run) -> list[str]:
    """A sentence for each protocol that the parameters must not be used for; none where unusable.

    Parameters
    ----------
    run : Run
    """
    if run.state == "unusable":
        return []
    return path_warnings(model_checks(run), run.specimen.unit)
