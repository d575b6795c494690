"""Text of a run: paragraphs of methods and results, LaTeX table, and its closing message."""

from __future__ import annotations

from biaxbayes.errors import listed, printable
from biaxbayes.identifiability.reported import row_lines
from biaxbayes.identifiability.verdict import BOUNDED, COMBINATION, IDENTIFIED, NOT_IDENTIFIED
from biaxbayes.mechanics.experiments import Tube
from biaxbayes.model.priors import prior_text
from biaxbayes.reports.text import CONVERGENCE_TEXTS, as_latex, latex_tabular, latex_text, truncate
from biaxbayes.runs.run import Run

LOAD_PHRASES = {
    "force": "the forces",
    "piola": "the first Piola-Kirchhoff stresses",
    "cauchy": "the nominal stresses (Cauchy stress over measured stretch)",
    "tube": "pressure and axial force",
}
TEST_PHRASES = {
    "biaxial": "tested planar-biaxially",
    "strip x": "a strip pulled along x with free sides",
    "strip y": "a strip pulled along y with free sides",
    "tube": "a pressurised tube",
}
MOUNTING_SENTENCES = {
    "noisy": (
        "For every draw the mounting stretches were the root of the balance between the model and "
        "the load at the mounted state, whose reading has the load cell's own error; the density "
        "was transformed with the determinant of that balance."
    ),
    "exact": (
        "For every draw the mounting stretches were the root of the balance between the model and "
        "the load read at the mounted state, taken as exact; the density was transformed with the "
        "determinant of that balance."
    ),
    "free": (
        "The mounting stretches were sampled directly, with the load read at the mounted state "
        "as a further datum."
    ),
    "ignored": "The mounting stretch was ignored: the mounted state was taken as unloaded.",
    "zeroed": (
        "The mounting stretch was ignored: the loads were zeroed at the mounted state, and that "
        "state was taken as unloaded."
    ),
}


def methods(run: Run) -> str:
    """The methods section as one paragraph of plain text, without results."""
    priors = "; ".join(f"{name} {words}" for name, words in prior_texts(run).items())
    sentences = (
        _test(run),
        _further_pieces(run),
        _grips(run),
        f"It was described by {run.law.in_words}.",
        "Measured stretches refer to the mounted state; the total stretch is the measured one "
        f"times the mounting stretch. {MOUNTING_SENTENCES[run.settings.mounting]}"
        if any(p.experiment.is_mounted for p in run.specimen.pieces)
        else "",
        _noise(run),
        f"Priors: {priors}." if priors else "",
        _sampling(run),
        "Reported are posterior medians with 90 % intervals, or 95 % bounds."
        if run.state == "converged" and run.result.rows
        else "",
    )
    return " ".join(s for s in sentences if s)


def _test(run: Run) -> str:
    s = run.specimen
    size = ""
    if s.edge_x_mm and s.edge_y_mm and s.thickness_mm:
        size = (
            f" of {s.edge_x_mm:g} mm by {s.edge_y_mm:g} mm and {s.thickness_mm:g} mm thickness "
            f"({s.geometry} dimensions)"
        )
    count, rows = len(s.protocols), sum(p.rows for p in s.protocols)
    paths = "one loading path" if count == 1 else f"{count} loading paths"
    thin = run.provenance["settings"].get("thin")
    averaged = f" Longer protocols were averaged to {thin} rows." if thin else ""
    tube = s.experiment
    if isinstance(tube, Tube):
        sector = f", missing sector {tube.missing_sector_deg:g} degrees"
        stress_free = sector if tube.missing_sector_deg else "; no residual stress"
        read = "pressure and axial force were" if tube.reads_force else "the pressure was"
        return (
            f"A tube (unloaded outer diameter {2.0 * tube.outer_radius_mm:g} mm, wall "
            f"{tube.thickness_mm:g} mm{stress_free}) was pressurised on {paths} ({rows:,} rows): "
            f"at measured outer diameters and axial stretches {read} read. Stresses were "
            f"integrated through the thick wall.{averaged}"
        )
    return f"A specimen{size} was {TEST_PHRASES[s.test]} on {paths} ({rows:,} rows).{averaged}"


