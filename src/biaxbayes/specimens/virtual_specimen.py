"""Virtual specimens, homogeneous or hooked, as a virtual biaxial machine records them.

The readings go into a :class:`Specimen`, the true values (material, mounting stretch, true mounting
force) into a separate :class:`Truth` with its own file.

A homogeneous specimen follows the model, plus the errors of the machine. A hooked specimen is a
known material held by five hooks per edge: its stress is not uniform, and a force divided by the
nominal section is wrong by more than the noise. Tests without a mounted state start without load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from biaxbayes.experiments import BIAXIAL, EXPERIMENTS
from biaxbayes.fem.sheet import Sheet
from biaxbayes.fem.sheet_tester import GAUGE, Hooks, SheetTest, SheetTester
from biaxbayes.laws.goh import GOH
from biaxbayes.laws.materials import MaterialResponse
from biaxbayes.mechanics.mounting import newtons_per_kPa, with_free_side
from biaxbayes.mechanics.virtual_test import VirtualTest, simulate_smooth_misfit, virtual_test
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.truth import Truth

MISFIT_LENGTH = 0.25
Stretch = float | tuple[float, float]


@dataclass(frozen=True)
class Dimensions:
    """Nominal dimensions of the unloaded specimen, mm."""

    edge_x_mm: float = 20.0
    edge_y_mm: float = 20.0
    thickness_mm: float = 1.0

    def mounted(self, mounting_stretch: Sequence[float]) -> Dimensions:
        """Dimensions of the same specimen in the mounted state; the volume is constant."""
        lx, ly = mounting_stretch
        return Dimensions(self.edge_x_mm * lx, self.edge_y_mm * ly, self.thickness_mm / (lx * ly))

    @property
    def area(self) -> np.ndarray:
        """Force (N) per nominal stress (kPa) in x and y."""
        return newtons_per_kPa(self.edge_x_mm, self.edge_y_mm, self.thickness_mm)


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
        Its correlation length as a fraction of the path.
    loads : {"force", "piola", "cauchy"}
        What the record holds. Stresses are computed as a lab does: force over the section in
        ``geometry``; "cauchy" is multiplied by the measured stretch.
    geometry : {"unloaded", "mounted"}
        The state whose dimensions the record states.
    """

    noise_N: float = 0.0
    misfit: float = 0.0
    misfit_length: float = MISFIT_LENGTH
    loads: str = "force"
    geometry: str = "unloaded"


# --- tests: homogeneous ones in closed form, hooked ones in finite elements ----------------------


def virtual_specimen(
    material: MaterialResponse,
    *,
    mounting_stretch: tuple[float, float],
    total_stretch: Stretch | None = None,
    measured_stretch: Stretch | None = None,
    ratios: Sequence[tuple[float, float]] = ((1.0, 1.0),),
    increments: int = 100,
    dimensions: Dimensions | None = None,
    test: str = BIAXIAL.name,
    hooks: Hooks | None = None,
    elements: int = 20,
    serendipity: bool = False,
    **record: Any,
) -> tuple[Specimen, Truth]:
    """Test a specimen of known material on a virtual biaxial machine.

    On `hooks`, stretches are those of the central region, which four markers report; the carriages
    are driven so that the markers reach them (strain control). The force is the sum over the hooks
    of an edge, a stress that force over the nominal section.

    Parameters
    ----------
    material : GOH or CheckedMaterial
        On hooks GOH.
    mounting_stretch : (float, float)
        Stretch of the mounted relative to the unloaded state.
    total_stretch, measured_stretch : float or (float, float)
        Largest stretch relative to the unloaded or to the mounted state; give one of them.
    ratios : sequence of (float, float)
        One protocol each: the fraction of the stretch beyond the mounted state that x and y reach,
        scaled so that the larger is one.
    increments : int
        Equal increments of a protocol; its record has one more row.
    dimensions : Dimensions
        Unloaded dimensions, whatever the geometry of the machine is.
    test : {"biaxial", "strip x", "strip y"}
        Kind of test; across a strip neither stretch nor load is recorded.
    hooks : Hooks, optional
        Hooks that hold the specimen, in finite elements (needs scikit-fem); else it is homogeneous.
    elements : int
        Elements along an edge.
    serendipity : bool
        Elements of eight nodes instead of nine.
    **record
        ``name`` and ``seed``; ``machine``, a :class:`Machine`; ``labels``, with ``layer``,
        ``axis_x`` and ``axis_y``; ``source``, the origin of the material.

    Returns
    -------
    Specimen, Truth

    Raises
    ------
    ValueError
        If the stretches or ratios do not define a test, or the hooks do not fit.
    InputError
        If scikit-fem is not installed.
    NotConverged
        If no equilibrium on hooks can be computed, however small the increments.
    """
    dimensions = dimensions or Dimensions()
    largest = _largest_stretches(mounting_stretch, total_stretch, measured_stretch, ratios)
    if hooks is not None:
        if test != BIAXIAL.name or not isinstance(material, GOH):
            raise ValueError("tests on hooks are simulated for squares of GOH alone")
        edges = (dimensions.edge_x_mm, dimensions.edge_y_mm)
        sheet = Sheet(*edges, elements=elements, serendipity=serendipity)
        tester = SheetTester(material, sheet, hooks.on(sheet), thickness_mm=dimensions.thickness_mm)
        start = tester.mount(mounting_stretch)
        hooked = {
            label: tester.stretch_to(start, stretch, increments=increments)
            for label, stretch in largest.items()
        }
        grips = {"elements": elements, **asdict(hooks), "marker_distance_of_edge": GAUGE}
        return _recorded(hooked, material, mounting_stretch, dimensions, grips=grips, **record)
    tests = {
        label: virtual_test(
            material,
            mounting_stretch=mounting_stretch,
            measured_stretch=stretch,
            increments=increments,
            free_side=EXPERIMENTS[test].free_side,
            **asdict(dimensions),
        )
        for label, stretch in largest.items()
    }
    first = next(iter(tests.values()))
    # of a strip, with the width that follows
    mounted = tuple(first.total[0].tolist())
    return _recorded(tests, material, mounted, dimensions, test=test, **record)


