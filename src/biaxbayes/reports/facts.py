"""What is said of a run beside its tables: facts on its page, other fits, one screen at its end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pandas as pd

from biaxbayes.errors import InputError, printable
from biaxbayes.identifiability.held_edges import EDGES, HeldEdge, held_from
from biaxbayes.identifiability.mounting_stretch.law_range import LAW_FITS
from biaxbayes.identifiability.mounting_stretch.stated import cure
from biaxbayes.options import INFERRING, Settings
from biaxbayes.parameters import STRETCH, Quantity, mounting_names
from biaxbayes.prediction.predictive_checks import path_warnings, predictive_checks
from biaxbayes.reports.parameters import prior_in_words, unit_of
from biaxbayes.reports.words import cut
from biaxbayes.runs.provenance import parse_options
from biaxbayes.runs.run import Run
from biaxbayes.specimens.findings import Finding
from biaxbayes.text_files import read_csv

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


# --- what stands beside the posterior: other laws, and edges of the range as hypotheses ----------


def kept_edges(run: Run) -> tuple[HeldEdge, ...]:
    """The edges that a run was drawn with held, from its ``edges.csv``; none without it."""
    try:
        return held_from(read_csv(run.path / EDGES), run.quantities)
    except (OSError, InputError, KeyError, ValueError):
        return ()


@dataclass(frozen=True)
class HeldRow:
    """A parameter with another one held at an end of its range, as text.

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


def held_rows(run: Run) -> list[HeldRow]:
    """The law's parameters and the mounting stretches under every hypothesis of an edge."""
    out = []
    for held in kept_edges(run):
        for name, (low, _, high) in held.intervals.items():
            quantity = run.quantities[name]
            p = quantity.parameter
            if name in run.law.names or p.kind == STRETCH:
                interval = f"{p.number(low)} to {p.number(high)}"
                out.append(
                    HeldRow(held.condition, quantity, interval, p.unit_symbol(quantity.load_unit))
                )
    return out


def law_rows(run: Run) -> list[dict[str, Any]]:
    """Least squares of every law under the same mounting constraint, from ``law-fits.csv``."""
    try:
        table = read_csv(run.path / LAW_FITS)
        names = [q.name for q in run.quantities.of_kind(STRETCH) if q.name in table]
        return [
            {
                "law": cut(row["law"], 30),
                "rms": f"{float(row['rms']):.3g}",
                "alike": "yes" if row["alike"] else "no",
                "mounting": [
                    f"{run.quantities[n].parameter.number(float(row[n]))} ± "
                    f"{float(row[f'{n}_sd']):.2g}"
                    for n in names
                ],
            }
            for row in table.to_dict("records")
        ]
    except (OSError, InputError, KeyError, ValueError, TypeError):
        return []


def not_inferred(run: Run) -> str:
    """What a run says that takes the mounted state as unloaded; empty of others."""
    mounting = run.provenance["settings"]["mounting"]
    if mounting in INFERRING:
        return ""
    return (
        f"the mounting stretch was not inferred (mounting {mounting}): the parameters carry its "
        "error"
    )


def mounting_cure(run: Run) -> str:
    """What to do about mounting stretches that are not stated as values; empty where all are."""
    axes = {run.quantities[n].axis for n, stated in run.stated.items() if not stated.is_value}
    names = mounting_names("stretch")
    return cure([names[axis] for axis in (0, 1) if axis in axes]) if axes else ""


# --- the closing message of a run: one screen that says what to trust ----------------------------


def closing_message(run: Run) -> str:
    """What a run found, as plain text of at most one screen."""
    record = run.provenance
    name = (
        record["specimen"]
        if not record.get("layer")
        else (f"{record['specimen']} ({record['layer']})")
    )
    lines = [f"{printable(name)}: {_verdict(record)}", *_found(run), ""]
    lines += _summary_lines(run)
    lines += ["", _readings(record)]
    lines += _thinning(record)
    lines += _identifiability(run)
    lines += _held(run)
    lines += [text for text in [not_inferred(run)] if text]
    lines += _stated(run)
    lines += _misses(run)
    lines += [printable(f"note: {note}") for note in record["notes"][:3]]
    if record["sampler"]["message"]:
        lines.append(f"note: {record['sampler']['message']}")
    lines += ["", f"open {run.path}/report.html; tables, figures and draws are beside it"]
    return "\n".join(lines)


