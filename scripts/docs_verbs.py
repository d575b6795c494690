"""Write docs/cli.md from the commands themselves, and docs/glossary.md from the words of reports.

python scripts/docs_verbs.py            writes the page
python scripts/docs_verbs.py --check    exit code 1 where a page is not what would be written
"""

from __future__ import annotations

import argparse
import inspect
import sys
from pathlib import Path

import click

from biaxbayes.cli import VERBS, group
from biaxbayes.options import WHICH_FIT
from biaxbayes.reports.words import GLOSSARY, SEVERAL, fit_terms
from biaxbayes.text_files import atomic_write_text

PAGE = Path(__file__).resolve().parents[1] / "docs" / "cli.md"
WORDS = PAGE.with_name("glossary.md")
HEAD = """# Command line

Every verb with its options; `biaxbayes VERB --help` prints the same. Exit codes: 0 done, 2 an
input, option or file that cannot be used, 3 ran but the result cannot be trusted; 70 a defect of
the program; 128 and the number of the signal where one stopped it (130: Ctrl-C).

| verb | |
|---|---|
"""


def section(verb: str) -> str:
    """The reference of one verb: usage, what it does, its options."""
    command = group.get_command(click.Context(group), verb)
    assert command is not None
    context = click.Context(command, info_name=f"biaxbayes {verb}")
    usage = " ".join(["biaxbayes", verb, *command.collect_usage_pieces(context)])
    parts = [f"## {verb}", f"```text\n{usage}\n```"]
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        lines = [line.strip() for line in paragraph.strip().splitlines()]
        # click's mark of a paragraph that keeps its lines: examples
        kept = lines[0] == "\b"
        parts.append("```text\n" + "\n".join(lines[1:]) + "\n```" if kept else "\n".join(lines))
    return "\n\n".join([*parts, "\n".join(_options(command, context))])


def _options(command: click.Command, context: click.Context) -> list[str]:
    """A line an option, but for --help."""
    lines = []
    for parameter in command.params:
        record = parameter.get_help_record(context)
        if isinstance(parameter, click.Option) and record is not None:
            names, words = (" ".join(part.split()) for part in record)
            lines.append(f"- `{names}`: {words.replace('<', '&lt;')}")  # no tag of HTML
    return lines


def page() -> str:
    """The whole page."""
    verbs = "".join(f"| [{verb}](#{verb}) | {words} |\n" for verb, words in VERBS.items())
    return HEAD + verbs + "\n" + "\n\n".join(section(verb) for verb in VERBS) + "\n"


def glossary() -> str:
    """The page of words."""
    terms = "".join(f"| {term} | {words} |\n" for term, words in (GLOSSARY | SEVERAL).items())
    fits = "".join(f"| `{term}` | {words} |\n" for term, words in fit_terms().items())
    return (
        f"# Glossary\n\n| term | what it means |\n|---|---|\n{terms}\n## The deterministic fits\n\n"
        f"| fit | what it does |\n|---|---|\n{fits}\n{WHICH_FIT}\n"
    )


def main() -> int:
    """Write or check the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    if not parser.parse_args().check:
        atomic_write_text(PAGE, page())
        atomic_write_text(WORDS, glossary())
        return 0
    wanted = {PAGE: page(), WORDS: glossary()}
    stale = [p.name for p, text in wanted.items() if p.read_text(encoding="utf-8") != text]
    for name in stale:
        print(f"docs/{name} is not current: run python scripts/docs_verbs.py", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
