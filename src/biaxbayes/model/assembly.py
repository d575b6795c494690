"""From a specimen and settings to the arrays of the compiled density, and back from its draws.

A slot is one number of the density, sampled, fixed or tied: the parameters of the law, the noise
sd, the factors of measured dimensions, the offsets of the load cell, and two per mounted state.
Natural values are in the units of the parameter table; a slot holds the log of a positive scale,
and angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.forward import ForwardModel, MeasuredRows
from biaxbayes.laws.chart import DEFAULT_SOFTENING
from biaxbayes.laws.law import Law, TransformInputs
from biaxbayes.model.density import (
    DIMENSION_SLOTS,
    MODE_FORCE,
    MODE_STRETCH,
    MODE_UNSTRETCHED,
    NOISE_SLOTS,
    Problem,
)
from biaxbayes.model.priors import Prior, Tie, default_priors
from biaxbayes.model.readings import ReadingVector
from biaxbayes.options import Settings
from biaxbayes.parameters import (
    DEGREE,
    DIMENSION,
    DIMENSION_PARAMETERS,
    NOISE_SD,
    Parameter,
    Quantities,
    mounting_names,
)
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import thinned_specimen


@dataclass(frozen=True)
class SamplingConstants:
    """Constants of the sampling coordinates; only the efficiency of a sampler depends on them.

    Attributes
    ----------
    softening : float
        Scale near isotropy (see :mod:`~biaxbayes.laws.dispersed_fibres`).
    reference_stretch : (float, float) or None
        Total stretches at which the fibre stress and exponent are taken as coordinates; None for
        the largest measured ones.
    """

    softening: float = DEFAULT_SOFTENING
    reference_stretch: tuple[float, float] | None = None


@dataclass(frozen=True)
class Assembly:
    """Input of the compiled density, with names."""

    problem: Problem
    forward: ForwardModel
    rows: MeasuredRows
    readings: ReadingVector
    slots: tuple[str, ...]  # names
    free: tuple[str, ...]  # names of the sampled slots, in the order of a walker's coordinates
    priors: dict[str, Prior | float | Tie]  # by slot; a number where fixed
    quantities: Quantities

    @property
    def law(self) -> Law:
        """The material law."""
        return self.forward.law

    @property
    def mounts(self) -> tuple[str, ...]:
        """Label of each mounted state: one empty label when shared, else the protocols' names."""
        return self.quantities.states

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the natural quantities of a draw, as in ``summary.csv``."""
        mounted = (
            () if self.problem.mounting_mode == MODE_UNSTRETCHED else self.quantities.mounting()
        )
        noise = (NOISE_SD.name,) if NOISE_SD.name in self.priors else ()
        measured = (n for n in self.free if self.quantities[n].parameter.kind == DIMENSION)
        return (*self.law.names, *(q.name for q in mounted), *noise, *measured)


def assemble(
    specimen: Specimen,
    settings: Settings,
    constants: SamplingConstants,
    *,
    determinant: bool,
    sampling: bool = True,
) -> Assembly:
    """Lay out the density of a specimen; without ``sampling`` its coordinates are the slots."""
    law = settings.material_law
    data = specimen.zeroed() if settings.mounting == "zeroed" else specimen
    thinned = thinned_specimen(data, settings.thin)
    shared = settings.shared
    states = ("",) if shared else tuple(p.name for p in specimen.protocols)
    quantities = Quantities(law.parameters, states, specimen.unit)
    reading, _ = specimen.mounting_readings(shared=shared)
    priors = _priors(specimen, settings, states)
    slots = (
        *law.names,
        *(p.name for p in (NOISE_SD, *DIMENSION_PARAMETERS)),
        *(n for state in states for n in mounting_names("stretch", state)),
    )
    of_slot = [quantities[name].parameter for name in slots]
    first = len(law.names) + NOISE_SLOTS + DIMENSION_SLOTS
    fixed, tie, factor = np.zeros(len(slots)), np.full(len(slots), -1), np.zeros(len(slots))
    if settings.mounting == "exact":
        fixed[first:] = reading.ravel()
    for i, p in enumerate(of_slot):
        if p.kind == DIMENSION and not p.unit_symbol("N"):
            fixed[i] = 1.0
    slot = np.full(len(slots), -1)
    kinds, table = np.zeros(len(slots), dtype=np.int64), np.zeros((len(slots), 5))
    free: list[str] = []
    for i, (name, p) in enumerate(zip(slots, of_slot, strict=True)):
        prior = priors.get(name)
        if isinstance(prior, Prior):
            kinds[i], table[i] = prior.encode(log_scale=p.logarithmic)
            # p(slot) = p(natural) d natural / d slot: degrees per radian
            table[i][4] += math.log(_per_unit(p))
            if i < first or settings.reads_force:
                slot[i] = len(free)
                free.append(name)
        elif isinstance(prior, Tie):
            if i >= first:
                slot[i] = slot[slots.index(quantities.in_same_state(name, prior.other))]
            else:
                tie[i], factor[i] = slots.index(prior.other), math.log(prior.factor)
        elif prior is not None:
            fixed[i] = to_slot(p, np.array(float(prior)))
    reference, max_I1_state = _references(specimen, constants.reference_stretch)
    peak_kPa = float(
        max(np.abs(specimen.load(p) / specimen.area).max() for p in specimen.protocols)
    )
    transform = law.sampling_transform(
        TransformInputs(
            free=tuple(n for n in law.names if n in free),
            reference=reference,
            softening=constants.softening,
            reparametrised=sampling,
            max_I1_state=max_I1_state,
            peak_kPa=max(peak_kPa, 1e-9),
        )
    )
    rows = MeasuredRows.from_thinned(thinned)
    readings = ReadingVector.from_rows(
        rows, thinned, reading.size if settings.reads_force else 0, average=settings.has_misfit
    )
    problem = Problem(
        slot=slot,
        fixed=fixed,
        tie=tie,
        tie_log_factor=factor,
        transform=transform,
        size=len(law.names),
        logarithmic=np.array([p.logarithmic for p in of_slot]),
        per_unit=np.array([_per_unit(p) for p in of_slot]),
        prior_kind=kinds,
        prior=table,
        mounting_mode=_MODES[settings.mounting],
        mounted=specimen.geometry == "mounted",
        determinant=determinant,
        mounting=reading,
        reads=settings.reads_force,
        area=specimen.area,
        reading_of=readings.index,
        share=readings.share,
        readings=len(readings.weight),
        **_rows(rows, shared),
    )
    forward = ForwardModel.from_specimen(specimen, settings)
    return Assembly(problem, forward, rows, readings, slots, tuple(free), priors, quantities)


_MODES = {
    "noisy": MODE_FORCE,
    "exact": MODE_FORCE,
    "free": MODE_STRETCH,
    "ignored": MODE_UNSTRETCHED,
    "zeroed": MODE_UNSTRETCHED,
}


def check_settings(specimen: Specimen, settings: Settings) -> None:
    """Refuse settings that do not suit the specimen."""
    ties = [n for n, v in settings.priors.items() if isinstance(v, Tie) and "mounting" in n]
    if ties and settings.mounting != "free":
        raise InputError(
            "mounting stretches can be tied only where they are sampled themselves, not the forces",
            remedy="use `mounting=free`",
        )
    if settings.reads_force and not settings.has_misfit:
        _, sd = specimen.mounting_readings(shared=settings.shared)
        if np.any(sd <= 0.0):
            raise InputError(
                f"`mounting={settings.mounting}` needs an error of the mounting force, and the "
                "file has no load noise",
                file=specimen.name,
                remedy="use `mounting=exact`, or state load_noise_N (or load_noise_kPa)",
            )
    away = [p.name for p in specimen.protocols if p.rest_rows == 0]
    if away and not settings.shared:
        raise InputError(
            f"protocol {away[0][:40]!r} does not start at the mounted state, so it has no mounting "
            "stretch of its own",
            file=specimen.name,
            remedy="use `mounting_stretch=shared`",
        )
    for key in ("edge_sd_mm", "thickness_sd_mm"):
        sizes = ("thickness_mm",) if key.startswith("thick") else ("edge_x_mm", "edge_y_mm")
        if key in specimen.metadata and any(getattr(specimen, k) is None for k in sizes):
            raise InputError(f"{key} is given without {' and '.join(sizes)}", file=specimen.name)


def _per_unit(parameter: Parameter) -> float:
    """Natural units in one unit of the slot."""
    return math.degrees(1.0) if parameter.unit == DEGREE else 1.0


def _priors(
    specimen: Specimen, settings: Settings, labels: tuple[str, ...]
) -> dict[str, Prior | float | Tie]:
    """Priors by slot name: the defaults, the user's, and those of measured dimensions."""
    given = dict(settings.priors)
    if settings.has_misfit:
        given.pop(NOISE_SD.name, None)
    chosen = default_priors(specimen, settings) | given
    of_all = {name: chosen.pop(name) for name in mounting_names("stretch")}
    out = dict(chosen)
    if settings.infers_mounting:
        for label in labels:
            out.update(zip(mounting_names("stretch", label), of_all.values(), strict=True))
    known = specimen.metadata
    if "edge_sd_mm" in known:
        for axis in "xy":
            edge = float(getattr(specimen, f"edge_{axis}_mm"))
            out[f"edge_{axis}"] = Prior("normal", 1.0, float(known["edge_sd_mm"]) / edge, low=0.0)
    if "thickness_sd_mm" in known:
        assert specimen.thickness_mm is not None
        sd = float(known["thickness_sd_mm"]) / specimen.thickness_mm
        out["thickness"] = Prior("normal", 1.0, sd, low=0.0)
    offset = known.get(f"load_offset_sd_{specimen.unit}")
    if offset is not None:
        for axis in "xy":
            out[f"load_offset_{axis}"] = Prior("normal", 0.0, float(offset))
    return out


