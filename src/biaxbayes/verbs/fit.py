"""``biaxbayes fit``: deterministic fits, with and without the mounting stretch."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import printable
from biaxbayes.laws import law_named
from biaxbayes.options import (
    ALL_FITS,
    FIT_DESCRIPTIONS,
    FIT_METHODS,
    NO_INTERVAL,
    WHICH_FIT,
    FitOptions,
    takes_options,
)
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.text_files import aligned, write_csv
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, PiecesLike, make_folder, open_specimen

if TYPE_CHECKING:
    from biaxbayes.fitting.fit_result import FitResult


@takes_options(FitOptions)
def fit(
    specimen: PiecesLike,
    method: str = "constrained",
    *,
    mounting_force: Sequence[float] | None = None,
    out: PathLike | None = None,
    **options: Any,
) -> FitResult | list[FitResult]:
    """Fit the material by least squares, and the mounting stretch where the method has one.

    Parameters
    ----------
    specimen : Specimen, path-like or list of them
        Several are pieces of one tissue, which ``constrained`` fits together.
    method : {"standard", "zeroed", "fip", "linden", "constrained", "all"}
        As in :func:`biaxbayes.fitting.fit.fit`; ``all`` gives a list, as :func:`fit_all`.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, added back.
    out : path-like, optional
        Folder for fits.csv, fits.pdf and fits.png.
    **options
        As in :class:`~biaxbayes.options.FitOptions`.

    Raises
    ------
    TaredSpecimen
        If the method infers prestretch and the file's mounting force is zero.
    InputError
        For an unknown method, option or fixed parameter.
    """
    from biaxbayes.fitting.fit import fit as fit_by
    from biaxbayes.fitting.fit import fit_all as fit_by_all

    chosen = dict(vars(FitOptions.from_values(options)))
    if method == ALL_FITS:
        del chosen["initial"]
    data = correct_for_hooks(open_specimen(specimen, mounting_force), **chosen)
    several = method == ALL_FITS
    results = fit_by_all(data, **chosen) if several else [fit_by(data, method, **chosen)]
    if out is not None:
        _write_fits(data, results, out)
    return results if several else results[0]


@takes_options(FitOptions, without=("initial",))
def fit_all(
    specimen: PiecesLike,
    *,
    mounting_force: Sequence[float] | None = None,
    out: PathLike | None = None,
    **options: Any,
) -> list[FitResult]:
    """Fit by every method that the specimen allows; arguments as in :func:`fit`.

    **options
        As in :class:`~biaxbayes.options.FitOptions`, without ``initial``.
    """
    fits: Any = fit(specimen, ALL_FITS, mounting_force=mounting_force, out=out, **options)
    return list(fits)


def correct_for_hooks(specimen: Specimen, **options: Any) -> Specimen:
    """The specimen with its loads corrected for the grips that its file states, if it does."""
    from biaxbayes.fitting.fit import fit as fitted
    from biaxbayes.grips.correction import correct_for_grips

    if not specimen.needs_grip_correction:
        return specimen
    method = "zeroed" if specimen.is_tared else "constrained"
    return correct_for_grips(specimen, lambda data: fitted(data, method, **options)).specimen


def _write_fits(
    specimen: Specimen,
    fits: Sequence[FitResult],
    folder: PathLike,
    truth: Mapping[str, float] | None = None,
) -> None:
    """Write fits.csv, one row per fit, and the fits over the data as fits.pdf and fits.png."""
    import pandas as pd

    from biaxbayes.figures.specimen import fits_figure
    from biaxbayes.figures.style import save_pictures

    target = make_folder(folder)
    rows = []
    for result in fits:
        row = _by_state(specimen, _record(specimen, result, truth))
        at_bound = " ".join(row.pop("at_bound"))
        does = FIT_DESCRIPTIONS[result.method] if specimen.experiment.is_mounted else ""
        rows.append({**row, "at_bound": at_bound, "what_it_does": does})
    write_csv(target / "fits.csv", pd.DataFrame(rows), digits=8)
    save_pictures(fits_figure(specimen, fits), target, "fits")


def _record(
    specimen: Specimen, result: FitResult, truth: Mapping[str, float] | None
) -> dict[str, Any]:
    """The fit as plain values, with its parameter error where true values are known."""
    record: dict[str, Any] = result.record()
    shared = len(result.mounting_stretch) == len(specimen.pieces)
    mounted = [  # stretches of a tube are total
        piece.experiment.is_mounted
        for piece in specimen.pieces
        for _ in range(1 if shared else len(piece.protocols))
    ]
    for name, column in zip(STRETCH_NAMES, result.mounting_stretch.T, strict=True):
        values = [float(v) if m else None for v, m in zip(column, mounted, strict=True)]
        record[name] = values if len(values) > 1 else values[0]
    if truth is not None:
        error = result.parameter_error(truth)
        record["parameter_error"] = None if math.isnan(error) else error
    return record


def _by_state(specimen: Specimen, record: Mapping[str, Any]) -> dict[str, Any]:
    """A record with one value for each mounted state, and for each further piece."""
    out: dict[str, Any] = {}
    for name, value in record.items():
        if name == "stiffness":  # that of the first piece is one
            pairs = zip(specimen.further, value[1:], strict=True)
            out |= {f"{name} {piece.name}": v for piece, v in pairs}
        elif name in STRETCH_NAMES and isinstance(value, list):
            states = specimen.quantities((), shared=len(value) == len(specimen.pieces)).states
            out |= {f"{name} {s}".strip(): v for s, v in zip(states, value, strict=True)}
        else:
            out[name] = value
    return out


# --- the command ---------------------------------------------------------------------------------


@click.command("fit")
@opt.argument("specimen", metavar="CSV...", nargs=-1, required=True)
@click.option(
    "--method",
    type=click.Choice([*FIT_METHODS, ALL_FITS]),
    default=ALL_FITS,
    show_default=True,
    help="; ".join(f"{name} {words}" for name, words in FIT_DESCRIPTIONS.items()) + ".",
)
@opt.json_option("A list of objects instead of the table.")
@opt.fix_option("Fix a parameter, e.g. kappa=0.")
@opt.options(FitOptions, "mounting_stretch")
@opt.mounting_force_option(
    "Force (N, or stress in kPa) at the mounted state of a tared file, known from elsewhere."
)
@opt.options(FitOptions, "starts", "seed", "law", "fibre_switch", "piece_sd")
@opt.file_option(
    "truth",
    "True values, as 'simulate' writes them: adds the mean relative error of the parameters "
    "(MAE of the method paper, Eq. 8).",
    "JSON",
)
@opt.file_option("out", "Folder for fits.csv and a figure of the fits over the data.", "DIR")
def command(
    specimen: tuple[Path, ...],
    method: str,
    as_json: bool,
    fix: tuple[str, ...],
    mounting_force: tuple[float, float] | None,
    truth: Path | None,
    out: Path | None,
    **given: Any,
) -> int:
    """Fit the material by least squares, with and without the mounting stretch.

    With --out the table goes into fits.csv, the fits over the data into fits.pdf and fits.png.
    """
    from biaxbayes.fitting.fit_quality import poor_fit
    from biaxbayes.specimens.truth import read_truth

    fixed = opt.fixed_values(fix, law_named(given["law"], fibre_switch=given["fibre_switch"]))
    data = open_specimen(list(specimen), mounting_force)
    data = correct_for_hooks(data, fixed=fixed, **given)
    known = None if truth is None else read_truth(truth, data.name)
    results = fit(data, method, fixed=fixed, **given)
    fits = results if isinstance(results, list) else [results]
    if out is not None:
        _write_fits(data, fits, out, known)
    poor = poor_fit(data, fits)
    if as_json:
        records = [_record(data, result, known) for result in fits]
        click.echo(json.dumps(records, indent=2, allow_nan=False))
    else:
        _print_fits(data, fits, fixed, known, advise=not poor)
        if out is not None:
            click.echo(f"{out / 'fits.csv'}, {out / 'fits.pdf'}")
    if method == ALL_FITS and data.is_tared:
        click.echo(
            "note: the force at the mounted state is zero (a tared load cell), so fip, linden and "
            "constrained cannot infer prestretch; give it with --mounting-force X Y",
            err=True,
        )
    if poor:
        click.echo(f"warning: {poor}", err=True)
    if missed := [result.method for result in fits if not result.converged]:
        click.echo(f"not converged: {', '.join(missed)}", err=True)
    return opt.NOT_CONVERGED if missed else 0


METHODS_WITHOUT_MOUNTING = ("standard", "zeroed")
"""Methods without a mounting stretch."""
STRETCH_NAMES = ("mounting_stretch_x", "mounting_stretch_y")
FORMAT_BY_UNIT = {"deg": "{:.2f}", "1": "{:.4f}"}
"""Formats of angles and of dimensionless parameters that are not logarithmic."""
FIT_ROWS = (
    *((name.replace("_", " "), "", name, "{:.4f}") for name in STRETCH_NAMES),
    ("R2", "", "r2", "{:.5f}"),
    ("RMSE", "kPa", "rmse_kPa", "{:.4g}"),
    ("MAE", "kPa", "mae_kPa", "{:.4g}"),
    ("iterations", "", "iterations", "{:d}"),
    ("stiffness", "", "stiffness", "{:.4f}"),  # of several pieces
    ("parameter error", "", "parameter_error", "{:.4g}"),  # where the truth is known
)
"""Label, unit, key of the record and format."""


def _print_fits(
    specimen: Specimen,
    fits: list[FitResult],
    fixed: dict[str, float],
    truth: Mapping[str, float] | None,
    *,
    advise: bool,
) -> None:
    for note in specimen.notes:
        click.echo(f"note: {printable(note)}")
    click.echo("\n".join([printable(specimen.name), *_table(specimen, fits, fixed, truth)]))
    lines = ["* ended on a bound"] if any(result.at_bound for result in fits) else []
    lines += ["= fixed"] if fixed else []
    if specimen.experiment.is_mounted:
        lines += [f"{result.method}: {FIT_DESCRIPTIONS[result.method]}" for result in fits]
    # of other tests one method alone is of use
    several = specimen.experiment.is_biaxial and not specimen.further
    lines.append((WHICH_FIT if several and advise else "") + NO_INTERVAL)
    if any(result.method in METHODS_WITHOUT_MOUNTING for result in fits):
        lines.append(
            "R2, RMSE and MAE compare the Cauchy stress with the data at the mounting stretch of "
            "the fit; for standard and zeroed they do not show the distance from the tissue."
        )
    for line in lines:
        click.echo(textwrap.fill(line, 80))


def _table(
    specimen: Specimen,
    fits: list[FitResult],
    fixed: dict[str, float],
    truth: Mapping[str, float] | None,
) -> list[str]:
    """Lines with a column for each fit."""
    lines = [["", *(result.method for result in fits)]]
    rows = []
    for p in fits[0].material.law.parameters:
        form = "{:.4g}" if p.logarithmic else FORMAT_BY_UNIT[p.unit]
        rows.append((p.name, p.unit.replace("1", ""), p.label, form))
    records = [_by_state(specimen, _record(specimen, result, truth)) for result in fits]
    for label, unit, key, form in (*rows, *FIT_ROWS):
        for name in dict.fromkeys(n for r in records for n in r if n.partition(" ")[0] == key):
            cells = []
            for result, record in zip(fits, records, strict=True):
                value = record.get(name)
                if key in STRETCH_NAMES and result.method in METHODS_WITHOUT_MOUNTING:
                    value = None
                mark = "*" if label in result.at_bound else "=" if label in fixed else ""
                cells.append(("-" if value is None else form.format(value)) + mark)
            if set(cells) != {"-"} or key not in STRETCH_NAMES:
                state = name.removeprefix(key).strip()
                lines.append([" ".join(filter(None, (label, state, unit))), *cells])
    lines.append(["converged", *("yes" if result.converged else "NO" for result in fits)])
    return aligned(lines, right=range(1, len(lines[0])))
