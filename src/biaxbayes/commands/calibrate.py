"""``biaxbayes calibrate``: whether the intervals are right on this protocol and noise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.executor_options import executor_options
from biaxbayes.commands.model_options import (
    model_options,
    read_model_options,
    specimen_with_mounting_force,
)
from biaxbayes.commands.progress_line import graceful_stop, progress_line

if TYPE_CHECKING:
    from biaxbayes.findings.calibration import Study
    from biaxbayes.output.calibration import Outcome
    from biaxbayes.specimens.specimen import Specimen

__all__ = ["command"]


@click.command("calibrate")
@click.argument("specimen", type=click.Path(path_type=Path))
@click.option("--replications", type=int, default=200, show_default=True)
@executor_options
@click.option(
    "--from",
    "source",
    type=click.Choice(["prior", "posterior"]),
    default="prior",
    show_default=True,
    help="True values from a prior scaled to the protocol, or around the specimen's posterior.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder [<stem>-calibration].")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--ess", type=float, default=600, show_default=True, help="Effective draws of each.")
@click.option("--resume", is_flag=True, help="Continue, or add replications to, a study.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.option("--break", "broken", default="", hidden=True, help="determinant, or noise.")
@model_options
def command(
    specimen: Path,
    replications: int,
    workers: int | None,
    scheduler: str | None,
    source: str,
    out: Path | None,
    seed: int,
    ess: float,
    resume: bool,
    quiet: bool,
    broken: str,
    mounting_force: tuple[float, float] | None,
    **model: Any,
) -> int:
    """Simulation-based calibration on the protocols, dimensions and load noise of SPECIMEN.

    True values are drawn, readings simulated and sampled as a measured specimen's are, and
    the true values ranked among the draws. Writes ranks.csv, calibration.csv, a figure and the
    priors used. With independent noise the ranks must be uniform; with effective noise, whose
    weight is estimated from each record, the coverage is reported. Exit code 3 when the ranks
    are not uniform.
    """
    from biaxbayes.errors import InputError
    from biaxbayes.executors.executor import executor_for

    if replications < 1:
        raise InputError("--replications must be at least 1")
    if not ess >= 200:
        raise InputError("--ess must be at least 200: 127 draws are ranked against")
    if not 0 <= seed < 2**63:
        raise InputError("--seed must be a whole number from 0 up")
    executor = executor_for(workers, scheduler)
    options = read_model_options(**model)
    read = specimen_with_mounting_force(specimen, mounting_force)
    from biaxbayes.output.calibration import CalibrationStudy

    study = CalibrationStudy(
        _study(read, options, source, seed, ess, broken),
        out or Path(f"{specimen.stem}-calibration"),
        replications,
        executor,
    )
    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        outcome = study.execute(resume=resume, progress=tell, stop=stop)
    tested = options["noise"] == "independent"
    if not quiet:
        click.echo(_closing(study.folder, outcome, tested))
    return 3 if tested and not outcome.calibrated else 0


def _study(
    specimen: Specimen, options: dict[str, Any], source: str, seed: int, ess: float, broken: str
) -> Study:
    from biaxbayes.findings.calibration import Study
    from biaxbayes.findings.study_prior import protocol_prior

    stated = options.pop("priors")
    if source == "posterior":
        priors = _around_posterior(specimen, options, stated, seed)
    else:
        priors = {**protocol_prior(specimen), **stated}
    return Study(specimen, options, priors, seed=seed, ess=ess, broken=broken)


def _around_posterior(
    specimen: Specimen, options: dict[str, Any], stated: dict[str, Any], seed: int
) -> dict[str, Any]:
    from biaxbayes.errors import NotConverged
    from biaxbayes.findings.study_prior import local_prior
    from biaxbayes.inference.posterior import Posterior
    from biaxbayes.inference.priors import default_priors
    from biaxbayes.inference.sampler import Plan, draw

    drawn = draw(Posterior(specimen, **options, priors=stated, seed=seed), Plan(seed=seed))
    if drawn.convergence.state == "unusable":
        raise NotConverged(
            f"the specimen's own posterior is no basis for a study: {drawn.convergence.reason}"
        )
    return local_prior(drawn.quantities, {**default_priors(specimen), **stated})


def _closing(folder: Path, outcome: Outcome, tested: bool) -> str:
    total = sum(outcome.states.values())
    lines = [f"{'':18s} {'uniform p':>9s} {'in band':>8s}   coverage of 50, 80, 90, 95 %"]
    for row in outcome.table.to_dict("records"):
        shares = "  ".join(f"{100 * row[f'coverage_{level}']:5.1f}" for level in (50, 80, 90, 95))
        lines.append(
            f"{row['parameter']:18s} {row['uniformity_p']:9.3f} {row['inside_band']:>8s}   {shares}"
        )
    doubtful = {k: v for k, v in outcome.states.items() if k != "reliable"}
    lines.append(
        f"{total} replications, "
        + (", ".join(f"{v} {k}" for k, v in doubtful.items()) if doubtful else "all reliable")
    )
    if tested:
        said = "uniform" if outcome.calibrated else "NOT uniform"
        lines.append(f"the ranks of all quantities together are {said} (p = {outcome.p:.3g})")
    else:
        lines.append(
            "the weight of the likelihood is estimated from each record: uniform ranks are not "
            "promised, coverage is what counts"
        )
    lines.append(f"written to {folder}")
    return "\n".join(lines)
