"""Virtual specimens of a population whose means, sds and members are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.mechanics.virtual_test import simulate_smooth_misfit
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

PARAMETERS = GOHLaw().names
LOGS = 3
"""The first of them are pooled as logs."""
CENTRES = {"media": (14.0, 140.0, 11.9, 38.4, 0.16), "adventitia": (8.0, 60.0, 6.0, 52.0, 0.2)}
"""Of the groups, natural values."""
SD_DONORS = np.array([0.2, 0.2, 0.2, 3.5, 0.02])
SD_SPECIMENS = np.array([0.22, 0.22, 0.22, 3.5, 0.02])
"""On the scale of the model; together 0.3 of a log, 5 degrees and 0.03."""
RATIOS: tuple[tuple[float, float], ...] = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
TOP = 1.2
MISFIT = 0.02


@dataclass(frozen=True)
class Plan:
    """What is tested in a kind of study.

    Attributes
    ----------
    count : int
        Specimens.
    groups : tuple of str
        Of a donor's specimens, in turn; each donor gives two.
    three_protocols : tuple of int, optional
        Specimens with three protocols; the others have an equibiaxial test. All by default.
    noise_N : float
        Sd of the force readings.
    increments : int
        Of a protocol.
    misfit : {"", "common", "own"}
        A smooth relative error of the forces of 2 %, drawn once a study or for each specimen.
    noise : str
        Error model that the specimens are sampled with.
    """

    count: int
    groups: tuple[str, ...] = ("media",)
    three_protocols: tuple[int, ...] | None = None
    noise_N: float = 0.0006
    increments: int = 20
    misfit: str = ""
    noise: str = "independent"


PLANS = {
    "ridge": Plan(12, three_protocols=(1, 5, 9), noise_N=0.01, increments=12),
    "alike": Plan(12, three_protocols=(), noise_N=0.01, increments=12),
    "common-misfit": Plan(8, misfit="common", noise="correlated"),
    "own-misfit": Plan(8, misfit="own", noise="correlated"),
    "no-misfit": Plan(8),
}


@dataclass(frozen=True)
class Member:
    """A virtual specimen and its truth on the model's scale, shape (p,)."""

    label: str
    group: str
    donor: str
    specimen: Specimen
    theta: np.ndarray


def on_scale(values: Sequence[float] | np.ndarray) -> np.ndarray:
    """Natural values of the parameters (..., p) on the scale of the model."""
    out = np.array(values, dtype=float)
    out[..., :LOGS] = np.log(out[..., :LOGS])
    return out


def made(plan: Plan, seed: int) -> list[Member]:
    """The specimens of a study."""
    rng = np.random.default_rng([seed, 23])
    donors = [f"D{k // 2:02d}" for k in range(plan.count)]
    effects = {donor: SD_DONORS * rng.standard_normal(5) for donor in dict.fromkeys(donors)}
    common = _misfit(plan, len(RATIOS), rng)
    out = []
    for k, donor in enumerate(donors):
        group = plan.groups[k % len(plan.groups)]
        while True:
            theta = on_scale(CENTRES[group]) + effects[donor]
            theta += SD_SPECIMENS * rng.standard_normal(5)
            if 0.0 <= theta[3] <= 90.0 and 0.0 <= theta[4] <= 1.0 / 3.0:
                break
        three = plan.three_protocols is None or k in plan.three_protocols
        lx, ly = 1.0 + 0.02 * rng.random(2)
        label = f"s{k:02d}-{group}"
        specimen, _ = virtual_specimen(
            GOH(*np.exp(theta[:LOGS]), *theta[LOGS:]),
            name=label,
            mounting_stretch=(float(lx), float(ly)),
            total_stretch=TOP,
            ratios=RATIOS if three else RATIOS[:1],
            increments=plan.increments,
            machine=Machine(),
            seed=0,
            labels={"layer": group},
        )
        own = _misfit(plan, len(RATIOS), rng)
        factors = {"common": common, "own": own}.get(plan.misfit, np.ones_like(common))
        out.append(Member(label, group, donor, _read(specimen, factors, plan.noise_N, rng), theta))
    return out


def _misfit(plan: Plan, protocols: int, rng: np.random.Generator) -> np.ndarray:
    """Factors of the forces, (protocols, rows, 2)."""
    path = np.arange(plan.increments + 1, dtype=float)
    drawn = [
        [simulate_smooth_misfit(path, MISFIT, rng) for _ in range(2)] for _ in range(protocols)
    ]
    return 1.0 + np.array(drawn).transpose(0, 2, 1)


def _read(
    specimen: Specimen, factors: np.ndarray, noise_N: float, rng: np.random.Generator
) -> Specimen:
    """The specimen as a machine with noise reads it."""
    protocols = []
    for p, factor in zip(specimen.protocols, factors, strict=False):
        load = np.column_stack([p.load_x, p.load_y]) * factor
        load = np.round(load + noise_N * rng.standard_normal(load.shape), 7)
        protocols.append(replace(p, load_x=load[:, 0], load_y=load[:, 1]))
    return replace(specimen, protocols=tuple(protocols), load_noise=noise_N)
