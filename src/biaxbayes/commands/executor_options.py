"""Options of the verbs that work off many tasks: local processes, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

__all__ = ["executor_options"]


def executor_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--workers`` and ``--scheduler``; the result depends on neither."""
    options = [
        click.option(
            "--workers", type=int, default=None, help="Local processes [processors, at most 4]."
        ),
        click.option(
            "--scheduler",
            metavar="ADDRESS",
            help="Use the workers of this Dask scheduler, as tcp://host:8786.",
        ),
    ]
    for option in reversed(options):
        function = option(function)
    return function
