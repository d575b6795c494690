"""Bias from ignoring the mounting stretch: one specimen sampled under three mounting models.

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
    thin_draws,
)
from biaxbayes.identifiability.marginals import ComparisonScale, parameter_scales
from biaxbayes.model.draw import draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.model.preparation import prepare
from biaxbayes.parameters import Quantities, mounting_names
from biaxbayes.prediction.percentiles import quantiles
from biaxbayes.prediction.stress import covered_stretches
from biaxbayes.sampling.sampler import Plan, Progress
from biaxbayes.specimens.specimen import Specimen

MOUNTING_MODELS = ("inferred", "ignored", "zeroed")
MAX_STRESS_DRAWS = 20_000


@dataclass(frozen=True)
class MountingModelDraws:
    """Draws of a specimen under one model of its mounting.

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
    """Parameters and stresses under the three mounting models.

    Attributes
    ----------
    table : DataFrame
        One row per quantity: ``quantity``, ``unit``, ``total_stretch`` (empty for parameters),
        ``extrapolation``, ``scale`` of the comparison (natural logs for C1, k1 and k2), for each
        model ``_median``, ``_q05`` and ``_q95``, ``inferred_sd`` on the scale, and
        ``shift_ignored_sd``, ``shift_zeroed_sd``: the difference of the medians from the
        inferred one in units of that.
    states : dict
        Convergence state of each model's draws.
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
        """Medians under the three mounting models, for notebooks."""
        columns = ["quantity", "unit", "total_stretch", "inferred_median", "ignored_median"]
        columns += ["shift_ignored_sd", "zeroed_median", "shift_zeroed_sd"]
        return self.table[columns].to_html(
            index=False, float_format=lambda v: f"{v:.4g}", na_rep="–"
        )


def sample_mounting_model(
    specimen: Specimen,
    options: Mapping[str, Any],
    plan: Plan,
    progress: Callable[[Progress], None] = lambda p: None,
) -> MountingModelDraws:
    """Sample a specimen in memory; ``options`` are keyword arguments of ``Posterior``."""
    posterior = prepare(specimen, **options, seed=plan.seed)
    drawn = draw_posterior(posterior, plan, progress=progress)
    draws = pd.DataFrame({name: q.ravel() for name, q in drawn.quantities.items()})
    return MountingModelDraws(posterior, draws, drawn.convergence.state)


def sample_mounting_models(
    specimen: Specimen,
    options: Mapping[str, Any],
    plan: Plan,
    inferred: MountingModelDraws | None = None,
    progress: Callable[[Progress], None] = lambda p: None,
) -> dict[str, MountingModelDraws]:
    """A specimen under each of :data:`MOUNTING_MODELS`; a given ``inferred`` is not resampled."""
    first = inferred or sample_mounting_model(specimen, options, plan, progress)
    variants = {MOUNTING_MODELS[0]: first}
    # without inference there is no mounting stretch, hence no prior for it
    priors = {k: v for k, v in options["priors"].items() if k not in mounting_names("stretch")}
    for name in MOUNTING_MODELS[1:]:
        other = {**options, "mounting": name, "priors": priors}
        variants[name] = sample_mounting_model(first.posterior.specimen, other, plan, progress)
    return variants


def ledger(
    variants: Mapping[str, MountingModelDraws], stretches: Sequence[float] | None = None
) -> Ledger:
    """Compare three mounting models of one specimen.

    Parameters
    ----------
    variants : mapping
        A :class:`MountingModelDraws` for each of :data:`MOUNTING_MODELS`.
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
            thin_draws(variants[name].draws, MAX_STRESS_DRAWS),
            inferred.posterior.law,
            chosen,
            tensor=False,
        )
        for name in MOUNTING_MODELS
    }
    for by_model in zip(*stresses.values(), strict=True):
        q = by_model[0]
        row = {"quantity": q.name, "unit": "kPa", "total_stretch": q.stretch, "scale": q.name}
        draws = {name: t.values for name, t in zip(MOUNTING_MODELS, by_model, strict=True)}
        rows.append(row | _compared(draws, None))
    table = pd.DataFrame(rows)
    at = table["total_stretch"].to_numpy(dtype=float)
    is_stress = np.isfinite(at)
    extrapolation = np.full(len(table), "", dtype=object)
    lm = median_mounting(inferred.draws, specimen)
    covered = covered_stretches(specimen, lm)
    extrapolation[is_stress] = covered.extrapolation(at[is_stress], at[is_stress])
    table.insert(3, "extrapolation", extrapolation)
    states = {name: variants[name].state for name in MOUNTING_MODELS}
    return Ledger(table, states, specimen.name, quantities)


def _compared(values: Mapping[str, np.ndarray], scale: ComparisonScale | None) -> dict[str, float]:
    out: dict[str, float] = {}
    for name in MOUNTING_MODELS:
        q05, q50, q95 = quantiles(values[name])
        out |= {f"{name}_median": q50, f"{name}_q05": q05, f"{name}_q95": q95}
    scaled = {name: v if scale is None else scale.to_scale(v) for name, v in values.items()}
    sd = float(scaled["inferred"].std(ddof=1))
    out |= {"inferred_sd": sd}
    for name in MOUNTING_MODELS[1:]:
        # shift = (median under the model - median inferred) / sd inferred
        difference = float(np.median(scaled[name]) - np.median(scaled["inferred"]))
        out[f"shift_{name}_sd"] = difference / sd if sd > 0.0 else np.nan
    return out
