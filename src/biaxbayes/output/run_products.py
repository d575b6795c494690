"""What a run folder holds besides the draws: figures, verdicts, report."""

from __future__ import annotations

from pathlib import Path

from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Draws

__all__ = ["write_products"]


def write_products(folder: Path, posterior: Posterior, draws: Draws) -> None:
    """Write the products of a run into its folder."""
