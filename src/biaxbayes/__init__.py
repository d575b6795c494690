"""Bayesian material parameters and mounting stretches from planar biaxial tests of soft tissue.

The names below are imported on first use, so that ``import biaxbayes`` stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_EXPORTS = {
    "GOH": "biaxbayes.laws.goh",
    "law": "biaxbayes.laws",
    "dispersion_as_goh": "biaxbayes.laws.dispersed_fibres",
    "Specimen": "biaxbayes.specimens.specimen",
    "Protocol": "biaxbayes.specimens.protocol",
    "read_specimen": "biaxbayes.specimens.specimen_file",
    "write_specimen": "biaxbayes.specimens.specimen_file",
    "check_specimen": "biaxbayes.specimens.check",
    "check": "biaxbayes.verbs.check",
    "convert": "biaxbayes.verbs.convert",
    "simulate": "biaxbayes.verbs.simulate",
    "Choice": "biaxbayes.machines.choice",
    "virtual_specimen": "biaxbayes.specimens.virtual_specimen",
    "Dimensions": "biaxbayes.specimens.virtual_specimen",
    "Machine": "biaxbayes.specimens.virtual_specimen",
    "fit": "biaxbayes.verbs.fit",
    "fit_all": "biaxbayes.verbs.fit",
    "Posterior": "biaxbayes.model.posterior",
    "prepare": "biaxbayes.model.preparation",
    "sample": "biaxbayes.verbs.sample",
    "open_run": "biaxbayes.runs.run",
    "identify": "biaxbayes.verbs.identify",
    "profile": "biaxbayes.verbs.profile",
    "compare": "biaxbayes.verbs.compare",
    "compare_laws": "biaxbayes.verbs.laws",
    "design": "biaxbayes.verbs.design",
    "calibrate": "biaxbayes.verbs.calibrate",
    "predict": "biaxbayes.verbs.predict",
    "inflate": "biaxbayes.verbs.predict",
    "plot": "biaxbayes.verbs.plot",
    "report": "biaxbayes.verbs.report",
    "export": "biaxbayes.verbs.export",
    "batch": "biaxbayes.verbs.batch",
    "population": "biaxbayes.verbs.population",
}

_OTHER_NAMES = {"law": "material"}
"""Names in the module, where they differ."""

__all__ = ["__version__", *_EXPORTS]


__version__: str


def __getattr__(name: str) -> Any:
    value: Any
    if name == "__version__":
        from importlib import metadata

        try:
            value = metadata.version("biaxbayes")
        except metadata.PackageNotFoundError:  # a source tree that was never installed
            value = "0+unknown"
    elif name in _EXPORTS:
        value = getattr(import_module(_EXPORTS[name]), _OTHER_NAMES.get(name, name))
    else:
        raise AttributeError(f"module 'biaxbayes' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
