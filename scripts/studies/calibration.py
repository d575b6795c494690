"""Calibration of every mounting mode on the protocols of two shipped specimens, and of other laws.

    python scripts/study.py calibration --folder studies --workers 2
    python scripts/study.py calibration --folder studies --document docs

Each case is what ``biaxbayes calibrate`` runs, in a folder of its own, and continues where it was
interrupted. The second command writes docs/calibration.md and its figures from what is finished.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import pandas as pd

from biaxbayes.text_files import write_csv
from studies.page import DATA, table

if TYPE_CHECKING:
    from biaxbayes.calibration.calibration import Study
    from biaxbayes.specimens.specimen import Specimen

SPECIMENS = ("donor2-media", "donor2-adventitia")
THREE_RATIOS = "three-ratios"
OTHER_LAWS = ("goh-exponential", "fung", "four-fibre")
"""Laws besides the default one: another energy, fewer parameters, and more."""
SIMULATE = (
    "biaxbayes simulate --material donor2-media --ratio 1:1 --ratio 1:0.5 --ratio 0.5:1 "
    "--increments 20 --noise-N 0.0006 --out three-ratios.csv"
)


@dataclass(frozen=True)
class Case:
    """One study: a specimen, a mounting mode, a noise model, and what is broken on purpose.

    A ``loose`` one has a noise sd around half the peak load, so that the prior and its change of
    variables matter. The specimen ``three-ratios`` is made, with three protocols. No ``law`` is the
    default one.
    """

    specimen: str
    mounting: str
    noise: str = "independent"
    broken: str = ""
    replications: int = 500
    loose: bool = False
    mounting_stretch: str = "shared"
    law: str = ""

    @property
    def name(self) -> str:
        """Name of the folder."""
        broken = {"determinant": "without-determinant", "noise": "wrong-noise"}.get(self.broken)
        own = self.mounting_stretch if self.mounting_stretch != "shared" else ""
        loose = self.loose and "loose"
        parts = (self.specimen, self.mounting, self.noise, own, loose, broken, self.law)
        return "-".join(p for p in parts if p)

    @property
    def seed(self) -> int:
        """One for each case, so that no two share their true values."""
        return CASES.index(self) + 1

    @property
    def command(self) -> str:
        """What to type for it."""
        folder = "" if self.specimen == THREE_RATIOS else "data/"
        text = f"biaxbayes calibrate {folder}{self.specimen}.csv --mounting {self.mounting}"
        text += f" --law {self.law}" if self.law else ""
        if self.mounting_stretch != "shared":
            text += f" --mounting-stretch {self.mounting_stretch}"
        text += f" --noise {self.noise} --seed {self.seed} --replications {self.replications}"
        text += " --priors loose.toml" if self.loose else ""
        return text + (f" --break {self.broken}" if self.broken else "")

    def study(self, specimen: Specimen) -> Study:
        """What ``command`` runs; a loose one has a larger noise sd than the protocol's prior."""
        from biaxbayes.jobs.calibrate import study_of
        from biaxbayes.model.priors import Prior
        from biaxbayes.options import CalibrationPlan

        options: dict[str, Any] = {
            "mounting": self.mounting,
            "noise": self.noise,
            "mounting_stretch": self.mounting_stretch,
            "noise_growth": False,
            "fibre_switch": False,
            "priors": {},
        }
        if self.law:
            options["law"] = self.law
        if self.loose:
            median = float(f"{0.5 * specimen.peak_load:.2g}")
            options["priors"] = {"noise_sd": Prior("lognormal", median, 0.3)}
        return study_of(specimen, options, CalibrationPlan(seed=self.seed, broken=self.broken))


