"""Hook of mkdocs: the help of every verb in place of ``<!-- verbs -->``."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import click

from biaxbayes.cli import VERBS

MARK = "<!-- verbs -->"


def verbs_markdown() -> str:
    """One section a verb, with its help as a terminal shows it."""
    sections = []
    for verb, summary in VERBS.items():
        module = f"biaxbayes.commands.{verb}"
        if find_spec(module) is None:
            continue
        command: click.Command = import_module(module).command
        context = click.Context(command, info_name=f"biaxbayes {verb}", max_content_width=96)
        sections.append(f"## {verb}\n\n{summary}\n\n```text\n{command.get_help(context)}\n```\n")
    return "\n".join(sections)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for every page."""
    return markdown.replace(MARK, verbs_markdown()) if MARK in markdown else markdown
