"""Virtual specimens: homogeneous ones in closed form, hooked ones in finite elements.

A homogeneous specimen is what the model says, plus the errors of the machine. A hooked specimen is
what five hooks an edge make of a known material: its stress is not uniform, and a record that
divides the force by the nominal section is off by an amount that no noise explains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from biaxbayes.mechanics.goh import GOH
from biaxbayes.mechanics.grips import Hooks
from biaxbayes.mechanics.sheet import Sheet
from biaxbayes.mechanics.sheet_tester import GAUGE, SheetTester
from biaxbayes.mechanics.virtual import virtual_test
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_record import (
    Dimensions,
    Machine,
    Truth,
    record_tests,
    write_truth,
)

__all__ = [
    "Dimensions",
    "Machine",
    "Truth",
    "hooked_specimen",
    "virtual_specimen",
    "write_truth",
]

Stretch = float | tuple[float, float]


def virtual_specimen(
    material: GOH,
    *,
    name: str,
    mounting_stretch: tuple[float, float],
    total_stretch: Stretch | None = None,
    measured_stretch: Stretch | None = None,
    ratios: Sequence[tuple[float, float]] = ((1.0, 1.0),),
    increments: int = 100,
    dimensions: Dimensions | None = None,
    machine: Machine | None = None,
    seed: int,
    labels: Mapping[str, str] | None = None,
    source: str = "",
) -> tuple[Specimen, Truth]:
    """Test a homogeneous specimen of known material on a virtual biaxial machine.

    Parameters
    ----------
    material : GOH
    name : str
        Name of the specimen.
    mounting_stretch : (float, float)
        Stretch of the mounted relative to the unloaded state.
    total_stretch, measured_stretch : float or (float, float)
        Largest stretch relative to the unloaded or to the mounted state; give one of them.
    ratios : sequence of (float, float)
        One protocol each: the share of the stretch beyond the mounted state that x and y take,
        scaled so that the larger is one.
    increments : int
        Equal increments of a protocol; its record has one more row.
    dimensions : Dimensions
        Unloaded dimensions, whatever ``machine.geometry`` is.
    machine : Machine
    seed : int
        The same seed gives the same readings.
    labels : mapping, optional
        Header keys ``layer``, ``axis_x``, ``axis_y``.
    source : str
        Where the material comes from; kept in the truth only.

    Returns
    -------
    Specimen, Truth

    Raises
    ------
    ValueError
        If the stretches or ratios do not define a test.
    """
    dimensions = dimensions or Dimensions()
    tests = {
        label: virtual_test(
            material,
            mounting_stretch=mounting_stretch,
            measured_stretch=top,
            increments=increments,
            **asdict(dimensions),
        )
        for label, top in _tops(mounting_stretch, total_stretch, measured_stretch, ratios).items()
    }
    return record_tests(
        tests,
        material,
        name=name,
        mounting_stretch=mounting_stretch,
        dimensions=dimensions,
        machine=machine,
        seed=seed,
        labels=labels,
        source=source,
    )


def hooked_specimen(
    material: GOH,
    *,
    name: str,
    mounting_stretch: tuple[float, float],
    total_stretch: Stretch | None = None,
    measured_stretch: Stretch | None = None,
    ratios: Sequence[tuple[float, float]] = ((1.0, 1.0),),
    increments: int = 100,
    dimensions: Dimensions | None = None,
    machine: Machine | None = None,
    seed: int,
    labels: Mapping[str, str] | None = None,
    source: str = "",
    hooks: Hooks | None = None,
    elements: int = 20,
) -> tuple[Specimen, Truth]:
    """Test a specimen held by hooks, in finite elements (needs scikit-fem).

    Stretches, the mounting stretch included, are those of the central region, which four markers
    report; the carriages are driven so that the markers reach them (strain control). The force is
    the sum over the hooks of an edge. The record states the nominal dimensions, so a stress
    taken from it is the force over the nominal section.

    Parameters
    ----------
    hooks : Hooks, optional
        Five hooks an edge by default.
    elements : int
        Elements along an edge.
    material, name, mounting_stretch, total_stretch, measured_stretch, ratios, increments, \
dimensions, machine, seed, labels, source
        As in :func:`virtual_specimen`.

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
        If no equilibrium is found, however small the increments.
    """
    dimensions, hooks = dimensions or Dimensions(), hooks or Hooks()
    tops = _tops(mounting_stretch, total_stretch, measured_stretch, ratios)
    sheet = Sheet(dimensions.edge_x_mm, dimensions.edge_y_mm, elements=elements)
    tester = SheetTester(material, sheet, hooks.on(sheet), thickness_mm=dimensions.thickness_mm)
    mounted = tester.mount(mounting_stretch)
    return record_tests(
        {
            label: tester.stretch_to(mounted, top, increments=increments)
            for label, top in tops.items()
        },
        material,
        name=name,
        mounting_stretch=mounting_stretch,
        dimensions=dimensions,
        machine=machine,
        seed=seed,
        labels=labels,
        source=source,
        grips={"elements": elements, **asdict(hooks), "marker_distance_of_edge": GAUGE},
    )


def _tops(
    mounting_stretch: Sequence[float],
    total_stretch: Stretch | None,
    measured_stretch: Stretch | None,
    ratios: Sequence[tuple[float, float]],
) -> dict[str, tuple[float, float]]:
    """Largest measured stretch (x, y) of every protocol, by its label such as ``1:0.5``."""
    if (total_stretch is None) == (measured_stretch is None):
        raise ValueError("give one of total_stretch and measured_stretch")
    if total_stretch is None:
        top = np.ones(2) * np.asarray(measured_stretch, dtype=float)
    else:
        top = np.ones(2) * np.asarray(total_stretch, dtype=float) / np.asarray(mounting_stretch)
    out = {}
    for x, y in ratios:
        if not (max(x, y) > 0.0 and min(x, y) >= 0.0 and math.isfinite(x + y)):
            raise ValueError("a ratio needs two numbers, not negative and not both zero")
        share = np.array([x, y]) / max(x, y)
        end = 1.0 + share * (top - 1.0)
        out[f"{x:g}:{y:g}"] = (float(end[0]), float(end[1]))
    if not out or len(out) < len(ratios):
        raise ValueError("give each ratio once")
    return out
