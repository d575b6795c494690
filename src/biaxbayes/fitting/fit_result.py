"""Result of a deterministic fit, and how far rounding of the data limits it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from biaxbayes.errors import load_text, two_digits
from biaxbayes.forward import LoadResponse
from biaxbayes.laws.law import Law
from biaxbayes.specimens.rows import MeasuredRows

EXPLAINED = 1.5
"""Misfit over noise up to which the noise explains the misfit."""
POOR_MISFIT = 0.07
"""A law that misses by more than this fraction of the largest load does not describe it."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """A deterministic fit.

    Attributes
    ----------
    method : str
        ``standard``, ``zeroed``, ``fip``, ``linden`` or ``constrained``.
    mounting_stretch : ndarray, shape (m, 2)
        One row, or one per protocol.
    mounting_load : ndarray, shape (m, 2)
        Load of the model at the mounted state, in the specimen's unit.
    r2, rmse_kPa, mae_kPa : float
        Coefficient of determination, root mean square and mean absolute error of the Cauchy stress
        against the data at the fit's own mounting stretch, all rows, both directions pooled with
        one mean. R2 is NaN where the data do not vary.
    iterations : int
        Accepted steps; for ``fip`` the alternations.
    at_bound : tuple of str
        Unknowns that ended on a bound.
    residuals : tuple of ndarray, shape (n_p, 2)
        Measured minus model load in the specimen's unit over :attr:`Specimen.load_scale`, without
        the rows at rest, of all pieces.
        All zero where their root mean square is below :attr:`Specimen.load_resolution`, which is
        rounding.
    stiffness : ndarray, shape (pieces,)
        Of each piece over that of the first.
    """

    method: str
    material: Any
    mounting_stretch: np.ndarray
    mounting_load: np.ndarray
    r2: float
    rmse_kPa: float
    mae_kPa: float
    iterations: int
    converged: bool
    at_bound: tuple[str, ...]
    residuals: tuple[np.ndarray, ...]
    stiffness: np.ndarray = field(default_factory=lambda: np.ones(1))

    def __repr__(self) -> str:
        values = ", ".join(f"{label}={v:.4g}" for label, v in self._values().items())
        end = "" if self.converged else ", not converged"
        return f"FitResult({self.method}: {values}, RMSE {self.rmse_kPa:.3g} kPa{end})"

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, in the unit of the loads."""
        return root_mean_square(self.residuals)

    def _values(self) -> dict[str, float]:
        """Parameters of the material, by their names with units."""
        labels = [p.label for p in self.material.law.parameters]
        return dict(zip(labels, self.material.values, strict=True))

    def record(self) -> dict[str, object]:
        """The fit as plain values; mounting stretches are lists where each protocol has one."""
        stretch_x, stretch_y = (
            column if len(column) > 1 else column[0] for column in self.mounting_stretch.T.tolist()
        )
        errors = {"r2": self.r2, "rmse_kPa": self.rmse_kPa, "mae_kPa": self.mae_kPa}
        return {
            "method": self.method,
            "law": self.material.law.name,
            **self._values(),
            "mounting_stretch_x": stretch_x,
            "mounting_stretch_y": stretch_y,
            **{name: value if math.isfinite(value) else None for name, value in errors.items()},
            "iterations": self.iterations,
            "converged": self.converged,
            "at_bound": list(self.at_bound),
        } | ({"stiffness": self.stiffness.tolist()} if len(self.stiffness) > 1 else {})

    def parameter_error(self, truth: Mapping[str, float]) -> float:
        """Mean relative error of the material parameters, the MAE of the method paper (Eq. 8).

        (1/n) sum |P_true - P| / |P_true| over the parameters whose true value is known, by label
        (``C1_kPa``) or name, and not zero; NaN if there is none.
        """
        values = zip(self.material.law.parameters, self.material.values, strict=True)
        known = [(v, truth.get(p.label, truth.get(p.name, 0.0))) for p, v in values]
        errors = [abs(value - true) / abs(true) for value, true in known if true]
        return float(np.mean(errors)) if errors else math.nan

    def _repr_html_(self) -> str:
        """The fit as a table of one column, for notebooks."""
        rows = []
        for name, value in self.record().items():
            text = f"{value:.5g}" if isinstance(value, float) else str(value)
            rows.append(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>")
        return f"<table>{''.join(rows)}</table>"


def fit_from_record(record: Mapping[str, Any], law: Law, states: int) -> FitResult:
    """Material and mounting stretches of a record, no residuals; ValueError if out of range."""
    values = [float(record[p.label]) for p in law.parameters]
    stretch = np.column_stack(
        [np.array(record[f"mounting_stretch_{a}"], dtype=float, ndmin=1) for a in "xy"]
    )
    inside = all(p.in_range(np.array(v)) for p, v in zip(law.parameters, values, strict=True))
    positive = np.isfinite(stretch).all() and (stretch > 0.0).all()
    if not (inside and positive and stretch.shape == (states, 2)):
        raise ValueError("its values are out of range")
    method, converged = str(record["method"]), bool(record["converged"])
    nan = math.nan
    unknown = np.full_like(stretch, nan)
    stiffness = np.asarray(record.get("stiffness", [1.0]), dtype=float)
    material = law.material_at(tuple(values))
    return FitResult(
        method, material, stretch, unknown, nan, nan, nan, 0, converged, (), (), stiffness
    )


def root_mean_square(residuals: Sequence[np.ndarray]) -> float:
    """Root mean square of the residuals of all protocols."""
    # across a strip nothing is read
    read = [column for part in residuals for column in part.T if column.any()]
    return float(np.sqrt(np.mean(np.concatenate(read) ** 2))) if read else 0.0


DIGITS = 15
"""Significant digits that a double holds whatever the number is."""


def half_digits(values: np.ndarray) -> np.ndarray:
    """Half a unit of the last written digit of each value of a column.

    A column is written with a fixed number of decimals or of significant digits. Either is the
    largest that one of its values needs; the coarser of the two applies to a value.
    """
    written = [f"{v:.{DIGITS - 1}e}".split("e") for v in np.abs(values).tolist()]
    significant = np.array([len(m.replace(".", "").rstrip("0")) for m, _ in written])
    leading = np.array([int(exponent) for _, exponent in written])
    nonzero = significant > 0
    if not nonzero.any():
        return np.zeros(len(values))
    decimals = int((significant - 1 - leading)[nonzero].max())
    by_significance = np.where(nonzero, leading + 1 - int(significant.max()), -decimals)
    return 0.5 * 10.0 ** np.maximum(-decimals, by_significance)


def rounding_bound(data: MeasuredRows, response: LoadResponse) -> float:
    """Largest root mean square miss of the Cauchy stress that rounding explains, in kPa.

    A record without noise is fitted down to that, where no step lowers the cost any more.
    """
    # half digits of the columns; the reader divides stretches, and Cauchy stresses with them, by
    # the stretch at rest
    written = []
    for piece in data.pieces:
        curves = [np.hstack([p.known_stretch, p.recorded_load]) for p in piece.protocols]
        by = [np.tile(p.reference, (p.rows, 2)) for p in piece.protocols]
        values, divided = np.concatenate(curves), np.concatenate(by)
        if not piece.kind_of_loads.times_stretch:
            divided[:, 2:] = 1.0
        digits = np.column_stack([half_digits(column) for column in (values * divided).T])
        written.append(digits / divided)
    stretch, load = np.hsplit(np.concatenate(written), 2)
    # data: f l lm / A0 (unloaded), f l / Am (mounted); model: s(l lm). Their difference moves by
    #   df / factor + s dl / l - sum_j ds/d(ln l_j) dl_j / l_j
    stress = response.stress[..., None] * np.eye(2)
    # d(load / section) / d ln lm = ds/d(ln l) - s with unloaded dimensions
    by_log = response.by_log_mounting / response.load_per_stress[..., None]
    slope = np.abs(by_log + data.unloaded[:, None, None] * stress) + np.abs(stress)
    moved = stretch / np.nan_to_num(data.stretch, nan=1.0)
    bound = load / response.load_per_stress + np.einsum("nkj,nj->nk", slope, moved)
    return float(np.sqrt((bound[data.is_read] ** 2).mean()))


def misfit_sentence(
    law_name: str,
    rms: float,
    noise: float,
    peak: float,
    unit: str,
    *,
    record: str = "this record",
    share: bool = False,
) -> str:
    """The misfit of a law beside the noise of a reading, or as a share of the peak load."""
    text = f"{law_name} misses {record} by {load_text(rms, unit)} (root mean square)"
    if share or not noise > 0.0:
        text += f", {100.0 * rms / max(peak, 1e-300):.2g} % of the largest load"
    if not noise > 0.0:
        return text
    ratio = rms / noise
    if ratio < EXPLAINED:
        return f"{text}, about the noise of the load cell"
    times = "twice" if 1.75 <= ratio < 2.25 else f"{two_digits(ratio)} times"
    return f"{text}, {times} the noise of the load cell"
