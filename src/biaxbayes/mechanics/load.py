"""What the load cell reads of a stress: the load law and the sections of a specimen.

A load is a force in N or a first Piola-Kirchhoff stress in kPa, as the specimen's file has it. The
section of a direction turns kPa into that unit; edges and thickness may be unknown factors of
what the file states. Dimensions refer to the unloaded or to the mounted state:

    unloaded dimensions:  f_k = A0_k P_k = A0_k s_k / (l_k lm_k)
    mounted dimensions:   f_k = Am_k s_k / l_k              (Am_k = A0_k / lm_k)

with the Cauchy stress s_k at the total stretch l_k lm_k, l_k the measured stretch and lm_k the
mounting stretch.
"""

from __future__ import annotations

from biaxbayes.compilation import inlined

__all__ = ["load_per_stress", "sections", "unloaded_section"]


@inlined
def load_per_stress(section, stretch, mounting, mounted):
    """Load per Cauchy stress, f / s, in one direction; arguments broadcast.

    Parameters
    ----------
    section : float or ndarray
        Load per kPa in the state that the dimensions refer to.
    stretch, mounting : float or ndarray
        Measured stretch (1 at the mounted state), and mounting stretch.
    mounted : bool
        Whether the dimensions refer to the mounted state.
    """
    if mounted:
        # f = Am s / l
        return section / stretch
    # f = A0 s / (l lm)
    return section / (stretch * mounting)


@inlined
def unloaded_section(section, mounting, mounted):
    """Load per first Piola-Kirchhoff stress, f / P, of the unloaded state."""
    # f = A0 P;  A0 = Am lm
    return section * mounting if mounted else section


@inlined
def sections(area, edge_x, edge_y, thickness):
    """Load per kPa in (x, y): stated sections times the true factors of the dimensions."""
    # the section in x is edge_y * thickness
    return area[0] * edge_y * thickness, area[1] * edge_x * thickness
