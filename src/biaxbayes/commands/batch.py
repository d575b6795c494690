"""``biaxbayes batch``: a whole study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.commands.executor_options import executor_options
from biaxbayes.commands.model_options import model_options, read_model_options
from biaxbayes.commands.progress_line import graceful_stop, progress_line
from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.inference.study_file import Study
    from biaxbayes.output.study_result import StudyResult

__all__ = ["command"]

IN_FILE = {
    "seed": "seed",
    "ess": "ess",
    "max_steps": "max_steps",
    "mounting": "options",
    "noise": "options",
    "mounting_stretch": "options",
    "noise_growth": "options",
    "thin": "options",
    "fibre_switch": "options",
    "fix": "priors",
    "priors": "priors",
    "mounting_force": "mounting_force",
}
"""Where a study file states what is an option for CSV files."""


@click.command("batch")
@click.argument(
    "sources", metavar="STUDY.toml|CSV...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@executor_options
@click.option("--out", type=click.Path(path_type=Path), help="Study folder [<stem>-study].")
@click.option("--seed", type=int, default=1, show_default=True, help="Same seed, same bytes.")
@model_options
@click.option("--ess", type=float, default=2000, show_default=True, help="Effective draws wanted.")
@click.option("--max-steps", type=int, default=20_000, show_default=True, help="When to give up.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.pass_context
def command(
    context: click.Context,
    sources: tuple[Path, ...],
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    seed: int,
    mounting_force: tuple[float, float] | None,
    ess: float,
    max_steps: int,
    quiet: bool,
    **model: Any,
) -> int:
    r"""Sample many specimens: those of a study file, or the CSV files given.

    Writes a study folder: study.csv with a row for each specimen and quantity, summaries across
    layers and donors, study.html with the layers compared, and in runs/ a run folder of each
    specimen. The same command again does what is missing: a finished specimen is not sampled
    again, an interrupted one continues. A specimen that fails does not stop the others. Exit
    code 0 when every specimen is reliable, 3 when one is not, 2 when the input cannot be used.

    \b
    biaxbayes batch study.toml --workers 4
    biaxbayes batch study.toml --scheduler tcp://head:8786
    biaxbayes batch *.csv --out aortas --noise independent
    """
    from biaxbayes.executors.executor import executor_for

    if len(sources) == 1 and sources[0].suffix.lower() == ".toml":
        study = _study_of_file(sources[0], context)
    else:
        if mounting_force is not None:
            raise InputError(
                "--mounting-force is that of one specimen",
                remedy="state mounting_force for each in a study file",
            )
        study = _study_of_files(list(sources), read_model_options(**model), seed, ess, max_steps)
    executor = executor_for(workers, scheduler, isolated=True)
    folder = out or Path(f"{sources[0].stem}-study" if len(sources) == 1 else "study")
    from biaxbayes.output.batch import Batch

    with progress_line(quiet=quiet) as tell, graceful_stop() as stop:
        result = Batch(study, folder, executor).execute(progress=tell, stop=stop)
    if not quiet:
        click.echo(_closing(result))
    for label, reason in result.failures.items():
        click.echo(f"biaxbayes: {_plain(label)}: {_plain(reason)}", err=True)
    return 0 if result.reliable else 3


def _study_of_file(path: Path, context: click.Context) -> Study:
    from biaxbayes.inference.study_file import read_study

    given = click.core.ParameterSource.COMMANDLINE
    for name, key in IN_FILE.items():
        if context.get_parameter_source(name) is given:
            raise InputError(
                f"--{name.replace('_', '-')} is for CSV files",
                file=path,
                remedy=f"state it in the study file, under {key}",
            )
    return read_study(path)


def _study_of_files(
    files: list[Path], options: dict[str, Any], seed: int, ess: float, max_steps: int
) -> Study:
    from biaxbayes.inference.study_file import study_of_files

    for path in files:
        if path.suffix.lower() == ".toml":
            raise InputError(
                "a study file stands alone", file=path, remedy="list all specimens in it"
            )
    return study_of_files(files, options, seed=seed, ess=ess, max_steps=max_steps)


def _closing(result: StudyResult) -> str:
    lines = [f"{'specimen':<28}{'donor':<12}{'layer':<14}state"]
    for s in result.specimens.to_dict("records"):
        cells = [
            _plain(str(s[k]))[: n - 2] for k, n in (("specimen", 28), ("donor", 12), ("layer", 14))
        ]
        lines.append(f"{cells[0]:<28}{cells[1]:<12}{cells[2]:<14}{s['state']}")
    counts = ", ".join(f"{n} {state}" for state, n in result.states.items())
    lines += ["", f"{len(result.specimens)} specimens: {counts}"]
    lines.append(f"open {result.folder / 'study.html'}; all numbers are in study.csv beside it")
    return "\n".join(lines)


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
