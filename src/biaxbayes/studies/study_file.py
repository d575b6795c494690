"""Study files (docs/studies.md): specimens that belong together, and the options of each."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import biaxbayes
from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.laws import law_key, law_named
from biaxbayes.model.priors import parse_priors, prior_value
from biaxbayes.options import ModelOptions, SamplingPlan, options_of
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.specimens.check import with_force
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.text_files import one_line, read_toml, safe_file_name

DEFAULT_OPTIONS: dict[str, Any] = {
    name: getattr(ModelOptions, name) for name in options_of(ModelOptions)
}
SAMPLING_KEYS = ("seed", "ess", "max_steps")
"""Options of :class:`~biaxbayes.options.SamplingPlan` in a study file."""
STUDY_KEYS = ("name", *SAMPLING_KEYS, "anyway", "columns", "options", "priors", "specimen")
TEXT_KEYS = ("label", "donor", "layer")
SPECIMEN_KEYS = (
    "file", "pieces", *TEXT_KEYS, "seed", "mounting_force", "anyway", "options", "priors",
)  # fmt: skip
MAX_TEXT_LENGTH = 120


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
    pieces: tuple[Path, ...] = ()  # files of other pieces of the same tissue


@dataclass(frozen=True)
class Study:
    """Specimens that are sampled and reported together."""

    name: str
    specimens: tuple[StudySpecimen, ...]
    ess: float = SamplingPlan.ess
    max_steps: int = SamplingPlan.max_steps
    columns: tuple[str, ...] = ()  # of the groups of a population; empty: the layer


def study_of_files(
    files: list[Path],
    options: Mapping[str, Any],
    *,
    seed: int = SamplingPlan.seed,
    ess: float = SamplingPlan.ess,
    max_steps: int = SamplingPlan.max_steps,
    anyway: bool = False,
) -> Study:
    """A study of specimen files with common options, labelled by their file names."""
    for key, value in {"seed": seed, "ess": ess, "max_steps": max_steps}.items():
        SamplingPlan.check(key, value)
    for path in files:
        _check_file(path)
    specimens = tuple(
        StudySpecimen(path, path.stem, dict(options), seed, anyway=anyway) for path in files
    )
    _check_labels(specimens, None)
    return Study("study", specimens, float(ess), int(max_steps))


def read_study(path: Path) -> Study:
    """Read a study file; InputError names the file and the key that cannot be used."""
    table = read_toml(path)
    _check_table(table, STUDY_KEYS, "a study", "", path)
    numbers = {key: table.get(key, getattr(SamplingPlan, key)) for key in SAMPLING_KEYS}
    columns = tuple(dict.fromkeys(table.get("columns", [])))
    common = {"seed": numbers["seed"], "anyway": table.get("anyway", False), "columns": columns}
    common |= _options_and_priors(table, DEFAULT_OPTIONS | {"priors": {}}, "", path)
    entries = table.get("specimen")
    if not isinstance(entries, list) or not entries:
        raise InputError("lists no specimen", file=path, remedy="add tables [[specimen]]")
    specimens = tuple(_specimen(e, f"specimen {n}", common, path) for n, e in enumerate(entries, 1))
    _check_labels(specimens, path)
    name = one_line(table.get("name", path.stem))
    return Study(name, specimens, float(numbers["ess"]), int(numbers["max_steps"]), columns)


def _specimen(entry: object, what: str, common: Mapping[str, Any], path: Path) -> StudySpecimen:
    """One table [[specimen]], with the settings that the study's specimens share."""
    where = f"{what}: "
    if not isinstance(entry, dict):
        raise InputError(f"{where}is not a table", file=path, remedy="write it as [[specimen]]")
    own_columns = [c for c in common["columns"] if c not in TEXT_KEYS]
    known = (*SPECIMEN_KEYS, *own_columns)
    _check_table({"file": None, **entry}, known, what, where, path)
    specimen, *pieces = (path.parent / f for f in (entry["file"], *entry.get("pieces", [])))
    for key, file in (("file", specimen), *(("pieces", piece) for piece in pieces)):
        _check_file(file, f"{path}, {where}{key}")
    for name in own_columns:
        if name not in entry:
            raise InputError(
                f"{where}{name} is missing, which columns declares",
                file=path,
                remedy=f'give {name} = "..." for every specimen, or remove it from columns',
            )
    texts = {key: one_line(entry[key]) for key in (*TEXT_KEYS, *own_columns) if key in entry}
    force = entry.get("mounting_force")
    return StudySpecimen(
        specimen,
        texts.get("label", specimen.stem[:MAX_TEXT_LENGTH]),
        _options_and_priors(entry, common, where, path),
        int(entry.get("seed", common["seed"])),
        texts.get("donor"),
        texts.get("layer"),
        None if force is None else (float(force[0]), float(force[1])),
        entry.get("anyway", common["anyway"]),
        {name: texts[name] for name in own_columns},
        tuple(pieces),
    )


def _is_path(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip()) and "\0" not in value


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip()) and len(value) <= MAX_TEXT_LENGTH


def _is_force(value: object) -> bool:
    numbers = value if isinstance(value, list) and len(value) == 2 else [None]
    return all(
        isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e9 for v in numbers
    )


def _are_columns(value: object) -> bool:
    reserved = {*SPECIMEN_KEYS} - {"layer", "donor"}
    return isinstance(value, list) and all(
        isinstance(name, str) and name.isidentifier() and name not in reserved for name in value
    )


