"""How stiff the pieces of a tissue are beside one another, and which of them differ."""

from __future__ import annotations

import pandas as pd

from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import STIFFNESS, name_of
from biaxbayes.prediction.percentiles import quantiles
from biaxbayes.report_table import interval_texts


def piece_stiffnesses(posterior: Posterior, draws: pd.DataFrame) -> tuple[list[str], list[str]]:
    """A sentence on each further piece: those as stiff as the first, and those that differ."""
    alike, different = [], []
    first, *further = posterior.specimen.pieces
    for piece in further:
        low, median, high = quantiles(draws[name_of(STIFFNESS.name, piece.name)])
        middle, *ends = interval_texts(median, low, high, STIFFNESS)
        many = f"{middle} ({' to '.join(ends)})"
        text = f"piece {piece.name} is {many} times as stiff as {first.name}"
        if low <= 1.0 <= high:
            alike.append(text)
            continue
        different.append(
            f"{text}: it differs. The other intervals allow for a stiffness of its own, not for "
            "another fibre angle or layer: check its width and thickness and where it was cut"
        )
    return alike, different
