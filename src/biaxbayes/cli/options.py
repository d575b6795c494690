"""What commands share: options made of the tables of :mod:`biaxbayes.options`, and usable runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError
from biaxbayes.options import ModelOptions, Option, Options, stated
from biaxbayes.specimens.keys import KEYS, NONE, OF_FORCES

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.runs.run import Run

__all__ = [
    "HEADER_OPTIONS",
    "MODEL",
    "Decorator",
    "Pair",
    "any_record_option",
    "anyway_option",
    "argument",
    "executor_options",
    "file_option",
    "fix_option",
    "fixed_values",
    "header_options",
    "model_options",
    "mounting_force_option",
    "open_usable_run",
    "options",
    "overwrite_option",
    "quiet_option",
    "read_model_options",
    "refuse_given",
]

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class Pair(click.ParamType):
    """Two positive numbers with a separator, or one number for both, as in the example."""

    def __init__(
        self, name: str, separator: str, example: str, *, single: bool = False, zero: bool = False
    ) -> None:
        self.name, self.separator, self.example = name, separator, example
        self.single, self.zero = single, zero

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Numbers from the text of the option."""
        if isinstance(value, tuple):
            return value
        parts = str(value).split(self.separator)
        if len(parts) == 1 and self.single:
            parts *= 2
        try:
            x, y = (float(part) for part in parts)
        except ValueError:
            x = y = math.nan
        lowest = min(x, y)
        if not (math.isfinite(x + y) and (lowest > 0.0 or (self.zero and lowest == 0.0))):
            self.fail(f"{value!r} does not read like {self.example}", param, ctx)
        return x, y


def options(table: type[Options], *names: str, **changes: dict[str, Any]) -> Decorator:
    """Add options of a table to a command.

    Parameters
    ----------
    table : type
        One of the tables of :mod:`biaxbayes.options`.
    *names : str
        In the order of the help; all of the table's where none is named.
    **changes
        What this command says otherwise of an option, as keyword arguments of ``click.option``.
    """

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for name in reversed(names or tuple(stated(table))):
            function = _option(table, name, changes.get(name, {}))(function)
        return function

    return add


def _option(table: type[Options], name: str, changes: dict[str, Any]) -> Decorator:
    option, default = stated(table)[name], getattr(table, name)
    told: dict[str, Any] = {"help": option.words or None, "metavar": option.metavar}
    if option.kind is bool:
        told |= {"is_flag": True, "default": default}
    else:
        if option.choices:
            told["type"] = click.Choice(option.choices)
        elif option.shown:
            told["type"] = _range(option)
        elif option.kind is not None:
            told["type"] = option.kind
        if default is not None:
            # A count is shown as a user would write it: 2000, not 2000.0.
            whole = isinstance(default, float) and default >= 100.0 and default.is_integer()
            told |= {"default": int(default) if whole else default, "show_default": True}
    return click.option(f"--{option.flag}", name, **(told | changes))


def _range(option: Option) -> click.ParamType:
    most = None if option.most == math.inf else option.most
    if option.kind is int:
        return click.IntRange(int(option.least), None if most is None else int(most))
    inside = option.inside
    return click.FloatRange(option.least, most, min_open=inside, max_open=inside)


def argument(name: str, **more: Any) -> Decorator:
    """A path among the arguments of a command."""
    return click.argument(name, type=click.Path(path_type=Path), **more)


def file_option(name: str, words: str, metavar: str | None = None, **more: Any) -> Decorator:
    """An option that takes a path."""
    kind = click.Path(path_type=Path)
    return click.option(f"--{name}", type=kind, metavar=metavar, help=words, **more)


quiet_option = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
anyway_option = click.option("--anyway", is_flag=True, help="Even if the run has not converged.")


def overwrite_option(kind: str) -> Decorator:
    """``--overwrite`` of what took long to sample."""
    words = f"Replace a finished {kind}, with all that was made of it."
    return click.option("--overwrite", is_flag=True, help=words)


any_record_option = click.option(
    "--anyway", is_flag=True, help="Even if the record cannot be a loading curve (see check)."
)


