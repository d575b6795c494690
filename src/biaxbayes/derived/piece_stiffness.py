"""How stiff the pieces of a tissue are beside one another, and which of them differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import STIFFNESS, name_of
from biaxbayes.prediction.percentiles import quantiles
from biaxbayes.report_table import interval_texts


@dataclass(frozen=True)
class PieceStiffness:
    """Stiffness of a further piece over that of the first: quantiles of the draws."""

    piece: str
    first: str
    median: float
    low: float
    high: float

    @property
    def differs(self) -> bool:
        """Whether the interval excludes 1."""
        return not self.low <= 1.0 <= self.high

    def __str__(self) -> str:
        median, low, high = interval_texts(self.median, self.low, self.high, STIFFNESS)
        text = f"{self.piece} is {median} ({low} to {high}) times as stiff as {self.first}"
        if not self.differs:
            return text
        return (
            f"{text}: it differs. The other intervals allow for a stiffness of its own, not for "
            "another fibre angle or layer: check its width and thickness and where it was cut"
        )


def piece_stiffnesses(posterior: Posterior, draws: pd.DataFrame) -> tuple[PieceStiffness, ...]:
    """The stiffness of each further piece."""
    out, (first, *further) = [], posterior.specimen.pieces
    for piece in further:
        values = draws[name_of(STIFFNESS.name, piece.name)].to_numpy(dtype=float)
        low, median, high = quantiles(values)
        out.append(PieceStiffness(piece.name, first.name, median, low, high))
    return tuple(out)


def differences(pieces: Sequence[PieceStiffness]) -> tuple[str, ...]:
    """A sentence on each piece that differs from the first."""
    return tuple(str(piece) for piece in pieces if piece.differs)
