"""A tube of known material, inflated at some axial stretches."""

import numpy as np

from biaxbayes.experiments import Tube
from biaxbayes.forward import ForwardModel
from biaxbayes.laws import law_named
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

MATERIAL = {"C1": 15.0, "k1": 40.0, "k2": 4.0, "alpha": 40.0, "kappa": 0.15}
MATRIX = MATERIAL | {"k1": 0.0}
"""A neo-Hookean solid, mu = 2 C1."""
ARTERY = Tube(4.0, 0.9, missing_sector_deg=140.0)
HEADER = {
    "unloaded_outer_diameter_mm": 8.0,
    "missing_sector_deg": 140.0,
    "axial_force_noise_N": 0.003,
}


def readings(tube: Tube, stretch: np.ndarray, values: dict[str, float]) -> np.ndarray:
    forward = ForwardModel(law_named("goh"), np.ones(2), False, tube)
    return forward.load(values, stretch)[0]


def states(*axial: float) -> list[np.ndarray]:
    around = np.linspace(1.0, 1.28, 24)
    return [np.column_stack([around, np.full(around.size, lz)]) for lz in axial]


def virtual_tube(
    *axial: float, noise: tuple[float, float] = (0.03, 0.003), misfit: float = 0.0, seed: int = 1
) -> Specimen:
    """A tube of :data:`MATERIAL` inflated at some axial stretches."""
    rng, protocols = np.random.default_rng(seed), []
    for stretch in states(*axial):
        load = readings(ARTERY, stretch, MATERIAL)
        load = load * (1.0 + misfit * np.sin(12.0 * stretch[:, :1] + [0.0, 2.0]))
        load = load + rng.normal(size=load.shape) * noise
        protocols.append(Protocol(f"at {stretch[0, 1]:g}", *stretch.T, *load.T))
    return Specimen(
        "tube", tuple(protocols), "pressure", thickness_mm=0.9, load_noise=noise[0],
        metadata=HEADER, test="tube",
    )  # fmt: skip
