"""Material laws: one law, one file.

:data:`LAWS` is the registry; a law is imported on first use.
"""

from __future__ import annotations

from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from biaxbayes.errors import InputError

if TYPE_CHECKING:
    from biaxbayes.laws.law import Law
    from biaxbayes.laws.materials import CheckedMaterial
    from biaxbayes.parameters import Parameter

DEFAULT_LAW = "goh"
LAWS = {
    "goh": ("biaxbayes.laws.goh", "GOHLaw"),
    "goh-exponential": ("biaxbayes.laws.goh_exponential", "GOHExponentialLaw"),
    "holzapfel-2005": ("biaxbayes.laws.holzapfel_2005", "Holzapfel2005Law"),
    "may-newman": ("biaxbayes.laws.may_newman", "MayNewmanLaw"),
    "hgo": ("biaxbayes.laws.hgo", "HGOLaw"),
    "fung": ("biaxbayes.laws.fung", "FungLaw"),
    "four-fibre": ("biaxbayes.laws.four_fibre", "FourFibreLaw"),
    "lee-sacks": ("biaxbayes.laws.lee_sacks", "LeeSacksLaw"),
}
"""Module and class of each law, by its name."""


def law_key(law: object, folder: Path | None = None) -> str:
    """What a run keeps of its law: its name, or the text of a user's file (from ``folder``)."""
    given = str(law)
    if "\n" not in given and given.endswith(".py"):
        from biaxbayes.text_files import one_line, read_text

        path = (folder or Path()) / given
        given = f"# {one_line(path.name)}\n{read_text(path)}"
    law_named(given)
    return given


def law_named(name: str, *, fibre_switch: bool = False) -> Law:
    """A law by its name, or by the file of a user's own: its path or text."""
    known = _law_class(name)
    if fibre_switch and not known.has_switch:
        switched = [n for n in LAWS if _law_class(n).has_switch]
        raise InputError(
            f"`fibre_switch` does not apply to the law {known.name}",
            remedy=f"leave it out; it is an option of {' and '.join(switched)}",
        )
    return known(fibre_switch)


def _law_class(name: str) -> type[Law]:
    if not isinstance(name, str):
        raise InputError(f"a law is named by a text, not {type(name).__name__}")
    if "\n" in name:
        from biaxbayes.laws.law_file import law_from_text

        return law_from_text(name)
    if name.endswith(".py"):
        return _law_class(law_key(name))
    if name not in LAWS:
        near = get_close_matches(str(name), LAWS, 1)
        meant = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"unknown law {str(name)[:40]!r}",
            remedy=f"{meant}laws are {', '.join(LAWS)}, or give a file with your own, my_law.py",
        )
    module, kind = LAWS[name]
    known: type[Law] = getattr(import_module(module), kind)
    return known


def all_parameters() -> tuple[Parameter, ...]:
    """The parameters of all laws, each name once: for tables that do not say the law."""
    known: dict[str, Parameter] = {}
    for name in LAWS:
        for parameter in law_named(name).parameters:
            known.setdefault(parameter.name, parameter)
    return tuple(known.values())


def material(name: str, *, fibre_switch: bool = False, **values: float) -> CheckedMaterial:
    """One material of a law.

    Parameters
    ----------
    name : str
        ``goh``, ``fung``, ...; :data:`LAWS` has all. Or the file of your own law, ``my_law.py``.
    fibre_switch : bool
        Fibres carry no compression, for laws that leave it open.
    **values : float
        Every parameter with its unit, as ``c0_kPa=10``; the bare name, ``c0``, will do.

    Returns
    -------
    CheckedMaterial
        With ``cauchy``, ``piola`` and ``strain_energy`` at total stretches.

    Raises
    ------
    InputError
        For an unknown law, and a parameter that is unknown, missing or out of range.
    """
    return law_named(name, fibre_switch=fibre_switch).checked_material(values)
