"""The grips that a specimen file states, as the finite-element sheet takes them."""

from __future__ import annotations

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments.sheet import HOOK_WIDTH_MM
from biaxbayes.fem.sheet_tester import Hooks
from biaxbayes.specimens.keys import hook_count
from biaxbayes.specimens.specimen import Specimen


def stated_hooks(specimen: Specimen, edges: np.ndarray | None = None) -> Hooks:
    """The hooks that a specimen file states, on edges (2,) in mm, else its own."""
    stated = specimen.metadata
    count = hook_count(str(stated["grips"]))
    for key in ("edge_x_mm", "edge_y_mm"):
        if getattr(specimen, key) is None:
            problem = f"the correction for grips needs {key}"
            raise InputError(problem, file=specimen.name, remedy="add the line")
    if "grip_inset_mm" not in stated:
        problem = (
            "the correction for grips needs grip_inset_mm, the distance of the hooks from the edge"
        )
        remedy = "add a line '# grip_inset_mm: ...'"
        raise InputError(problem, file=specimen.name, remedy=remedy)
    inset = float(stated["grip_inset_mm"])
    shortest = float(np.min(edges_mm(specimen) if edges is None else edges))
    spacing = float(stated.get("grip_spacing_mm", shortest / (count + 1.0)))
    width = float(stated.get("grip_width_mm", min(HOOK_WIDTH_MM, 2.0 * inset, spacing)))
    span = (count - 1) * spacing + width
    if width > 2.0 * inset:
        problem = f"hooks that move {width:g} mm of tissue reach over an edge {inset:g} mm away"
    elif width > spacing * (1.0 + 1e-9):
        problem = f"hooks that move {width:g} mm of tissue overlap at a spacing of {spacing:.3g} mm"
    elif span > shortest * (1.0 + 1e-9) or 2.0 * inset >= shortest:
        problem = f"{count} hooks per edge, {spacing:.3g} mm apart, do not fit on {shortest:g} mm"
    else:
        return Hooks(count, inset, width / 2.0, spacing if "grip_spacing_mm" in stated else None)
    remedy = "correct grips, grip_inset_mm, grip_width_mm or grip_spacing_mm"
    raise InputError(problem, file=specimen.name, remedy=remedy)


def edges_mm(specimen: Specimen) -> np.ndarray:
    """Edges of the sheet in mm as the file states them, shape (2,)."""
    return np.array([specimen.edge_x_mm, specimen.edge_y_mm], dtype=float)


def describe_hooks(specimen: Specimen) -> str:
    """The grips of a specimen as a phrase."""
    hooks = stated_hooks(specimen)
    spacing = hooks.spacing(float(edges_mm(specimen).min()))
    return (
        f"{hooks.count} hooks per edge, {hooks.inset_mm:g} mm inside it and {spacing:.3g} mm apart"
    )
