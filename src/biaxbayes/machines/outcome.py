"""What becomes of machine exports: a specimen with the account of every row, or questions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.record import Record, Recording, ranges_without
from biaxbayes.specimens.check import Finding
from biaxbayes.specimens.protocol import Protocol
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import in_lines
from biaxbayes.text_files import aligned


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
    n = record.lines.size
    left = np.ones(record.lines.size, dtype=bool)
    for r, p in zip(conversion.recordings, conversion.specimen.protocols, strict=True):
        if r.record is not record:
            continue
        left[r.rows] = False
        cycles = [cycle for of_protocol in record.cycles.values() for cycle in of_protocol]
        # a fall alone is no cycle
        whole = [c.rows("both") for c in cycles if np.isin(r.rows, c.unloading).all()]
        lines = ranges_without(record.lines, np.setdiff1d(np.arange(n), [*whole, r.rows][0]))
        side = "reversed unloading" if r.branch == "unloading" else r.branch
        cycle = f", cycle {r.cycle}" if r.cycle else ""
        reference = f"reference {record.stretches_text(p.reference, '.4f')} (rows: {p.rest_rows});"
        table.append(
            (
                "kept",
                str(p.rows),
                f"protocol {p.name}{cycle}, {side}:",
                f"--rows {lines};",
                reference if p.rest_rows else "",
                f"largest stretch {record.stretches_text(p.stretch.max(axis=0), '.4f')},",
                f"load {record.loads_text(p.recorded_load.max(axis=0), 4)}",
            )
        )
    for reason in dict.fromkeys(record.reasons[left].tolist()):
        others = record.lines[left & (record.reasons == reason)]
        table.append(("left out", str(others.size), f"{reason}:", f"lines {in_lines(others)}"))
    return table