def virtual_inflation(
    material: MaterialResponse,
    test: str,
    *,
    name: str,
    thickness_mm: float,
    header: Mapping[str, float],
    largest_stretch: float,
    axial_stretches: Sequence[float] = (1.0,),
    increments: int = 100,
    noise: Mapping[str, float],
    misfit: float = 0.0,
    seed: int,
    source: str = "",
) -> tuple[Specimen, Truth]:
    """Test a specimen of known material that has no mounted state, such as a pressurised tube.

    ``header`` holds the dimensions that this test states, ``noise`` sds by unit of the reading.
    """
    stated = {**header, "thickness_mm": thickness_mm}
    experiment = EXPERIMENTS[test].of(stated, (True, True))
    [(kind, loads)] = experiment.loads.items()
    area = experiment.area(stated, kind)
    section = np.ones(2) if area is None else area
    sd = [noise[unit] if k in experiment.axes else 0.0 for k, unit in enumerate(loads.units)]

    def readings(stretch: np.ndarray) -> np.ndarray:
        points, side = experiment.points(stretch), experiment.free_side
        total = points.stretch
        if side is not None:
            total = with_free_side(material.cauchy, total, side)
        return points.sums(np.stack(material.cauchy(*total.T), axis=-1) * section)

    rng, protocols = np.random.default_rng(seed), []
    paths = experiment.paths(largest_stretch, axial_stretches, increments, readings)
    for label, stretch in paths.items():
        load = _with_misfit(readings(stretch), misfit, MISFIT_LENGTH, rng)
        load = _rounded(load + sd * rng.standard_normal(load.shape), sd)
        protocols.append(Protocol(label, *stretch.T, *load.T))
    of_y = {loads.noise_key_y: sd[1]} if sd[1] > 0.0 else {}
    specimen = Specimen(
        name,
        tuple(protocols),
        kind,
        thickness_mm=thickness_mm,
        load_noise=sd[0] or None,
        metadata={**header, **of_y},
        test=test,
    )
    truth = Truth(
        specimen=name,
        material=_material_values(material),
        unit=specimen.unit,
        unloaded_dimensions=stated,
        load_noise_N=noise["N"],
        misfit=misfit,
        misfit_length=MISFIT_LENGTH,
        seed=seed,
        source=source,
    )
    return specimen, truth


