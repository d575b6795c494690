"""Study files: specimens that belong together, and the options of each.

The format is TOML; paths are relative to the file::

    name = "aortas of three donors"          # optional, as seed, ess and max_steps
    seed = 1
    columns = ["disease"]                    # what makes groups of a population; default: layer

    [options]                                # for all specimens
    noise = "effective"

    [priors]                                 # as in a priors file
    kappa = 0.2

    [[specimen]]
    file = "donor1-media.csv"
    label = "D1 media"                       # default: name of the file without its ending
    donor = "D1"                             # default: from the header of the file
    layer = "media"                          # likewise
    disease = "aneurysm"                     # of every column that was declared
    mounting_force = [0.015, 0.013]          # for a tared file
    options = { mounting = "zeroed" }        # for this one alone
    priors = { alpha = { distribution = "normal", mean = 41, sd = 3 } }
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from biaxbayes.errors import InputError
from biaxbayes.laws import law_named
from biaxbayes.model.priors import Prior, Tie, parse_priors
from biaxbayes.options import MOST_WHOLE, ModelOptions, SamplingPlan, options_of
from biaxbayes.text_files import one_line, read_toml

DEFAULT_OPTIONS: dict[str, Any] = {
    name: getattr(ModelOptions, name) for name in options_of(ModelOptions)
}
NUMBERS = ("seed", "ess", "max_steps")
"""Options of :class:`~biaxbayes.options.SamplingPlan` in a study file."""
STUDY_KEYS = ("name", *NUMBERS, "anyway", "columns", "options", "priors", "specimen")
TEXT_KEYS = ("label", "donor", "layer")
SPECIMEN_KEYS = ("file", *TEXT_KEYS, "seed", "mounting_force", "anyway", "options", "priors")
LONGEST = 120


@dataclass(frozen=True)
class StudySpecimen:
    """One specimen of a study."""

    file: Path
    label: str  # unique in the study
    options: Mapping[str, Any]  # of the posterior, with priors
    seed: int = SamplingPlan.seed
    donor: str | None = None  # None: from the header of the file
    layer: str | None = None
    mounting_force: tuple[float, float] | None = None  # added back to a tared file, in its unit
    anyway: bool = False  # sample even if it cannot be a loading curve
    # values of the columns that the study declares
    columns: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """Specimens that are sampled and reported together."""

    name: str
    specimens: tuple[StudySpecimen, ...]
    ess: float = SamplingPlan.ess
    max_steps: int = SamplingPlan.max_steps
    columns: tuple[str, ...] = ()  # of the groups of a population; empty: the layer


@dataclass(frozen=True)
class _Common:
    """Settings that the specimens of a study file share."""

    path: Path
    seed: int
    options: dict[str, Any]
    priors: dict[str, Prior | float | Tie] = field(default_factory=dict)
    anyway: bool = False
    columns: tuple[str, ...] = ()

    @property
    def own_columns(self) -> tuple[str, ...]:
        """Declared columns other than donor and layer."""
        return tuple(c for c in self.columns if c not in TEXT_KEYS)


def study_of_files(
    files: list[Path],
    options: Mapping[str, Any],
    *,
    name: str = "study",
    seed: int = SamplingPlan.seed,
    ess: float = SamplingPlan.ess,
    max_steps: int = SamplingPlan.max_steps,
    anyway: bool = False,
) -> Study:
    """A study of specimen files with common options, labelled by their file names."""
    for path in files:
        _check_file(path, path)
    specimens = tuple(
        StudySpecimen(
            path,
            path.stem,
            dict(options),
            _number("`seed`", seed, "seed", None),
            anyway=anyway,
        )
        for path in files
    )
    _check_labels(specimens, None)
    return Study(
        name,
        specimens,
        float(_number("`ess`", ess, "ess", None)),
        int(_number("`max_steps`", max_steps, "max_steps", None)),
    )


def read_study(path: Path) -> Study:
    """Read a study file; InputError names the file and the key that cannot be used."""
    table = read_toml(path)
    _check_keys(table, STUDY_KEYS, "a study", path)
    numbers = {
        key: _number(key, table.get(key, getattr(SamplingPlan, key)), key, path) for key in NUMBERS
    }
    options = _options(table.get("options", {}), DEFAULT_OPTIONS, "options", path)
    common = _Common(
        path,
        int(numbers["seed"]),
        options,
        _priors(table.get("priors", {}), options["law"], "priors", path),
        _flag(table.get("anyway", False), "anyway", path),
        _columns(table.get("columns", []), path),
    )
    entries = table.get("specimen")
    if not isinstance(entries, list) or not entries:
        raise InputError("lists no specimen", file=path, remedy="add tables [[specimen]]")
    specimens = tuple(_specimen(entry, n, common) for n, entry in enumerate(entries, start=1))
    _check_labels(specimens, path)
    name = _text(table, "name", "", path) or path.stem
    return Study(name, specimens, float(numbers["ess"]), int(numbers["max_steps"]), common.columns)


def _columns(value: object, path: Path) -> tuple[str, ...]:
    """Names of the columns that make groups."""
    given = value if isinstance(value, list) else [None]
    taken = {*SPECIMEN_KEYS} - {"layer", "donor"}
    for name in given:
        if not isinstance(name, str) or not name.isidentifier() or name in taken:
            raise InputError(
                f"columns: {str(name)[:60]!r} cannot be a column",
                file=path,
                remedy='write columns = ["disease"], a word that is not a key of a specimen',
            )
    return tuple(dict.fromkeys(given))


def _column_value(entry: Mapping[str, object], name: str, where: str, path: Path) -> str:
    value = _text(entry, name, where, path)
    if value is None:
        raise InputError(
            f"{where}{name} is missing, which columns declares",
            file=path,
            remedy=f'give {name} = "..." for every specimen, or remove it from columns',
        )
    return value


def _specimen(entry: object, number: int, common: _Common) -> StudySpecimen:
    path, where = common.path, f"specimen {number}: "
    if not isinstance(entry, dict):
        raise InputError(f"{where}is not a table", file=path, remedy="write it as [[specimen]]")
    _check_keys(entry, (*SPECIMEN_KEYS, *common.own_columns), f"specimen {number}", path)
    file = entry.get("file")
    if not isinstance(file, str) or not file.strip() or "\0" in file:
        raise InputError(f"{where}file must be the path of a CSV", file=path)
    specimen = path.parent / file
    _check_file(specimen, f"{path}, {where}file", path=path)
    options = _options(entry.get("options", {}), common.options, f"{where}options", path)
    given = _priors(entry.get("priors", {}), options["law"], f"{where}priors", path)
    priors = {**common.priors, **given}
    return StudySpecimen(
        specimen,
        _text(entry, "label", where, path) or specimen.stem[:LONGEST],
        options | {"priors": priors},
        int(_number(f"{where}seed", entry.get("seed", common.seed), "seed", path)),
        _text(entry, "donor", where, path),
        _text(entry, "layer", where, path),
        _force(entry.get("mounting_force"), f"{where}mounting_force", path),
        _flag(entry.get("anyway", common.anyway), f"{where}anyway", path),
        {name: _column_value(entry, name, where, path) for name in common.own_columns},
    )


def _check_keys(table: Mapping[str, object], known: tuple[str, ...], what: str, path: Path) -> None:
    for key in table:
        if key not in known:
            raise InputError(
                f"{key[:60]!r} is not a key of {what}",
                file=path,
                remedy=f"keys are {', '.join(known)}",
            )


def _check_file(file: Path, name_in_message: object, *, path: Path | None = None) -> None:
    try:
        there = file.is_file()
    except (OSError, ValueError):
        there = False
    if not there:
        name = f": {str(file)[:200]}" if path is not None else ""
        raise InputError(f"no such file{name}", file=name_in_message, remedy="check the path")


def _check_labels(specimens: tuple[StudySpecimen, ...], path: Path | None) -> None:
    seen: dict[str, int] = {}
    for number, specimen in enumerate(specimens, start=1):
        label = specimen.label.casefold()
        if label in seen:
            where = f"specimen {number}: " if path is not None else ""
            raise InputError(
                f"{where}label {specimen.label!r} is that of specimen {seen[label]} as well",
                file=path,
                remedy="give different labels in a study file",
            )
        seen[label] = number


def _number(what: str, value: object, key: str, path: Path | None) -> Any:
    """A number that the key allows."""
    option = options_of(SamplingPlan)[key]
    whole = option.kind is int
    fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if not (fits and option.least <= value <= MOST_WHOLE and math.isfinite(value)):  # type: ignore
        raise InputError(
            f"{what} must be a {'whole ' if whole else ''}number, at least {option.least:g}",
            file=path,
        )
    return value


def _text(table: Mapping[str, object], key: str, where: str, path: Path) -> str | None:
    value = table.get(key)
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip() or len(value) > LONGEST:
        raise InputError(f"{where}{key} must be text of at most {LONGEST} characters", file=path)
    return one_line(value)


def _options(table: object, common: Mapping[str, Any], where: str, path: Path) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table", file=path)
    _check_keys(table, tuple(DEFAULT_OPTIONS), where, path)
    for key, value in table.items():
        ModelOptions.check(key, value, where=f"{where}: ", file=path)
    return {**common, **table}


def _priors(table: object, law: str, where: str, path: Path) -> dict[str, Prior | float | Tie]:
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table", file=path)
    if not table:
        return {}
    return parse_priors(table, f"{path}, {where}", law_named(law))


def _flag(value: object, what: str, path: Path) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{what} must be true or false", file=path)
    return value


def _force(value: object, where: str, path: Path) -> tuple[float, float] | None:
    if value is None:
        return None
    numbers = value if isinstance(value, list) else []
    if len(numbers) != 2 or not all(
        isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e9 for v in numbers
    ):
        raise InputError(f"{where} must be two numbers [x, y]", file=path)
    return float(numbers[0]), float(numbers[1])
