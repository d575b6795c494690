"""The finite-element test against the closed form, its refinement, and what hooks do.

    python scripts/study.py hooks           about a minute

``docs/grips.md`` quotes the tables.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.collections import PolyCollection

from biaxbayes import GOH
from biaxbayes.fem.sheet import Sheet
from biaxbayes.fem.sheet_tester import GAUGE, Grips, Hooks, SheetTest, SheetTester
from biaxbayes.laws.published import MATERIALS
from studies.common import BLUE, RED, options_of, parser, print_table, save_figure

EDGE, THICKNESS = 20.0, 0.88
CASES = {
    "hooked-media": ("donor2-media", (1.009, 1.010), (1.2, 1.2)),
    "hooked-weisbecker": ("weisbecker-media", (1.02, 1.02), (1.2 / 1.02, 1.2 / 1.02)),
}
"""Material, mounting stretch and largest measured stretch of the shipped specimens."""
LAYOUTS = {
    "as shipped (5 hooks, 1.5 mm inside, R = 1 mm)": Hooks(),
    "R = 0.5 mm": Hooks(radius_mm=0.5),
    "1 mm inside": Hooks(inset_mm=1.0),
    "2 mm inside": Hooks(inset_mm=2.0),
    "4 hooks": Hooks(count=4),
    "7 hooks": Hooks(count=7),
}


def tester(material: GOH, elements: int = 20, hooks: Hooks | None = None, control="markers"):
    """A sheet on hooks."""
    sheet = Sheet(EDGE, EDGE, elements=elements)
    grips = (hooks or Hooks()).on(sheet)
    return SheetTester(material, sheet, grips, thickness_mm=THICKNESS, control=control)


def tested(case: str, increments: int, **options: Any) -> tuple[SheetTester, SheetTest]:
    """The test of a shipped specimen."""
    name, mounting, top = CASES[case]
    machine = tester(MATERIALS[name].material, **options)
    return machine, machine.stretch_to(machine.mount(mounting), top, increments=increments)


def uniform_edges(sheet: Sheet) -> Grips:
    """Edges that stay straight and move as one, without friction along them."""
    free = sheet.free
    component = sheet.component[free]
    here = sheet.position[component, free]
    held = np.flatnonzero(np.abs(here - sheet.edge[component] / 2.0) < 1e-9 * sheet.edge.min())
    weights = np.zeros((free.size, held.size))
    weights[held, np.arange(held.size)] = 1.0
    return Grips(weights, component[held], sheet.edge / 2.0)


def nominal_force(material: GOH, test: SheetTest) -> np.ndarray:
    """Closed-form stress at the central stretch times the nominal section, N, shape (rows, 2)."""
    return np.column_stack(material.piola(*test.total.T)) * EDGE * THICKNESS * 1e-3


def uniform_gaps() -> pd.DataFrame:
    """Largest relative difference from the closed form where edges are uniform."""
    rows = []
    for name in ("smoljkic-m55", "weisbecker-media", "donor2-media", "donor2"):
        material = MATERIALS[name].material
        sheet = Sheet(EDGE, EDGE, distortion=0.4)
        machine = SheetTester(
            material, sheet, uniform_edges(sheet), thickness_mm=THICKNESS, control="grips"
        )
        top = MATERIALS[name].measured_stretch or 1.2 / 1.02
        test = machine.stretch_to(machine.mount((1.02, 1.02)), (top, top), increments=20)
        gap = np.abs(test.force_N / nominal_force(material, test) - 1.0).max()
        stretch = np.abs(test.total[:, 0] / test.grip[:, 0] - 1.0).max()
        rows.append({"material": name, "force": gap, "stretch": stretch})
    return pd.DataFrame(rows)


def refinement(meshes: tuple[int, ...]) -> pd.DataFrame:
    """Grip stretch and force at the largest measured stretch, by elements per edge."""
    rows = []
    for case in CASES:
        for elements in meshes:
            _, test = tested(case, 20, elements=elements)
            row: dict[str, object] = {"specimen": case, "elements": elements}
            row |= {"grip_stretch_x": test.grip[-1, 0], "grip_stretch_y": test.grip[-1, 1]}
            row |= {"force_x_N": test.force_N[-1, 0], "force_y_N": test.force_N[-1, 1]}
            rows.append(row)
    return pd.DataFrame(rows)


def force_shares(layouts: dict[str, Hooks], elements: int) -> pd.DataFrame:
    """Force of the hooks over the closed form, by layout of the hooks."""
    rows = []
    for layout, hooks in layouts.items():
        for case in CASES:
            machine, test = tested(case, 10, elements=elements, hooks=hooks)
            nominal = nominal_force(machine.material, test)
            share = test.force_N / nominal
            # the best constant factor for the whole curve, and what it leaves
            factor = (test.force_N * nominal).sum(axis=0) / (nominal**2).sum(axis=0)
            left = np.abs(share / factor - 1.0).max(axis=0)
            row: dict[str, object] = {"hooks": layout, "specimen": case}
            for k, axis in enumerate("xy"):
                row |= {f"mounted_{axis}": share[0, k], f"end_{axis}": share[-1, k]}
                row |= {f"factor_{axis}": factor[k], f"left_{axis}": left[k]}
            rows.append(row)
    return pd.DataFrame(rows)


def draw_sheet(machine: SheetTester, test: SheetTest, out: Path) -> None:
    """Deformed mesh of the whole sheet, coloured by the stretch of each element."""
    sheet, state = machine.sheet, test.states[-1]
    mesh = sheet.basis.mesh
    u = sheet.displacement(state.u)[sheet.basis.nodal_dofs]
    corners = (mesh.p + u).T[mesh.t.T]  # elements, 4, 2
    F = sheet.deformation_gradient(state.u)
    signs = [np.array([sx, sy]) for sx in (1, -1) for sy in (1, -1)]
    half = 0.5 * GAUGE * sheet.edge * machine.stretch(state)
    drawing, axes = plt.subplots(1, 2, figsize=(7.2, 3.9), sharex=True, sharey=True)
    for k, (ax, axis) in enumerate(zip(axes, "xy", strict=True)):
        # l_k = |F e_k|, mean over the Gauss points of an element
        stretch = np.sqrt((F[:, k] ** 2).sum(axis=0)).mean(axis=1)
        hooks = [
            np.array([X, Y]) + sheet.displacement_at(X, Y) @ state.u
            for direction, X, Y in Hooks().places(sheet)
            if direction == k
        ]
        for sign in signs:
            cells = PolyCollection(corners * sign, array=stretch, edgecolors="0.25", lw=0.25)
            cells.set_clim(*np.percentile(stretch, [2, 98]))
            ax.add_collection(cells)
            ax.plot(*(sign * np.array(hooks)).T, "o", ms=4.5, mfc="none", mec=RED)
            ax.plot(*(sign * half), "s", ms=4, mfc="white", mec="black", mew=0.8)
        label = f"stretch {axis}"
        drawing.colorbar(cells, ax=ax, orientation="horizontal", extend="both", label=label)
        ax.set(aspect="equal", xlabel="x (mm)", xlim=(-13, 13), ylim=(-13, 13))
    axes[0].set_ylabel("y (mm)")
    save_figure(drawing, out, "hooked-sheet")


def draw_shares(tests: dict[str, tuple[SheetTester, SheetTest]], out: Path) -> None:
    """The share of the closed-form force along the test."""
    drawing, axes = plt.subplots(1, len(tests), figsize=(7.2, 2.9), sharey=True)
    for ax, (case, (machine, test)) in zip(axes, tests.items(), strict=True):
        share = test.force_N / nominal_force(machine.material, test)
        ax.plot(test.measured[:, 0], share[:, 0], color=BLUE, label="x")
        ax.plot(test.measured[:, 1], share[:, 1], "--", color=RED, label="y")
        ax.set(xlabel="measured stretch", title=case)
        ax.legend()
    axes[0].set_ylabel("hook force / closed form")
    save_figure(drawing, out, "hooked-force-share")


def main() -> None:
    """Write all tables and figures."""
    options = options_of(parser(__doc__))
    quick = options.quick
    print_table("fem-uniform-edges", uniform_gaps())
    print_table("fem-refinement", refinement((10,) if quick else (10, 20, 40, 80)))
    layouts = dict(list(LAYOUTS.items())[:1]) if quick else LAYOUTS
    print_table("fem-force-shares", force_shares(layouts, 10 if quick else 40))
    tests = {case: tested(case, 5 if quick else 100) for case in CASES}
    draw_sheet(*tests["hooked-media"], options.out)
    draw_shares(tests, options.out)


if __name__ == "__main__":
    main()
