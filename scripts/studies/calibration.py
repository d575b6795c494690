"""Simulation-based calibration of the mounting modes on shipped specimens, of laws, and of pieces.

    python scripts/study.py calibration --workers 2

Each case is a ``biaxbayes calibrate`` in a folder below ``--records``; the same command continues
one that was interrupted. ``docs/calibration.md`` quotes the tables. A *loose* case has a
noise sd around half the peak load, so that the prior and its change of variables matter; a *broken*
one has to be caught.
"""

from __future__ import annotations

import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

import biaxbayes
from studies.common import DATA, options_of, parser, print_table, write_table
from studies.pieces import FIRST_SEED, pieces_of, virtual_tissue

if TYPE_CHECKING:
    from biaxbayes.verbs.calibrate import CalibrationResult

SPECIMENS = ("donor2-media", "donor2-adventitia")
THREE_RATIOS = "three-ratios"
"""Three protocols of the media of donor 2, 0.6 mN noise."""
PIECES = {"square-and-strips": "square + strips", "strips": "strips", "tube": "tube"}
"""Pieces of a tissue of the study of pieces."""


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
    *(Case(s, "noisy", noise="misfit", replications=200) for s in SPECIMENS),
    Case(THREE_RATIOS, "noisy", noise="misfit", replications=200),
    *(Case(s, "noisy", replications=120, loose=True) for s in SPECIMENS),
    *(Case(s, "noisy", broken="determinant", replications=120, loose=True) for s in SPECIMENS),
    Case(THREE_RATIOS, "noisy", replications=120),
    Case(THREE_RATIOS, "noisy", replications=120, mounting_stretch="per-protocol"),
    *(
        Case(THREE_RATIOS, "noisy", replications=200, law=law)
        for law in ("goh-exponential", "fung", "four-fibre")
    ),
    *(Case(name, "noisy", noise="misfit", replications=200) for name in PIECES),
)


DRAWN = (
    "donor2-media-noisy-independent",
    "donor2-adventitia-noisy-independent",
    "donor2-media-noisy-independent-loose-without-determinant",
)
"""Cases whose figure the page has."""


def specimen_of(case: Case) -> biaxbayes.Specimen:
    """The specimen whose protocols, dimensions and noise are calibrated on."""
    if case.specimen in PIECES:
        return pieces_of(virtual_tissue(FIRST_SEED - 1), PIECES[case.specimen])
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
    return biaxbayes.calibrate(
        specimen,
        out=folder,
        resume=folder.exists(),
        workers=workers,
        replications=replications,
        seed=CASES.index(case) + 1,
        broken=case.broken,
        priors=priors,
        **{k: getattr(case, k) for k in ("law", "mounting", "noise", "mounting_stretch")},
    )


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
