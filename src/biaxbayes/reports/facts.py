"""What the page says beside its tables: specimen, test, convergence, settings, citations."""

from __future__ import annotations

from typing import Any

import pandas as pd

from biaxbayes.options import Settings
from biaxbayes.prediction.predictive_checks import path_warnings, predictive_checks
from biaxbayes.reports.methods import prior_in_words, unit_of
from biaxbayes.reports.names import cut
from biaxbayes.runs.provenance import parse_options
from biaxbayes.runs.run import Run
from biaxbayes.specimens.findings import Finding

__all__ = [
    "citations",
    "missed_paths",
    "model_checks",
    "record_findings",
    "settings_facts",
    "specimen_facts",
    "state_words",
    "test_rows",
    "version_facts",
]


# --- the posterior predictive checks of a run, for everything that is written about it -----------


NAME_LENGTH = 60


def model_checks(run: Run) -> pd.DataFrame:
    """Checks of every curve, as by :func:`biaxbayes.prediction.predictive_checks`.

    Parameters
    ----------
    run : Run
        Of a state that has a posterior.
    """
    settings = Settings(**parse_options(run.provenance["settings"]))
    table = predictive_checks(run.specimen, run.draws, settings=settings)
    return table.assign(protocol=[cut(name, NAME_LENGTH) for name in table["protocol"]])


def missed_paths(run: Run) -> list[str]:
    """A sentence for each protocol that the parameters must not be used for; none where unusable.

    Parameters
    ----------
    run : Run
    """
    if run.state == "unusable":
        return []
    return path_warnings(model_checks(run), run.specimen.unit, run.law.name)


MOST_FINDINGS = 8


def record_findings(run: Run) -> list[str]:
    """What was odd about the record of the test before it was sampled, a sentence each.

    Parameters
    ----------
    run : Run
    """
    found, told = run.provenance.get("findings"), []
    for finding in found if isinstance(found, list) else []:
        try:
            told.append(cut(str(Finding(**finding)), 400))
        except TypeError:
            continue  # a stranger's file
    return told[:MOST_FINDINGS]


# --- what to cite for a run ----------------------------------------------------------------------


METHOD = (
    "Improved Mechanical Characterization of Soft Tissues Including Mounting Stretches. "
    "Mathematical and Computational Applications 29(4), 55, 2024.",
    "10.3390/mca29040055",
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
        "The biaxbayes developers. biaxbayes: Bayesian material parameters and mounting stretches "
        f"from planar biaxial tests, version {version}."
    )
    return [(software, ""), METHOD, (f"{run.law.source}.", run.law.doi), SAMPLER]


# --- what the page says beside its tables: specimen, test, convergence, settings, versions -------


MEASURED = {
    "force": "forces (N)",
    "piola": "first Piola-Kirchhoff stress (kPa)",
    "cauchy": "Cauchy stress (kPa)",
}
STATES = {
    "converged": "Converged chains: the ensembles agree and hold enough independent draws.",
    "tentative": "Tentative: not converged. Do not publish these numbers; sample longer.",
    "unusable": "Not usable: the ensembles disagree, so the draws say nothing.",
}


def state_words(run: Run) -> tuple[str, str]:
    """What to trust, and why not."""
    return STATES[run.state], cut(run.provenance["convergence"]["reason"], 400)


def specimen_facts(run: Run) -> list[tuple[str, str]]:
    """Specimen and test at a glance, as pairs."""
    s, record = run.specimen, run.provenance
    facts = [("Specimen", cut(s.name))]
    if s.layer:
        facts.append(("Layer", cut(s.layer)))
    axes = [f"{a}: {cut(n, 60)}" for a, n in (("x", s.axis_x), ("y", s.axis_y)) if n]
    if axes:
        facts.append(("Axes", ", ".join(axes)))
    if s.edge_x_mm and s.edge_y_mm and s.thickness_mm:
        size = f"{s.edge_x_mm:g} × {s.edge_y_mm:g} mm, {s.thickness_mm:g} mm thick"
        facts.append(("Dimensions", f"{size}, {s.geometry}"))
    else:
        facts.append(("Reference of the stresses", f"{s.geometry} dimensions"))
    facts.append(("Measured", MEASURED[s.stress_pair]))
    if s.noise_sd > 0.0:
        whose = "stated" if s.load_noise is not None else "estimated from the record"
        facts.append(("Noise of one load reading", f"{s.noise_sd:.3g} {s.unit} ({whose})"))
    facts.append(("File", cut(record.get("source", ""))))
    return facts


def test_rows(run: Run) -> list[dict[str, str]]:
    """One row a protocol: what was reached."""
    s = run.specimen
    out = []
    for p in s.protocols:
        fx, fy = s.mounting_reading(p)
        load = abs(s.load(p)).max(axis=0)
        out.append(
            {
                "name": cut(p.name, 60),
                "rows": f"{p.rows:,}",
                "stretch_x": f"{p.stretch_x.max():.3f}",
                "stretch_y": f"{p.stretch_y.max():.3f}",
                "load_x": f"{load[0]:.3g}",
                "load_y": f"{load[1]:.3g}",
                "mounting": f"{fx:.3g}, {fy:.3g}",
            }
        )
    return out


def settings_facts(run: Run) -> list[tuple[str, str]]:
    """Settings of the model and the priors, as pairs."""
    record = run.provenance
    settings = record["settings"]
    facts = [
        ("Material law", run.law.title),
        ("Mounting force", cut(settings.get("mounting", ""), 30)),
        ("Mounted states", cut(settings.get("mounting_stretch", ""), 30)),
        ("Errors", cut(settings.get("noise", ""), 30)),
        ("Errors grow with the load", _yes(settings.get("noise_growth"))),
        ("Fibres in extension only", _yes(settings.get("fibre_switch"))),
    ]
    if settings.get("thin"):
        facts.append(("Longer protocols averaged to", f"{settings['thin']} rows"))
    priors = record.get("priors")
    if isinstance(priors, dict):
        facts += [
            (f"Prior of {cut(k, 40)}", prior_in_words(v, unit_of(run, k)))
            for k, v in priors.items()
        ]
    return facts


def version_facts(run: Run) -> list[tuple[str, str]]:
    """Seed, hash and versions, as pairs; no times, so that the same run writes the same page."""
    record = run.provenance
    facts = [
        ("biaxbayes", cut(record.get("biaxbayes", ""), 30)),
        ("Seed", str(record["seed"])),
        ("SHA-256 of the specimen", cut(record.get("specimen_sha256", ""), 64)),
    ]
    facts += [(cut(k, 30), cut(v, 30)) for k, v in _table(record, "versions").items()]
    return facts


def _table(record: dict[str, Any], key: str) -> dict[str, Any]:
    value = record.get(key)
    return value if isinstance(value, dict) else {}


def _yes(value: object) -> str:
    return "yes" if value is True else "no"
