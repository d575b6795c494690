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
    pieces = ["donor1-strip-x.csv"]          # other pieces of the same tissue
    label = "D1 media"                       # default: name of the file without its ending
    donor = "D1"                             # default: from the header of the file
    layer = "media"                          # likewise
    disease = "aneurysm"                     # of every column that was declared
    mounting_force = [0.015, 0.013]          # for a tared file
    options = { mounting = "zeroed" }        # for this one alone
    priors = { alpha = { distribution = "normal", mean = 41, sd = 3 } }
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import biaxbayes
from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.laws import law_key, law_named
from biaxbayes.model.priors import Prior, Tie, parse_priors, prior_value
from biaxbayes.options import ModelOptions, SamplingPlan, options_of
from biaxbayes.runs.folder import RUNS
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
    name: str = "study",
    seed: int = SamplingPlan.seed,
    ess: float = SamplingPlan.ess,
    max_steps: int = SamplingPlan.max_steps,
    anyway: bool = False,
) -> Study:
    """A study of specimen files with common options, labelled by their file names."""
    for key, value in {"seed": seed, "ess": ess, "max_steps": max_steps}.items():
        SamplingPlan.check(key, value)
    for path in files:
        _check_file(path, path)
    specimens = tuple(
        StudySpecimen(path, path.stem, dict(options), seed, anyway=anyway) for path in files
    )
    _check_labels(specimens, None)
    return Study(name, specimens, float(ess), int(max_steps))


def read_study(path: Path) -> Study:
    """Read a study file; InputError names the file and the key that cannot be used."""
    table = read_toml(path)
    _check_keys(table, STUDY_KEYS, "a study", path)
    numbers = {key: table.get(key, getattr(SamplingPlan, key)) for key in SAMPLING_KEYS}
    for key, value in numbers.items():
        SamplingPlan.check(key, value, file=path)
    options = _options(table.get("options", {}), DEFAULT_OPTIONS, "options", path)
    common = {
        "seed": numbers["seed"],
        "anyway": _flag(table.get("anyway", False), "anyway", path),
        "options": options,
        "priors": _priors(table.get("priors", {}), options["law"], "priors", path),
        "columns": _columns(table.get("columns", []), path),
    }
    entries = table.get("specimen")
    if not isinstance(entries, list) or not entries:
        raise InputError("lists no specimen", file=path, remedy="add tables [[specimen]]")
    specimens = tuple(_specimen(e, f"specimen {n}", common, path) for n, e in enumerate(entries, 1))
    _check_labels(specimens, path)
    name = _text(table, "name", "", path) or path.stem
    ess, max_steps = float(numbers["ess"]), int(numbers["max_steps"])
    return Study(name, specimens, ess, max_steps, common["columns"])


def _columns(value: object, path: Path) -> tuple[str, ...]:
    """Names of the columns that make groups."""
    given = value if isinstance(value, list) else [None]
    reserved = {*SPECIMEN_KEYS} - {"layer", "donor"}
    for name in given:
        if not isinstance(name, str) or not name.isidentifier() or name in reserved:
            raise InputError(
                f"columns: {str(name)[:60]!r} cannot be a column",
                file=path,
                remedy='write columns = ["disease"], a word that is not a key of a specimen',
            )
    return tuple(dict.fromkeys(given))


def _specimen(entry: object, what: str, common: Mapping[str, Any], path: Path) -> StudySpecimen:
    """One table [[specimen]], with the settings that the study's specimens share."""
    where = f"{what}: "
    if not isinstance(entry, dict):
        raise InputError(f"{where}is not a table", file=path, remedy="write it as [[specimen]]")
    own_columns = [c for c in common["columns"] if c not in TEXT_KEYS]
    _check_keys(entry, (*SPECIMEN_KEYS, *own_columns), what, path)
    file = entry.get("file")
    if not isinstance(file, str) or not file.strip() or "\0" in file:
        raise InputError(f"{where}file must be the path of a CSV", file=path)
    specimen = path.parent / file
    _check_file(specimen, f"{path}, {where}file", path=path)
    pieces = entry.get("pieces", [])
    if not isinstance(pieces, list) or not all(isinstance(p, str) and p.strip() for p in pieces):
        remedy = 'write pieces = ["strip-x.csv", "strip-y.csv"]'
        raise InputError(f"{where}pieces must be a list of paths", file=path, remedy=remedy)
    for piece in pieces:
        _check_file(path.parent / piece, f"{path}, {where}pieces", path=path)
    options = _options(entry.get("options", {}), common["options"], f"{where}options", path)
    priors = _priors(entry.get("priors", {}), options["law"], f"{where}priors", path)
    seed = entry.get("seed", common["seed"])
    SamplingPlan.check("seed", seed, where, path)
    columns = {name: _text(entry, name, where, path) for name in own_columns}
    for name, value in columns.items():
        if value is None:
            raise InputError(
                f"{where}{name} is missing, which columns declares",
                file=path,
                remedy=f'give {name} = "..." for every specimen, or remove it from columns',
            )
    return StudySpecimen(
        specimen,
        _text(entry, "label", where, path) or specimen.stem[:MAX_TEXT_LENGTH],
        options | {"priors": {**common["priors"], **priors}},
        int(seed),
        _text(entry, "donor", where, path),
        _text(entry, "layer", where, path),
        _force(entry.get("mounting_force"), f"{where}mounting_force", path),
        _flag(entry.get("anyway", common["anyway"]), f"{where}anyway", path),
        {name: str(value) for name, value in columns.items()},
        tuple(path.parent / piece for piece in pieces),
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


def _text(table: Mapping[str, object], key: str, where: str, path: Path) -> str | None:
    value = table.get(key)
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip() or len(value) > MAX_TEXT_LENGTH:
        raise InputError(
            f"{where}{key} must be text of at most {MAX_TEXT_LENGTH} characters", file=path
        )
    return one_line(value)


def _options(table: object, common: Mapping[str, Any], where: str, path: Path) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table", file=path)
    _check_keys(table, tuple(DEFAULT_OPTIONS), where, path)
    if "law" in table:  # a file beside that of the study
        table = table | {"law": law_key(table["law"], path.parent)}
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


# --- the specimens as they were read, with the digest of what their runs depend on ----------------


@dataclass(frozen=True)
class LoadedSpecimen:
    """A specimen of the study, or the problem with reading it."""

    listing: StudySpecimen  # as in the study file
    slug: str  # name of the run folder
    specimen: Specimen | None = None
    problem: str = ""
    fingerprint: str = ""  # of everything that the run depends on

    @property
    def folder(self) -> str:
        """Run folder, relative to the study's."""
        return f"{RUNS}/{self.slug}"

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
