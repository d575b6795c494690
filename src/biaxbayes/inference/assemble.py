"""From a specimen and the user's settings to the arrays of the compiled density."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.inference import problem as layout
from biaxbayes.inference.coordinates import ANGULAR, SHEAR
from biaxbayes.inference.priors import LOG_SCALE, Prior, Tie, default_priors
from biaxbayes.inference.problem import Problem
from biaxbayes.inference.settings import Settings
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.thinning import ThinnedSpecimen, thinned_specimen

__all__ = ["Assembly", "assemble"]

SLOT_NAMES = (
    "C1",
    "k1",
    "k2",
    "alpha",
    "kappa",
    "noise_sd",
    "noise_growth",
    "edge_x",
    "edge_y",
    "thickness",
    "load_offset_x",
    "load_offset_y",
)
"""Natural names of the kernel's fixed slots; two mounting slots a mounted state follow."""


@dataclass(frozen=True)
class Assembly:
    """A problem for the kernel, with the names of what it samples.

    Attributes
    ----------
    problem : Problem
    slots : tuple of str
        Natural name of every slot.
    free : tuple of str
        Natural names of the sampled slots, in the order of a walker's coordinates.
    priors : dict
        The prior of every slot that has one (a number where fixed).
    mounts : tuple of str
        Label of each mounted state: empty when shared, else the protocol's name.
    """

    problem: Problem
    slots: tuple[str, ...]
    free: tuple[str, ...]
    priors: dict[str, Prior | float | Tie]
    mounts: tuple[str, ...]


def assemble(
    specimen: Specimen,
    settings: Settings,
    *,
    beta: float = 1.0,
    reference_stretch: tuple[float, float] | None = None,
    chart: int = SHEAR,
    softening: float = 0.3,
    structural: bool = True,
    determinant: bool = True,
) -> Assembly:
    """Lay out the posterior density of a specimen.

    Parameters
    ----------
    specimen : Specimen
    settings : Settings
    beta : float or array_like, shape (p, 2)
        Weight of the log likelihood, n_eff / n.
    reference_stretch : (float, float), optional
        Where the fibre stress and exponent are held (a constant; only the efficiency of the
        sampler depends on it). Default: the largest measured stretches.
    chart, softening, structural : int, float, bool
        Coordinates of the angles and of the stiffnesses; natural ones for checks.
    determinant : bool
        Leave out only to show that it matters.

    Raises
    ------
    InputError
        If the settings and the specimen do not fit.
    """
    _check(specimen, settings)
    data = specimen.zeroed() if settings.mounting == "zeroed" else specimen
    thinned = thinned_specimen(data, settings.thin)
    shared = settings.mounting_stretch == "shared"
    labels = ("",) if shared else tuple(p.name for p in specimen.protocols)
    reading, reading_sd = specimen.mounting_readings(shared=shared)
    priors = _priors(specimen, settings, labels)
    slots = (*SLOT_NAMES, *(n for label in labels for n in mounting_names("stretch", label)))
    fixed, tie, factor = np.zeros(len(slots)), np.full(len(slots), -1), np.zeros(len(slots))
    if settings.mounting == "exact":
        fixed[layout.MOUNTING :] = reading.ravel()
    fixed[[layout.EDGE_X, layout.EDGE_Y, layout.THICKNESS]] = 1.0
    slot = np.full(len(slots), -1)
    kinds, rows = np.zeros(len(slots), dtype=np.int64), np.zeros((len(slots), 5))
    free: list[str] = []
    for i, name in enumerate(slots):
        prior = priors.get(name)
        if isinstance(prior, Prior):
            kinds[i], rows[i] = prior.encode(log_scale=name in LOG_SCALE)
            if name == "alpha":
                rows[i][4] += math.log(math.degrees(1.0))  # stated per degree, sampled in radians
            if i < layout.MOUNTING or settings.mounting in ("noisy", "free"):
                slot[i] = len(free)
                free.append(name)
        elif isinstance(prior, Tie):
            if i >= layout.MOUNTING:
                slot[i] = slot[slots.index(prior.other + name[len("mounting_stretch_y") :])]
            else:
                tie[i], factor[i] = slots.index(prior.other), math.log(prior.factor)
        elif prior is not None:
            fixed[i] = _slot_value(name, prior)
    if slot[layout.ALPHA] < 0 or slot[layout.KAPPA] < 0:
        chart = ANGULAR
    problem = Problem(
        slot=slot,
        fixed=fixed,
        tie=tie,
        tie_log_factor=factor,
        chart=chart,
        softening=softening,
        structural=structural,
        reference=_reference(specimen, reference_stretch),
        prior_kind=kinds,
        prior=rows,
        mounting_mode=_MODES[settings.mounting],
        mounted=specimen.geometry == "mounted",
        fibre_switch=float(settings.fibre_switch),
        determinant=determinant,
        reading=reading,
        reading_sd=reading_sd if settings.mounting in ("noisy", "free") else 0.0 * reading_sd,
        area=specimen.area,
        # an averaged row counts as the rows that it stands for
        beta=np.asarray(beta, dtype=float) * np.array(thinned.weight)[:, None] * np.ones(2),
        has_growth=settings.noise_growth,
        **_rows(thinned, shared),
    )
    return Assembly(problem, slots, tuple(free), priors, labels)


