"""``biaxbayes compare``: several runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError
from biaxbayes.options import ModelOptions, SamplingPlan, takes_options
from biaxbayes.progress_bar import with_progress
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import OnProgress, PathLike, RunLike, SpecimenLike, Stop

if TYPE_CHECKING:
    from biaxbayes.comparison.compare import Comparison


@with_progress
@takes_options(SamplingPlan, ModelOptions)
def compare(
    runs: Sequence[RunLike | SpecimenLike],
    *,
    labels: Sequence[str] | None = None,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    anyway: bool = False,
    overwrite: bool = False,
    progress: OnProgress | None = None,
    stop: Stop = inputs.no_stop,
    **options: Any,
) -> Comparison:
    """Compare what runs report, and the quantities that two of them identify.

    Parameters
    ----------
    runs : sequence of Run, Specimen or path-like
        Two or more. A specimen is sampled first, into a run folder inside ``out``.
    labels : sequence of str, optional
        Default: the layers if they differ, else the specimens, else the folders.
    out : path-like, optional
        Folder of the tables, figures and the page, compare.html.
    anyway : bool
        Use runs that have not converged, which get no verdict, and sample specimens whose data do
        not look like a loading curve.
    overwrite : bool
        Replace finished runs of specimens in ``out``.
    mounting_force, progress, stop : optional
        As in :func:`biaxbayes.sample`, for specimens to sample.
    **options
        For specimens to sample, as in :func:`biaxbayes.sample`.
    """
    from biaxbayes.comparison.compare import ComparedRun, run_labels
    from biaxbayes.comparison.compare import compare as lay_out
    from biaxbayes.reports.comparison import write_comparison
    from biaxbayes.verbs.sample import sample

    ModelOptions.from_values(SamplingPlan.split(options)[1])
    if len(runs) < 2:
        raise InputError("a comparison needs at least two runs")
    if labels is not None and (len(labels) != len(runs) or not all(labels)):
        problem = f"{len(labels)} `labels` for {len(runs)} runs"
        raise InputError(problem, remedy="give one label for each run")
    options |= {"mounting_force": mounting_force, "anyway": anyway, "overwrite": overwrite}
    opened = []
    for source in runs:
        run: Any = source
        if not inputs.is_run(source):
            if out is None:
                problem = "a specimen that is sampled needs a folder for its run"
                raise InputError(problem, remedy="give it with `out`")
            stem = run.name if isinstance(run, Specimen) else Path(run).stem
            folder = Path(out) / f"{stem}-posterior"
            run = sample(run, out=folder, progress=progress, stop=stop, **options)
        opened.append(inputs.usable_run(run, anyway=anyway))
    names = labels or run_labels([r.specimen for r in opened], [r.path.name for r in opened])
    compared = []
    for name, run in zip(names, opened, strict=True):
        # Draws used in spite of their state still get no verdict.
        state = "tentative" if run.state == "unusable" else run.state
        posterior = run.posterior()
        compared.append(ComparedRun(name, posterior, run.draws, state, run.result.reported))
    result = lay_out(compared)
    if out is not None:
        write_comparison(result, Path(out))
    return result


# --- the command ---------------------------------------------------------------------------------


@click.command("compare")
@opt.argument("sources", metavar="RUN|CSV...", nargs=-1, required=True)
@click.option("--labels", metavar="A,B,...", help="Names of the runs, in their order.")
@opt.file_option(
    "out",
    "Folder of the tables, figures and the page.",
    default=Path("comparison"),
    show_default=True,
)
@opt.options(SamplingPlan, "seed", seed={"help": "For specimens to sample."})
@opt.model_options()
@opt.options(SamplingPlan, "ess", "workers")
@opt.flag(
    "anyway",
    "Use runs that have not converged, and sample data that do not look like a loading curve.",
)
@opt.overwrite_option("run")
@opt.quiet_option
def command(
    sources: tuple[Path, ...],
    labels: str | None,
    out: Path,
    anyway: bool,
    quiet: bool,
    **given: Any,
) -> int:
    r"""Compare runs of different layers, specimens or settings.

    Writes the matrix of verdicts, the overlaid posteriors, the forest of intervals, the distances
    between the runs and a page, compare.html. A specimen CSV is sampled first, with the model
    options given here, into a run folder inside --out.

    \b
    biaxbayes compare intima.run media.run adventitia.run --out layers
    biaxbayes compare media.run media.csv --fix alpha=41 --labels "free,alpha from histology"
    """
    from biaxbayes.reports.comparison import comparison_text

    given = opt.with_priors(**given)
    names = None if labels is None else [name.strip() for name in labels.split(",")]
    runs = [opt.open_usable_run(s, anyway=anyway) if s.is_dir() else s for s in sources]
    with opt.progress_and_stop(quiet) as work:
        result = compare(runs, labels=names, out=out, anyway=anyway, **work, **given)
    if not quiet:
        click.echo(comparison_text(result, out))
    if not result.converged:
        click.echo("biaxbayes: not every run has converged, see compare.html", err=True)
    return 0 if result.converged else opt.NOT_CONVERGED
