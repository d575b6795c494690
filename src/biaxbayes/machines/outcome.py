"""What becomes of machine exports: a specimen, with account and recipe, or questions."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.record import Record, Recording, ranges_without
from biaxbayes.specimens.check import Finding
from biaxbayes.specimens.keys import KEYS
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import in_lines
from biaxbayes.text_files import aligned, read_toml

OF_ONE_FILE = ("rows", "specimen")
"""Answers that hold for one file only."""
OF_A_LAB = (
    "geometry", "reference", "load_noise_N", "load_noise_kPa", "axial_force_noise_N",
    "stress_limit_kPa",
)  # fmt: skip
"""Header keys that hold for all specimens of a lab; edges and thickness do not."""
FOUND = "found"
"""Table of what the first export held."""


@dataclass(frozen=True)
class Conversion:
    """A specimen, its recordings, and its protocols with the stretches as measured."""

    specimen: Specimen
    recordings: tuple[Recording, ...]
    protocols_as_measured: tuple[Protocol, ...]
    records: tuple[Record, ...]  # all rows of the tables, with the reason of each left out
    findings: tuple[Finding, ...]  # of the check of the specimen
    choice: Choice  # as the user gave it
    header: Mapping[str, float | str]

    @property
    def account(self) -> str:
        """What became of every row, as the command prints it; columns and units as understood."""
        lines, records = [], self.records
        common = [n for n in records[0].notes if all(n in record.notes for record in records)]
        for record in records:
            lines.append(f"{record.source}: {record.lines.size} rows read")
            lines += [f"  {line}" for line in aligned(_rows_of(record, self), right=(1,))]
            lines += [f"  {note}" for note in record.notes if note not in common]
        notes = [note for r in self.recordings for note in r.notes]
        assumed = str(self.specimen.metadata.get("conversion", "")).split("; ")
        assumed = [text for text in assumed if not any(n.startswith(f"{text}:") for n in common)]
        return "\n".join([*lines, *filter(None, dict.fromkeys([*common, *notes, *assumed]))])

    def __repr__(self) -> str:
        sources = ", ".join(r.record.source for r in self.recordings)
        return f"Conversion({self.specimen!r} from {sources})"


class OpenQuestions(InputError):
    """All that files leave open, each with its proposals; nothing is written.

    Attributes
    ----------
    questions : tuple of Question
    provisional : Conversion or None
        What the files would give with what each question assumes; None where that fails.
    obstacle : str
        Why that fails; empty otherwise.
    choices : dict of str
        What each answer to any of them would give, by option and value, such as ``cycles=last``.
    """

    def __init__(
        self, questions: Sequence[Question], provisional: Conversion | None, obstacle: str = ""
    ) -> None:
        self.questions, self.provisional = tuple(questions), provisional
        self.obstacle = obstacle
        self.choices = {answer: gives for q in questions for answer, gives in q.choices.items()}
        first = questions[0]
        if len(questions) == 1:
            super().__init__(first.text, file=first.file, remedy=first.answers)
            return
        texts, answers = (
            ", ".join(f"({n}) {said}" for n, said in enumerate(each, start=1))
            for each in ([q.text for q in questions], [q.answers for q in questions])
        )
        super().__init__(f"{len(questions)} questions: {texts}", file=first.file, remedy=answers)


def _rows_of(record: Record, conversion: Conversion) -> list[Sequence[str]]:
    """Rows kept and left out, with their number, lines and peaks or reason."""
    table: list[Sequence[str]] = []
    left = np.ones(record.lines.size, dtype=bool)
    for r, p in zip(conversion.recordings, conversion.specimen.protocols, strict=True):
        if r.record is not record:
            continue
        left[r.rows] = False
        cycles = [cycle for of_protocol in record.cycles.values() for cycle in of_protocol]
        # a fall alone is no cycle
        whole = [c.rows("both") for c in cycles if np.isin(r.rows, c.unloading).all()]
        others = np.setdiff1d(np.arange(left.size), [*whole, r.rows][0])
        side = "reversed unloading" if r.branch == "unloading" else r.branch
        cycle = f", cycle {r.cycle}" if r.cycle else ""
        reference = f"reference {record.stretches_text(p.reference, '.4f')} (rows: {p.rest_rows});"
        row = ["kept", str(p.rows), f"protocol {p.name}{cycle}, {side}:"]
        row += [f"--rows {ranges_without(record.lines, others)};", reference if p.rest_rows else ""]
        row += [f"largest stretch {record.stretches_text(p.stretch.max(axis=0), '.4f')},"]
        table.append([*row, f"load {record.loads_text(p.recorded_load.max(axis=0), 4)}"])
    for reason in dict.fromkeys(record.reasons[left].tolist()):
        others = record.lines[left & (record.reasons == reason)]
        table.append(("left out", str(others.size), f"{reason}:", f"lines {in_lines(others)}"))
    return table


# --- the recipe: the answers of a conversion, for exports of the same kind ------------------------


def recipe_text(result: Conversion) -> str:
    """The recipe of a conversion."""
    choice, header = result.choice, result.header
    lines = ["# Answers for 'biaxbayes convert FILE --recipe': one line an option"]
    for f in fields(choice):
        value = getattr(choice, f.name)
        if f.name not in OF_ONE_FILE and value != f.default:
            lines.append(f"{f.name} = {_toml(value)}")
    header_lines = [f"{key} = {_toml(header[key])}" for key in OF_A_LAB if key in header]
    if header_lines:
        lines += ["", "[header]", *header_lines]
    lines += ["", "# A file that holds others does not fit", f"[{FOUND}]"]
    lines += [f"{key} = {_toml(value)}" for key, value in _found(result).items()]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)


def _found(result: Conversion) -> dict[str, Any]:
    """What a file of the same kind holds, too."""
    columns = dict.fromkeys(name for r in result.recordings for name in r.record.columns if name)
    count = len(result.recordings)
    return {"columns": list(columns), "loads": result.specimen.loads, "protocols": count}


def read_recipe(path: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Options, header values, and what a file has to hold."""
    table = read_toml(path)
    header, found = table.pop("header", {}), table.pop(FOUND, {})
    known = {f.name for f in fields(Choice)} - set(OF_ONE_FILE)
    for name in table:
        if name not in known:
            remedy = f"options are {', '.join(sorted(known))}"
            raise InputError(f"no option {name[:60]!r}", file=path, remedy=remedy)
    if not isinstance(header, dict) or not isinstance(found, dict) or set(header) - set(KEYS):
        problem = f"[header] and [{FOUND}] must be tables, of header keys and of what was found"
        raise InputError(problem, file=path, remedy=f"keys are {', '.join(KEYS)}")
    options = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    return options, header, found


def refuse_other_content(found: Mapping[str, Any], result: Conversion, recipe: Path) -> None:
    """Refuse a file that holds other columns or protocols than the recipe was made from."""
    here = _found(result)
    for key in here:
        if key in found and found[key] != here[key]:
            problem = f"does not fit the recipe {recipe}: its {key} are {_toml(here[key])}, those "
            problem += f"of the recipe {_toml(found[key])}"
            remedy = "convert it without the recipe, and answer what is asked"
            raise InputError(problem, file=result.recordings[0].record.path, remedy=remedy)
