"""Simulation-based calibration of the mounting modes on shipped specimens, of laws, and of pieces.

    python scripts/study.py calibration --workers 2

Each case is a ``biaxbayes calibrate`` in a folder below ``--records``; the same command continues
one that was interrupted. ``docs/calibration.md`` quotes the tables. A *loose* case has a
noise sd around half the peak load, so that the prior and its change of variables matter; a *broken*
one has to be caught.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

import biaxbayes
from biaxbayes.calibration.calibration import Calibration, planned_calibration
from biaxbayes.calibration.simulated_specimen import simulate_specimen
from biaxbayes.model.assembly import Assembly
from biaxbayes.model.preparation import fitted
from biaxbayes.options import CalibrationPlan, InferringOptions
from biaxbayes.parallel import executor_for
from biaxbayes.parameters import NOISE_SD
from biaxbayes.verbs.calibrate import CalibrationResult, run_calibration
from studies.common import DATA, options_of, parser, print_table, write_table
from studies.pieces import pieces_of, virtual_tissue

SPECIMENS = ("donor2-media", "donor2-adventitia")
THREE_RATIOS = "three-ratios"
"""Three protocols of the media of donor 2, 0.6 mN noise."""
PIECES = {"square-and-strips": "square + strips", "strips": "strips", "tube": "tube"}
PIECES_SEED = 56_999
"""Pieces of a tissue of the study of pieces, and its seed."""


@dataclass(frozen=True)
class Case:
    """One calibration; ``broken`` is what is wrong on purpose."""

    specimen: str
    mounting: str
    noise: str = "independent"
    broken: str = ""
    replications: int = 500
    loose: bool = False
    mounting_stretch: str = "shared"
    law: str = "goh"

    @property
    def name(self) -> str:
        """Name of the folder: what differs from the defaults."""
        own = self.mounting_stretch if self.mounting_stretch != "shared" else ""
        broken = {"determinant": "without-determinant", "noise": "wrong-noise"}.get(self.broken, "")
        law = self.law if self.law != "goh" else ""
        parts = (self.specimen, self.mounting, self.noise, own, "loose" * self.loose, broken, law)
        return "-".join(part for part in parts if part)


CASES = (
    *(Case(s, m) for m in ("noisy", "exact", "free") for s in SPECIMENS),
    *(Case(s, "noisy", broken="noise", replications=200) for s in SPECIMENS),
    *(Case(s, "noisy", noise="correlated", replications=200) for s in SPECIMENS),
    Case(THREE_RATIOS, "noisy", noise="correlated", replications=200),
    *(Case(s, "noisy", replications=120, loose=True) for s in SPECIMENS),
    *(Case(s, "noisy", broken="determinant", replications=120, loose=True) for s in SPECIMENS),
    Case(THREE_RATIOS, "noisy", replications=120),
    Case(THREE_RATIOS, "noisy", replications=120, mounting_stretch="per-protocol"),
    *(
        Case(THREE_RATIOS, "noisy", replications=200, law=law)
        for law in ("goh-exponential", "fung", "four-fibre")
    ),
    *(Case(name, "noisy", noise="correlated", replications=200) for name in PIECES),
)


DRAWN = (
    "donor2-media-noisy-independent",
    "donor2-adventitia-noisy-independent",
    "donor2-media-noisy-independent-loose-without-determinant",
)
"""Cases whose figure the page has."""


# --- what is wrong on purpose --------------------------------------------------------------------

WRONG_SD = 1.2


class WrongNoise(Calibration):
    """Readings scatter by more than the noise that is ranked."""

    def simulated(
        self, model: biaxbayes.Posterior, truth: Mapping[str, float], rng: np.random.Generator
    ) -> biaxbayes.Specimen:
        """A specimen with these true values, but for the noise."""
        return simulate_specimen(
            model, {**truth, NOISE_SD.name: WRONG_SD * truth[NOISE_SD.name]}, rng
        )


class PosteriorWithoutDeterminant(biaxbayes.Posterior):
    """A density without the change of variables from mounting force to mounting stretch."""

    @cached_property
    def assembly(self) -> Assembly:
        """The density in the sampling coordinates."""
        whole = super().assembly
        return replace(whole, problem=whole.problem._replace(determinant=False))

    @cached_property
    def natural_assembly(self) -> Assembly:
        """The density in natural coordinates."""
        whole = super().natural_assembly
        return replace(whole, problem=whole.problem._replace(determinant=False))


class WithoutDeterminant(Calibration):
    """Inference by a density without the determinant of the balance."""

    def posterior(self, specimen: biaxbayes.Specimen, seed: int = 0) -> biaxbayes.Posterior:
        """The posterior of a simulated specimen."""
        options = {**self.options, "priors": self.priors, "misfit_fit": self.misfit_fit}
        return fitted(PosteriorWithoutDeterminant(specimen, **options), seed)


BROKEN = {"": Calibration, "noise": WrongNoise, "determinant": WithoutDeterminant}


# --- the cases -----------------------------------------------------------------------------------


def specimen_of(case: Case) -> biaxbayes.Specimen:
    """The specimen whose protocols, dimensions and noise are calibrated on."""
    if case.specimen in PIECES:
        return pieces_of(virtual_tissue(PIECES_SEED), PIECES[case.specimen])
    if case.specimen != THREE_RATIOS:
        return biaxbayes.read_specimen(DATA / f"{case.specimen}.csv")
    ratios = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))
    specimen, _ = biaxbayes.simulate(
        material="donor2-media", ratios=ratios, increments=20, noise_N=0.0006
    )
    return specimen


def run(case: Case, folder: Path, replications: int, workers: int) -> CalibrationResult:
    """Run one case, or what is missing of it."""
    specimen = specimen_of(case)
    priors = {}
    if case.loose:
        median = float(f"{0.5 * specimen.peak_load:.2g}")
        priors = {"noise_sd": {"distribution": "lognormal", "median": median, "sd_log": 0.3}}
    options = {k: getattr(case, k) for k in ("law", "mounting", "noise", "mounting_stretch")}
    options["priors"] = priors
    seed, resume = CASES.index(case) + 1, folder.exists()
    if not case.broken:
        amount = {"workers": workers, "replications": replications, "seed": seed}
        return biaxbayes.calibrate(specimen, out=folder, resume=resume, **amount, **options)
    model = InferringOptions.from_values(options).keywords()
    right = planned_calibration(specimen, model, CalibrationPlan(seed=seed))
    wrong = BROKEN[case.broken](**vars(right))
    executor = executor_for(workers, None)
    return run_calibration(wrong, folder, replications, executor, resume=resume)


def main() -> None:
    """Run the cases and write what they say."""
    arguments = parser(__doc__)
    arguments.add_argument("--only", default="", help="cases whose name contains this")
    options = options_of(arguments)
    summary, tables = [], []
    for case in CASES[:1] if options.quick else CASES:
        if options.only not in case.name:
            continue
        folder = options.records / "calibration" / case.name
        outcome = run(case, folder, 10 if options.quick else case.replications, options.workers)
        outside = int((outcome.table["inside_band"] == "no").sum())
        row = {**asdict(case), "uniform": outcome.calibrated, "p": outcome.p}
        row["outside_their_band"] = f"{outside} of {len(outcome.table)}"
        row["not_converged"] = sum(n for s, n in outcome.states.items() if s != "converged")
        summary.append(row)
        tables.append(outcome.table.assign(study=case.name))
        if case.name in DRAWN:
            place = options.out / "figures" / f"calibration-{case.name}.png"
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / "calibration.png", place)
    print_table("summary", pd.DataFrame(summary))
    write_table(options.out, "calibration", pd.concat(tables))


if __name__ == "__main__":
    main()
