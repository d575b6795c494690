"""All laws fitted to one record under the same mounting constraint, and what tells them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from biaxbayes.fitting.constrained import LawFit, fit_law
from biaxbayes.laws import DEFAULT_LAW, LAWS
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.path import thinned_specimen
from biaxbayes.specimens.specimen import Specimen

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "FEWEST",
    "LAW_FITS",
    "LawRange",
    "better_law",
    "distinctly_better",
    "law_fits",
    "law_range",
]

LAW_FITS = "law-fits.csv"
"""The table of a run folder."""
ROWS = 60
"""Rows of a protocol that the laws are fitted to, averaged."""
ALIKE = 1.15
"""Laws within so many times the misfit of the best, or of the noise, describe a record alike."""
FEWEST = 2
"""A low end is that of the laws alike, and of so many of the best at least."""
RUBBER = 1.5
"""A sheet of rubber without fibres carries so many times more load a stretch over its first part
than up to a stretch of 1.2. A law that says more of tissue has put the mounted state too near."""
# Tuned with those of what is stated of the mounting stretch (stated.py).
BETTER = 0.75
"""Another law describes a record distinctly better where it misses by less than this share."""
LEAST_SHARE = 2e-3
"""Of the largest load: about what the calibration of a load cell leaves."""


@dataclass(frozen=True)
class LawRange:
    """Fits of all laws to the record of a posterior, and the noise that they are held against.

    Attributes
    ----------
    fits : tuple of LawFit
        The best first.
    noise, peak : float
        Sd of a reading by the load cell, and largest load, in the unit of the specimen.
    carried, reached : ndarray, shape (m, 2), optional
        Load of the mounted state over the largest one of its direction, and the largest measured
        stretch.
    """

    fits: tuple[LawFit, ...]
    noise: float
    peak: float
    carried: np.ndarray | None = None
    reached: np.ndarray | None = None

    @classmethod
    def of(cls, fits: Sequence[LawFit], specimen: Specimen) -> LawRange:
        """Fits of laws to a specimen, in any order.

        Parameters
        ----------
        fits : sequence of LawFit
            At least one.
        specimen : Specimen
        """
        ordered = tuple(sorted(fits, key=lambda f: f.rms))
        shared = len(ordered[0].mounting_stretch) == 1
        reading, _ = specimen.mounting_readings(shared=shared)
        largest = np.max([np.abs(specimen.load(p)).max(axis=0) for p in specimen.protocols], axis=0)
        reached = np.array([[p.stretch_x.max(), p.stretch_y.max()] for p in specimen.protocols])
        return cls(
            ordered,
            specimen.noise_sd,
            specimen.peak_load,
            reading / np.where(largest > 0.0, largest, 1.0),
            reached.max(axis=0, keepdims=True) if shared else reached,
        )

    @property
    def alike(self) -> tuple[LawFit, ...]:
        """Those that describe the record about as well as the best."""
        most = ALIKE * max(self.fits[0].rms, self.noise)
        return tuple(f for f in self.fits if f.rms <= most)

    @property
    def lowest_of(self) -> tuple[LawFit, ...]:
        """Those whose mounting stretches a low end lies below."""
        return self.fits[: max(FEWEST, len(self.alike))]

    def softens(self, index: int, axis: int) -> bool:
        """Whether tissue would be softer where it was measured than on its way to the mounting.

        Parameters
        ----------
        index, axis : int
            As in :func:`stated_by_laws`.
        """
        if self.carried is None or self.reached is None:
            return False
        carried, reached = self.carried[index, axis], self.reached[index, axis]
        stretch = self.fits[0].mounting_stretch[index, axis]
        return bool(
            carried > 0.0 and RUBBER * (stretch - 1.0) < carried * (stretch * reached - 1.0)
        )

    @property
    def least_difference(self) -> float:
        """Misfits that differ by less than the noise, or by this share of the peak, do not."""
        return max(self.noise, LEAST_SHARE * self.peak)

    def to_frame(self, mounts: Sequence[str] = ("",)) -> pd.DataFrame:
        """One row a law: misfits, mounting stretches by name and their sd.

        Parameters
        ----------
        mounts : sequence of str
            Labels of the mounted states.
        """
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "law": f.law,
                    "alike": f in self.alike,
                    "converged": f.converged,
                    "misses_smoothly": f.smooth,
                    "rms": f.rms,
                    "rmse_kPa": f.rmse_kPa,
                    **{
                        key: float(values[i, axis])
                        for i, state in enumerate(mounts)
                        for axis, name in enumerate(mounting_names("stretch", state))
                        for key, values in ((name, f.mounting_stretch), (f"{name}_sd", f.sd))
                    },
                }
                for f in self.fits
            ]
        )


def law_range(table: pd.DataFrame, specimen: Specimen, mounts: Sequence[str]) -> LawRange:
    """Turn the table of a :class:`LawRange` back into it.

    Parameters
    ----------
    table : DataFrame
        From :meth:`LawRange.to_frame`.
    specimen : Specimen
    mounts : sequence of str
        As they were given to it.

    Raises
    ------
    KeyError
        If a column is missing.
    """
    names = [mounting_names("stretch", state) for state in mounts]
    fits = tuple(
        LawFit(
            str(row["law"]),
            float(row["rms"]),
            float(row["rmse_kPa"]),
            np.array([[row[name] for name in pair] for pair in names]),
            np.array([[row[f"{name}_sd"] for name in pair] for pair in names]),
            bool(row["misses_smoothly"]),
            bool(row["converged"]),
        )
        for row in table.to_dict("records")
    )
    return LawRange.of(fits, specimen)


def law_fits(
    specimen: Specimen,
    laws: Sequence[str] = tuple(LAWS),
    *,
    mounting: str = "noisy",
    mounting_stretch: str = "shared",
    rows: int = ROWS,
    starts: int = 3,
) -> LawRange | None:
    """Fit laws to a record under the same mounting constraint.

    Parameters
    ----------
    specimen : Specimen
    laws : sequence of str
    mounting : {"noisy", "exact", "ignored", "zeroed"}
        As in :func:`~biaxbayes.fitting.constrained.constrained_fit`.
    mounting_stretch : {"shared", "per-protocol"}
    rows : int
        Rows of a protocol that longer ones are averaged to.
    starts : int

    Returns
    -------
    LawRange or None
        None where no law could be fitted.
    """
    # The scatter of neighbouring rows is lost by averaging: state it.
    data = replace(thinned_specimen(specimen, rows).specimen, load_noise=specimen.noise_sd or None)
    found = [
        fit_law(data, law, mounting=mounting, mounting_stretch=mounting_stretch, starts=starts)
        for law in laws
    ]
    kept = [f for f in found if np.isfinite(f.rms) and np.isfinite(f.mounting_stretch).all()]
    if not kept:
        return None
    return LawRange.of(kept, specimen)


def distinctly_better(found: LawRange, law: str) -> str:
    """Words on a law that describes the record distinctly better than one; else empty.

    Parameters
    ----------
    found : LawRange
    law : str
        Of the run.
    """
    best = found.fits[0]
    own = next((f for f in found.fits if f.law == law), None)
    if own is None or best.law == law:
        return ""
    if not (best.rms < BETTER * own.rms and own.rms - best.rms > found.least_difference):
        return ""
    return (
        f"{best.law} misses by {best.rmse_kPa:.2g} kPa where {law} misses by "
        f"{own.rmse_kPa:.2g} kPa: see biaxbayes laws"
    )


QUICK_ROWS, QUICK_STARTS = 20, 2
"""Enough to tell laws apart that differ distinctly."""


def better_law(specimen: Specimen, law: str = DEFAULT_LAW) -> str:
    """Words on a law that describes a record distinctly better, by quick fits; else empty.

    Parameters
    ----------
    specimen : Specimen
    law : str
    """
    mounting = "ignored" if specimen.is_tared else "noisy"

    def fitted(laws: Sequence[str]) -> LawRange | None:
        return law_fits(specimen, laws, mounting=mounting, rows=QUICK_ROWS, starts=QUICK_STARTS)

    own = fitted((law,))
    # no law misses by less than the noise
    if own is None or own.fits[0].rms - own.noise < own.least_difference:
        return ""
    others = fitted(tuple(name for name in LAWS if name != law))
    fits = (*own.fits, *(others.fits if others else ()))
    return distinctly_better(replace(own, fits=tuple(sorted(fits, key=lambda f: f.rms))), law)
