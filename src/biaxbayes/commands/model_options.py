"""Options that several verbs share: the statistical model and its priors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from biaxbayes.specimens.specimen import Specimen

__all__ = ["model_options", "read_model_options", "specimen_with_mounting_force"]


def model_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the statistical model to a command."""
    options = [
        click.option(
            "--mounting",
            type=click.Choice(["noisy", "exact", "free", "ignored", "zeroed"]),
            default="noisy",
            show_default=True,
            help="How the mounting force enters.",
        ),
        click.option(
            "--noise",
            type=click.Choice(["effective", "systematic", "independent"]),
            default="effective",
            show_default=True,
            help="Weigh the rows by the independent readings they are worth, or not.",
        ),
        click.option(
            "--mounting-stretch",
            type=click.Choice(["shared", "per-protocol"]),
            default="shared",
            show_default=True,
            help="One mounted state for all protocols, or one each.",
        ),
        click.option("--noise-growth", is_flag=True, help="Let the noise sd grow with the load."),
        click.option(
            "--thin",
            metavar="N|none|auto",
            default="auto",
            show_default=True,
            help="Average longer protocols to N rows; auto: above 200 rows to 100, for effective "
            "noise alone.",
        ),
        click.option(
            "--fibre-switch", is_flag=True, help="Fibres carry no compression (Abaqus, FEBio)."
        ),
        click.option(
            "--fix",
            multiple=True,
            metavar="NAME=VALUE",
            help="Fix a parameter, as kappa=0 or alpha=41 (degrees). Repeatable.",
        ),
        click.option(
            "--priors",
            type=click.Path(path_type=Path),
            metavar="FILE.toml",
            help="Priors, fixed and tied parameters.",
        ),
        click.option(
            "--mounting-force",
            nargs=2,
            type=float,
            default=None,
            metavar="X Y",
            help="For a tared file: the force (or stress) at the mounted state, put back on.",
        ),
    ]
    for option in reversed(options):
        function = option(function)
    return function


def read_model_options(
    *,
    mounting: str,
    noise: str,
    mounting_stretch: str,
    noise_growth: bool,
    thin: str = "auto",
    fibre_switch: bool,
    fix: tuple[str, ...],
    priors: Path | None,
) -> dict[str, Any]:
    """Keyword arguments of :class:`~biaxbayes.inference.posterior.Posterior`.

    Raises
    ------
    InputError
        Naming the option or the key of the priors file that cannot be used.
    """
    from biaxbayes.errors import InputError
    from biaxbayes.inference.priors_file import check_fixed, read_priors

    chosen: dict[str, Any] = {} if priors is None else dict(read_priors(priors))
    for text in fix:
        name, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            equals = ""
            number = 0.0
        if not equals:
            raise InputError(f"--fix {text[:60]!r}", remedy="write it as --fix kappa=0.1")
        chosen[name.strip()] = check_fixed(name.strip(), number)
    return {
        "mounting": mounting,
        "noise": noise,
        "mounting_stretch": mounting_stretch,
        "noise_growth": noise_growth,
        "thin": thin,
        "fibre_switch": fibre_switch,
        "priors": chosen,
    }


def specimen_with_mounting_force(path: Path, force: tuple[float, float] | None) -> Specimen:
    """Read a specimen and put a stated mounting force back on.

    Raises
    ------
    InputError
        If the specimen's own mounting force is not zero.
    """
    from biaxbayes.errors import InputError
    from biaxbayes.specimens.specimen_file import read_specimen

    specimen = read_specimen(path)
    if force is None:
        return specimen
    if not specimen.is_tared:
        raise InputError(
            "has a mounting force of its own",
            file=path,
            remedy="--mounting-force is for files whose force was zeroed after mounting",
        )
    return specimen.with_mounting_force(*force)