def _largest_stretches(
    mounting_stretch: Sequence[float],
    total_stretch: Stretch | None,
    measured_stretch: Stretch | None,
    ratios: Sequence[tuple[float, float]],
) -> dict[str, tuple[float, float]]:
    """Largest measured stretch (x, y) of every protocol, by its label such as ``1:0.5``."""
    if (total_stretch is None) == (measured_stretch is None):
        raise ValueError("give one of total_stretch and measured_stretch")
    given = measured_stretch if total_stretch is None else total_stretch
    largest = np.ones(2) * np.asarray(given, dtype=float)
    if total_stretch is not None:
        largest = largest / np.asarray(mounting_stretch)
    out = {}
    for x, y in ratios:
        if not (max(x, y) > 0.0 and min(x, y) >= 0.0 and math.isfinite(x + y)):
            raise ValueError("a ratio needs two numbers, not negative and not both zero")
        fraction = np.array([x, y]) / max(x, y)
        end = 1.0 + fraction * (largest - 1.0)
        out[f"{x:g}:{y:g}"] = (float(end[0]), float(end[1]))
    if not out or len(out) < len(ratios):
        raise ValueError("give each ratio once")
    return out


# --- the record and the true values --------------------------------------------------------------


def _recorded(
    tests: Mapping[str, VirtualTest | SheetTest],
    material: MaterialResponse,
    mounting_stretch: tuple[float, float],
    dimensions: Dimensions,
    *,
    name: str,
    seed: int,
    test: str = BIAXIAL.name,
    machine: Machine | None = None,
    labels: Mapping[str, Any] | None = None,
    source: str = "",
    grips: dict[str, float] | None = None,
) -> tuple[Specimen, Truth]:
    """Record error-free tests (first row: the mounted state) with the errors of a machine."""
    machine = machine or Machine()
    nominal = dimensions.mounted(mounting_stretch) if machine.geometry == "mounted" else dimensions
    # N per unit of the record
    divisor = np.ones(2) if machine.loads == "force" else nominal.area
    # One header value stands for both directions; sections differ by the mounting stretch only.
    noise_sd = machine.noise_N / float(np.sqrt(divisor.prod()))
    rng, across = np.random.default_rng(seed), ~np.isin([0, 1], EXPERIMENTS[test].axes)
    protocols, disturbed = [], {}
    for label, ideal in tests.items():
        # twelve digits, to avoid 1.0020000000000002 in the file
        stretch, force = np.round(ideal.measured, 12), ideal.force_N
        force = _with_misfit(force, machine.misfit, machine.misfit_length, rng)
        noise = machine.noise_N * rng.standard_normal(force.shape)
        load = (force + noise) / divisor * (stretch if machine.loads == "cauchy" else 1.0)
        load = _rounded(load, (noise_sd, noise_sd))
        stretch[:, across], load[:, across] = np.nan, 0.0
        protocol = label if len(tests) > 1 else "1"
        protocols.append(Protocol(protocol, *stretch.T, *load.T))
        disturbed[protocol] = tuple((force[0] / divisor).tolist())
    specimen = Specimen(
        name,
        tuple(protocols),
        machine.loads,
        machine.geometry,
        **asdict(nominal),
        load_noise=noise_sd or None,
        test=test,
        **(labels or {}),
    )
    # f0_k = A0_k P_k(theta, lm)
    mounting = np.array(material.piola(*mounting_stretch)) * dimensions.area
    force_x, force_y = (mounting / divisor).tolist()
    truth = Truth(
        specimen=name,
        material=_material_values(material),
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
        grips=grips,
    )
    return specimen, truth


def _material_values(material: MaterialResponse) -> dict[str, float | bool | str]:
    """A material by the parameters of its law; one of GOH needs no name."""
    if isinstance(material, GOH):
        return asdict(material)
    law = material.law
    values = {p.label: float(v) for p, v in zip(law.parameters, material.values, strict=True)}
    switch = {"fibre_switch": law.fibre_switch} if law.has_switch else {}
    return {"law": law.name, **values, **switch}


def _with_misfit(
    load: np.ndarray, misfit: float, length: float, rng: np.random.Generator
) -> np.ndarray:
    """Loads (n, 2) with a smooth error along the path, f = f_true (1 + misfit)."""
    path = np.arange(len(load), dtype=float)
    # always drawn, so that the noise of a seed does not depend on the misfit
    drawn = [simulate_smooth_misfit(path, 1.0, rng, length=length) for _ in range(2)]
    return load * (1.0 + misfit * np.column_stack(drawn))


def _rounded(load: np.ndarray, noise: Sequence[float]) -> np.ndarray:
    """Loads (n, 2) to a thousandth of their noise, as a machine writes readings."""
    digits = [3 + math.ceil(-math.log10(sd)) if sd > 0.0 else 15 for sd in noise]
    return np.column_stack([np.round(v, d) for v, d in zip(load.T, digits, strict=True)])
