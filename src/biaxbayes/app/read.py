"""Reading exports of a machine: what each column is, what is open, which rows are taken.

The address of the page has the answers, by options of ``convert``, header keys, and as
``columns:stretch_x`` what a target is read from.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import biaxbayes
from biaxbayes.app.figures import record_figure
from biaxbayes.app.jobs import command_line
from biaxbayes.app.server import Page
from biaxbayes.errors import InputError
from biaxbayes.experiments import EXPERIMENTS, Experiment
from biaxbayes.machines.choice import FORMATS, Choice
from biaxbayes.machines.columns import IGNORE, TARGETS
from biaxbayes.machines.outcome import Conversion, OpenQuestions
from biaxbayes.options import options_of
from biaxbayes.specimens.keys import KEYS
from biaxbayes.tables.expressions import columns_in, is_expression
from biaxbayes.tables.layout import table_from_sheet
from biaxbayes.tables.preview import Preview, preview
from biaxbayes.tables.question import Proposal, Question
from biaxbayes.tables.sheets import read_sheets
from biaxbayes.verbs.convert import HEADER_OPTIONS, common_stem

COLUMN = "columns:"
FIRST_ASKED = ("machine", "sheets", "sets", "test", "hidden")
"""Options on which other questions depend."""
ANSWERS = {f"{COLUMN}{target}" for target in (*TARGETS, IGNORE)} | {
    "machine", "specimen", *options_of(Choice), *HEADER_OPTIONS
}  # fmt: skip
"""Names of answers; others in an address are left."""


@dataclass
class Control:
    """An answer and its question; proposals: control, value, word to replace, what it gives."""

    name: str
    value: str
    text: str = ""
    assumed: str = ""  # until it is answered
    proposals: list[tuple[str, str, str, str]] = field(default_factory=list)


@dataclass
class Reading:
    """What files are with some answers."""

    files: list[Path]
    answers: dict[str, str]
    recipe: Path | None = None
    conversion: Conversion | None = None
    problem: str = ""
    controls: dict[str, Control] = field(default_factory=dict)

    def keywords(self, names: Collection[str] = ANSWERS) -> dict[str, Any]:
        """The answers of some names, as keyword arguments of ``convert``."""
        found: dict[str, Any] = {"recipe": self.recipe} if self.recipe else {}
        for name, value in self.answers.items():
            usual = getattr(Choice, name, None)
            if name not in names:
                continue
            if name.startswith(COLUMN):
                found.setdefault("columns", []).append(f"{name.removeprefix(COLUMN)}={value}")
            elif isinstance(usual, tuple):
                found[name] = [part.strip() for part in value.split(",")]
            else:
                found[name] = True if usual is False else value
        return found

    def convert(self, names: Collection[str]) -> list[Question]:
        """Convert, and note the result; returns what is open."""
        self.problem = ""
        try:
            self.conversion = biaxbayes.convert(self.files, **self.keywords(names))
        except OpenQuestions as error:
            self.conversion = error.provisional
            return list(error.questions)
        except InputError as error:
            self.conversion, self.problem = None, str(error)
        return []

    def ask(self) -> None:
        """Collect all controls: those of what was answered as well, with their proposals."""
        self.answers.setdefault("machine", likely_machine(self.files[0]))
        self.controls["machine"] = Control("machine", self.answers["machine"], "Format.")
        earlier, asked = [], self.convert(("machine",))
        if set(self.answers) & set(FIRST_ASKED[1:]):
            earlier, asked = asked, self.convert(FIRST_ASKED)
        if len(self.answers) > 1:
            earlier, asked = earlier + asked, self.convert(ANSWERS)
        for question in earlier + asked:
            name, _ = answer_of(question.proposals[0])
            if question in earlier and name not in self.answers:
                continue  # another answer has settled it
            likely = (question.default, question.assumed)
            default, assumed = (answer_of(p)[1] if p else "" for p in likely)
            # what the test is depends on the columns, which may not be known yet
            value = self.answers.get(name, "" if name == "test" else default)
            control = self.controls.setdefault(name, Control(name, value))
            control.text, control.assumed = question.text, assumed
            control.proposals = [(*answer_of(p), p.blank, p.label) for p in question.proposals]
        for name, value in self.answers.items():
            if name not in HEADER_OPTIONS:
                self.controls.setdefault(name, Control(name, value))

    @property
    def open(self) -> list[str]:
        """Questions without an answer, by the name of their control."""
        return [c.name.removeprefix(COLUMN) for c in self.controls.values() if not c.value]

    @property
    def experiment(self) -> Experiment:
        """The kind of test, as far as it is known."""
        return EXPERIMENTS.get(self.answers.get("test", ""), EXPERIMENTS["biaxial"])

    @property
    def usual_keys(self) -> list[str]:
        """Header keys that nearly every test of this kind has, and those that are asked for."""
        needed = self.experiment.needed("force")
        asked = [key for key in self.controls if key in HEADER_OPTIONS]
        return list(dict.fromkeys(["specimen", "layer", "axis_x", "axis_y", *needed, *asked]))

    def targets(self, column: str) -> list[str]:
        """Targets that a column is read for."""
        return [
            name.removeprefix(COLUMN)
            for name, control in self.controls.items()
            if name.startswith(COLUMN) and column in sources(control.value or control.assumed)
        ]


def answer_of(proposal: Proposal) -> tuple[str, str]:
    """Name of the control that takes an answer, and its value."""
    if proposal.option != "columns":
        return proposal.option, proposal.value
    target, _, source = proposal.value.partition("=")
    return COLUMN + target.strip(), source.strip()


def sources(text: str) -> list[str]:
    """Columns that a source is read from."""
    return columns_in(text) if is_expression(text) else [text.partition(":")[0].strip(), text]


def likely_machine(path: Path) -> str:
    """The format that recognises a file; any table is generic."""
    for machine in (name for name in FORMATS if name != "generic"):
        for sheet in read_sheets(path).values():
            try:
                table = table_from_sheet(sheet, path)
            except InputError:
                continue
            if import_module(f"biaxbayes.machines.{machine}").recognises(table, Choice(machine)):
                return machine
    return "generic"


def reading_of(page: Page) -> Reading:
    """Files and answers of a request."""
    recipes = page.files("recipe") if page.get_argument("recipe", "") else [None]
    answers = {}
    for name in (name for name in page.request.arguments if name in ANSWERS):
        text = page.get_argument(name)
        if name in KEYS and KEYS[name].range:
            text = text.replace(",", ".")
        if text:
            answers[name] = text
    return Reading(page.files("file"), answers, recipes[0])


async def read(page: Page) -> None:
    """Show what files are, with all that is open."""
    reading, each = reading_of(page), bool(page.get_argument("each", ""))
    files = [path.name for path in reading.files]
    free = page.place.new_name(f"{common_stem(reading.files)}-specimen", ".csv")
    out = page.get_argument("out", "") or free
    if each:
        reading.files = reading.files[:1]

    def shown() -> list[tuple[str, str, Preview]]:
        reading.ask()
        return [(p.name, name, sheet) for p in reading.files for name, sheet in preview(p).items()]

    sheets = await page.off_loop(shown)
    conversion = reading.conversion
    recipe = {"recipe": reading.recipe.name} if reading.recipe else {}
    page.show(
        "read.html.jinja",
        reading=reading,
        sheets=sheets,
        files=files,
        each=each,
        out=out,
        targets=[*TARGETS, IGNORE],
        keys=KEYS,
        header=HEADER_OPTIONS,
        options=options_of(Choice),
        account=conversion.account if conversion else "",
        plots=[record_figure(conversion, r) for r in conversion.records] if conversion else [],
        line=command_line("convert", files, reading.keywords() | recipe | {"out": out}),
    )


async def write(page: Page) -> None:
    """Write the specimen file with its picture and recipe; or one of each file."""
    reading, folder = reading_of(page), page.place.folder
    out = page.place.path(page.get_argument("out"))
    of_file = {out: reading.files}
    if page.get_argument("each", ""):
        of_file = {folder / f"{path.stem}-{out.stem}.csv": [path] for path in reading.files}
    for path in of_file:
        if path.suffix != ".csv" or page.place.new_name(path.stem, ".csv") != path.name:
            problem = f"{path.name!r} exists already, or does not end with .csv"
            raise InputError(problem, remedy="choose another name")

    def convert() -> None:
        for path, files in of_file.items():
            biaxbayes.convert(files, out=path, **reading.keywords())

    try:
        await page.off_loop(convert)
    except OpenQuestions:  # that of an answer which was only proposed
        names = page.request.arguments
        return page.go_to("read", **{name: page.get_arguments(name) for name in names})
    page.go_to("specimen" if len(of_file) == 1 else "", file=[path.name for path in of_file])
