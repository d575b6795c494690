"""From a specimen and settings to the arrays of the compiled density, and back from its draws.

Natural values are in the units of the parameter table. Slots of positive parameters hold logs,
those of angles radians; their order is that of :mod:`.density`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws.law import Law
from biaxbayes.model.density import (
    MODE_FORCE,
    MODE_STRETCH,
    MODE_UNSTRETCHED,
    OFFSET_X,
    PIECE_SLOTS,
    Problem,
)
from biaxbayes.model.piece import Piece
from biaxbayes.model.priors import Prior, Tie, default_priors
from biaxbayes.model.readings import known
from biaxbayes.options import Settings
from biaxbayes.parameters import (
    DEGREE,
    DIMENSION,
    ERROR,
    FORCE,
    FREE_SIDE,
    MOUNTING_PARAMETERS,
    NOISE_SD,
    OF_PIECE,
    PIECE,
    STIFFNESS,
    STRETCH,
    Parameter,
    Quantities,
    mounting_names,
    name_of,
)
from biaxbayes.sampling.target import bounds_array
from biaxbayes.specimens.specimen import Specimen


@dataclass(frozen=True)
class SamplingConstants:
    """Constants of the sampling coordinates; only the efficiency of a sampler depends on them."""

    isotropy_scale: float = 0.3  # near isotropy, see laws/chart.py
    # total stretches at which fibre stress and exponent are coordinates; None: the largest
    # measured
    reference_stretch: tuple[float, float] | None = None


@dataclass(frozen=True)
class Assembly:
    """Input of the compiled density, with names."""

    problem: Problem
    pieces: tuple[Piece, ...]
    slots: tuple[str, ...]  # names
    free: tuple[str, ...]  # names of the sampled slots, in the order of a walker's coordinates
    priors: dict[str, Prior | float | Tie]  # by slot; a number where fixed
    quantities: Quantities

    @property
    def law(self) -> Law:
        """The material law."""
        return self.pieces[0].settings.material_law

    @property
    def bounds(self) -> np.ndarray:
        """Bounds of the coordinates, shape (d, 2); infinite where there is none."""
        limits = self.law.sampling_bounds(self.problem.transform)
        finite = {i: limits[n] for i, n in enumerate(self.free) if n in limits}
        return bounds_array(finite, len(self.free))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the natural quantities of a draw, as in ``summary.csv``."""
        inferred = (self.problem.mounting_mode != MODE_UNSTRETCHED).any()
        mounted = self.quantities.of_kind(STRETCH, FREE_SIDE, FORCE) if inferred else ()
        of_errors = [q.name for q in self.quantities.of_kind(ERROR) if q.name in self.priors]
        others = (DIMENSION, PIECE)
        measured = (n for n in self.free if self.quantities[n].parameter.kind in others)
        return (*self.law.names, *(q.name for q in mounted), *of_errors, *measured)


def assemble(
    specimen: Specimen,
    settings: Settings,
    constants: SamplingConstants,
    *,
    determinant: bool = True,
    sampling: bool = True,
) -> Assembly:
    """Lay out the density of a specimen; without ``sampling`` its coordinates are the slots."""
    law = settings.material_law
    pieces = Piece.of_tissue(specimen, settings)
    quantities = specimen.quantities(law.parameters, shared=settings.shared)
    priors = _priors(pieces, settings, quantities)
    # (parameter, state or piece)
    of_slot: list[tuple[Parameter, str]] = [(p, "") for p in law.parameters]
    of_slot += [(p, piece.labels.label) for piece in pieces for p in OF_PIECE]
    stretches = [p for p in MOUNTING_PARAMETERS if p.kind == STRETCH]
    of_slot += [(p, state) for state in quantities.states for p in stretches]
    slots = tuple(name_of(p.name, label) for p, label in of_slot)
    first = len(law.names) + PIECE_SLOTS * len(pieces)
    fixed, tie, factor = np.zeros(len(slots)), np.full(len(slots), -1), np.zeros(len(slots))
    if settings.mounting == "exact":
        fixed[first:] = np.concatenate([piece.rows.mounting_load.ravel() for piece in pieces])
    for i, (p, _) in enumerate(of_slot):
        if p.kind == DIMENSION and not p.unit_symbol("N"):
            fixed[i] = 1.0
    slot = np.full(len(slots), -1)
    kinds, table = np.zeros(len(slots), dtype=np.int64), np.zeros((len(slots), 5))
    free: list[str] = []
    for i, (name, (p, _)) in enumerate(zip(slots, of_slot, strict=True)):
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
                # of one stretch to the other in the same state, which precedes it: the factor is 1
                slot[i] = slot[slots.index(name_of(prior.other, quantities[name].state))]
            else:
                tie[i], factor[i] = slots.index(prior.other), math.log(prior.factor)
        elif prior is not None:
            fixed[i] = to_slot(p, np.array(float(prior)))
    reference, max_I1_state = _references(specimen, constants.reference_stretch)
    peak_kPa = peak_stress(specimen)
    transform = law.sampling_transform(
        free,
        reference,
        constants.isotropy_scale,
        max_I1_state,
        max(peak_kPa, 1e-9),
        reparametrised=sampling,
    )
    problem = Problem(
        slot=slot,
        fixed=fixed,
        tie=tie,
        tie_log_factor=factor,
        transform=transform,
        size=len(law.names),
        logarithmic=np.array([p.logarithmic for p, _ in of_slot]),
        per_unit=np.array([_per_unit(p) for p, _ in of_slot]),
        prior_kind=kinds,
        prior=table,
        determinant=determinant,
        **_arrays(pieces, settings, len(law.names)),
    )
    return Assembly(problem, pieces, slots, tuple(free), priors, quantities)


