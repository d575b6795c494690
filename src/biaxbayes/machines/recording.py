"""What to take from a raw file, and what was taken from it for one protocol."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines import BRANCHES, FORMATS, STRETCH_SOURCES
from biaxbayes.machines.raw_table import RawTable
from biaxbayes.specimens.branches import Cycle, cycles, progress
from biaxbayes.specimens.plausibility import check_load, check_stretch

__all__ = [
    "Choice",
    "Reader",
    "Recording",
    "chosen_number",
    "cycle_label",
    "gauge_note",
    "shear_angle_deg",
    "take_branch",
]


@dataclass(frozen=True)
class Choice:
    """What to take from a raw file.

    Attributes
    ----------
    machine : str
        One of :data:`biaxbayes.machines.FORMATS`.
    columns : tuple of str
        ``target=column[:unit]`` texts of the generic machine.
    cycle : str
        ``last`` or a number.
    branch : {"loading", "unloading", "both"}
    stretch_from : {"auto", "tracked", "rake"}
        Of a BioTester.
    sets : tuple of str
        Of a BioTester; the last where empty.
    sheets : tuple of str
        Of a workbook, one or more protocols each; ``all`` for every one that holds a table.
    """

    machine: str
    columns: tuple[str, ...] = ()
    cycle: str = "last"
    branch: str = "loading"
    stretch_from: str = "auto"
    sets: tuple[str, ...] = ()
    sheets: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("machine", self.machine, tuple(FORMATS)),
            ("branch", self.branch, BRANCHES),
            ("stretch_from", self.stretch_from, STRETCH_SOURCES),
        ):
            if value not in allowed:
                raise InputError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")


@dataclass(frozen=True, eq=False)
class Recording:
    """Rows of one loading path, converted.

    Attributes
    ----------
    name : str
    source : str
        File (and set) that it comes from.
    stretch, load : ndarray, shape (n, 2)
        As measured: the stretch at rest need not be one. N or kPa.
    columns : tuple of str
        Raw columns that stretch x, y and load x, y come from.
    stress_pair : {"force", "piola", "cauchy"}
    time_s : ndarray, shape (n,), or None
    gradient : ndarray, shape (n, 2, 2), or None
        In-plane deformation gradient where the file has its off-diagonal components.
    lines : ndarray of int, shape (n,)
        Line of the raw file of each row.
    rows_in_file : int
    cycle : str or None
        Such as ``6 of 6``; None where the file holds one cycle only.
    branch : str
    notes : tuple of str
    """

    name: str
    source: str
    stretch: np.ndarray
    load: np.ndarray
    columns: tuple[str, str, str, str]
    stress_pair: str
    time_s: np.ndarray | None
    gradient: np.ndarray | None
    lines: np.ndarray
    rows_in_file: int
    cycle: str | None
    branch: str
    notes: tuple[str, ...] = ()

    def check(
        self, file: object, sections: tuple[float, float] | None, limit_kPa: float | None = None
    ) -> None:
        """Refuse numbers that cannot be what their column says.

        Parameters
        ----------
        file : object
            For the message.
        sections : (float, float) or None
            Sections under the force in x and y, mm^2; None for stresses.
        limit_kPa : float, optional
        """
        if len(self.lines) < 2:
            raise InputError(
                f"{len(self.lines)} row left of the {self.branch} branch",
                file=file,
                remedy="choose another --cycle or --branch",
            )
        for k in range(2):
            check_stretch(self.stretch[:, k], self.lines, self.columns[k], file)
            check_load(
                self.load[:, k],
                self.lines,
                self.columns[2 + k],
                file,
                section_mm2=None if sections is None else sections[k],
                limit_kPa=limit_kPa,
            )


Reader = Callable[[RawTable, Choice, tuple[float, float] | None], list[Recording]]
"""Reader of a format: a table, what to take, and the edges (mm) where they are known."""


def gauge_note(axis: str, edge_mm: float) -> str:
    """What a displacement was divided by to make a stretch of it."""
    return (
        f"stretch {axis} is 1 + displacement / {edge_mm:g} mm: the edge is taken as gauge length; "
        "if the grips or markers are another distance apart, give a column of lengths or stretches"
    )


def shear_angle_deg(gradient: np.ndarray) -> np.ndarray:
    """Change of the right angle between the x and y axes, degrees; a rotation has none.

    Parameters
    ----------
    gradient : ndarray, shape (n, 2, 2)
    """
    # C = F^T F;  sin(gamma) = C12 / sqrt(C11 C22)
    C = np.einsum("nki,nkj->nij", gradient, gradient)
    sine = C[:, 0, 1] / np.sqrt(C[:, 0, 0] * C[:, 1, 1])
    return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))


def take_branch(
    stretch: np.ndarray, load: np.ndarray, branch: str, which: str, table: RawTable
) -> tuple[np.ndarray, str | None]:
    """Rows of a branch of a cycle that is found from the curves themselves.

    Parameters
    ----------
    stretch, load : ndarray, shape (n, 2)
    branch : {"loading", "unloading", "both"}
        An unloading branch is turned round, so that its first row is at rest.
    which : str
        ``last`` or a number from 1.
    table : RawTable
        For messages.

    Returns
    -------
    rows : ndarray of int
    cycle : str or None
        Such as ``3 of 5``; None where there is one cycle.
    """
    found = cycles(progress(stretch, load))
    if not found:
        raise InputError(
            "the record never rises: no loading branch",
            file=table.path,
            remedy=f"check the columns; {table.found}",
        )
    names = [str(i + 1) for i in range(len(found))]
    number = chosen_number(which, names, table)
    return rows_of(found[number], branch), cycle_label(names, number)


def rows_of(cycle: Cycle, branch: str) -> np.ndarray:
    """Row numbers of a branch."""
    up = np.arange(cycle.loading.start, cycle.loading.stop)
    down = np.arange(cycle.unloading.start, cycle.unloading.stop)
    return {"loading": up, "unloading": down[::-1], "both": np.union1d(up, down)}[branch]


def cycle_label(found: list[str], number: int) -> str | None:
    """A cycle among others, such as ``6 of 6``; None where it is the only one."""
    if len(found) < 2:
        return None
    place = f"{number + 1} of {len(found)}"
    return place if found[number] == str(number + 1) else f"{found[number]} ({place})"


def chosen_number(which: str, found: list[str], table: RawTable) -> int:
    """Index of the cycle that was asked for.

    Raises
    ------
    InputError
        If there is no such cycle; the message lists those that were found.
    """
    if which == "last":
        return len(found) - 1
    if which not in found:
        shown = ", ".join(found) if len(found) < 12 else f"{found[0]} to {found[-1]}"
        raise InputError(
            f"no cycle {which}", file=table.path, remedy=f"found {shown or 'none'}; or --cycle last"
        )
    return found.index(which)