def _further_pieces(run: Run) -> str:
    """Sentences on the other pieces of the tissue, or empty."""
    if not run.specimen.further:
        return ""
    pieces = [
        f"{truncate(piece.name, 60)} ({TEST_PHRASES[piece.test]}, "
        f"{sum(p.rows for p in piece.protocols):,} rows)"
        for piece in run.specimen.further
    ]
    return (
        f"Further pieces of the same tissue were {listed(pieces)}. Each piece had its own mounted "
        "state, misfit and noise, and, beside the first, a stiffness of its own, log-normal about "
        f"that of the first with a standard deviation of {100 * run.settings.piece_sd:g} %."
    )


def _grips(run: Run) -> str:
    """Sentence on the correction of the loads for the grips, or empty."""
    record = run.provenance.get("grips")
    if not isinstance(record, dict):
        if not run.specimen.experiment.is_mounted:
            return ""
        if "grips" in run.specimen.metadata:
            return ""
        return "Loads were taken as those of a uniform test, whatever the grips."
    words = truncate(record.get("in_words", ""), 300)
    text = (
        f"{words[:1].upper()}{words[1:]}: the force of a finite-element sheet at the least-squares "
        "fit over that of a uniform test; fit and finite elements were repeated until the ratio "
        "settled (Fehervary et al., 2016)."
    )
    mesh, sd_log_ratio = record.get("mesh_difference"), record.get("largest_sd_of_log_ratio")
    if isinstance(mesh, float) and isinstance(sd_log_ratio, float):
        text += (
            f" The ratio differs by {100 * mesh:.2g} % between two meshes, and its standard "
            f"deviation over the posterior is at most {100 * sd_log_ratio:.2g} %."
        )
    return text


def _noise(run: Run) -> str:
    noise, settings = run.provenance["noise"], run.settings
    loads = LOAD_PHRASES[run.specimen.stress_pair]
    mounted = run.specimen.experiment.is_mounted
    mounting = ", the mounting readings among them," if mounted else ""
    if not settings.has_misfit:
        return (
            f"Errors of {loads} were independent and Gaussian with an inferred standard deviation "
            f"({noise['readings']:,} readings)."
        )
    return (
        f"Readings of {loads}{mounting} were the sum of the law, a smooth "
        "misfit of the law and the load cell's noise. The misfit was a Gaussian process relative "
        "to the load; the likelihood is the average over its structure (functions of the loading "
        "path, of length 0.15 to 1.5 of it, independent or correlated in x and y, and with "
        "several protocols functions of both stretches), its amplitude (half-normal, standard "
        f"deviation 5 %) and a factor of the noise; the law errs by {100 * settings.toe:g} % "
        f"(standard deviation) near the mounted state. The {noise['readings']:,} readings were "
        f"averaged to {noise['readings_compared']:,} for it."
    )


def prior_texts(run: Run) -> dict[str, str]:
    """Priors of a run as text, by the names of their quantities."""
    priors = run.provenance.get("priors")
    words = {}
    for name, prior in priors.items() if isinstance(priors, dict) else ():
        known = run.quantities.get(name)
        words[truncate(name, 40)] = truncate(prior_text(prior, "" if known is None else known.unit))
    return words


def _sampling(run: Run) -> str:
    record = run.provenance
    sampler, convergence = record["sampler"], record["convergence"]
    emcee = record.get("versions", {}).get("emcee", "")
    version = truncate(record.get("biaxbayes", ""), 30)
    text = (
        f"The joint posterior was sampled with biaxbayes {version} (emcee {truncate(emcee, 30)}) "
        f"in {sampler.get('ensembles', 4)} independent ensembles of "
        f"{sampler.get('walkers', 0)} walkers for {sampler.get('steps', 0):,} steps after an "
        f"adaptive warm-up (seed {record['seed']})"
    )
    if run.state == "converged" and convergence.get("worst_rhat"):
        return (
            f"{text}; the largest split R-hat across ensembles was "
            f"{convergence['worst_rhat']:.4f}, the smallest effective sample size "
            f"{convergence['worst_ess']:,.0f}."
        )
    return f"{text}. The chains did NOT converge: {truncate(convergence['reason'], 300)}."


