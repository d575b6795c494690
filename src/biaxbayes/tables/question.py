"""What a file leaves open: a question with proposals."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from biaxbayes.errors import InputError

BLANK = re.compile(r"\b(COLUMN|EXPRESSION|UNIT|FACTOR|LENGTH_MM|AXIAL_STRETCH|MM|SHEET|LINES)\b")
"""Words in an answer that the user replaces."""


@dataclass(frozen=True)
class Proposal:
    """One answer to a question: an argument of :func:`biaxbayes.convert`, and what it gives."""

    option: str
    value: str
    label: str

    @property
    def blank(self) -> str:
        """The word in the value that the user replaces, such as LENGTH_MM; empty without one."""
        found = BLANK.search(re.sub(r"\{[^{}]*\}", "", self.value))
        return found[0] if found else ""


class Question(InputError):
    """A choice that only the user can make; nothing is written without it.

    Attributes
    ----------
    option : str
        Argument of :func:`biaxbayes.convert` that most answers set.
    target : str
        For ``columns`` the target in question, such as ``stretch_x``; otherwise empty.
    text : str
        What is open, in one sentence.
    proposals : tuple of Proposal
    default : Proposal or None
        The most likely of them; None where nothing tells.
    assumed : Proposal or None
        The answer with which the conversion went on, to find what else is open.
    """

    def __init__(
        self,
        text: str,
        choices: Mapping[str, str],
        *,
        file: object,
        assumed: str = "",
        likely: bool = True,
    ) -> None:
        self.text = text
        self.proposals = tuple(
            Proposal(*answer.partition("=")[::2], label) for answer, label in choices.items()
        )
        self.option = self.proposals[0].option
        self.target = ""
        if self.option == "columns":
            self.target = self.proposals[0].value.partition("=")[0].strip()
        whole = next((p for p in self.proposals if not p.blank), None)
        self.default = whole if likely else None
        self.assumed = Proposal(*assumed.partition("=")[::2], "") if assumed else whole
        super().__init__(text, file=file, remedy=self.answers)

    def rename(self, names: Mapping[str, str], *, assumed: bool) -> None:
        """Replace texts in the values of all proposals, and of what is assumed."""
        for old, new in names.items():
            self.proposals = tuple(
                replace(p, value=p.value.replace(old, new)) for p in self.proposals
            )
            if assumed and self.assumed is not None:
                self.assumed = replace(self.assumed, value=self.assumed.value.replace(old, new))

    @property
    def answers(self) -> str:
        """The proposals in one sentence."""
        listed = (
            f"`{answer}` ({gives})" if gives else f"`{answer}`"
            for answer, gives in self.choices.items()
        )
        return f"answer with {', '.join(listed)}"

    @property
    def choices(self) -> dict[str, str]:
        """What each answer would give, by option and value, such as ``cycles=last``."""
        return {f"{p.option}={p.value}": p.label for p in self.proposals}
