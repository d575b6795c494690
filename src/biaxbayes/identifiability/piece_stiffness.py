"""How stiff the pieces of a tissue are beside one another, and which of them disagree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import STIFFNESS, name_of
from biaxbayes.prediction.percentiles import quantiles

FAR = 2.0
"""Stated standard deviations beyond which a stiffness disagrees, if its interval excludes 1."""


@dataclass(frozen=True)
class PieceStiffness:
    """Stiffness of a further piece over that of the first: quantiles of the draws."""

    piece: str
    first: str
    median: float
    low: float
    high: float
    sds: float  # ln median over the stated sd

    @property
    def disagrees(self) -> bool:
        """Whether the stiffness differs from 1 by more than pieces were stated to scatter."""
        return abs(self.sds) > FAR and not self.low <= 1.0 <= self.high

    def __str__(self) -> str:
        text = (
            f"{self.piece} is {self.median:.2f} ({self.low:.2f} to {self.high:.2f}) times as stiff "
            f"as {self.first}"
        )
        if not self.disagrees:
            return text
        return (
            f"{text}, {abs(self.sds):.1f} stated standard deviations from it: these pieces "
            "disagree. Check its width and thickness and where it was cut, or state a larger "
            "--piece-sd"
        )


def piece_stiffnesses(posterior: Posterior, draws: pd.DataFrame) -> tuple[PieceStiffness, ...]:
    """The stiffness of each further piece."""
    out, (first, *further) = [], posterior.specimen.pieces
    for piece in further:
        values = draws[name_of(STIFFNESS.name, piece.name)].to_numpy(dtype=float)
        low, median, high = quantiles(values)
        sds = float(np.log(median)) / posterior.settings.piece_sd
        out.append(PieceStiffness(piece.name, first.name, median, low, high, sds))
    return tuple(out)


def disagreements(pieces: Sequence[PieceStiffness]) -> tuple[str, ...]:
    """A sentence on each piece that disagrees with the first."""
    return tuple(str(piece) for piece in pieces if piece.disagrees)
