"""A specimen drawn from the statistical model: true values from the prior, readings from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from biaxbayes.inference.priors import Prior, Tie
from biaxbayes.inference.settings import Settings
from biaxbayes.mechanics.goh import GOH, cauchy_stress
from biaxbayes.mechanics.mounting import BRACKET, balance, mounted_state
from biaxbayes.specimens.specimen import Specimen

__all__ = ["Rules", "SimulatedSpecimen", "draw_truth", "simulate_specimen"]

SAME_ROOT = 1e-6
"""Relative difference of mounting stretches that count as one root."""


@dataclass(frozen=True)
class Rules:
    """What stays the same in every replication.

    Attributes
    ----------
    specimen : Specimen
        Whose protocols, dimensions and load noise are used.
    settings : Settings
    priors : mapping
        Of every unknown, by the names that the posterior uses.
    mounts : tuple of str
        Label of each mounted state.
    """

    specimen: Specimen
    settings: Settings
    priors: Mapping[str, Prior | float | Tie]
    mounts: tuple[str, ...]

    @property
    def shared(self) -> bool:
        """One mounted state for all protocols."""
        return self.settings.mounting_stretch == "shared"


@dataclass(frozen=True)
class SimulatedSpecimen(Specimen):
    """A specimen whose mounting readings have a stated sd.

    The sd of a measured specimen's mounting reading may be estimated from its rows at rest; in
    a study it is the one that the readings were simulated with.
    """

    reading: tuple[tuple[float, float], ...] = ()
    reading_sd: tuple[tuple[float, float], ...] = ()

    def mounting_readings(self, *, shared: bool) -> tuple[np.ndarray, np.ndarray]:
        """As in :class:`Specimen`, but as simulated."""
        del shared
        return np.array(self.reading), np.array(self.reading_sd)

    def __reduce__(self) -> Any:
        fields = {key: getattr(self, key) for key in self.__dataclass_fields__}
        return _rebuild, (fields | {"metadata": dict(self.metadata)},)


def _rebuild(fields: dict[str, Any]) -> SimulatedSpecimen:
    return SimulatedSpecimen(**fields)


def draw_truth(rules: Rules, rng: np.random.Generator) -> tuple[dict[str, float], int]:
    """True values from the prior, cut to the support of the posterior.

    The posterior is zero where no stable mounted state exists inside the bracket, and, where
    the mounting force is sampled, where the state that balances it is not the one that
    Newton's method finds from the unloaded state. Such draws are rejected whole, so that the
    true values follow the prior times that indicator, which is the prior that the posterior uses.

    Parameters
    ----------
    rules : Rules
    rng : numpy.random.Generator

    Returns
    -------
    truth : dict
        By the names of ``summary.csv``, mounting forces included.
    rejected : int
        Draws that were rejected before.

    Raises
    ------
    ValueError
        If a thousand draws in a row are rejected.
    """
    for rejected in range(1000):
        truth = _from_prior(rules.priors, rng)
        if _add_mounting_forces(rules, truth):
            return truth, rejected
    raise ValueError("the prior has next to no mass where a stable mounted state exists")


def simulate_specimen(
    rules: Rules, truth: Mapping[str, float], rng: np.random.Generator, *, noise_factor: float = 1.0
) -> SimulatedSpecimen:
    """Readings of the true values on the specimen's own protocols.

    Parameters
    ----------
    rules : Rules
    truth : mapping
        From :func:`draw_truth`.
    rng : numpy.random.Generator
    noise_factor : float
        Times the true noise sd: other than one only to show that a wrong sd is noticed.

    Returns
    -------
    SimulatedSpecimen
        Rows at rest all hold the mounting reading.
    """
    specimen = rules.specimen
    forces = np.array([_pair(truth, "mounting_force", m) for m in rules.mounts])
    _, sd = specimen.mounting_readings(shared=rules.shared)
    reading = forces
    if rules.settings.mounting != "exact":
        # f0 = p0 + offset + s0 eps
        reading = forces + _offset(truth) + sd * rng.standard_normal(sd.shape)
    protocols = []
    for i, p in enumerate(specimen.protocols):
        m = 0 if rules.shared else i
        stretch = np.array([p.stretch_x, p.stretch_y])
        load = _load(rules, truth, stretch, _pair(truth, "mounting_stretch", rules.mounts[m]))
        spread = np.hypot(truth["noise_sd"], truth.get("noise_growth", 0.0) * load)
        load = load + _offset(truth)[:, None]
        load += noise_factor * spread * rng.standard_normal(load.shape)
        load[:, : p.rest_rows] = reading[m][:, None]
        if specimen.stress_pair == "cauchy":
            load = load * stretch
        protocols.append(replace(p, load_x=load[0], load_y=load[1]))
    fields = {k: getattr(specimen, k) for k in Specimen.__dataclass_fields__}
    return SimulatedSpecimen(
        **fields | {"protocols": tuple(protocols)},
        reading=tuple((float(x), float(y)) for x, y in reading),
        reading_sd=tuple((float(x), float(y)) for x, y in sd),
    )


def _from_prior(
    priors: Mapping[str, Prior | float | Tie], rng: np.random.Generator
) -> dict[str, float]:
    truth = {}
    for name, prior in priors.items():
        if isinstance(prior, Prior):
            truth[name] = float(prior.sample(rng, 1)[0])
        elif not isinstance(prior, Tie):
            truth[name] = float(prior)
    for name, prior in priors.items():
        if isinstance(prior, Tie):
            tail = name[len("mounting_stretch_y") :] if name.startswith("mounting") else ""
            truth[name] = prior.factor * truth[prior.other + tail]
    return truth


def _pair(truth: Mapping[str, float], what: str, label: str) -> np.ndarray:
    tail = f"[{label}]" if label else ""
    return np.array([truth[f"{what}_x{tail}"], truth[f"{what}_y{tail}"]])


def _offset(truth: Mapping[str, float]) -> np.ndarray:
    return np.array([truth.get("load_offset_x", 0.0), truth.get("load_offset_y", 0.0)])


def _section(rules: Rules, truth: Mapping[str, float]) -> np.ndarray:
    """True load per kPa, (x, y): measured dimensions times their true factors."""
    edges = np.array([truth.get("edge_y", 1.0), truth.get("edge_x", 1.0)])
    return rules.specimen.area * edges * truth.get("thickness", 1.0)


def _material(rules: Rules, truth: Mapping[str, float]) -> GOH:
    return GOH(
        truth["C1"],
        truth["k1"],
        truth["k2"],
        truth["alpha"],
        truth["kappa"],
        fibre_switch=rules.settings.fibre_switch,
    )


def _load(
    rules: Rules, truth: Mapping[str, float], stretch: np.ndarray, mounting: np.ndarray
) -> np.ndarray:
    """Load without noise at measured stretches, shape (2, n)."""
    total = stretch * mounting[:, None]
    material = _material(rules, truth)
    stress = np.array(
        cauchy_stress(*material.theta, total[0], total[1], fibre_switch=rules.settings.fibre_switch)
    )
    # unloaded dimensions: f = A s / (l lm); mounted dimensions: f = A s / l
    reference = stretch if rules.specimen.geometry == "mounted" else total
    return _section(rules, truth)[:, None] * stress / reference


def _add_mounting_forces(rules: Rules, truth: dict[str, float]) -> bool:
    """Put the mounting forces in; False where the posterior has no such state."""
    material, section = _material(rules, truth), _section(rules, truth)
    if not (np.all(section > 0.0) and np.all(np.isfinite(list(truth.values())))):
        return False
    for label in rules.mounts:
        lm = _pair(truth, "mounting_stretch", label)
        if not np.all((lm > BRACKET[0]) & (lm < BRACKET[1])):
            return False
        force = _load(rules, truth, np.ones((2, 1)), lm)[:, 0]
        if rules.settings.mounting == "free":
            good = _stable(material, force / section, lm, rules.specimen.geometry == "mounted")
        else:
            state = mounted_state(material, *(force / section), geometry=rules.specimen.geometry)
            good = state.found and bool(np.allclose(state.stretch, lm, rtol=SAME_ROOT, atol=0.0))
        if not good:
            return False
        tail = f"[{label}]" if label else ""
        truth[f"mounting_force_x{tail}"], truth[f"mounting_force_y{tail}"] = map(float, force)
    return True


def _stable(material: GOH, reading: np.ndarray, lm: np.ndarray, mounted: bool) -> bool:
    """Whether the balance is stable at a state, however it would be found."""
    C1, k1, k2, _, _ = material.theta
    Hx, Hy, Hz = material.structure_tensor()
    px, py = reading
    x, y = np.log(lm)
    switch = float(material.fibre_switch)
    _, _, jxx, jxy, jyy = balance(C1, k1, k2, Hx, Hy, Hz, switch, px, py, mounted, x, y)
    return bool(jxx > 0.0 and jxx * jyy - jxy * jxy > 0.0)
