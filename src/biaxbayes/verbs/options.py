"""Options that commands share, made for click from the tables of :mod:`biaxbayes.options`."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError, NotConverged
from biaxbayes.options import WORKERS_HELP, ModelOptions, Options, options_of
from biaxbayes.parameters import DEGREE
from biaxbayes.progress_bar import graceful_stop, progress_line

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.runs.run import Run

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

NOT_CONVERGED = NotConverged.exit_code


def pair(separator: str, example: str, *, single: bool = False, zero: bool = False) -> Any:
    """Type of an option: two positive numbers with a separator, or one number for both."""

    def numbers(value: Any) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        parts = str(value).split(separator)
        if len(parts) == 1 and single:
            parts *= 2
        try:
            x, y = (float(part) for part in parts)
        except ValueError:
            x = y = math.nan
        lowest = min(x, y)
        if not (math.isfinite(x + y) and (lowest > 0.0 or (zero and lowest == 0.0))):
            raise click.BadParameter(f"{value!r} is not of the form {example}")
        return x, y

    return numbers


RATIO = pair(":", "1:0.5", zero=True)


# --- options of a table --------------------------------------------------------------------------


def together(*decorators: Decorator) -> Decorator:
    """Several options as one decorator, in the order of the help page."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return add


def options(table: type[Options], *names: str, **changes: dict[str, Any]) -> Decorator:
    """Options of a table (default all); `changes` by option go to ``click.option``."""
    described, made = options_of(table), []
    for name in names or described:
        option, default = described[name], getattr(table, name)
        settings: dict[str, Any] = {"help": option.help or None, "metavar": option.metavar}
        if option.choices:
            settings["type"] = click.Choice(option.choices)
        elif option.kind is bool:
            settings |= {"is_flag": True, "default": default}
        elif option.kind is not None:
            settings["type"] = option.kind
        if default is not None and option.kind is not bool:
            # A count is shown as a user would write it: 2000, not 2000.0.
            whole = isinstance(default, float) and default >= 100.0 and default.is_integer()
            settings |= {"default": int(default) if whole else default, "show_default": True}
        made.append(click.option(f"--{option.flag}", name, **settings | changes.get(name, {})))
    return together(*made)


# --- further arguments and options ------------------------------------------------


def argument(name: str, **more: Any) -> Decorator:
    """A path among the arguments of a command."""
    return click.argument(name, type=click.Path(path_type=Path), **more)


def file_option(flag: str, help_text: str, metavar: str | None = None, **more: Any) -> Decorator:
    """An option that takes a path; ``name`` where the argument has another name than the flag."""
    names = [f"--{flag}", more.pop("name", flag)]
    kind = click.Path(path_type=Path)
    return click.option(*names, type=kind, metavar=metavar, help=help_text, **more)


def choice_option(name: str, flag: str, choices: Iterable[str], help_text: str = "") -> Decorator:
    """An option that takes one of several values, by default the first."""
    how: dict[str, Any] = {"type": click.Choice(list(choices)), "help": help_text or None}
    return click.option(f"--{flag}", name, default=next(iter(choices)), show_default=True, **how)


def flag(name: str, help_text: str) -> Decorator:
    """An option without a value."""
    return click.option(f"--{name}", is_flag=True, help=help_text)


quiet_option = flag("quiet", "Print nothing but errors.")
unconverged_option = flag("anyway", "Use the draws of a run that has not converged.")
anyway_option = flag("anyway", "Sample data that do not look like a loading curve (see check).")
resume_option = flag("resume", "Continue from the folder's checkpoint.")


def json_option(help_text: str) -> Decorator:
    """``--json``."""
    return click.option("--json", "as_json", is_flag=True, help=help_text)


def overwrite_option(kind: str) -> Decorator:
    """``--overwrite`` for results that took long to sample."""
    return flag("overwrite", f"Replace a finished {kind}, and everything derived from it.")


executor_options = together(
    click.option("--workers", type=int, default=None, help=WORKERS_HELP),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use the workers of this Dask scheduler, as tcp://host:8786.",
    ),
)
"""``--workers`` and ``--scheduler``; the result depends on neither."""


# --- the statistical model and its priors --------------------------------------------------------


MODEL = tuple(options_of(ModelOptions))


def parameters_option(help_text: str) -> Decorator:
    """``--parameter NAME``, repeatable."""
    return click.option("--parameter", "parameters", multiple=True, metavar="NAME", help=help_text)