def executor_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--workers`` and ``--scheduler``; the result depends on neither."""
    for option in (
        click.option(
            "--scheduler",
            metavar="ADDRESS",
            help="Use the workers of this Dask scheduler, as tcp://host:8786.",
        ),
        click.option(
            "--workers", type=int, default=None, help="Local processes [processors, at most 4]."
        ),
    ):
        function = option(function)
    return function


# --- the statistical model and its priors --------------------------------------------------------


MODEL = (
    *("law", "mounting", "noise", "mounting_stretch", "mounting_sd", "noise_growth", "thin"),
    "fibre_switch",
)


def fix_option(words: str) -> Decorator:
    """``--fix NAME=VALUE``."""
    return click.option("--fix", multiple=True, metavar="NAME=VALUE", help=words)


def mounting_force_option(
    words: str = "For a tared file: the force (or stress) at the mounted state, put back on.",
) -> Decorator:
    """``--mounting-force X Y``."""
    return click.option(
        "--mounting-force", nargs=2, type=float, default=None, metavar="X Y", help=words
    )


def model_options(table: type[ModelOptions] = ModelOptions) -> Decorator:
    """Add the options of the statistical model to a command."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in (
            mounting_force_option(),
            file_option("priors", "Priors, fixed and tied parameters.", "FILE.toml"),
            fix_option("Fix a parameter, as kappa=0 or alpha=41 (degrees). Repeatable."),
            options(table, *MODEL),
        ):
            function = option(function)
        return function

    return add


def read_model_options(
    *, fix: tuple[str, ...], law: str, priors: Path | None = None, **model: Any
) -> dict[str, Any]:
    """Keyword arguments of :class:`~biaxbayes.model.posterior.Posterior`.

    Raises
    ------
    InputError
        Naming the option or the key of the priors file that cannot be used.
    """
    from biaxbayes.laws import law_named
    from biaxbayes.model.priors import check_fixed, read_priors

    material_law = law_named(law, fibre_switch=model.get("fibre_switch", False))
    chosen: dict[str, Any] = {} if priors is None else dict(read_priors(priors, material_law))
    for name, value in chosen.items():
        if isinstance(value, float):
            _warn_of_radians(name, value)
    for name, value in fixed_values(fix, material_law).items():
        chosen[name] = check_fixed(name, value, law=material_law)
    return {**model, "law": law, "priors": chosen}


def fixed_values(texts: tuple[str, ...], law: Law) -> dict[str, float]:
    """Numbers of ``--fix``, not checked against the range of their parameter."""
    held = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            held[law.known_name(name.strip())] = float(value)
        except ValueError:
            raise InputError(f"--fix {text[:60]!r}", remedy="write it as --fix kappa=0.1") from None
        _warn_of_radians(name.strip(), held[law.known_name(name.strip())])
    return held


def _warn_of_radians(name: str, value: float) -> None:
    """An angle is stated in degrees; one below pi / 2 may be meant in radians."""
    if name.startswith("alpha") and 0.0 < value <= math.pi / 2.0:
        click.echo(
            f"warning: {name} is fixed at {value:g} degrees; if that is in radians, write "
            f"{name}={math.degrees(value):.4g}",
            err=True,
        )


def refuse_given(context: click.Context, names: tuple[str, ...], problem: str, **more: Any) -> None:
    """Refuse the first of these options that was given; ``{}`` in the problem is its name."""
    for name in names:
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise InputError(problem.format(f"--{name.replace('_', '-')}"), **more)


# --- a run for what builds on it: draws that have not converged are refused, or used -------------


def open_usable_run(path: Path, *, anyway: bool) -> Run:
    """Open a run folder as :func:`~biaxbayes.jobs.opening.usable_run`, and say how good it is."""
    from biaxbayes import api

    run = api.usable_run(path, anyway=anyway)
    if run.state == "unusable":
        click.echo("warning: the chains of this run have not converged", err=True)
    elif run.state == "tentative":
        click.echo("note: this run is tentative: few effective draws", err=True)
    return run


# --- header keys of a specimen file ---------------------------------------------------------------


HEADER_OPTIONS = {
    "specimen": "TEXT",
    "layer": "TEXT",
    "axis_x": "TEXT",
    "axis_y": "TEXT",
    "geometry": "unloaded|mounted",
    "reference": "common",
    "edge_x_mm": "MM",
    "edge_y_mm": "MM",
    "thickness_mm": "MM",
    "load_noise_N": "N",
    "load_noise_kPa": "KPA",
    "edge_sd_mm": "MM",
    "thickness_sd_mm": "MM",
    "mounting_stretch_x": "'M +- SD'",
    "mounting_stretch_y": "'M +- SD'",
    "stress_limit_kPa": "KPA",
}
"""Header keys that can be stated, and what the help prints for their values."""


def header_options() -> Decorator:
    """An option for each header key of a specimen file."""

    def add(function: Any) -> Any:
        for key, metavar in reversed(HEADER_OPTIONS.items()):
            words, default = KEYS[key]
            default = "name of the first file" if key == "specimen" else default
            without = default if default == OF_FORCES else f"default: {default}"
            text = f"{words}." if default == NONE else f"{words} ({without})."
            option = f"--{key.replace('_', '-')}"
            names = [option] if option == option.lower() else [option, option.lower()]
            function = click.option(*names, key.lower(), metavar=metavar, help=text)(function)
        return function

    return add
