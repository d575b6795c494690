"""Posterior draws as arrays, and the single draws that stand for them.

The medians of correlated parameters may have curves outside every band; a draw has not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from biaxbayes.errors import InputError
from biaxbayes.evenly import evenly_chosen
from biaxbayes.laws.law import Law
from biaxbayes.mechanics.mounting import with_free_side
from biaxbayes.parameters import mounting_names
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen

# --- mounted states of posterior draws -----------------------------------------------------------


def mounting_labels(draws: pd.DataFrame, specimen: Specimen) -> tuple[str, ...]:
    """Labels of the mounted states: empty when not inferred, ``("",)`` when shared."""
    states = ("", *(p.name for p in specimen.protocols))
    return tuple(s for s in states if mounting_names("stretch", s)[0] in draws)


def mounting_stretch(draws: pd.DataFrame, state: str = "") -> np.ndarray:
    """Mounting stretches (x, y) of each draw, shape (n, 2); one where it was not inferred."""
    names = list(mounting_names("stretch", state))
    return draws[names].to_numpy(dtype=float) if names[0] in draws else np.ones((len(draws), 2))


def protocol_mounting(draws: pd.DataFrame, protocol: Protocol) -> np.ndarray:
    """Mounting stretches of each draw for one protocol, shape (n, 2)."""
    per_protocol = mounting_names("stretch", protocol.name)[0] in draws
    return mounting_stretch(draws, protocol.name if per_protocol else "")


def with_free_sides(draws: pd.DataFrame, specimen: Specimen, law: Law) -> Specimen:
    """The same piece, with unmeasured stretches across a strip as the median draw gives them."""
    side = specimen.experiment.free_side
    if side is None:
        return specimen
    medians = {name: float(draws[name].median()) for name in law.names}
    cauchy, protocols = law.material(medians).cauchy, []
    for p in specimen.protocols:
        lm = np.median(protocol_mounting(draws, p), axis=0)
        total = with_free_side(cauchy, p.stretch * lm, side)
        across = {f"stretch_{'xy'[side]}": total[:, side] / lm[side]}
        protocols.append(replace(p, **across))
    return replace(specimen, protocols=tuple(protocols))


# --- single draws that stand for a posterior: the median draw, the most probable one, a sample ---


STATES_PER_PROTOCOL = 60  # of each protocol, evenly along the record


def common_states(draws: pd.DataFrame, specimen: Specimen) -> list[np.ndarray]:
    """Total stretches (m, 2) per protocol at the median mounting stretch, one for all draws."""
    return [
        p.stretch[evenly_chosen(p.rows, STATES_PER_PROTOCOL)]
        * np.median(protocol_mounting(draws, p), axis=0)
        for p in specimen.protocols
    ]


def median_draw(draws: pd.DataFrame, specimen: Specimen, law: Law) -> int:
    """Row of the draw whose stress curves, scaled to their peaks, lie nearest the median curves."""
    material = law.material(draws)
    distance = np.zeros(len(draws))
    for states in common_states(draws, with_free_sides(draws, specimen, law)):
        for curve in material.piola(*states.T):
            median = np.median(curve, axis=0)
            scale = max(float(np.abs(median).max()), 1e-300)
            distance += np.square((curve - median) / scale).mean(axis=1)
    return int(np.argmin(distance))


def chosen_draws(
    draws: pd.DataFrame,
    specimen: Specimen,
    law: Law,
    *,
    count: int | None = None,
    at: str = "median",
    seed: int = 0,
) -> tuple[list[int], str]:
    """Rows of the draws to export, in rising order, and a text on them.

    ``count`` random ones without replacement, or the ``median`` draw, or (``map``) that of the
    highest density. A density depends on its coordinates: here ln C1, ln k1, ln k2, alpha and
    kappa, the mounted state and the logarithm of the noise. Raises InputError if ``count`` is too
    large, or no density is stored.
    """
    if count is not None:
        if not 1 <= count <= len(draws):
            raise InputError(
                f"cannot choose {count} draws",
                remedy=f"the run has {len(draws)}: choose 1 to {len(draws)}",
            )
        chosen = np.random.default_rng(seed).choice(len(draws), size=count, replace=False)
        return sorted(int(i) for i in chosen), f"random posterior draw, seed {seed}"
    if at == "map":
        if "lp" not in draws:
            raise InputError(
                "this run stores no posterior density of its draws", remedy="use `at=median`"
            )
        row = int(np.argmax(draws["lp"].to_numpy(dtype=float)))
        return [row], "most probable posterior draw"
    row = median_draw(draws, specimen, law)
    return [row], "posterior draw with the stress curves nearest the median curves"