def _references(
    specimen: Specimen, stretch: tuple[float, float] | None
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The squared reference stretch, and the same of the row of largest I1."""
    measured = np.vstack([np.column_stack([p.stretch_x, p.stretch_y]) for p in specimen.protocols])
    top = measured.max(axis=0)
    stretch = (float(top[0]), float(top[1])) if stretch is None else stretch
    squared = measured**2
    widest = measured[np.argmax(squared.sum(axis=1) + 1.0 / squared.prod(axis=1))]
    # I1 = X + Y + Z is largest at the widest row; its stretches, moved as the reference is
    x, y = np.asarray(stretch) * widest / top
    return _above_one(stretch), _above_one((float(x), float(y)))


def _above_one(stretch: tuple[float, float]) -> tuple[float, float, float]:
    """Squares (X, Y, Z) of a stretch, moved to where all fibres are extended."""
    # fibres at any angle are extended where both exceed one: l >= 1 + max(l_max - 1, 0.02) / 4
    least = 1.0 + 0.25 * max(max(stretch) - 1.0, 0.02)
    lx, ly = (max(s, least) for s in stretch)
    return lx * lx, ly * ly, 1.0 / (lx * ly) ** 2


def _rows(rows: MeasuredRows, shared: bool) -> dict[str, np.ndarray]:
    """The arrays of the kernel that hold the readings."""
    lx, ly = rows.stretch.T.copy()
    fx, fy = rows.load.T.copy()
    protocols = np.arange(len(rows.names))
    return {
        "start": np.searchsorted(rows.protocol, np.arange(len(rows.names) + 1)),
        "mount": np.zeros_like(protocols) if shared else protocols,
        "ilx": 1.0 / lx,
        "ily": 1.0 / ly,
        "X": lx * lx,
        "Y": ly * ly,
        "Z": 1.0 / (lx * ly) ** 2,
        "fx": fx,
        "fy": fy,
    }


# --- between sampling coordinates and natural quantities of draws --------------------------------


def natural_values(assembly: Assembly, values: np.ndarray, u: np.ndarray) -> dict[str, np.ndarray]:
    """Natural values of slots and mounting forces by name, from an ``Evaluation`` at ``u``."""
    problem = assembly.problem
    out = {name: values[:, i] * problem.per_unit[i] for i, name in enumerate(assembly.slots)}
    if problem.mounting_mode == MODE_UNSTRETCHED:
        return out
    forward = assembly.forward
    for m, state in enumerate(assembly.mounts):
        names = mounting_names("force", state)
        if problem.mounting_mode != MODE_FORCE:
            out.update(zip(names, forward.mounting_load(out, state).T, strict=True))
            continue
        for k, name in enumerate(names):
            # sampled, or read from the file: not computed from the mounting stretch
            place = problem.size + NOISE_SLOTS + DIMENSION_SLOTS + 2 * m + k
            i = problem.slot[place]
            reading = problem.fixed[place] - out[f"load_offset_{'xy'[k]}"]
            out[name] = u[:, i].copy() if i >= 0 else reading
    return out


def sampling_coordinates(assembly: Assembly, parameters: Mapping[str, Any]) -> np.ndarray:
    """Sampling coordinates of parameters by slot name, shape (n, d)."""
    problem, law = assembly.problem, assembly.law
    slot_values: dict[str, np.ndarray] = {}
    for name in law.names:
        prior = assembly.priors[name]
        given = prior if isinstance(prior, int | float) else parameters.get(name, math.nan)
        value = np.atleast_1d(np.asarray(given, dtype=float))
        slot_values[name] = to_slot(law.parameter(name), value)
    values = law.to_sampling_coordinates(problem.transform, slot_values)
    for name in assembly.free:
        if name not in values:
            value = np.atleast_1d(np.asarray(parameters[name], dtype=float))
            values[name] = to_slot(assembly.quantities[name].parameter, value)
    return np.column_stack(np.broadcast_arrays(*(values[n] for n in assembly.free)))


def to_slot(parameter: Parameter, value: np.ndarray) -> np.ndarray:
    """Values on the scale of the slot, from natural ones."""
    if parameter.logarithmic:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(value)
    return np.deg2rad(value) if parameter.unit == DEGREE else value
