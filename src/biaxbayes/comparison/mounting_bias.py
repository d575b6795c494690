"""Cost of ignoring the mounting stretch: the same specimen, sampled three ways.

``inferred`` is the posterior with the mounting stretch as an unknown; ``ignored`` takes the mounted
state for the reference and leaves the forces; ``zeroed`` subtracts the first reading as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from biaxbayes.comparison.distance import equibiaxial_steps
from biaxbayes.errors import InputError
from biaxbayes.identifiability.determined import (
    derived_quantities,
    largest_equibiaxial,
    median_mounting,
    some_draws,
)
from biaxbayes.identifiability.marginals import Scale, parameter_scales
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.parameters import Quantities, mounting_names
from biaxbayes.prediction.stress import covered_stretches
from biaxbayes.sampling.sampler import Plan, Progress
from biaxbayes.specimens.specimen import Specimen

VARIANTS = ("inferred", "ignored", "zeroed")
MOST_DRAWS = 20_000


@dataclass(frozen=True)
class Variant:
    """Draws of a specimen under one treatment of its mounting force.

    Attributes
    ----------
    draws : DataFrame
        Natural quantities, one row per draw.
    state : str
        ``converged``, ``tentative`` or ``unusable``.
    """

    posterior: Posterior
    draws: pd.DataFrame
    state: str


@dataclass(frozen=True)
class Ledger:
    """Parameters and stresses under the three treatments.

    Attributes
    ----------
    table : DataFrame
        One row per quantity: ``quantity``, ``unit``, ``total_stretch`` (empty for parameters),
        ``extrapolation``, ``scale`` of the comparison (natural logs for C1, k1 and k2), for each
        treatment ``_median``, ``_q05`` and ``_q95``, ``inferred_sd`` on the scale, and
        ``shift_ignored_sd``, ``shift_zeroed_sd``: the difference of the medians from the
        inferred one in units of that.
    states : dict
        State of each treatment's draws.
    known : Quantities
        What the parameters are.
    """

    table: pd.DataFrame
    states: dict[str, str]
    specimen: str
    known: Quantities

    @property
    def converged(self) -> bool:
        """True if all three have converged."""
        return set(self.states.values()) == {"converged"}

    @property
    def parameters(self) -> pd.DataFrame:
        """Rows of the parameters and mounting stretches."""
        return self.table[self.table["total_stretch"].isna()]

    @property
    def stresses(self) -> pd.DataFrame:
        """Rows of the stresses."""
        return self.table[self.table["total_stretch"].notna()]

    def __repr__(self) -> str:
        states = ", ".join(f"{name} {state}" for name, state in self.states.items())
        return f"Ledger({states}; {len(self.parameters)} parameters, {len(self.stresses)} stresses)"

    def _repr_html_(self) -> str:
        """Medians of the three treatments, for notebooks."""
        columns = ["quantity", "unit", "total_stretch", "inferred_median", "ignored_median"]
        columns += ["shift_ignored_sd", "zeroed_median", "shift_zeroed_sd"]
        return self.table[columns].to_html(
            index=False, float_format=lambda v: f"{v:.4g}", na_rep="–"
        )


def sample_variant(
    specimen: Specimen,
    options: Mapping[str, Any],
    plan: Plan,
    progress: Callable[[Progress], None] = lambda p: None,
) -> Variant:
    """Sample a specimen in memory; ``options`` are keyword arguments of ``Posterior``."""
    posterior = prepare(specimen, **options, seed=plan.seed)
    drawn = draw_posterior(posterior, plan, progress=progress)
    draws = pd.DataFrame({name: q.ravel() for name, q in drawn.quantities.items()})
    return Variant(posterior, draws, drawn.convergence.state)


def sample_variants(
    specimen: Specimen,
    options: Mapping[str, Any],
    plan: Plan,
    inferred: Variant | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
) -> dict[str, Variant]:
    """A specimen under each of :data:`VARIANTS`, with the options of ``inferred`` if given."""
    first = inferred or sample_variant(specimen, options, plan, progress)
    variants = {VARIANTS[0]: first}
    # a classical treatment has no mounting stretch, hence no prior of one
    priors = {k: v for k, v in options["priors"].items() if k not in mounting_names("stretch")}
    for name in VARIANTS[1:]:
        classical = {**options, "mounting": name, "priors": priors}
        variants[name] = sample_variant(first.posterior.specimen, classical, plan, progress)
    return variants


def ledger(variants: Mapping[str, Variant], stretches: Sequence[float] | None = None) -> Ledger:
    """Lay three treatments of one specimen side by side.

    Parameters
    ----------
    variants : mapping
        A :class:`Variant` for each of :data:`VARIANTS`.
    stretches : sequence of float, optional
        Total equibiaxial stretches of the stresses; five up to the largest tested one if not
        given.
    """
    inferred = variants["inferred"]
    specimen, quantities = inferred.posterior.specimen, inferred.posterior.quantities
    if stretches is None:
        stretches = equibiaxial_steps(largest_equibiaxial(inferred.draws, specimen))
    for value in stretches:
        if not (0.5 < value < 3.0 and value != 1.0):
            raise InputError(
                f"a total stretch of {value:g} has no stress to compare",
                remedy="state stretches such as 1.05; one is the unloaded state",
            )
    chosen = sorted(set(map(float, stretches)))
    rows: list[dict[str, Any]] = []
    for scale in parameter_scales(inferred.posterior.priors, quantities, inferred.draws):
        # a mounting stretch that is not inferred was taken as one
        draws = {
            name: v.draws[scale.name].to_numpy(dtype=float) if scale.name in v.draws else np.ones(1)
            for name, v in variants.items()
        }
        row = {"quantity": scale.name, "unit": scale.unit, "total_stretch": np.nan}
        rows.append(row | {"scale": scale.label} | _compared(draws, scale))
    stresses = {
        name: derived_quantities(
            some_draws(variants[name].draws, MOST_DRAWS),
            inferred.posterior.law,
            chosen,
            tensor=False,
        )
        for name in VARIANTS
    }
    for treatments in zip(*stresses.values(), strict=True):
        q = treatments[0]
        row = {"quantity": q.name, "unit": "kPa", "total_stretch": q.stretch, "scale": q.name}
        draws = {name: t.values for name, t in zip(VARIANTS, treatments, strict=True)}
        rows.append(row | _compared(draws, None))
    table = pd.DataFrame(rows)
    at = table["total_stretch"].to_numpy(dtype=float)
    known = np.isfinite(at)
    place = np.full(len(table), "", dtype=object)
    lm = median_mounting(inferred.draws, specimen)
    place[known] = covered_stretches(specimen, lm).extrapolation(at[known], at[known])
    table.insert(3, "extrapolation", place)
    states = {name: variants[name].state for name in VARIANTS}
    return Ledger(table, states, specimen.name, quantities)


def _compared(values: Mapping[str, np.ndarray], scale: Scale | None) -> dict[str, float]:
    out: dict[str, float] = {}
    for name in VARIANTS:
        q05, q50, q95 = np.quantile(values[name], [0.05, 0.5, 0.95])
        out |= {f"{name}_median": q50, f"{name}_q05": q05, f"{name}_q95": q95}
    moved = {name: v if scale is None else scale.to_scale(v) for name, v in values.items()}
    sd = float(moved["inferred"].std(ddof=1))
    out |= {"inferred_sd": sd}
    for name in VARIANTS[1:]:
        # shift = (median of the treatment - median inferred) / sd inferred
        difference = float(np.median(moved[name]) - np.median(moved["inferred"]))
        out[f"shift_{name}_sd"] = difference / sd if sd > 0.0 else np.nan
    return out
