"""One loading path as it was taken from an export."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Recording:
    """Rows of one loading path, converted.

    Attributes
    ----------
    name : str
        Name of the protocol.
    source : str
        File, and set or protocol in it.
    stretch, load : ndarray, shape (n, 2)
        As measured: the stretch at rest need not be one. N or kPa.
    columns : tuple of str
        Raw columns of stretch x, y and load x, y.
    stress_pair : {"force", "piola", "cauchy"}
    time_s : ndarray, shape (n,), or None
    gradient : ndarray, shape (n, 2, 2), or None
        In-plane deformation gradient where the file has its off-diagonal components.
    lines : ndarray of int, shape (n,)
        Line of the raw file of each row.
    rows_in_file : int
        Rows that the branch was cut from.
    cycle : str or None
        Such as ``6 of 6``; None where the file holds one cycle only.
    branch : str
        Branch that was taken.
    notes : tuple of str
        How the file was read.
    assumptions : tuple of str
        What stretches and loads rest on; written into the specimen file.
    """

    name: str
    source: str
    stretch: np.ndarray
    load: np.ndarray
    columns: tuple[str, ...]
    stress_pair: str
    time_s: np.ndarray | None
    gradient: np.ndarray | None
    lines: np.ndarray
    rows_in_file: int
    cycle: str | None
    branch: str
    notes: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def shear_angle_deg(gradient: np.ndarray) -> np.ndarray:
    """Change of the right angle between the x and y axes by gradients of shape (n, 2, 2)."""
    # C = F^T F;  sin(gamma) = C12 / sqrt(C11 C22); a rotation has none
    C = np.einsum("nki,nkj->nij", gradient, gradient)
    sine = C[:, 0, 1] / np.sqrt(C[:, 0, 0] * C[:, 1, 1])
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))
