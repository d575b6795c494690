"""``biaxbayes check``: what the tool understands of a specimen file, and what is odd about it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from biaxbayes.specimens.finding import Finding
    from biaxbayes.specimens.specimen import Specimen

__all__ = ["command"]


@click.command("check")
@click.argument("specimen", type=click.Path(path_type=Path))
@click.option(
    "--figure", type=click.Path(path_type=Path), help="Draw the record (.pdf, .png or .svg)."
)
@click.option("--json", "as_json", is_flag=True, help="One object instead of the text.")
@click.option(
    "--fit/--no-fit",
    "with_fit",
    default=True,
    show_default=True,
    help="Whether to try if GOH can follow the record.",
)
def command(specimen: Path, figure: Path | None, as_json: bool, with_fit: bool) -> int:
    """Print what is understood of a specimen file, and warn of what may go wrong."""
    from biaxbayes.specimens.check import check_specimen
    from biaxbayes.specimens.specimen_file import read_specimen

    data = read_specimen(specimen)
    findings = list(check_specimen(data))
    if with_fit:
        from biaxbayes.findings.goh_description import goh_description

        misfit = goh_description(data)
        findings.append(misfit)
        findings.sort(key=lambda finding: finding.severity != "warning")
    if as_json:
        import json

        record = {**summary(data), "findings": [finding.record() for finding in findings]}
        click.echo(json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _print(data, findings)
    if figure is not None:
        from biaxbayes.output.specimen_figure import save_figure, specimen_figure

        save_figure(specimen_figure(data), figure)
        if not as_json:
            click.echo(f"figure: {figure}")
    return 0


def summary(specimen: Specimen) -> dict[str, Any]:
    """What is understood of a specimen, as plain values."""
    readings, sds = specimen.mounting_readings(shared=False)
    area = specimen.area * 1e3 if specimen.stress_pair == "force" else [None, None]
    return {
        "specimen": specimen.name,
        "layer": specimen.layer,
        "axis_x": specimen.axis_x,
        "axis_y": specimen.axis_y,
        "geometry": specimen.geometry,
        "edge_x_mm": specimen.edge_x_mm,
        "edge_y_mm": specimen.edge_y_mm,
        "thickness_mm": specimen.thickness_mm,
        "section_x_mm2": None if area[0] is None else float(area[0]),
        "section_y_mm2": None if area[1] is None else float(area[1]),
        "stress_pair": specimen.stress_pair,
        "unit": specimen.unit,
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
                "stretch_x": [float(p.stretch_x.min()), float(p.stretch_x.max())],
                "stretch_y": [float(p.stretch_y.min()), float(p.stretch_y.max())],
                "largest_load_x": float(load[:, 0].max()),
                "largest_load_y": float(load[:, 1].max()),
                "mounting_force_x": float(reading[0]),
                "mounting_force_y": float(reading[1]),
                "mounting_force_sd_x": float(sd[0]),
                "mounting_force_sd_y": float(sd[1]),
                "reference_x": p.reference[0],
                "reference_y": p.reference[1],
            }
            for p, reading, sd in zip(specimen.protocols, readings, sds, strict=True)
            for load in [specimen.load(p)]
        ],
    }


def _print(specimen: Specimen, findings: list[Finding]) -> None:
    about = summary(specimen)
    layer = f", {specimen.layer}" if specimen.layer else ""
    click.echo(f"specimen {specimen.name}{layer}")
    axes = [f"{k} {getattr(specimen, f'axis_{k}')}" for k in "xy" if getattr(specimen, f"axis_{k}")]
    if axes:
        click.echo(f"  axes       {', '.join(axes)}")
    click.echo(f"  dimensions {_dimensions(specimen)}")
    if about["section_x_mm2"] is not None:
        click.echo(
            f"  sections   {about['section_x_mm2']:.4g} mm2 under the force in x, "
            f"{about['section_y_mm2']:.4g} mm2 in y"
        )
    kind = {"force": "force", "piola": "first Piola-Kirchhoff stress", "cauchy": "Cauchy stress"}
    rows = sum(p["rows"] for p in about["protocols"])
    count = len(about["protocols"])
    click.echo(
        f"  readings   {kind[specimen.stress_pair]} in {specimen.unit}, {rows} rows in {count} "
        f"{'protocol' if count == 1 else 'protocols'}"
    )
    origin = "stated" if specimen.load_noise is not None else "from the scatter of the rows"
    click.echo(f"  load noise {specimen.noise_sd:.3g} {specimen.unit}, {origin}")
    for key, value in specimen.metadata.items():
        click.echo(f"  {key}: {value}")
    click.echo("")
    for line in _protocol_table(about):
        click.echo(line)
    click.echo("")
    for finding in findings:
        where = f"protocol {finding.protocol}: " if finding.protocol else ""
        click.echo(_wrapped(f"{finding.severity}: {where}{finding.message}"))
    count = sum(finding.severity == "warning" for finding in findings)
    click.echo("no warnings" if not count else f"{count} {'warning' if count == 1 else 'warnings'}")


def _dimensions(specimen: Specimen) -> str:
    if specimen.edge_x_mm is None or specimen.edge_y_mm is None:
        text = "not stated"
    else:
        text = f"{specimen.edge_x_mm:g} x {specimen.edge_y_mm:g} mm"
    if specimen.thickness_mm is not None:
        text += f", {specimen.thickness_mm:g} mm thick"
    return f"{text} (stresses and dimensions refer to the {specimen.geometry} state)"


def _protocol_table(about: dict[str, Any]) -> list[str]:
    unit = about["unit"]
    heads = (
        "protocol",
        "rows",
        "at rest",
        "stretch x",
        "stretch y",
        f"mounting force x, y ({unit})",
    )
    lines = [heads]
    for p in about["protocols"]:
        forces = [
            f"{p[f'mounting_force_{k}']:.3g} +- {p[f'mounting_force_sd_{k}']:.2g}" for k in "xy"
        ]
        name = p["name"] if len(p["name"]) <= 30 else p["name"][:29] + "…"
        lines.append(
            (
                name,
                str(p["rows"]),
                str(p["rest_rows"]),
                "{:.4f}-{:.4f}".format(*p["stretch_x"]),
                "{:.4f}-{:.4f}".format(*p["stretch_y"]),
                ", ".join(forces),
            )
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(heads))]
    return [
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]


def _wrapped(text: str) -> str:
    import textwrap

    return textwrap.fill(text, width=96, subsequent_indent="    ", break_long_words=False)
