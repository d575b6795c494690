"""Quick posteriors of virtual specimens, for tests that need draws."""

import contextlib
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest

from biaxbayes.fitting.fit_result import FitResult, fit_from_record
from biaxbayes.laws import law_named
from biaxbayes.laws.goh import GOH
from biaxbayes.model.draw import as_sampled, draw_posterior
from biaxbayes.model.posterior import Posterior
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Dimensions, Machine, virtual_specimen
from shared import cached

THREE_RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
EQUIBIAXIAL = ((1.0, 1.0),)
FEW_WALKERS = 32
QUICK = {"noise": "independent", "mounting": "exact", "priors": {"kappa": 0.1}, "ess": 60}
"""Options of a run whose draws are only a means."""


class Sampled(NamedTuple):
    """What ``identify`` needs of a run, and the chains."""

    target: Posterior
    draws: pd.DataFrame
    state: str
    chains: dict[str, np.ndarray]

    def posterior(self) -> Posterior:
        return self.target


def specimen(
    material: GOH,
    *,
    total_stretch: float = 1.2,
    ratios: tuple[tuple[float, float], ...] = THREE_RATIOS,
    noise_N: float = 0.002,
    increments: int = 20,
    seed: int = 3,
) -> Specimen:
    """A virtual specimen mounted at 1.01, 1.02."""
    made, _ = virtual_specimen(
        material, name="virtual", mounting_stretch=(1.01, 1.02), total_stretch=total_stretch,
        ratios=ratios, increments=increments, machine=Machine(noise_N=noise_N), seed=seed,
    )  # fmt: skip
    return made


def exact_specimen(
    material: GOH,
    *,
    name: str = "media",
    mounting_stretch: tuple[float, float] = (1.01, 1.02),
    measured_stretch: float = 1.18,
    ratios: tuple[tuple[float, float], ...] = EQUIBIAXIAL,
    **machine: Any,
) -> Specimen:
    """A square of 20 mm, 0.88 mm thick, tested without noise unless ``machine`` says otherwise."""
    made, _ = virtual_specimen(
        material, name=name, mounting_stretch=mounting_stretch,
        measured_stretch=measured_stretch, ratios=ratios,
        dimensions=Dimensions(20.0, 20.0, 0.88), increments=machine.pop("increments", 100),
        machine=Machine(**machine), seed=1,
    )  # fmt: skip
    return made


def small_specimen() -> Specimen:
    """Few rows of a material that three ratios determine."""
    return specimen(GOH(14.0, 60.0, 8.0, 38.0, 0.1), increments=8)


def sampled(
    data: Specimen, *, ess: float = 150.0, seed: int = 1, walkers: int = FEW_WALKERS, **options: Any
) -> Sampled:
    """Sample a specimen once a test session, errors independent unless options say otherwise."""
    options = {"noise": "independent", **options}

    def find() -> tuple:
        target = Posterior(data, **options)
        plan = Plan(ess=ess, seed=seed, workers=2, walkers=walkers)
        result = draw_posterior(target, plan)
        as_drawn = as_sampled(target, result.target.constants)
        return as_drawn, result.convergence.state, result.quantities

    target, state, chains = cached((data, ess, seed, walkers, sorted(options.items())), find)
    draws = pd.DataFrame({name: q.ravel() for name, q in chains.items()})
    return Sampled(target, draws, state, chains)


def stated_fit(
    values: Mapping[str, float],
    stretches: Sequence[tuple[float, float]] = ((1.0, 1.0),),
    *,
    fibre_switch: bool = False,
) -> FitResult:
    """A fit of stated GOH parameters and mounting stretches, one pair per mounted state."""
    law = law_named("goh", fibre_switch=fibre_switch)
    record: dict[str, Any] = {p.label: values[p.name] for p in law.parameters}
    for k, axis in enumerate("xy"):
        record[f"mounting_stretch_{axis}"] = [pair[k] for pair in stretches]
    return fit_from_record(record | {"method": "stated", "converged": True}, law, len(stretches))


@contextlib.contextmanager
def runs_of_few_walkers() -> Iterator[None]:
    """Run folders whose draws are only a means: half of a run's walkers do as well."""
    from biaxbayes.verbs import sample

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sample, "Plan", functools.partial(Plan, walkers=FEW_WALKERS))
        yield


@contextlib.contextmanager
def without_figures() -> Iterator[None]:
    """Run folders without figures and fits of other laws, which other tests look at."""
    from biaxbayes.identifiability import identify
    from biaxbayes.runs import run_result
    from biaxbayes.verbs import sample

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sample, "write_figures", lambda *arguments: None)
        patched.setattr(identify, "fit_laws", lambda *specimen, **options: None)
        patched.setattr(run_result, "simulation_table", lambda *run: pd.DataFrame())
        yield


@contextlib.contextmanager
def runs_without_figures() -> Iterator[None]:
    """Quick run folders: few walkers, and figures would cost most of the time."""
    with runs_of_few_walkers(), without_figures():
        yield


def bent(data: Specimen, name: str, share: float) -> Specimen:
    """The specimen with one protocol's y loads off by a share of their peak halfway."""
    protocols = []
    for p in data.protocols:
        load = np.array(p.load_y)
        if p.name == name:
            load += share * load.max() * np.sin(np.linspace(0.0, np.pi, p.rows))
        protocols.append(replace(p, load_y=load))
    return replace(data, protocols=tuple(protocols))
