"""Quick posteriors of virtual specimens, for tests that need draws."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest

from biaxbayes.inference.posterior import Posterior
from biaxbayes.inference.sampler import Plan, draw
from biaxbayes.mechanics.goh import GOH
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen

THREE_RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
EQUIBIAXIAL = ((1.0, 1.0),)


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
        material,
        name="virtual",
        mounting_stretch=(1.01, 1.02),
        total_stretch=total_stretch,
        ratios=ratios,
        increments=increments,
        machine=Machine(noise_N=noise_N),
        seed=seed,
    )
    return made


def sampled(data: Specimen, *, ess: float = 150.0, seed: int = 1, **options: Any) -> Sampled:
    """Sample a specimen, errors independent unless said otherwise."""
    target = Posterior(data, **{"noise": "independent", **options})
    found = draw(target, Plan(ess=ess, seed=seed, workers=2))
    draws = pd.DataFrame({name: q.ravel() for name, q in found.quantities.items()})
    return Sampled(target, draws, found.convergence.state, found.quantities)


@contextlib.contextmanager
def runs_without_figures() -> Iterator[None]:
    """Run folders whose figures other tests look at: here they would cost most of the time."""
    from biaxbayes.findings.identifiability import identify_draws
    from biaxbayes.output import run_products
    from biaxbayes.output.archive import flatten
    from biaxbayes.output.report import page

    def verdicts_alone(folder, posterior, draws):
        table = pd.DataFrame({k: flatten(v).ravel() for k, v in draws.quantities.items()})
        found = identify_draws(posterior, table, draws.convergence.state)
        run_products.write_identifiability(found, folder / "identifiability.csv")

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(run_products, "write_products", verdicts_alone)
        patched.setattr(page, "_determined", lambda run: [])
        yield
