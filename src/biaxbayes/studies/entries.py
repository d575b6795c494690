"""The specimens of a study as they were read, with the digest of what their runs depend on."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass

import biaxbayes
from biaxbayes.errors import BiaxbayesError
from biaxbayes.model.priors import prior_value
from biaxbayes.runs.folder import RUNS
from biaxbayes.runs.provenance import specimen_digest
from biaxbayes.specimens.check import with_force
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import read_specimen
from biaxbayes.studies.study_file import Study, StudySpecimen


@dataclass(frozen=True)
class Entry:
    """A specimen of the study, or the problem that kept it from being read."""

    entry: StudySpecimen
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
        return self.entry.donor or str(in_header)

    @property
    def layer(self) -> str:
        """Layer, likewise."""
        return self.entry.layer or (self.specimen.layer if self.specimen else None) or ""


def read_entries(study: Study) -> list[Entry]:
    """Read the specimens; one that cannot be read stays in the list with its error."""
    out = []
    slugs: set[str] = set()
    for entry in study.specimens:
        slug = stem = _slug(entry.label)
        number = 1
        while slug.casefold() in slugs:
            number += 1
            slug = f"{stem}-{number}"
        slugs.add(slug.casefold())
        try:
            specimen = read_specimen(entry.file)
            if entry.mounting_force is not None:
                specimen = with_force(specimen, entry.mounting_force, entry.file)
        except BiaxbayesError as error:
            out.append(Entry(entry, slug, problem=str(error)))
            continue
        out.append(Entry(entry, slug, specimen, "", _fingerprint(study, entry, specimen)))
    return out


def _slug(label: str) -> str:
    """A folder name that every file system accepts."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", label).strip(".-")[:60] or "specimen"


def _fingerprint(study: Study, entry: StudySpecimen, specimen: Specimen) -> str:
    """Digest of everything that the run of a specimen depends on."""
    options = dict(entry.options)
    options["priors"] = {k: prior_value(v) for k, v in dict(options.get("priors", {})).items()}
    content = {
        "specimen": specimen_digest(specimen),
        "options": options,
        "seed": entry.seed,
        "ess": study.ess,
        "max_steps": study.max_steps,
        "biaxbayes": biaxbayes.__version__,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()
