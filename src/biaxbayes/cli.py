"""The command line: a lazy group, one module of :mod:`biaxbayes.commands` a verb.

Nothing heavy is imported here; a verb's module is imported when the verb is called, so that
``biaxbayes --help`` answers at once.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

import click

from biaxbayes.errors import BiaxbayesError

__all__ = ["main"]

VERBS = {
    "sample": "Joint posterior of the GOH parameters and the mounting stretches.",
    "fit": "Deterministic fits, with and without the mounting stretch.",
    "check": "What the tool understands of a specimen file, and its warnings.",
    "convert": "Machine exports to a specimen file.",
    "simulate": "A virtual biaxial test, written as a specimen file.",
    "identify": "Which parameters the data determine.",
    "profile": "Profile likelihood of one parameter.",
    "compare": "Several runs side by side: layers, specimens, settings.",
    "design": "What to measure next.",
    "ledger": "What ignoring the mounting stretch costs.",
    "calibrate": "Simulation-based calibration on your own protocol.",
    "predict": "Stress with bands on any path; thin-walled inflation.",
    "plot": "Figures of a run, sized for a paper.",
    "report": "The report of a run: HTML page, Markdown or LaTeX tables.",
    "export": "Material cards for Abaqus and FEBio.",
    "batch": "Many specimens, resumable, in parallel.",
}
"""Verbs in the order of the help page; each lives in ``commands/<verb>.py`` as ``command``."""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        return import_module(f"biaxbayes.commands.{cmd_name}").command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="biaxbayes")
def group() -> None:
    """GOH parameters and mounting stretches of soft tissue from planar biaxial tests.

    Start with: biaxbayes sample specimen.csv
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; errors become one line and an exit code."""
    try:
        outcome: Any = group.main(arguments, prog_name="biaxbayes", standalone_mode=False)
    except BiaxbayesError as error:
        click.echo(f"biaxbayes: {error}", err=True)
        sys.exit(error.exit_code)
    except click.exceptions.Abort:
        click.echo("biaxbayes: interrupted", err=True)
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(141)
    sys.exit(outcome if isinstance(outcome, int) else 0)


if __name__ == "__main__":
    main()
