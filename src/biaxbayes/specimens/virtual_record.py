"""What a virtual biaxial machine writes down of a test whose truth is known.

The readings go into a :class:`Specimen`; what no machine knows (material, mounting stretch,
true mounting force) goes into a separate :class:`Truth`, which is written to a file of its own.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from biaxbayes.mechanics.goh import GOH
from biaxbayes.mechanics.sheet_tester import SheetTest
from biaxbayes.mechanics.virtual import VirtualTest, smooth_misfit
from biaxbayes.specimens.specimen import Protocol, Specimen
from biaxbayes.specimens.text_file import atomic_write_text

__all__ = ["Curves", "Dimensions", "Machine", "Truth", "record_tests", "write_truth"]

MISFIT_LENGTH = 0.25


Curves = VirtualTest | SheetTest
"""Error-free curves of one protocol, in closed form or by finite elements."""


@dataclass(frozen=True)
class Dimensions:
    """Nominal dimensions of the unloaded specimen, mm."""

    edge_x_mm: float = 20.0
    edge_y_mm: float = 20.0
    thickness_mm: float = 1.0

    def mounted(self, mounting_stretch: Sequence[float]) -> Dimensions:
        """Dimensions of the same specimen in the mounted state; the volume is kept."""
        lx, ly = mounting_stretch
        return Dimensions(self.edge_x_mm * lx, self.edge_y_mm * ly, self.thickness_mm / (lx * ly))

    def section_mm2(self) -> np.ndarray:
        """Sections (x, y) that the forces act on: edge of the other direction x thickness."""
        return np.array([self.edge_y_mm, self.edge_x_mm]) * self.thickness_mm


@dataclass(frozen=True)
class Machine:
    """Errors of the virtual machine and the form of its record.

    Attributes
    ----------
    noise_N : float
        Standard deviation of every force reading, the mounting reading included.
    misfit : float
        Standard deviation of the smooth model error relative to the local true force, a
        squared-exponential process along the path, independent in x and y and between
        protocols. It multiplies the true force of every row, the mounted state included.
    misfit_length : float
        Its correlation length as a share of the path.
    stress_pair : {"force", "piola", "cauchy"}
        What the record holds. Stresses are computed as a lab does: force over the section in
        ``geometry``; "cauchy" is multiplied by the measured stretch.
    geometry : {"unloaded", "mounted"}
        The state whose dimensions the record states.
    """

    noise_N: float = 0.0
    misfit: float = 0.0
    misfit_length: float = MISFIT_LENGTH
    stress_pair: str = "force"
    geometry: str = "unloaded"


@dataclass(frozen=True)
class Truth:
    """What a fit must find, and how the readings were disturbed.

    ``mounting_force_x, _y`` is the force of the material at the true mounting stretch, in
    ``unit`` (that of the record: N, or kPa over the section of the record's geometry);
    ``disturbed_mounting_force`` is what the load cells really carried before their noise: with
    the smooth misfit of the first row, and for hooks the sum over them. One pair a protocol.
    ``grips`` is None for a homogeneous specimen.
    """

    specimen: str
    material: dict[str, float | bool]
    mounting_stretch_x: float
    mounting_stretch_y: float
    unit: str
    mounting_force_x: float
    mounting_force_y: float
    disturbed_mounting_force: dict[str, tuple[float, float]]
    unloaded_dimensions: dict[str, float]
    load_noise_N: float
    misfit: float
    misfit_length: float
    seed: int
    source: str
    grips: dict[str, float] | None = None


def record_tests(
    tests: Mapping[str, Curves],
    material: GOH,
    *,
    name: str,
    mounting_stretch: tuple[float, float],
    dimensions: Dimensions,
    machine: Machine | None = None,
    seed: int,
    labels: Mapping[str, str] | None = None,
    source: str = "",
    grips: Mapping[str, float] | None = None,
) -> tuple[Specimen, Truth]:
    """Record error-free tests (closed form or finite elements) with a machine's errors.

    Parameters
    ----------
    tests : mapping of protocol name to VirtualTest or SheetTest
        The first row of each is the mounted state.
    material : GOH
    name : str
        Name of the specimen.
    mounting_stretch : (float, float)
        Stretch of the mounted relative to the unloaded state.
    dimensions : Dimensions
        Unloaded dimensions, whatever ``machine.geometry`` is.
    machine : Machine
    seed : int
        The same seed gives the same readings.
    labels : mapping, optional
        Header keys ``layer``, ``axis_x``, ``axis_y``.
    source : str
        Where the material comes from; kept in the truth only.
    grips : mapping, optional
        How a finite-element specimen was held and measured; kept in the truth only.

    Returns
    -------
    Specimen, Truth
    """
    machine = machine or Machine()
    rng = np.random.default_rng(seed)
    stated = dimensions.mounted(mounting_stretch) if machine.geometry == "mounted" else dimensions
    # N per unit of the record: 1 for forces, section in mm^2 times 1e-3 (kPa mm^2) for stresses.
    divisor = np.ones(2) if machine.stress_pair == "force" else stated.section_mm2() * 1e-3
    # One header value stands for both directions; sections differ by the mounting stretch only.
    noise = machine.noise_N / float(np.sqrt(divisor.prod()))
    protocols, disturbed = [], {}
    for label, test in tests.items():
        # Twelve digits: neither 1.0020000000000002 in the file nor an error that matters.
        stretch = np.round(np.column_stack([test.measured_x, test.measured_y]), 12)
        true_force = np.column_stack([test.force_x_N, test.force_y_N])
        force, readings = _disturb(true_force, machine, rng)
        load = readings / divisor
        if machine.stress_pair == "cauchy":
            load = load * stretch
        load = _as_written(load, noise)
        shown = label if len(tests) > 1 else "1"
        protocols.append(Protocol(shown, *stretch.T, *load.T))
        disturbed[shown] = _pair(force[0] / divisor)
    labels = labels or {}
    specimen = Specimen(
        name,
        tuple(protocols),
        machine.stress_pair,
        machine.geometry,
        **asdict(stated),
        load_noise=noise or None,
        layer=labels.get("layer"),
        axis_x=labels.get("axis_x"),
        axis_y=labels.get("axis_y"),
    )
    # f0_k = A0_k P_k(theta, lm)
    mounting = np.array(material.piola(*mounting_stretch)) * dimensions.section_mm2() * 1e-3
    force_x, force_y = _pair(mounting / divisor)
    truth = Truth(
        specimen=name,
        material=asdict(material),
        mounting_stretch_x=mounting_stretch[0],
        mounting_stretch_y=mounting_stretch[1],
        unit=specimen.unit,
        mounting_force_x=force_x,
        mounting_force_y=force_y,
        disturbed_mounting_force=disturbed,
        unloaded_dimensions=asdict(dimensions),
        load_noise_N=machine.noise_N,
        misfit=machine.misfit,
        misfit_length=machine.misfit_length,
        seed=seed,
        source=source,
        grips=None if grips is None else dict(grips),
    )
    return specimen, truth


def write_truth(truths: Sequence[Truth], path: str | os.PathLike) -> None:
    """Write truths as JSON, one object a specimen under its name.

    Parameters
    ----------
    truths : sequence of Truth
    path : path-like
        The file appears under its name only when it is complete.
    """
    text = json.dumps({truth.specimen: asdict(truth) for truth in truths}, indent=2)
    atomic_write_text(Path(path), text + "\n")


def _disturb(
    force: np.ndarray, machine: Machine, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Forces with smooth misfit, and the same as read by the load cells; shape (n, 2)."""
    path = np.arange(len(force), dtype=float)
    # Drawn in any case, so that the noise of a seed does not depend on the misfit.
    misfit = [smooth_misfit(path, 1.0, rng, length=machine.misfit_length) for _ in range(2)]
    noise = rng.standard_normal(force.shape)
    # f_j = f_true_j (1 + misfit_j)
    disturbed = force * (1.0 + machine.misfit * np.column_stack(misfit))
    return disturbed, disturbed + machine.noise_N * noise


def _as_written(load: np.ndarray, noise: float) -> np.ndarray:
    """Readings to a thousandth of their noise, as a machine writes them; all digits without."""
    if noise == 0.0:
        return load
    return np.round(load, 3 + math.ceil(-math.log10(noise)))


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