CASES = (
    *(Case(s, m) for m in ("noisy", "exact", "free") for s in SPECIMENS),
    *(Case(s, "noisy", broken="noise", replications=200) for s in SPECIMENS),
    *(Case(s, "noisy", noise="effective", replications=150) for s in SPECIMENS),
    *(Case(s, "noisy", replications=120, loose=True) for s in SPECIMENS),
    *(Case(s, "noisy", broken="determinant", replications=120, loose=True) for s in SPECIMENS),
    Case(THREE_RATIOS, "noisy", replications=120),
    Case(THREE_RATIOS, "noisy", replications=120, mounting_stretch="per-protocol"),
    *(Case(THREE_RATIOS, "noisy", replications=200, law=law) for law in OTHER_LAWS),
)


def main() -> int:
    """Run or document the cases."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--folder", type=Path, required=True, help="where the studies are kept")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--at-most", type=int, default=10**6, help="replications of a case")
    parser.add_argument("--document", type=Path, help="write the page into this folder instead")
    arguments = parser.parse_args()
    if arguments.document:
        write_page(arguments.folder, arguments.document)
        return 0
    for case in CASES:
        if arguments.only in case.name:
            run(case, arguments.folder, arguments.workers, arguments.at_most)
    return 0


def run(case: Case, folder: Path, workers: int, at_most: int) -> None:
    """Run one case, or what is missing of it."""
    from biaxbayes.executors.executor import executor_for
    from biaxbayes.jobs.calibrate import CalibrationStudy
    from biaxbayes.specimens.specimen_file import read_specimen

    path = DATA / f"{case.specimen}.csv"
    if case.specimen == THREE_RATIOS:
        path = folder / f"{THREE_RATIOS}.csv"
        simulate(path)
    specimen = read_specimen(path)
    clock = time.perf_counter()
    count = min(case.replications, at_most)
    kept = CalibrationStudy(case.study(specimen), folder / case.name, count, executor_for(workers))
    outcome = kept.execute(resume=True)
    minutes = (time.perf_counter() - clock) / 60.0
    print(
        f"{case.name}: p = {outcome.p:.3g}, {outcome.states}, {minutes:.1f} min",
        flush=True,
    )


def simulate(path: Path) -> None:
    """The specimen with three protocols, as the command says that the page prints."""
    import shlex

    from biaxbayes.cli import main as biaxbayes

    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    arguments = shlex.split(SIMULATE)[1:]
    arguments[arguments.index("--out") + 1] = str(path)
    try:
        biaxbayes(arguments)
    except SystemExit as done:
        if done.code:
            raise


def write_page(folder: Path, docs: Path) -> None:
    """The page and its figures, from the cases that have ranks."""
    from biaxbayes.calibration.calibration import RANKED_DRAWS
    from biaxbayes.calibration.ranks import calibration_table
    from biaxbayes.figures.run.trace import rank_figure
    from biaxbayes.figures.style import save_figure
    from biaxbayes.jobs.calibrate import read_ranks
    from biaxbayes.text_files import atomic_write_text

    found = {}
    for case in CASES:
        path = folder / case.name / "ranks.csv"
        ranks = read_ranks(path) if path.exists() else None
        if ranks is not None and ranks["rank"].notna().any():
            found[case] = ranks
    tables = {c: calibration_table(r[r["rank"].notna()], RANKED_DRAWS) for c, r in found.items()}
    lines = [TITLE, *_result(tables)]
    for name in FIGURES:
        drawn = next((c for c in found if c.name == name), None)
        if drawn is None:
            continue
        ranks = found[drawn]
        figure = rank_figure(ranks[ranks["rank"].notna()], RANKED_DRAWS)
        save_figure(figure, docs / "figures" / f"calibration-{name}.png")
        n = int(tables[drawn]["replications"].max())
        lines += ["", f"![{title(drawn)}](figures/calibration-{name}.png)", ""]
        lines += [f"*{title(drawn)}, {n} replications. {CAPTION}*"]
    lines += ["", *_summary(found, tables), "", METHOD]
    atomic_write_text(docs / "calibration.md", "\n".join(lines))
    each = [t.assign(study=title(c), command=c.command) for c, t in tables.items()]
    columns = ["study", *(n for n in each[0] if n not in ("study", "command")), "command"]
    write_csv(docs / "tables" / "calibration.csv", pd.concat(each)[columns], digits=4)


def _result(tables: dict[Case, pd.DataFrame]) -> list[str]:
    """What all studies say, in a paragraph."""
    from biaxbayes.calibration.ranks import verdict

    judged = {case: verdict(t) for case, t in tables.items() if case.noise != "effective"}
    sound = {c: v for c, v in judged.items() if not c.broken}
    caught = [not uniform for c, (uniform, _) in judged.items() if c.broken]
    count = sum(int(tables[c]["replications"].max()) for c in sound)
    covered = pd.concat([tables[c]["coverage_90"] for c in sound])
    failing = "; ".join(title(c) for c, (uniform, _) in sound.items() if not uniform)
    but = f", but for {failing}" if failing else ""
    text = (
        f"**Intervals hold the truth as often as they say{but}. Over {count:,} simulated specimens "
        f"in {len(sound)} studies ranks are uniform in {sum(u for u, _ in sound.values())} "
        f"(smallest p {min(p for _, p in sound.values()):.2g}); intervals of 90 % hold "
        f"{100 * covered.min():.0f} to {100 * covered.max():.0f} % of the truths of every quantity "
        f"(mean {100 * covered.mean():.1f}). Of {len(caught)} studies that were broken on purpose "
        f"{sum(caught)} are caught.**"
    )
    return wrap(text, 100)


def title(case: Case) -> str:
    """What a case is, in words."""
    text = f"{case.specimen}, mounting {case.mounting}, {case.noise} noise"
    text += f", law {case.law}" if case.law else ""
    text += ", a mounted state each protocol" if case.mounting_stretch != "shared" else ""
    text += ", loose readings" if case.loose else ""
    broken = {"determinant": ", determinant left out", "noise": ", noise sd off by 20 %"}
    return text + broken.get(case.broken, "")


def _summary(found: dict, tables: dict) -> list[str]:
    from biaxbayes.calibration.ranks import verdict
    from biaxbayes.laws import DEFAULT_LAW

    rows: dict[str, list[list[object]]] = {"specimen": [], "law": []}
    for case, ranks in found.items():
        judged = tables[case]
        states = ranks.drop_duplicates("replication")["state"]
        outside = int((judged["inside_band"] == "no").sum())
        calibrated, p = verdict(judged)
        said = "uniform" if calibrated else ("caught" if case.broken else "not uniform")
        if case.broken and calibrated:
            said = "not caught"
        if case.noise == "effective":
            said = "coverage only"
        own = ", per-protocol" if case.mounting_stretch != "shared" else ""
        noise = case.noise + (", loose" if case.loose else "")
        noise += f"; broken: {case.broken}" if case.broken else ""
        shown = f"{p:.2g}" if p > LEAST_P else f"< {LEAST_P:g}"
        count, short = len(states), int((states != "converged").sum())
        of = "law" if case.law else "specimen"
        first = f"`{case.law}`" if case.law else case.specimen
        rows[of].append(
            [first, case.mounting + own, noise, said, shown]
            + [f"{outside} of {len(judged)}", f"{count} ({short})"]
        )
    header = ["mounting", "noise", "ranks", "p, all together"]
    header += ["quantities outside their band", "replications (not converged)"]
    default, others = (table([of, *header], rows[of], left=4).splitlines() for of in rows)
    lines = [f"The law `{DEFAULT_LAW}`:", "", *default]
    if rows["law"]:
        lines += ["", f"Other laws, on the protocols of {THREE_RATIOS}:", "", *others]
    missing = "; ".join(title(case) for case in CASES if case not in found)
    lines += ["", "[Every quantity of every study](tables/calibration.csv)"]
    return [*lines, "", f"Not run yet: {missing}."] if missing else lines


LEAST_P = 1e-15
"""What is less is rounding."""
TITLE = "# Calibration\n"
METHOD = """## How it is checked