def _found(run: Run) -> list[str]:
    """What was odd about the record before it was sampled."""
    return [printable(text) for text in record_findings(run)]


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


def _summary_lines(run: Run) -> list[str]:
    lines = [f"{'parameter':<26}{'unit':<6}{'median':>10}{'5 %':>10}{'95 %':>10}"]
    refits = _refits(run)
    for row in run.summary.itertuples():
        name = str(row.parameter)
        ends = refits.get(name, (row.q05, row.q95))
        cells = "".join(f"{_number(float(str(v))):>10}" for v in (row.q50, *ends))
        cells += "  not identified: range of refits" if name in refits else ""
        lines.append(f"{printable(str(row.parameter))[:25]:<26}{row.unit:<6}{cells}")
    if len(lines) > 24:
        hidden = len(lines) - 22
        lines = [*lines[:22], f"... and {hidden} more rows in summary.csv"]
    return lines


def _refits(run: Run) -> dict[str, tuple[float, float]]:
    """Ranges that stand in place of an interval which the data contradict."""
    table = _verdicts(run)
    if table is None or "refit_low" not in table:
        return {}
    lost = table[table["verdict"] == "not identified"]
    return {
        str(r.parameter): (float(str(r.refit_low)), float(str(r.refit_high)))
        for r in lost.itertuples()
    }


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _readings(record: dict[str, Any]) -> str:
    noise = record["noise"]
    if noise["effective_readings"] is None:
        return (
            f"{noise['readings']} readings taken as independent; if the model misses smoothly, "
            "the intervals are too narrow (--noise effective)"
        )
    return (
        f"your {noise['readings']} readings carry as much information as "
        f"{noise['effective_readings']:.0f} independent ones"
    )


def _thinning(record: dict[str, Any]) -> list[str]:
    noise = record["noise"]
    rows, used = noise.get("rows"), noise.get("rows_used")
    if not rows or not used or used >= rows:
        return []
    return [
        f"{rows:,} rows were averaged to {used:,} along the path; the answer does not "
        "depend on it (--thin none)"
    ]


def _identifiability(run: Run) -> list[str]:
    table = _verdicts(run)
    if table is None:
        return []
    loose = [f"{r.parameter}: {r.verdict}" for r in table.itertuples() if r.verdict != "identified"]
    if not loose:
        return ["every parameter is identified"]
    said = ["not determined on its own: " + "; ".join(printable(t) for t in loose)]
    if _refits(run):
        said.append(
            "the mounting stretch rests on the toe of the model, which these data contradict; "
            "nominal stresses at measured stretches (report.html) do not"
        )
    return said


def _stated(run: Run) -> list[str]:
    """What is stated of the mounting stretch of the tissue, and a law that fits better."""
    lines = []
    for name, stated in run.stated.items():
        said = stated.in_words(run.quantities[name].parameter)
        lines.append(printable(f"{name} of the tissue: {said}; {stated.reason}"))
    cure = mounting_cure(run)
    lines += [printable(cure)] if cure else []
    better = run.provenance.get("identifiability", {}).get("better_law", "")
    return [*lines, *([printable(better)] if better else [])]


def _held(run: Run) -> list[str]:
    """What holds with a parameter at an end of its range that the data do not exclude."""
    return [printable(held.summary(run.law.names, run.quantities)) for held in kept_edges(run)]


def _verdicts(run: Run) -> pd.DataFrame | None:
    path = run.path / "identifiability.csv"
    if not path.is_file():
        return None
    return read_csv(path)


def _misses(run: Run) -> list[str]:
    """Paths that the model must not be used for, two at most."""
    said = missed_paths(run)
    more = [f"... and {len(said) - 2} more protocols (report.html)"] if len(said) > 2 else []
    return [printable(text) for text in said[:2]] + more
