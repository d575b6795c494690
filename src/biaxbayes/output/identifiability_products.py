"""What a run folder says about what its data determine: tables, a figure, sentences."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from biaxbayes.findings.determined import determined, mounting_stated
from biaxbayes.findings.identifiability import Identifiability, identify_draws
from biaxbayes.findings.sloppiness import Sloppiness, sloppiness
from biaxbayes.inference.posterior import Posterior
from biaxbayes.output.annotated_table import write_annotated
from biaxbayes.output.identifiability_file import write_identifiability

__all__ = ["Identified", "write_identifiability_products"]

DETERMINED_NOTES = (
    "median and 90 % interval of the model; stretches are total, or relative to the mounted state "
    "for nominal stresses at a measured stretch; stiffnesses are derivatives of the Cauchy "
    "stress by the log stretch; relative_width is the interval over the median",
    "tissue_low_90, tissue_high_90: the interval of the tissue's stress, which holds the error "
    "that the run inferred as well, and at total stretches a mounting stretch that is not "
    "identified; empty at total stretches where the mounting stretch may be 1.1 or more and was "
    "not measured: state the stress at a measured stretch then",
)


@dataclass(frozen=True)
class Identified:
    """What was found.

    Attributes
    ----------
    verdicts : Identifiability
    determined : DataFrame or None
        None where the chains are not reliable.
    directions : Sloppiness or None
        None there too, and where no material parameter is free or some are tied.
    """

    verdicts: Identifiability
    determined: pd.DataFrame | None
    directions: Sloppiness | None

    def in_words(self) -> list[str]:
        """Sentences: a verdict a parameter, then the best and the least known combination."""
        lines = self.verdicts.in_words()
        return lines + (self.directions.in_words() if self.directions else [])


def write_identifiability_products(
    folder: Path, posterior: Posterior, draws: pd.DataFrame, state: str, *, figure: bool = True
) -> Identified:
    """Judge the draws of a run and write what was found into its folder.

    Writes ``identifiability.csv``, with reliable draws ``determined.csv`` and
    ``same-curves.csv``, and ``identifiability.pdf``.

    Parameters
    ----------
    folder : Path
    posterior : Posterior
    draws : DataFrame
        Natural quantities, ``log_likelihood`` and ``lp``, one row a draw.
    state : {"reliable", "tentative", "unusable"}
    figure : bool
        Whether to draw the figure, which takes matplotlib.

    Returns
    -------
    Identified

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    verdicts = identify_draws(posterior, draws, state)
    write_identifiability(verdicts, folder / "identifiability.csv")
    table, directions = None, None
    if state == "reliable":
        table = determined(
            draws,
            posterior.specimen,
            fibre_switch=posterior.settings.fibre_switch,
            refits=verdicts.refits(),
            mounting_known=mounting_stated(posterior.settings.priors),
        )
        write_annotated(table, DETERMINED_NOTES, folder / "determined.csv")
        directions = sloppiness(posterior, draws)
        if directions is not None:
            notes = [directions.words, "C1, k1 in kPa, alpha in degrees"]
            write_annotated(directions.path.to_frame(), notes, folder / "same-curves.csv")
    if figure:
        from biaxbayes.output.figures.identifiability import identifiability_figure
        from biaxbayes.output.style import save_figure

        save_figure(identifiability_figure(verdicts), folder / "identifiability.pdf")
    return Identified(verdicts, table, directions)