An interval that says 90 % should hold the truth nine times in ten. `biaxbayes calibrate` checks
it on a specimen's own protocols, dimensions and load noise (simulation-based calibration, Talts
et al., arXiv:1804.06788): true values of every unknown are drawn from a prior, readings are
simulated from them, the readings are sampled as a measured specimen's are, with the same prior,
and the rank of each true value among 127 posterior draws is noted. If density and sampler are
right the ranks are uniform. *p* is the exact probability that uniform ranks leave uniformity as
far behind somewhere (Saeilynoja et al., Statistics and Computing 32 (2022) 32); below 0.05 they
leave the simultaneous 95 % band. One right quantity in twenty does so by chance, which is why *p,
all together* multiplies the smallest by the number of quantities. Coverage is that of central
intervals, in percent, with its binomial interval.

The prior is scaled to the protocol, and written beside the ranks as a priors file: C1, k1 and
k2 lognormal (sd of the log 0.8) around values at which the exponent k2 E^2 is one at the
largest stretch and matrix and fibres carry 30 and 70 % of the specimen's peak stress; alpha and
kappa uniform over their ranges; mounting stretches N(1.02, 0.01); noise sd lognormal (0.7)
around 0.5 % of the specimen's peak load; parameters of other laws are scaled in the same way.
The default priors of `biaxbayes sample` would draw tissue of 10 MPa, or pushed together at
mounting. True values without a stable mounted state are rejected, as the posterior does. The
log likelihood of the readings at the true values is ranked as well: it notices errors that no
single parameter shows. Replications whose chains did not reach their target are counted and
stay in every figure.