def fix_option(help_text: str) -> Decorator:
    """``--fix NAME=VALUE``."""
    return click.option("--fix", multiple=True, metavar="NAME=VALUE", help=help_text)


def mounting_force_option(
    help_text: str = "For a tared file: the force (or stress) at the mounted state, added back.",
) -> Decorator:
    """``--mounting-force X Y``."""
    return click.option(
        "--mounting-force", nargs=2, type=float, default=None, metavar="X Y", help=help_text
    )


def model_options(table: type[ModelOptions] = ModelOptions) -> Decorator:
    """Options of the statistical model."""
    return together(
        options(table),
        fix_option("Fix a parameter, as kappa=0 or alpha=41 (degrees). Repeatable."),
        file_option(
            "priors",
            "Priors, fixed and tied parameters; or the name of a tissue whose fibre angle and "
            "dispersion are known from imaging (an unknown name lists them).",
            "FILE.toml|NAME",
        ),
        mounting_force_option(),
    )


def with_priors(
    *, fix: tuple[str, ...], law: str, priors: Path | None = None, **others: Any
) -> dict[str, Any]:
    """Options of a command as its verb takes them: ``--fix`` and ``--priors`` as one table."""
    from biaxbayes.laws import law_key, law_named
    from biaxbayes.model.priors import check_fixed, named_priors, read_priors

    law = law_key(law)
    material_law = law_named(law, fibre_switch=others.get("fibre_switch", False))
    chosen: dict[str, Any] = {} if priors is None else dict(read_priors(priors, material_law))
    if known := named_priors().get(str(priors)):
        text = f"{known['tissue']}; {known['stated']} ({known['source']})"
        click.echo(f"priors of {priors}: {text}. Assumed: {known['assumed']}", err=True)
    for name, value in chosen.items():
        if isinstance(value, float):
            _warn_of_radians(material_law, name, value)
    for name, value in fixed_values(fix, material_law).items():
        chosen[name] = check_fixed(name, value, law=material_law)
    return {**others, "law": law, "priors": chosen}


def fixed_values(texts: tuple[str, ...], law: Law) -> dict[str, float]:
    """Numbers of ``--fix``, not checked against the range of their parameter."""
    fixed = {}
    for text in texts:
        given, value = named_number(text, "--fix", "kappa=0.1")
        fixed[law.known_name(given)] = value
        _warn_of_radians(law, given, value)
    return fixed


def named_number(text: str, flag: str, example: str) -> tuple[str, float]:
    """Name and number of a text NAME=VALUE."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        problem = f"{flag} {text[:60]!r} is not of the form NAME=VALUE"
        raise InputError(problem, remedy=f"write it as {flag} {example}") from None


def _warn_of_radians(law: Law, name: str, value: float) -> None:
    """Warn of an angle below pi / 2 degrees, which may be meant in radians."""
    angles = [p.name for p in law.parameters if p.unit == DEGREE]
    if law.known_name(name) in angles and 0.0 < value <= math.pi / 2.0:
        click.echo(
            f"warning: {name} is fixed at {value:g} degrees; if that is in radians, write "
            f"{name}={math.degrees(value):.4g}",
            err=True,
        )


# --- what commands do ----------------------------------------------------------------------------


@contextlib.contextmanager
def progress_and_stop(quiet: bool) -> Iterator[dict[str, Any]]:
    """Progress line and graceful interruption, as keyword arguments of a Python function."""
    with progress_line(quiet=quiet) as progress, graceful_stop() as stop:
        yield {"progress": progress, "stop": stop}


def was_given(name: str) -> bool:
    """Whether an option stands on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is click.core.ParameterSource.COMMANDLINE


def refuse_options(names: tuple[str, ...], problem: str, **more: Any) -> None:
    """Refuse the first of these options that was given; ``{}`` in the problem is its name."""
    for name in filter(was_given, names):
        raise InputError(problem.format(f"`{name}`"), **more)


def open_usable_run(path: Path, *, anyway: bool) -> Run:
    """Open a run folder as :func:`~biaxbayes.verbs.inputs.usable_run`; warn if not converged."""
    from biaxbayes.verbs.inputs import usable_run

    run = usable_run(path, anyway=anyway)
    if run.state == "unusable":
        click.echo("warning: the chains of this run have not converged", err=True)
    elif run.state == "tentative":
        click.echo("note: this run is tentative: few effective draws", err=True)
    return run
