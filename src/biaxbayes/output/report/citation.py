"""What to cite for a run."""

from __future__ import annotations

from biaxbayes.output.report.names import cut
from biaxbayes.output.run import Run

__all__ = ["citations"]

METHOD = (
    "Improved Mechanical Characterization of Soft Tissues Including Mounting Stretches. "
    "Mathematical and Computational Applications 29(4), 55, 2024.",
    "10.3390/mca29040055",
)
MODEL = (
    "Gasser, Ogden, Holzapfel. Hyperelastic modelling of arterial layers with distributed collagen "
    "fibre orientations. Journal of the Royal Society Interface 3, 15-35, 2006.",
    "10.1098/rsif.2005.0073",
)
SAMPLER = (
    "Foreman-Mackey, Hogg, Lang, Goodman. emcee: The MCMC Hammer. Publications of the Astronomical "
    "Society of the Pacific 125, 306-312, 2013.",
    "10.1086/670067",
)


def citations(run: Run) -> list[tuple[str, str]]:
    """References with their DOI (empty where there is none)."""
    version = cut(run.provenance.get("biaxbayes", ""), 30)
    software = (
        f"The biaxbayes developers. biaxbayes: Bayesian GOH parameters and mounting stretches from "
        f"planar biaxial tests, version {version}."
    )
    return [(software, ""), METHOD, MODEL, SAMPLER]
