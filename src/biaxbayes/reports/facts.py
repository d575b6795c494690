"""What is said of a run beside its tables: facts on its page, evidence, one screen at its end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from biaxbayes.errors import printable
from biaxbayes.identifiability.reported import interval_text, row_lines
from biaxbayes.parameters import MATERIAL, STRETCH, Quantity
from biaxbayes.reports.parameters import prior_in_words, unit_of
from biaxbayes.reports.words import cut
from biaxbayes.runs.run import Run

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
                "mounting": f"{fx:.3g}, {fy:.3g}" if p.rest_rows else "that of the others",
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


# --- evidence: what the reported table rests on ---------------------------------------------------


@dataclass(frozen=True)
class FixedRow:
    """A parameter of a posterior in which another one is fixed at an end of its range, as text.

    Attributes
    ----------
    condition : str
    quantity : Quantity
    interval, unit : str
    """

    condition: str
    quantity: Quantity
    interval: str
    unit: str


def fixed_rows(run: Run) -> list[FixedRow]:
    """The law's parameters and the mounting stretches under every assumption of an end."""
    out = []
    for row in run.result.fixed_ends.to_dict("records"):
        quantity = run.quantities[str(row["parameter"])]
        p = quantity.parameter
        if p.kind not in (MATERIAL, STRETCH):
            continue
        meaning = f" ({row['meaning']})" if isinstance(row["meaning"], str) else ""
        condition = cut(f"{row['fixed']} = {row['at']:g}{meaning}")
        interval = interval_text(float(row["low_90"]), float(row["high_90"]), p)
        out.append(FixedRow(condition, quantity, interval, p.unit_symbol(quantity.load_unit)))
    return out


def law_rows(run: Run) -> list[dict[str, Any]]:
    """Least squares of every law under the same mounting constraint."""
    table = run.result.law_fits
    names = [q.name for q in run.quantities.of_kind(STRETCH) if q.name in table]
    return [
        {
            "law": cut(row["law"], 30),
            "rms": f"{float(row['rms']):.3g}",
            "fits": "yes" if row["fits"] else "no",
            "mounting": [
                f"{run.quantities[n].parameter.number(float(row[n]))} ± {float(row[f'{n}_sd']):.2g}"
                for n in names
            ],
        }
        for row in table.to_dict("records")
    ]


def narrowing_rows(run: Run) -> list[dict[str, Any]]:
    """How much the data narrow each parameter, and what it trades with."""
    out = []
    for row in run.result.identifiability.to_dict("records"):
        contraction = float(row.get("contraction", math.nan))
        if math.isnan(contraction):
            continue
        ends = [row.get(f"refit_{side}", math.nan) for side in ("low", "high")]
        quantity = run.quantities[str(row["parameter"])]
        refits = interval_text(float(ends[0]), float(ends[1]), quantity.parameter)
        partners = row["partners"] if isinstance(row["partners"], str) else ""
        share = 100.0 * max(contraction, 0.0)
        out.append(
            {
                "quantity": quantity,
                "contraction": f"{min(share, 99.9):.3g} %",
                "partners": cut(", ".join(partners.split())) if partners else "none",
                "left": f"{100.0 * float(row['spread_given_partners']):.0f} %",
                "prior": f"{float(row['prior_sensitivity']):.2f}",
                "data": f"{float(row['likelihood_sensitivity']):.2f}",
                "refits": refits,
            }
        )
    return out


# --- the closing message of a run: one screen that says what to trust ----------------------------


MOST_LINES = 12
"""Of the closing message."""


def closing_message(run: Run) -> str:
    """What a run found, as plain text of at most twelve lines."""
    record, result = run.provenance, run.result
    name = (
        record["specimen"]
        if not record.get("layer")
        else (f"{record['specimen']} ({record['layer']})")
    )
    lines = [f"{printable(cut(name, 80))}: {_verdict(record)}"]
    serious = [f for f in record.get("findings") or [] if f["severity"] == "error"]
    lines += [printable(cut(f["message"], 400)) for f in serious[:1]]
    rest = [printable(text) for text in (result.fit, result.advice) if text]
    rest += [printable(text) for text in result.warnings[:1]]
    rest.append(f"report: {run.path}/report.html")
    lines += row_lines(result.rows, MOST_LINES - len(lines) - len(rest))
    return "\n".join([*lines, *rest])


def _verdict(record: dict[str, Any]) -> str:
    convergence = record["convergence"]
    if convergence["state"] == "converged":
        return (
            f"converged (R-hat {convergence['worst_rhat']:.4f}, at least "
            f"{convergence['worst_ess']:.0f} effective draws of every quantity)"
        )
    if convergence["state"] == "tentative":
        return f"TENTATIVE, not converged: {convergence['reason']}"
    return f"NOT USABLE, not converged: {convergence['reason']}"
