"""Virtual specimens of known material, as a virtual machine records them, and their true values.

A homogeneous specimen follows the model, plus the errors of the machine. One on hooks, in finite
elements, has no uniform stress: a force over its nominal section is wrong by more than the noise.
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
        Standard deviation of the smooth relative error of every true force, that of the mounted
        state included: a squared-exponential process along the path, independent in x and y and
        between protocols.
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
    misfit_length: float = 0.25
    loads: str = "force"
    geometry: str = "unloaded"


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
    machine: Machine | None = None,
    labels: Mapping[str, str] | None = None,
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
    elements, serendipity : int, bool
        Elements along an edge; whether they have eight nodes instead of nine.
    machine : Machine, optional
    labels : mapping, optional
        ``layer``, ``axis_x`` and ``axis_y``.
    **record
        ``name`` and ``seed``; ``source``, the origin of the material.

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
    dimensions, machine, grips = dimensions or Dimensions(), machine or Machine(), None
    largest = _largest_stretches(mounting_stretch, total_stretch, measured_stretch, ratios)
    tests: dict[str, VirtualTest | SheetTest] = {}
    if hooks is not None:
        if test != BIAXIAL.name or not isinstance(material, GOH):
            raise ValueError("tests on hooks are simulated for squares of GOH alone")
        edges = (dimensions.edge_x_mm, dimensions.edge_y_mm)
        sheet = Sheet(*edges, elements=elements, serendipity=serendipity)
        tester = SheetTester(material, sheet, hooks.on(sheet), thickness_mm=dimensions.thickness_mm)
        start = tester.mount(mounting_stretch)
        for label, stretch in largest.items():
            tests[label] = tester.stretch_to(start, stretch, increments=increments)
        grips = {"elements": elements, **asdict(hooks), "marker_distance_of_edge": GAUGE}
    else:
        for label, stretch in largest.items():
            tests[label] = virtual_test(
                material,
                mounting_stretch=mounting_stretch,
                measured_stretch=stretch,
                increments=increments,
                free_side=EXPERIMENTS[test].free_side,
                **asdict(dimensions),
            )
        # of a strip, with the width that follows
        x, y = next(iter(tests.values())).total[0].tolist()
        mounting_stretch = (x, y)
    nominal = dimensions.mounted(mounting_stretch) if machine.geometry == "mounted" else dimensions
    # N per unit of the record
    section = np.ones(2) if machine.loads == "force" else nominal.area
    # One header value stands for both directions; sections differ by the mounting stretch only.
    noise = machine.noise_N / float(np.sqrt(section.prod()))
    # f0_k = A0_k P_k(theta, lm)
    mounting = np.array(material.piola(*mounting_stretch)) * dimensions.area
    force_x, force_y = (mounting / section).tolist()
    return _recorded(
        # twelve digits, to avoid 1.0020000000000002 in the file
        {
            label if len(tests) > 1 else "1": (np.round(of.measured, 12), of.force_N)
            for label, of in tests.items()
        },
        material,
        test,
        machine,
        {**asdict(nominal), **(labels or {})},
        section=section,
        noise=(noise, noise),
        mounting_stretch_x=mounting_stretch[0],
        mounting_stretch_y=mounting_stretch[1],
        mounting_force_x=force_x,
        mounting_force_y=force_y,
        unloaded_dimensions=asdict(dimensions),
        grips=grips,
        **record,
    )


def virtual_inflation(
    material: MaterialResponse,
    test: str,
    *,
    thickness_mm: float,
    header: Mapping[str, float],
    largest_stretch: float,
    axial_stretches: Sequence[float] = (1.0,),
    increments: int = 100,
    noise: Mapping[str, float],
    misfit: float = 0.0,
    **record: Any,
) -> tuple[Specimen, Truth]:
    """Test a specimen of known material that has no mounted state, such as a pressurised tube.

    ``header``: dimensions of the test; ``noise``: sds by unit; ``record``: as of a square.
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

    paths = experiment.paths(largest_stretch, axial_stretches, increments, readings)
    of_y = {loads.noise_key_y: sd[1]} if sd[1] > 0.0 else {}
    return _recorded(
        {label: (stretch, readings(stretch)) for label, stretch in paths.items()},
        material,
        test,
        Machine(noise["N"], misfit, loads=kind),
        {"thickness_mm": thickness_mm, "metadata": {**header, **of_y}},
        section=np.ones(2),
        noise=sd,
        unloaded_dimensions=stated,
        **record,
    )


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


def _recorded(
    tests: Mapping[str, tuple[np.ndarray, np.ndarray]],
    material: MaterialResponse,
    test: str,
    machine: Machine,
    header: Mapping[str, Any],
    *,
    name: str,
    seed: int,
    source: str = "",
    section: np.ndarray,
    noise: Sequence[float],
    **truth: Any,
) -> tuple[Specimen, Truth]:
    """Record error-free stretches and loads, both (n, 2), with the errors of a machine.

    ``section``: load per reading; ``noise``: sds of the readings.
    """
    experiment, rng = EXPERIMENTS[test], np.random.default_rng(seed)
    protocols, disturbed = [], {}
    for label, (stretch, load) in tests.items():
        path = np.arange(len(load), dtype=float)
        # always drawn, so that the noise of a seed does not depend on the misfit
        length = machine.misfit_length
        misfits = [simulate_smooth_misfit(path, 1.0, rng, length=length) for _ in range(2)]
        # f = f_true (1 + misfit)
        load = load * (1.0 + machine.misfit * np.column_stack(misfits))
        of_cell = machine.noise_N if experiment.is_mounted else np.array(noise)
        reading = (load + of_cell * rng.standard_normal(load.shape)) / section
        if machine.loads == "cauchy":
            reading = reading * stretch
        # to a thousandth of the noise, as a machine writes readings
        digits = [3 + math.ceil(-math.log10(sd)) if sd > 0.0 else 15 for sd in noise]
        columns = [
            np.round(values, digits[k]) if k in experiment.axes else np.zeros(len(load))
            for k, values in enumerate(reading.T)
        ]
        if experiment.free_side is not None:
            stretch[:, experiment.free_side] = np.nan
        protocols.append(Protocol(label, *stretch.T, *columns))
        if experiment.is_mounted:
            disturbed[label] = tuple((load[0] / section).tolist())
    specimen = Specimen(
        name,
        tuple(protocols),
        machine.loads,
        machine.geometry,
        load_noise=noise[0] or None,
        test=test,
        **header,
    )
    if isinstance(material, GOH):  # needs no name
        values: dict[str, Any] = asdict(material)
    else:
        law = material.law
        values = {p.label: float(v) for p, v in zip(law.parameters, material.values, strict=True)}
        switch = {"fibre_switch": law.fibre_switch} if law.has_switch else {}
        values = {"law": law.name, **values, **switch}
    return specimen, Truth(
        specimen=name,
        material=values,
        unit=specimen.unit,
        disturbed_mounting_force=disturbed,
        load_noise_N=machine.noise_N,
        misfit=machine.misfit,
        misfit_length=machine.misfit_length,
        seed=seed,
        source=source,
        **truth,
    )
