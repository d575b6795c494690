"""``biaxbayes check``: contents of a specimen file as they are read, and warnings."""

from __future__ import annotations

import json
import textwrap
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any

import click
import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments.sheet import REFERENCES
from biaxbayes.mechanics.mounting import N_PER_KPA_MM2
from biaxbayes.options import for_users
from biaxbayes.reports.text import plural
from biaxbayes.specimens.check import Finding, alignment_note, check_specimen, sorted_findings
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import aligned, refuse_foreign
from biaxbayes.verbs.inputs import PathLike, SpecimenLike, open_specimen
from biaxbayes.verbs.options import argument, file_option, flag, json_option

GRIPS_NOT_STATED = (
    "the header does not state the grips, so the loads are taken as those of a uniform test; five "
    "hooks per edge carry about a tenth less. Add 'grips: hooks 5' and 'grip_inset_mm: 1.5', or "
    "'grips: none'"
)
PLAIN_KEYS = ("layer", "axis_x", "axis_y", "geometry", "edge_x_mm", "edge_y_mm", "thickness_mm")
FORCE_KEYS = tuple(f"mounting_force{sd}_{axis}" for sd in ("", "_sd") for axis in "xy")


@dataclass(frozen=True)
class Checked:
    """A specimen as it was read, and the findings of its check.

    Attributes
    ----------
    specimen : Specimen
    findings : tuple of Finding
        The most severe first.
    """

    specimen: Specimen
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        count = sum(f.severity != "note" for f in self.findings)
        return f"Checked({self.specimen.name!r}, {count} of {len(self.findings)} findings serious)"

    def record(self) -> dict[str, Any]:
        """Contents as plain values, as ``biaxbayes check --json`` prints them."""
        specimen = self.specimen
        readings, sds = specimen.mounting_readings(shared=False)
        axes = specimen.experiment.axes
        area = specimen.experiment.area(specimen.header, specimen.loads)
        sections = {k: float(area[k] / N_PER_KPA_MM2) for k in axes} if area is not None else {}

        def span(stretch: np.ndarray) -> list[float] | None:
            return None if np.isnan(stretch).any() else [float(stretch.min()), float(stretch.max())]

        return {
            "specimen": specimen.name,
            "test": specimen.test,
            **{key: getattr(specimen, key) for key in PLAIN_KEYS},
            **{f"section_{a}_mm2": sections.get(k) for k, a in enumerate("xy")},
            "loads": specimen.loads,
            "unit": specimen.unit,
            "reference": specimen.reference or REFERENCES[0],
            "load_noise": specimen.noise_sd,
            "load_noise_stated": specimen.load_noise is not None,
            "tared": specimen.is_tared,
            "metadata": dict(specimen.metadata),
            "notes": list(specimen.notes),
            "protocols": [
                {
                    "name": p.name,
                    "rows": p.rows,
                    "rest_rows": p.rest_rows,
                    "stretch_x": span(p.stretch_x),
                    "stretch_y": span(p.stretch_y),
                    "largest_load_x": float(load[:, 0].max()) if 0 in axes else None,
                    "largest_load_y": float(load[:, 1].max()) if 1 in axes else None,
                    **{
                        key: float(value) if p.rest_rows and "xy".index(key[-1]) in axes else None
                        for key, value in zip(FORCE_KEYS, (*reading, *sd), strict=True)
                    },
                    "reference_x": p.reference[0],
                    "reference_y": p.reference[1],
                }
                for p, reading, sd in zip(specimen.protocols, readings, sds, strict=True)
                for load in [specimen.load(p)]
            ],
            "findings": [asdict(finding) for finding in self.findings],
        }

    def _repr_html_(self) -> str:
        """The findings, for notebooks."""
        rows = "".join(
            f"<tr><td>{escape(f.severity)}</td><td>{escape(f.protocol or '')}</td>"
            f"<td>{escape(f.message)}</td></tr>"
            for f in self.findings
        )
        return f"<p>{escape(self.specimen.name)}</p><table>{rows}</table>"


@for_users
def check(
    specimen: SpecimenLike,
    *,
    fit: bool = True,
    figure: PathLike | None = None,
    sketch: PathLike | None = None,
) -> Checked:
    """Read a specimen and list warnings of what may go wrong.

    Parameters
    ----------
    specimen : Specimen or path-like
    fit : bool
        Whether to fit the record, to see if GOH can follow it.
    figure : path-like, optional
        Draw the record into this file (.pdf, .png or .svg).
    sketch : path-like, optional
        Draw the sheet and the hooks that the header states, to scale, into this file.

    Raises
    ------
    InputError
        For a sketch of a specimen whose header states no hooks.
    """
    data = open_specimen(specimen)
    findings = list(check_specimen(data))
    if "grips" not in data.metadata and data.experiment.is_biaxial:
        findings.append(Finding("grips", "note", GRIPS_NOT_STATED))
    if note := alignment_note(data):
        findings.append(Finding("alignment", "note", note))
    if data.needs_grip_correction:
        from biaxbayes.grips.hooks import describe_hooks, stated_hooks

        words = (
            f"sample and fit correct the loads for {describe_hooks(data)}, each of which moves a "
            f"patch {2.0 * stated_hooks(data).radius_mm:.3g} mm wide; stretches from "
            f"{data.metadata.get('stretch_from', 'markers')}"
        )
        findings.append(Finding("grips", "note", words))
    if fit:
        from biaxbayes.fitting.fit_quality import misfit_finding, quick_fit, swapped_columns
        from biaxbayes.fitting.law_fits import quick_better_law

        best = quick_fit(data)
        findings.append(misfit_finding(data, best))
        if swapped := swapped_columns(data, best.residuals, best=best):
            findings.append(swapped)
        if better := quick_better_law(data):
            findings.append(Finding("other-law", "note", better))
    if figure is not None or sketch is not None:
        from biaxbayes.figures.mounting import sketch_figure
        from biaxbayes.figures.specimen import specimen_figure
        from biaxbayes.figures.style import save_figure

        for path in (figure, sketch):
            if path is not None:
                refuse_foreign(Path(path))
    if figure is not None:
        save_figure(specimen_figure(data), Path(figure))
    if sketch is not None:
        if not data.has_hooks:
            problem = "`sketch` draws hooks, and the header states none"
            remedy = "add lines such as '# grips: hooks 5' and '# grip_inset_mm: 1.5'"
            raise InputError(problem, file=data.name, remedy=remedy)
        save_figure(sketch_figure(data), Path(sketch))
    return Checked(data, sorted_findings(findings))


