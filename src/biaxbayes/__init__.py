"""Bayesian GOH parameters and mounting stretches from planar biaxial tests of soft tissue.

The names below are imported on first use, so that ``import biaxbayes`` stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

try:
    __version__ = version("biaxbayes")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"

_OF_RUNS, _OF_STUDIES = "biaxbayes.verbs.of_runs", "biaxbayes.verbs.of_studies"
_EXPORTS = {
    "GOH": "biaxbayes.mechanics.goh",
    "Specimen": "biaxbayes.specimens.specimen",
    "Protocol": "biaxbayes.specimens.specimen",
    "read_specimen": "biaxbayes.specimens.specimen_file",
    "write_specimen": "biaxbayes.specimens.specimen_file",
    "check_specimen": "biaxbayes.specimens.check",
    "convert": "biaxbayes.specimens.machines",
    "virtual_specimen": "biaxbayes.specimens.virtual_specimen",
    "fit": "biaxbayes.inference.fit",
    "Posterior": "biaxbayes.inference.posterior",
    "sample": "biaxbayes.output.run",
    "open_run": "biaxbayes.output.run",
    "identify": _OF_RUNS,
    "profile": _OF_RUNS,
    "compare": _OF_RUNS,
    "ledger": _OF_RUNS,
    "design": _OF_RUNS,
    "calibrate": _OF_STUDIES,
    "predict": _OF_RUNS,
    "inflate": _OF_RUNS,
    "plot": _OF_RUNS,
    "report": _OF_RUNS,
    "export": _OF_RUNS,
    "batch": _OF_STUDIES,
}

__all__ = ["__version__", *_EXPORTS]


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module 'biaxbayes' has no attribute {name!r}")
    value = getattr(import_module(_EXPORTS[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
