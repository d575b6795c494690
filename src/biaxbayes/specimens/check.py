"""Everything that is noticed about a specimen, as data."""

from __future__ import annotations

from biaxbayes.specimens.finding import Finding
from biaxbayes.specimens.mounting_findings import mounting_findings
from biaxbayes.specimens.path_findings import path_findings
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.unit_findings import unit_findings

__all__ = ["Finding", "check_specimen"]


def check_specimen(specimen: Specimen) -> tuple[Finding, ...]:
    """What a user should know of a specimen before trusting a fit of it.

    Parameters
    ----------
    specimen : Specimen

    Returns
    -------
    tuple of Finding
        Warnings first, each group in the order: mounted state, paths, units, origin.
    """
    found = [
        *mounting_findings(specimen),
        *path_findings(specimen),
        *unit_findings(specimen),
        *_origin(specimen),
    ]
    return tuple(sorted(found, key=lambda finding: finding.severity != "warning"))


def _origin(specimen: Specimen) -> list[Finding]:
    found = []
    shear = specimen.metadata.get("largest_shear")
    if shear is not None:
        angle = specimen.metadata.get("largest_shear_angle_deg")
        turned = "" if angle is None else f"; the right angle changes by up to {angle:.2g} degrees"
        found.append(
            Finding(
                "shear",
                "warning" if float(shear) > 0.02 else "note",
                f"the record holds shear: |F12|, |F21| up to {float(shear):.2g}{turned}. "
                "The model has none and ignores it",
            )
        )
    cycle, branch = specimen.metadata.get("cycle"), specimen.metadata.get("branch")
    if cycle is not None:
        found.append(Finding("cycle", "note", f"converted from cycle {cycle}"))
    if branch is not None:
        loading = set(str(branch).replace(",", " ").split()) == {"loading"}
        found.append(
            Finding(
                "branch",
                "note" if loading else "warning",
                f"converted from the {branch} branch"
                + ("" if loading else ": parameters of unloading are not those of loading"),
            )
        )
    return found