KINDS: dict[str, tuple[Callable[[object], bool], str]] = {
    "file": (_is_path, "the path of a CSV"),
    "pieces": (lambda v: isinstance(v, list) and all(map(_is_path, v)), "a list of paths"),
    "mounting_force": (_is_force, "two numbers [x, y]"),
    "anyway": (lambda v: isinstance(v, bool), "true or false"),
    "columns": (_are_columns, 'words that are not keys of a specimen, as ["disease"]'),
    "specimen": (lambda v: True, "tables"),  # each is checked on its own
    **dict.fromkeys(("options", "priors"), (lambda v: isinstance(v, dict), "a table")),
}
"""What the value of a key must be; of any other key it is text."""


def _check_table(
    table: Mapping[str, object], known: Iterable[str], what: str, where: str, path: Path
) -> None:
    """Refuse unknown keys, and values of another kind than that of their key."""
    for key, value in table.items():
        if key not in known:
            remedy = f"keys are {', '.join(known)}"
            raise InputError(f"{key[:60]!r} is not a key of {what}", file=path, remedy=remedy)
        if key in SAMPLING_KEYS:
            SamplingPlan.check(key, value, where, path)
            continue
        fits, words = KINDS.get(key, (_is_text, f"text of at most {MAX_TEXT_LENGTH} characters"))
        if not fits(value):
            raise InputError(f"{where}{key} must be {words}", file=path)


def _options_and_priors(
    table: Mapping[str, Any], common: Mapping[str, Any], where: str, path: Path
) -> dict[str, Any]:
    """Options of the posterior, with priors, in place of the common ones."""
    options = {key: common[key] for key in (*DEFAULT_OPTIONS, "priors")}
    for key, value in table.get("options", {}).items():
        if key not in DEFAULT_OPTIONS:
            remedy = f"keys are {', '.join(DEFAULT_OPTIONS)}"
            problem = f"{key[:60]!r} is not a key of {where}options"
            raise InputError(problem, file=path, remedy=remedy)
        # the file of a law is beside that of the study
        options[key] = law_key(value, path.parent) if key == "law" else value
        ModelOptions.check(key, options[key], where=f"{where}options: ", file=path)
    if priors := table.get("priors", {}):
        law = law_named(options["law"])
        options["priors"] = options["priors"] | parse_priors(priors, f"{path}, {where}priors", law)
    return options


def _check_file(file: Path, listed: str = "") -> None:
    """Refuse a file that is not there; of a study file, with the place where it is listed."""
    with contextlib.suppress(OSError, ValueError):
        if file.is_file():
            return
    name = f": {str(file)[:200]}" if listed else ""
    raise InputError(f"no such file{name}", file=listed or file, remedy="check the path")


def _check_labels(specimens: tuple[StudySpecimen, ...], path: Path | None) -> None:
    seen: dict[str, int] = {}
    for number, specimen in enumerate(specimens, start=1):
        first = seen.setdefault(specimen.label.casefold(), number)
        if first != number:
            where = f"specimen {number}: " if path is not None else ""
            raise InputError(
                f"{where}label {specimen.label!r} is that of specimen {first} as well",
                file=path,
                remedy="give different labels in a study file",
            )


@dataclass(frozen=True)
class LoadedSpecimen:
    """A specimen of the study, or the problem with reading it."""

    listing: StudySpecimen  # as in the study file
    slug: str  # name of the run folder, in the folder of runs
    specimen: Specimen | None = None
    problem: str = ""
    fingerprint: str = ""  # of everything that the run depends on

    @property
    def donor(self) -> str:
        """Donor, by the study file or the header of the specimen."""
        in_header = self.specimen.metadata.get("donor", "") if self.specimen else ""
        return self.listing.donor or str(in_header)

    @property
    def layer(self) -> str:
        """Layer, likewise."""
        return self.listing.layer or (self.specimen.layer if self.specimen else None) or ""


def load_specimens(study: Study) -> list[LoadedSpecimen]:
    """Read the specimens; one that cannot be read stays in the list with its error."""
    out = []
    slugs: set[str] = set()
    for entry in study.specimens:
        stem = safe_file_name(entry.label, "specimen")
        slug, number = stem, 1
        while slug.casefold() in slugs:
            number += 1
            slug = f"{stem}-{number}"
        slugs.add(slug.casefold())
        try:
            specimen = read_specimen(entry.file)
            if entry.mounting_force is not None:
                specimen = with_force(specimen, entry.mounting_force, entry.file)
            specimen = specimen.with_pieces(read_specimen(path) for path in entry.pieces)
        except BiaxbayesError as error:
            out.append(LoadedSpecimen(entry, slug, problem=str(error)))
            continue
        priors = {k: prior_value(v) for k, v in dict(entry.options.get("priors", {})).items()}
        content = {
            "specimen": specimen_digest(specimen),
            "options": {**entry.options, "priors": priors},
            "seed": entry.seed,
            "ess": study.ess,
            "max_steps": study.max_steps,
            "biaxbayes": biaxbayes.__version__,
        }
        text = json.dumps(content, sort_keys=True, default=str)
        fingerprint = hashlib.sha256(text.encode()).hexdigest()
        out.append(LoadedSpecimen(entry, slug, specimen, "", fingerprint))
    return out