# --- the command ---------------------------------------------------------------------------------


@click.command("check")
@argument("specimen")
@file_option("figure", "Draw the record (.pdf, .png or .svg).")
@file_option("sketch", "Draw the hooks that the header states, to scale (.pdf, .png or .svg).")
@flag("no-picture", "Write no NAME-check.png beside the specimen file.")
@json_option("One object instead of the text, and no picture.")
@click.option(
    "--fit/--no-fit",
    "with_fit",
    default=True,
    show_default=True,
    help="Whether to fit the record, to see if GOH can follow it.",
)
def command(
    specimen: Path,
    figure: Path | None,
    sketch: Path | None,
    no_picture: bool,
    as_json: bool,
    with_fit: bool,
) -> int:
    """Print the contents of a specimen file as they were read, and warn of what may go wrong.

    NAME-check.png beside the file shows all rows, those of each protocol in its colour.

    Exit code 0 for a record that 'sample' takes, with or without warnings; 2 for one with an error,
    which 'sample' refuses without --anyway.
    """
    result = check(specimen, fit=with_fit, figure=figure, sketch=sketch)
    if as_json:
        click.echo(json.dumps(result.record(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _print_result(result)
        if figure is not None:
            click.echo(f"figure: {figure}")
        if sketch is not None:
            click.echo(f"sketch: {sketch}")
        if not no_picture:
            click.echo(f"picture: {_picture(result.specimen, specimen)}")
    refused = any(finding.severity == "error" for finding in result.findings)
    return InputError.exit_code if refused else 0


def _picture(specimen: Specimen, file: Path) -> str:
    """Write the picture of all rows beside a specimen file, where that is possible."""
    from biaxbayes.figures.specimen import protocols_figure
    from biaxbayes.figures.style import save_figure

    path = file.with_name(f"{file.stem}-check.png")
    try:
        refuse_foreign(path)
        save_figure(protocols_figure(specimen), path)
    except InputError as error:
        return f"none, {error}"
    return str(path)


def _print_result(result: Checked) -> None:
    specimen, findings, about = result.specimen, result.findings, result.record()
    test, kind = specimen.experiment, specimen.kind_of_loads
    size = test.size(specimen.header) or "not stated"
    readings = f"{kind.words} in {specimen.unit}"
    if len({kind.units[k] for k in test.axes}) > 1:
        readings = " and ".join(f"{test.curves[k]} in {kind.units[k]}" for k in test.axes)
    rows = sum(p["rows"] for p in about["protocols"])
    protocols = plural(len(about["protocols"]), "protocol")
    origin = "stated" if specimen.load_noise is not None else "from the scatter of the rows"
    sections = {k: about[f"section_{k}_mm2"] for k in "xy"}
    facts = {
        "axes": ", ".join(f"{k} {about[f'axis_{k}']}" for k in "xy" if about[f"axis_{k}"]),
        "dimensions": f"{size} (stresses and dimensions refer to the {specimen.geometry} state)",
        "test": specimen.test,
        "sections": ", ".join(
            f"{area:.4g} mm2 under the force in {k}" for k, area in sections.items() if area
        ),
        "readings": f"{readings}, {rows} rows in {protocols}",
        "load noise": f"{specimen.noise_sd:.3g} {specimen.unit}, {origin}",
    }
    click.echo(f"specimen {specimen.name}{f', {specimen.layer}' if specimen.layer else ''}")
    lines = [f"  {name:10s} {text}" for name, text in facts.items() if text]
    lines += [f"  {key}: {value}" for key, value in specimen.metadata.items()]
    click.echo("\n".join([*lines, ""]))
    force = f"mounting force x, y ({about['unit']})"
    table = [["protocol", "rows", "at rest", "stretch x", "stretch y", force]]
    for p in about["protocols"]:
        spans = [p[f"stretch_{k}"] for k in "xy"]
        ranges = ["{:.4f}-{:.4f}".format(*span) if span else "free" for span in spans]
        forces = "as the others" if specimen.experiment.is_mounted else "none"
        if p["rest_rows"]:
            forces = ", ".join(
                f"{p[f'mounting_force_{k}']:.3g} +- {p[f'mounting_force_sd_{k}']:.2g}"
                if p[f"mounting_force_{k}"] is not None
                else "free"
                for k in "xy"
            )
        table.append([p["name"], str(p["rows"]), str(p["rest_rows"]), *ranges, forces])
    click.echo(textwrap.indent("\n".join(aligned(table)), "  ") + "\n")
    wrapped = textwrap.TextWrapper(96, subsequent_indent="    ", break_long_words=False)
    for finding in findings:
        click.echo(wrapped.fill(str(finding)))
    errors, count = (sum(f.severity == s for f in findings) for s in ("error", "warning"))
    if errors:
        click.echo("'sample' refuses it without --anyway")
    if count or not errors:
        click.echo(plural(count, "warning") if count else "no warnings")
