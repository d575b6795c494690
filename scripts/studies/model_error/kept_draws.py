"""Draws of a study on disk: one file a specimen and candidate, written whole or not at all."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd

from biaxbayes.text_files import atomic_write_bytes
from studies.model_error.candidates import Answer

__all__ = ["kept", "read", "write"]


def _path(folder: Path, seed: int, candidate: str) -> Path:
    return folder / f"{seed:04d} {candidate}.npz"


def kept(folder: Path, seed: int, candidate: str) -> bool:
    """Whether the draws are there already."""
    return _path(folder, seed, candidate).exists()


def write(folder: Path, seed: int, candidate: str, answer: Answer, cpu_s: float) -> None:
    """Keep the draws of a candidate."""
    folder.mkdir(parents=True, exist_ok=True)
    held = io.BytesIO()
    np.savez_compressed(
        held,
        names=np.array(answer.draws.columns, dtype=str),
        values=answer.draws.to_numpy(dtype=np.float64),
        state=answer.state,
        beta=answer.beta,
        cpu_s=cpu_s,
    )
    atomic_write_bytes(_path(folder, seed, candidate), held.getvalue())


def read(folder: Path, seed: int, candidate: str) -> Answer:
    """The draws again."""
    with np.load(_path(folder, seed, candidate)) as file:
        draws = pd.DataFrame(file["values"].astype(float), columns=list(map(str, file["names"])))
        return Answer(draws, str(file["state"]), float(file["beta"]), float(file["cpu_s"]))