_MODES = {
    "noisy": layout.FORCE,
    "exact": layout.FORCE,
    "free": layout.STRETCH,
    "ignored": layout.REFERENCE,
    "zeroed": layout.REFERENCE,
}


def mounting_names(what: str, label: str) -> tuple[str, str]:
    """Names of a mounting quantity of one mounted state, in x and y."""
    tail = f"[{label}]" if label else ""
    return f"mounting_{what}_x{tail}", f"mounting_{what}_y{tail}"


def _check(specimen: Specimen, settings: Settings) -> None:
    ties = [n for n, v in settings.priors.items() if isinstance(v, Tie) and "mounting" in n]
    if ties and settings.mounting != "free":
        raise InputError(
            "tied mounting stretches need the mounting stretches as unknowns",
            remedy="add --mounting free",
        )
    for key in ("edge_sd_mm", "thickness_sd_mm"):
        of = ("thickness_mm",) if key.startswith("thick") else ("edge_x_mm", "edge_y_mm")
        if key in specimen.metadata and any(getattr(specimen, k) is None for k in of):
            raise InputError(f"{key} is stated without {' and '.join(of)}", file=specimen.name)


def _slot_value(name: str, value: float) -> float:
    if name in LOG_SCALE:
        return math.log(value) if value > 0 else -math.inf
    return math.radians(value) if name == "alpha" else value


def _priors(
    specimen: Specimen, settings: Settings, labels: tuple[str, ...]
) -> dict[str, Prior | float | Tie]:
    """Priors by slot name: the defaults, the user's, and those of measured dimensions."""
    chosen = {**default_priors(specimen), **settings.priors}
    growth = chosen.pop("noise_growth")
    if settings.noise_growth:
        chosen["noise_growth"] = growth
    out = {n: v for n, v in chosen.items() if not n.startswith("mounting_stretch")}
    if settings.infers_mounting:
        for label in labels:
            for axis, name in zip("xy", mounting_names("stretch", label), strict=True):
                out[name] = chosen[f"mounting_stretch_{axis}"]
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


def _reference(specimen: Specimen, stretch: tuple[float, float] | None) -> np.ndarray:
    if stretch is None:
        top_x = max(float(p.stretch_x.max()) for p in specimen.protocols)
        top_y = max(float(p.stretch_y.max()) for p in specimen.protocols)
        stretch = (top_x, top_y)
    # Both above one, so that the fibre strain there is positive for every material.
    least = 1.0 + 0.25 * max(max(stretch) - 1.0, 0.02)
    lx, ly = (max(s, least) for s in stretch)
    return np.array([lx * lx, ly * ly, 1.0 / (lx * ly) ** 2])


def _rows(thinned: ThinnedSpecimen, shared: bool) -> dict[str, np.ndarray]:
    """The readings after the mounted state, protocol after protocol."""
    specimen = thinned.specimen
    stretch, load, start, mount = [], [], [0], []
    for i, p in enumerate(specimen.protocols):
        kept = slice(p.rest_rows, None)
        stretch.append(np.column_stack([p.stretch_x, p.stretch_y])[kept])
        load.append(specimen.load(p)[kept])
        start.append(start[-1] + p.rows - p.rest_rows)
        mount.append(0 if shared else i)
    lx, ly = np.concatenate(stretch).T.copy()
    fx, fy = np.concatenate(load).T.copy()
    vx, vy = np.concatenate(thinned.scatter).T.copy()
    return {
        "start": np.array(start, dtype=np.int64),
        "mount": np.array(mount, dtype=np.int64),
        "ax": lx * lx,
        "ay": ly * ly,
        "az": 1.0 / (lx * ly) ** 2,
        "ilx": 1.0 / lx,
        "ily": 1.0 / ly,
        "fx": fx,
        "fy": fy,
        "vx": vx,
        "vy": vy,
    }
