"""A sheet pulled at its edges from a mounted state: planar biaxial tests, and strips.

q_k = g_k s_k / l_k     in the directions that are pulled
0 = s_j                 across a strip: the stretch there is the root where it was not measured
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from biaxbayes.errors import ReadingError
from biaxbayes.experiments.experiment import (
    DIMENSIONS,
    EDGE_MM,
    LOAD_SD,
    OF_FORCES,
    STRETCH_RANGE,
    Column,
    Experiment,
    Key,
    Loads,
    Points,
)
from biaxbayes.mechanics.mounting import newtons_per_kPa

ONE_PAIR = "required, or another pair"
SD_MM = (1e-9, 1_000.0)
LEAST_WIDTHS = 4.0
"""Gauge length of a strip over its width below which its clamps hold back more than its ends."""
HOOK_WIDTH_MM = 2.0
REFERENCES = ("each protocol", "common")
"""References of measured stretches: the first rows of each protocol, or one state for all."""
SHEET_LOADS = {
    "force": Loads(("force_x_N", "force_y_N"), ("N", "N"), "force", "forces"),
    "piola": Loads(
        ("piola_x_kPa", "piola_y_kPa"),
        ("kPa", "kPa"),
        "first Piola-Kirchhoff stress",
        "first Piola-Kirchhoff stresses",
    ),
    "cauchy": Loads(
        ("cauchy_x_kPa", "cauchy_y_kPa"),
        ("kPa", "kPa"),
        "Cauchy stress",
        "nominal stresses (Cauchy stress over measured stretch)",
        times_stretch=True,
    ),
}
SHEET_COLUMNS = {
    "force_x_N": Column("Force along x, tension positive, not tared after mounting", ONE_PAIR),
    "force_y_N": Column("The same along y", ONE_PAIR),
    "piola_x_kPa": Column(
        "First Piola-Kirchhoff stress: force over the section in the state of `geometry`", ONE_PAIR
    ),
    "piola_y_kPa": Column("The same along y", ONE_PAIR),
    "cauchy_x_kPa": Column(
        "Cauchy stress as the lab computes it: that stress times the measured stretch", ONE_PAIR
    ),
    "cauchy_y_kPa": Column("The same along y", ONE_PAIR),
}
SHEET_KEYS = {
    "reference": Key(
        "State that the stretches are relative to: `each protocol` (the first rows of each) or "
        "`common` (one for all protocols; those that do not start at it have no rows at rest)",
        "each protocol; required where first rows differ by more than 2 %",
        choices=REFERENCES,
    ),
    "mounted_state_x": Key(
        "With a common reference: stretch of the mounted state along x in the columns of the file; "
        "at least one protocol starts there",
        "1",
        STRETCH_RANGE,
    ),
    "mounted_state_y": Key("The same along y", "1", STRETCH_RANGE),
    "edge_x_mm": Key("Edge along x", OF_FORCES, EDGE_MM),
    "edge_y_mm": Key("Edge along y; the force in x acts on edge_y x thickness", OF_FORCES, EDGE_MM),
    "edge_sd_mm": Key("Standard deviation of the edges", "exact", SD_MM),
    "thickness_sd_mm": Key("Standard deviation of the thickness", "exact", SD_MM),
    "load_offset_sd_N": Key(
        "Standard deviation of the zero of the load cells, an unknown of each direction",
        "no offset",
        LOAD_SD,
    ),
    "load_offset_sd_kPa": Key("The same of a stress", "no offset", LOAD_SD),
    "mounting_stretch_x": Key(
        "Mounting stretch along x known from an image, as `1.03 +- 0.01`", "inferred"
    ),
    "mounting_stretch_y": Key("The same along y", "inferred"),
    "physiological_stretch_x": Key(
        "Total stretch along x in the body, from the unloaded state: stress and stiffness there "
        "are reported",
        range=STRETCH_RANGE,
    ),
    "physiological_stretch_y": Key("The same along y", range=STRETCH_RANGE),
    "grips": Key(
        "Hooks per edge, as `hooks 5`: `sample` and `fit` correct the loads for them by finite "
        "elements; `none` for loads of a uniform test",
        "no correction, with a note",
    ),
    "grip_inset_mm": Key(
        "Distance of the hooks from the edge; required with `grips`", range=EDGE_MM
    ),
    "grip_width_mm": Key(
        "Diameter of the patch of tissue that a hook moves",
        f"{HOOK_WIDTH_MM:g}, less where hooks are closer to each other or to the edge",
        EDGE_MM,
    ),
    "grip_spacing_mm": Key(
        "Distance between neighbouring hooks",
        "equal distances from each other and the corners",
        EDGE_MM,
    ),
    "stretch_from": Key(
        "Whether stretches are measured between four markers in the centre or between opposite "
        "hooks (`grips`); needs `grips`",
        "markers",
        choices=("markers", "grips"),
    ),
    "grip_correction": Key(
        "`applied` in the files that `sample` writes, whose loads are corrected for the grips",
        "loads as measured",
        choices=("applied",),
    ),
    "rest_rows": Key(
        "Leading rows at rest: one number for all protocols, or one for each with commas; 0 "
        "for a protocol that starts elsewhere than the common reference",
        "counted from the stretches",
    ),
}


class Sheet(Experiment):
    """A square or rectangle pulled along x and y."""

    name = "biaxial"
    meaning = "a square or rectangle pulled along x and y"
    words = "a planar biaxial test"
    is_biaxial = True
    loads = SHEET_LOADS
    columns = SHEET_COLUMNS
    keys = SHEET_KEYS

    @property
    def drawing(self) -> str:  # type: ignore[override]
        """The sheet with its edges, and arrows where it is pulled."""
        w, h = (110 if k in self.axes else 44 for k in range(2))
        pulled = (
            f'<path class="pull" d="M{w + 20} {h / 2}h20l-6 -4m6 4l-6 4M-38 {h / 2}h-20l6 -4m-6 4'
            'l6 4"/>',
            f'<path class="pull" d="M{w / 2} -14v-12l-4 6m4 -6l4 6M{w / 2} {h + 32}v12l-4 -6m4 6'
            'l4 -6"/>',
        )
        return f"""<title>edge_x_mm and edge_y_mm are the edges along x and y, thickness_mm is the