SIZES = {"edge_sd_mm": ("edge_x", "edge_y"), "thickness_sd_mm": ("thickness",)}
"""Dimensions whose errors a header states, by its keys."""
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
    for piece in specimen.pieces:
        is_mounted = piece.experiment.is_mounted
        if settings.reads_force and is_mounted and not settings.has_misfit:
            _, sd = piece.mounting_readings(shared=settings.shared)
            if np.any(sd[:, list(piece.experiment.axes)] <= 0.0):
                raise InputError(
                    f"`mounting={settings.mounting}` needs an error of the mounting force, and the "
                    "file has no load noise",
                    file=piece.name,
                    remedy="use `mounting=exact`, or state load_noise_N (or load_noise_kPa)",
                )
        away = [p.name for p in piece.protocols if p.rest_rows == 0]
        if away and is_mounted and not settings.shared:
            raise InputError(
                f"protocol {away[0][:40]!r} does not start at the mounted state, so it has no "
                "mounting stretch of its own",
                file=piece.name,
                remedy="use `mounting_stretch=shared`",
            )
        for key, sizes in SIZES.items():
            keys = [f"{size}_mm" for size in sizes]
            if key in piece.metadata and any(getattr(piece, k) is None for k in keys):
                raise InputError(f"{key} is given without {' and '.join(keys)}", file=piece.name)


def _per_unit(parameter: Parameter) -> float:
    """Natural units in one unit of the slot."""
    return math.degrees(1.0) if parameter.unit == DEGREE else 1.0


def _priors(
    pieces: tuple[Piece, ...], settings: Settings, quantities: Quantities
) -> dict[str, Prior | float | Tie]:
    """Priors by slot name: the defaults, the user's, and those of measured dimensions."""
    given = dict(settings.priors)
    if settings.has_misfit:
        given.pop(NOISE_SD.name, None)
    out: dict[str, Prior | float | Tie] = {}
    for piece in pieces:
        label = piece.labels.label
        chosen = default_priors(piece.specimen, settings) | given
        of_states = {name: chosen.pop(name) for name in mounting_names("stretch")}
        for name, prior in chosen.items():
            out[name if name in settings.material_law.names else name_of(name, label)] = prior
        if settings.infers_mounting and piece.specimen.experiment.is_mounted:
            for state in piece.labels.states:
                named = zip(mounting_names("stretch", state), of_states.values(), strict=True)
                free = {q.name for q in quantities.of_kind(STRETCH)}
                out.update((name, prior) for name, prior in named if name in free)
        header = piece.specimen.metadata
        for key, sizes in SIZES.items():
            for size in sizes if key in header else ():
                sd = float(header[key]) / getattr(piece.specimen, f"{size}_mm")
                out[name_of(size, label)] = Prior("normal", 1.0, sd, low=0.0)
        offset = header.get(f"load_offset_sd_{piece.specimen.unit}")
        if offset is not None:
            for k in piece.specimen.experiment.axes:
                out[name_of(f"load_offset_{'xy'[k]}", label)] = Prior("normal", 0.0, float(offset))
        if label:
            out[name_of(STIFFNESS.name, label)] = Prior("logstudent", 1.0, settings.piece_sd)
    return out


def peak_stress(specimen: Specimen) -> float:
    """Largest stress of all pieces in kPa, a scale of stiffnesses."""
    stresses = [piece.stresses(p) for piece in specimen.pieces for p in piece.protocols]
    return float(max(np.abs(values).max() for values in stresses))