def results_paragraph(run: Run) -> str:
    """The reported table as a paragraph of plain text, with no other interval."""
    if run.state != "converged":
        return "" if not run.result.rows else "The chains have not converged: no result to report."
    sentences = []
    for row in run.result.rows:
        name = f"{row.name} ({row.quantity.parameter.words})"
        if row.verdict == IDENTIFIED:
            sentences.append(
                f"{name} was identified: {row.median} ({row.interval_with_unit}, 90 % interval)."
            )
        elif row.verdict == BOUNDED:
            sentences.append(f"{name} was bounded: {row.interval_with_unit} (95 % bound).")
        elif row.verdict == COMBINATION:
            sentences.append(
                f"{name} was identified {row.verdict} with {listed(row.partners)}: "
                f"{row.median} ({row.interval_with_unit}, 90 % interval)."
            )
    left = [row.name for row in run.result.rows if row.verdict == NOT_IDENTIFIED]
    if left:
        sentences.append(f"The test did not identify {listed(left)}.")
    sentences += [f"{text[:1].upper()}{text[1:]}." for text in run.result.pieces]
    fit = run.result.fit
    return " ".join([*sentences, f"{fit[:1].upper()}{fit[1:]}." if fit else ""]).strip()


def latex_table(run: Run) -> str:
    """The reported table with booktabs rules; both paragraphs as comments."""
    name = latex_text(run.specimen.name)
    caption = f"{name}: medians with 90\\,\\% intervals, or 95\\,\\% bounds."
    if run.state != "converged":
        caption += f" {latex_text(CONVERGENCE_TEXTS[run.state])}"
    rows = []
    for row in run.result.rows:
        texts = (row.median, row.interval, row.unit, row.verdict, row.reason)
        rows.append([as_latex(row.quantity), *(latex_text(t, 300) for t in texts)])
    heads = ("Parameter", "Median", "Interval", "Unit", "Verdict", "Reason")
    footnotes = [
        f"  \\par\\smallskip\\footnotesize {latex_text(t, 500)}" for t in run.result.warnings
    ]
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            f"% Methods: {methods(run)}",
            f"% Results: {results_paragraph(run)}",
            "\\begin{table}",
            "  \\centering",
            f"  \\caption{{{caption}}}",
            *(f"  {line}" for line in latex_tabular(heads, rows)),
            *footnotes,
            "\\end{table}",
            "",
        ]
    )


# --- in the terminal -----------------------------------------------------------------------------


def closing_message(run: Run) -> str:
    """The result of a run as plain text."""
    record, result = run.provenance, run.result
    name = str(record["specimen"])
    if record.get("layer"):
        name += f" ({record['layer']})"
    convergence = record["convergence"]
    state = "TENTATIVE" if run.state == "tentative" else "NOT USABLE"
    verdict = f"{state}, not converged: {convergence['reason']}"
    if run.state == "converged":
        verdict = (
            f"converged (R-hat {convergence['worst_rhat']:.4f}, at least "
            f"{convergence['worst_ess']:.0f} effective draws of every quantity)"
        )
    lines = [f"{printable(truncate(name, 80))}: {verdict}"]
    if isinstance(grips := record.get("grips"), dict):
        lines.append(printable(truncate(grips.get("in_words", ""), 200)))
    serious = [f for f in record.get("findings") or [] if f["severity"] == "error"]
    lines += [printable(truncate(f["message"], 400)) for f in serious[:1]]
    advice = "; ".join(filter(None, (result.low_information, result.advice)))
    rest = [printable(text) for text in (*result.pieces, result.fit, advice) if text]
    if not result.better_law:  # else no parameter is reported that could be used
        rest += [printable(text) for text in result.warnings[:1]]
    rest.append(f"report: {run.path}/report.html")
    lines += row_lines(result.rows)
    return "\n".join([*lines, *rest])