thickness; arrows show where it is pulled</title>
<g transform="translate({140 - w / 2} {88 - h / 2})">
<path d="M0 0h{w}v{h}H0z M{w} 0l14 -10v{h}l-14 10 M0 0l14 -10h{w}"/>
<path class="arrow" d="M0 {h + 10}h{w}m0 -5v10M0 {h + 5}v10M-10 0v{h}m-5 0h10M-15 0h10
M{w + 5} {h + 7}l14 -10"/>
<text x="{w / 2}" y="{h + 26}">edge_x_mm</text>
<text x="-18" y="{h / 2}" transform="rotate(-90 -18 {h / 2})">edge_y_mm</text>
<text class="start" x="{w + 22}" y="{h + 8}">thickness</text>
{"".join(pulled[axis] for axis in self.axes)}</g>
<text x="270" y="192">x →</text><text x="20" y="20">y ↑</text>"""

    def needed(self, loads: str) -> tuple[str, ...]:
        """Forces need the section, and the state that it is measured in."""
        return (*DIMENSIONS, "geometry") if loads == "force" else ()

    def check(self, header: Mapping[str, Any], protocols: Sequence[Any]) -> None:
        """Refuse a missing stretch."""
        remedy = "measure it, or state '# test: strip x' (or y) for a strip"
        for p in protocols:
            for k, key in enumerate(("stretch_x", "stretch_y")):
                if k != self.free_side and np.isnan(p.stretch[0, k]):
                    raise ReadingError("is missing", argument=key, protocol=p.name, remedy=remedy)

    def points(self, stretch: np.ndarray) -> Points:
        """One point a row."""
        weight = np.zeros((len(stretch), 2, 2))
        for k in self.axes:
            # q_k = g_k s_k / l_k
            weight[:, k, k] = 1.0 / stretch[:, k]
        return Points(stretch, weight, np.arange(len(stretch)))

    def area(self, header: Mapping[str, Any], loads: str) -> np.ndarray | None:
        """The section under forces, edge times thickness; that of a strip needs no length."""
        if loads != "force":
            return None
        x, y, thickness = (header[key] for key in DIMENSIONS)
        return newtons_per_kPa(x or 1.0, y or 1.0, thickness)

    def size(self, header: Mapping[str, Any]) -> str:
        """Edges, or the width of a strip, and thickness."""
        edges = [f"{e:g}" for e in (header["edge_x_mm"], header["edge_y_mm"]) if e is not None]
        size = f"{' × '.join(edges)} mm{'' if len(edges) == 2 else ' wide'}" if edges else ""
        thickness = header["thickness_mm"]
        thick = "" if thickness is None else f"{thickness:g} mm thick"
        return ", ".join(filter(None, (size, thick)))

    def methods(self, header: Mapping[str, Any], paths: str) -> str:
        """The sheet and how it was pulled."""
        size = self.size(header)
        stated = f" ({size}; {header['geometry']} dimensions)" if size else ""
        return f"A specimen{stated} was tested on {paths} in {self.words}."


class Strip(Sheet):
    """A strip pulled along one direction, with free long sides."""

    is_biaxial = False
    free_side: int

    def __init__(self, axis: int) -> None:
        self.axis, self.axes, self.free_side = axis, (axis,), 1 - axis
        self.name = f"strip {'xy'[axis]}"
        self.words = f"uniaxial tension of a strip along {'xy'[axis]} with free sides"
        self.meaning = "the same along y"
        if axis == 0:
            self.meaning = (
                "a strip pulled along x, whose file has stretch and load of that direction, and "
                "the other stretch if the width was measured"
            )

    def needed(self, loads: str) -> tuple[str, ...]:
        """No section depends on the length of a strip."""
        return tuple(key for key in super().needed(loads) if key != DIMENSIONS[self.axis])

    def check(self, header: Mapping[str, Any], protocols: Sequence[Any]) -> None:
        """Refuse a load across the strip, too."""
        super().check(header, protocols)
        key, remedy = f"load_{'xy'[self.free_side]}", "leave it out, or state '# test: biaxial'"
        problem = f"a strip carries no load across it, and {key} is not zero"
        for p in protocols:
            if p.recorded_load[:, self.free_side].any():
                raise ReadingError(problem, argument=key, protocol=p.name, remedy=remedy)

    def warnings(self, header: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
        """Clamps hold the width of a strip at its ends; its middle is free only if it is long."""
        length, width = (header[DIMENSIONS[k]] for k in (self.axis, self.free_side))
        if length is not None and width is not None and length < LEAST_WIDTHS * width:
            yield (
                "short-strip",
                f"the strip is {length:g} mm long and {width:g} mm wide: clamped strips shorter "
                f"than {LEAST_WIDTHS:g} widths are not free to contract, and look stiffer",
            )
