"""What a file leaves open: the choices, what each would give, and the option that answers."""

from __future__ import annotations

from collections.abc import Mapping

from biaxbayes.errors import InputError


class Question(InputError):
    """A choice that only the user can make; nothing is written without it.

    Attributes
    ----------
    choices : dict of str
        What each answer would give, by the argument that gives it, such as ``cycles=last``.
    """

    def __init__(self, problem: str, choices: Mapping[str, str], *, file: object) -> None:
        self.choices = dict(choices)
        listed = ", ".join(
            f"`{answer}` ({gives})" if gives else f"`{answer}`" for answer, gives in choices.items()
        )
        super().__init__(problem, file=file, remedy=f"answer with {listed}")
