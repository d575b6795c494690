"""One loading path of an export."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Recording:
    """Rows of one loading path, converted."""

    name: str  # of the protocol
    source: str  # file, and set or protocol in it
    stretch: np.ndarray  # (n, 2), as measured: at rest it need not be one
    load: np.ndarray  # (n, 2), N or kPa
    columns: tuple[str, ...]  # raw columns of stretch x, y and load x, y
    stress_pair: str
    time_s: np.ndarray | None
    gradient: np.ndarray | None  # (n, 2, 2), if the file has its off-diagonal components
    lines: np.ndarray  # of the raw file, from 1
    rows_in_file: int  # that the branch was cut from
    cycle: str | None  # such as "6 of 6"; None for a file of one cycle
    branch: str
    notes: tuple[str, ...] = ()  # how the file was read
    assumptions: tuple[str, ...] = ()  # of stretches and loads; written into the specimen file


def shear_angle_deg(gradient: np.ndarray) -> np.ndarray:
    """Change of the right angle between the x and y axes by gradients of shape (n, 2, 2)."""
    # C = F^T F;  sin(gamma) = C12 / sqrt(C11 C22); a rotation has none
    C = np.einsum("nki,nkj->nij", gradient, gradient)
    sine = C[:, 0, 1] / np.sqrt(C[:, 0, 0] * C[:, 1, 1])
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))
