"""A synthetic BioTester: what it writes of a specimen whose every reading is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biaxbayes import GOH
from biaxbayes.mechanics.virtual_test import virtual_test

MEDIA = GOH(C1_kPa=14.0, k1_kPa=140.0, k2=11.9, alpha_deg=38.4, kappa=0.21)
EDGE_MM, THICKNESS_MM = 10.0, 1.2
COLUMNS = (
    "SetName,Cycle,Time_S,XSize_um,YSize_um,XDisplacement_um,YDisplacement_um,XForce_mN,YForce_mN"
)
POINTS = ["X1", "Y1", "X2", "Y2", "X3", "Y3", "X4", "Y4"]


@dataclass(frozen=True)
class Export:
    """Rows of an export as text, and the truth of the last stretch phase."""

    header: list[str]
    rows: list[list[str]]
    stretch: np.ndarray  # (n, 2) of the tissue
    force_N: np.ndarray  # (n, 2) noise-free

    def text(self, separator: str = ",", decimal: str = ".") -> str:
        """The export as a file holds it."""
        lines = [separator.join(self.header)]
        lines += [separator.join(cells).replace(".", decimal) for cells in self.rows]
        return "\n".join(lines) + "\n"


def biotester_export(
    *,
    name: str = "Test1",
    cycles: int = 6,
    ratio: tuple[float, float] = (1.0, 1.0),
    rows: int = 60,
    force_noise_mN: float = 0.6,
    point_noise_px: float = 0.02,
    tracked: bool = True,
    shear: float = 0.0,
    seed: int = 0,
) -> Export:
    """Preload, preconditioning cycles of growing stiffness, holds, recovery; noise at 10 Hz.

    The tissue stretches 90 % of what the rakes move (it is soft at the rakes). Earlier cycles
    carry more force, as preconditioning tissue does; unloading carries less (hysteresis).
    """
    rng = np.random.default_rng(seed)
    test = virtual_test(
        MEDIA,
        mounting_stretch=(1.02, 1.03),
        measured_stretch=1.16,
        ratio=ratio,
        increments=rows - 1,
        edge_x_mm=EDGE_MM,
        edge_y_mm=EDGE_MM,
        thickness_mm=THICKNESS_MM,
    )
    stretch = test.measured
    force = test.force_N
    out: list[list[str]] = []
    clock = 0.0
    size0 = np.array([8000.0, 8000.0])

    def add(phase: str, lam: np.ndarray, load_N: np.ndarray) -> None:
        nonlocal clock
        for at in range(len(lam)):
            rake = size0 * (1.0 + (lam[at] - 1.0) / 0.9)
            noisy = load_N[at] * 1e3 + rng.normal(0.0, force_noise_mN, 2)
            cells = [name, phase, f"{clock:.1f}"]
            cells += [f"{v:.0f}" for v in (*rake, *(rake - size0))]
            cells += [f"{v:.3f}" for v in noisy]
            if tracked:
                F = np.array([[lam[at, 0], shear * (lam[at, 0] - 1.0)], [0.0, lam[at, 1]]])
                corners = np.array([[-1, -1], [1, -1], [1.1, 1], [-1, 1]]) * 120.0
                seen = corners @ F.T + [640.0, 480.0] + rng.normal(0, point_noise_px, (4, 2))
                cells += [f"{v:.3f}" for v in seen.ravel()]
            out.append(cells)
            clock += 0.1

    # The preload takes up the slack from 2 % below the mounted state.
    slack = np.linspace(0.98, 1.0, 20)[:, None] * np.ones(2)
    add("1-Preload", slack, np.linspace(0.0, 1.0, 20)[:, None] * force[0])
    for cycle in range(1, cycles + 1):
        softened = 1.0 + 0.3 * (cycles - cycle) / cycles
        add(f"{cycle}-Stretch", stretch, force * softened)
        held = np.linspace(1.0, 0.93, 15)[:, None] * force[-1] * softened
        add(f"{cycle}-Hold", np.repeat(stretch[-1:], 15, axis=0), held)
        down = 0.6 + 0.4 * np.linspace(0.9, 1.0, rows)[::-1, None]
        add(f"{cycle}-Recover", stretch[::-1], force[::-1] * softened * down)
        add(f"{cycle}-Rest", np.repeat(stretch[:1], 10, axis=0), np.repeat(force[:1], 10, axis=0))
    header = COLUMNS.split(",") + (POINTS if tracked else [])
    return Export(header, out, stretch, force)