The deliberately broken studies show that the check can fail: in one the readings have a noise sd
20 % above the true value that is ranked, in the other the density lacks the change of variables
from mounting force to mounting stretch. What that does depends on the readings: leaving the
determinant out moves a posterior by as many of its standard deviations as ln |det d P / d lm| has
as its own standard deviation under that posterior. With 0.5 % noise this is about 0.04 on these
protocols, which no check of this size can see; with noise around half the peak load (the *loose*
studies, `noise_sd = { distribution = "lognormal", median = <half the peak load>, sd_log = 0.3 }`
in a priors file) it is about 0.45. There the broken density has to be caught, and the right one
beside it has to pass.

With `effective` noise the likelihood is weighted by n_eff / n, estimated from each record's own
residuals. On independent errors, as here, the weight is below one by chance, so intervals are on
the wide side and ranks are not promised to be uniform; coverage is what counts.

Made with

    python scripts/study.py calibration --folder studies --workers 2
    python scripts/study.py calibration --folder studies --document docs

where `three-ratios.csv` is that of `biaxbayes simulate --material donor2-media --ratio 1:1
--ratio 1:0.5 --ratio 0.5:1 --increments 20 --noise-N 0.0006 --out three-ratios.csv`. (`--break`
is a hidden option of `biaxbayes calibrate`.)

A law of eight parameters or more is drawn with the ensembles of `biaxbayes sample`; the smaller
ones of a study do for the others. The posterior of `four-fibre` often has [two modes](laws.md) or
more. Ranks of its fibres are not uniform for two reasons: some of the records that so wide a prior
draws (a k2_x of 78, stresses of hundreds of kPa) are not fitted, which the run says, and which is
ranked all the same; and in some runs a part of one mode is reached by differential evolution alone,
too seldom for its mass. A run that has not converged is to be continued, not used.

The same for populations stands on [their page](population-evidence.md).
"""
CAPTION = (
    "The empirical distribution function of the ranks less the uniform one, against the rank; the "
    "grey band holds all of a uniform curve with probability 0.95, and a curve that leaves it is "
    "drawn in orange."
)
FIGURES = (
    "donor2-media-noisy-independent",
    "donor2-adventitia-noisy-independent",
    "donor2-media-noisy-independent-loose-without-determinant",
)


if __name__ == "__main__":
    sys.exit(main())