def _references(
    specimen: Specimen, stretch: tuple[float, float] | None
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Squares of the reference stretch, and of the row of largest I1 scaled like it."""
    pieces = specimen.pieces
    measured = np.vstack([p.known_stretch for piece in pieces for p in piece.protocols])
    top = measured.max(axis=0)
    stretch = (float(top[0]), float(top[1])) if stretch is None else stretch
    squared = measured**2
    widest = measured[np.argmax(squared.sum(axis=1) + 1.0 / squared.prod(axis=1))]
    # I1 = X + Y + Z is largest at the widest row
    x, y = np.asarray(stretch) * widest / top
    return _above_one(stretch), _above_one((float(x), float(y)))


def _above_one(stretch: tuple[float, float]) -> tuple[float, float, float]:
    """Squares (X, Y, Z) of a stretch, moved to where all fibres are extended."""
    # fibres at any angle are extended where both exceed one: l >= 1 + max(l_max - 1, 0.02) / 4
    least = 1.0 + 0.25 * max(max(stretch) - 1.0, 0.02)
    lx, ly = (max(s, least) for s in stretch)
    return lx * lx, ly * ly, 1.0 / (lx * ly) ** 2


def _arrays(pieces: tuple[Piece, ...], settings: Settings, size: int) -> dict[str, Any]:
    """The arrays of the kernel that hold tests and readings of all pieces."""
    parts = defaultdict[str, list[np.ndarray]](list)
    states = shift = 0  # mounted states and readings of the pieces before
    for i, piece in enumerate(pieces):
        experiment, rows, readings = piece.specimen.experiment, piece.rows, piece.readings
        side, of_point = experiment.free_side, experiment.points(rows.stretch)
        protocols, own = len(rows.names), len(piece.labels.states)
        unmeasured = side is not None and bool(np.isnan(of_point.stretch[:, side]).any())
        mode = _MODES[settings.mounting] if experiment.is_mounted else MODE_UNSTRETCHED
        index, of_mounting = readings.index[of_point.row], np.full((own, 2), -1)
        if piece.reads_force:
            of_mounting = readings.mounting_index
        of_piece = {
            "points": np.bincount(rows.protocol[of_point.row], minlength=protocols),
            "mount": states + np.asarray(rows.state_of_protocol),
            "solved": np.full(protocols, unmeasured),
            "mounting_mode": np.full(own, mode),
            "piece": np.full(own, i),
            "free_side": np.full(own, -1 if side is None else side),
            "stretch": known(of_point.stretch),
            "weight": of_point.weight * readings.share[of_point.row, None, None],
            "reading_of": np.where(index < 0, -1, index + shift),
            "mounting_reading": np.where(of_mounting < 0, -1, of_mounting + shift),
            "measured": piece.measured,
            "offset_of": size + PIECE_SLOTS * i + OFFSET_X + readings.axis,
        }
        for name, values in of_piece.items():
            parts[name].append(values)
        states, shift = states + own, shift + len(piece.measured)
    arrays = {name: np.concatenate(values) for name, values in parts.items()}
    arrays["start"] = np.cumsum([0, *arrays.pop("points")])
    return arrays | {
        "mounted_dimensions": np.array([p.specimen.geometry == "mounted" for p in pieces]),
        "area": np.array([p.specimen.area for p in pieces]),
    }


# --- between sampling coordinates and natural quantities of draws --------------------------------


def natural_values(assembly: Assembly, values: np.ndarray, u: np.ndarray) -> dict[str, np.ndarray]:
    """Natural values of slots and mounting forces by name, from an ``Evaluation`` at ``u``."""
    problem = assembly.problem
    out = {name: values[:, i] * problem.per_unit[i] for i, name in enumerate(assembly.slots)}
    first = problem.size + PIECE_SLOTS * len(assembly.pieces)
    for m, state in enumerate(assembly.quantities.states):
        piece = assembly.pieces[problem.piece[m]]
        if problem.mounting_mode[m] == MODE_UNSTRETCHED:
            continue
        forces = piece.forward.mounting_load(out, state)
        for k in piece.labels.axes:
            name, i = mounting_names("force", state)[k], problem.slot[first + 2 * m + k]
            # sampled, or read from the file: not computed from the mounting stretch
            if problem.mounting_mode[m] != MODE_FORCE:
                out[name] = forces[:, k]
            elif i >= 0:
                out[name] = u[:, i].copy()
            else:
                offset = out[name_of(f"load_offset_{'xy'[k]}", piece.labels.label)]
                out[name] = problem.fixed[first + 2 * m + k] - offset
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
