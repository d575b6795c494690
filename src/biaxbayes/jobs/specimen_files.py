"""The verbs that begin with a specimen or a machine's export: check, convert, fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biaxbayes.errors import InputError
from biaxbayes.jobs.opening import (
    SpecimenLike,
    check_new,
    made_folder,
    opened_specimen,
)
from biaxbayes.options import ALL_FITS, FIT_WORDS, FitOptions, documented
from biaxbayes.specimens.specimen import REFERENCES, Specimen
from biaxbayes.specimens.specimen_file import parse_specimen, specimen_text
from biaxbayes.text_files import atomic_write_text, write_csv

if TYPE_CHECKING:
    from biaxbayes.fitting.result import FitResult
    from biaxbayes.machines.conversion import Choice, Conversion
    from biaxbayes.specimens.findings import Finding

__all__ = [
    "Checked",
    "check",
    "convert",
    "fit",
    "fit_all",
    "write_fits",
]

# --- check ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Checked:
    """What is understood of a specimen, and what is odd about it.

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
        """Everything as plain values, as ``biaxbayes check --json`` prints it."""
        return {
            **understood(self.specimen),
            "findings": [finding.record() for finding in self.findings],
        }

    def _repr_html_(self) -> str:
        """The findings, for notebooks."""
        rows = "".join(
            f"<tr><td>{escape(f.severity)}</td><td>{escape(f.protocol or '')}</td>"
            f"<td>{escape(f.message)}</td></tr>"
            for f in self.findings
        )
        return f"<p>{escape(self.specimen.name)}</p><table>{rows}</table>"


def check(specimen: SpecimenLike, *, fit: bool = True, figure: str | Path | None = None) -> Checked:
    """What the tool understands of a specimen, and warnings of what may go wrong.

    Parameters
    ----------
    specimen : Specimen or path-like
    fit : bool
        Whether to try if GOH can follow the record.
    figure : path-like, optional
        Draw the record into this file (.pdf, .png or .svg).
    """
    from biaxbayes.specimens.check import check_specimen
    from biaxbayes.specimens.findings import Finding, sorted_findings

    data = opened_specimen(specimen)
    findings = list(check_specimen(data))
    if fit:
        from biaxbayes.identifiability.mounting_stretch.law_range import better_law
        from biaxbayes.identifiability.mounting_stretch.toe import (
            described,
            goh_description,
            swapped_columns,
        )

        best = described(data)
        swapped = swapped_columns(data, best.residuals)
        findings += [goh_description(data, best), *([swapped] if swapped else [])]
        better = better_law(data)
        findings += [Finding("other-law", "note", better)] if better else []
    if figure is not None:
        from biaxbayes.figures.specimen import specimen_figure
        from biaxbayes.figures.style import save_figure

        save_figure(specimen_figure(data), Path(figure))
    return Checked(data, sorted_findings(findings))


FORCE_KEYS = tuple(f"mounting_force{sd}_{axis}" for sd in ("", "_sd") for axis in "xy")


def understood(specimen: Specimen) -> dict[str, Any]:
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
                "stretch_x": [float(p.stretch_x.min()), float(p.stretch_x.max())],
                "stretch_y": [float(p.stretch_y.min()), float(p.stretch_y.max())],
                "largest_load_x": float(load[:, 0].max()),
                "largest_load_y": float(load[:, 1].max()),
                **{
                    key: float(value) if p.rest_rows else None
                    for key, value in zip(FORCE_KEYS, (*reading, *sd), strict=True)
                },
                "reference_x": p.reference[0],
                "reference_y": p.reference[1],
            }
            for p, reading, sd in zip(specimen.protocols, readings, sds, strict=True)
            for load in [specimen.load(p)]
        ],
    }


# --- convert -------------------------------------------------------------------------------------


def convert(
    raw: str | Path | Sequence[str | Path],
    choice: Choice | None = None,
    *,
    header: Mapping[str, float | str] | None = None,
    protocol_names: Sequence[str] = (),
    out: str | Path | None = None,
    overwrite: bool = False,
    **taken: Any,
) -> Conversion:
    """Read machine exports as the protocols of one specimen, and write it where asked to.

    Parameters
    ----------
    raw : sequence of path-like
        A file, or several: each (or each set or sheet in it) becomes a protocol.
    choice : Choice, optional
        What to take from the files; or its fields as keywords.
    header : mapping, optional
        Header values by their key in a specimen file (``edge_x_mm``, ``geometry``,
        ``load_noise_N``, ``layer`` ...).
    protocol_names : sequence of str
        One a protocol; from the names of the files where empty.
    out : path-like, optional
        The specimen file to write. Nothing is written that cannot be read again.
    overwrite : bool
        Replace a file of that name.
    **taken
        ``machine``, ``columns``, ``cycle``, ``branch``, ``stretch_from``, ``sets`` and ``sheets``,
        as in :class:`~biaxbayes.machines.choice.Choice`. Texts may stand for a list of one.

    Returns
    -------
    Conversion
        With ``out``, its specimen is the one that the file reads back to.

    Raises
    ------
    InputError
        For files, columns and options that do not fit together.
    """
    from biaxbayes.machines.conversion import convert as conversion
    from biaxbayes.specimens.header import checked_value

    choice = _choice(choice, taken)
    paths = [raw] if isinstance(raw, str | Path) else raw
    files, target = [Path(path) for path in paths], None if out is None else Path(out)
    _check_choice(choice)
    _check_raw(files, target)
    if target is not None:
        check_new(target, overwrite)
    values = {
        key: checked_value(key, " ".join(value.split())) if isinstance(value, str) else value
        for key, value in (header or {}).items()
        if not (isinstance(value, str) and not value.strip())
    }
    chosen = replace(choice, cycle=_cycle(str(choice.cycle)))
    found = conversion(files, chosen, header=values, protocol_names=list(protocol_names))
    if target is None:
        return found
    text = specimen_text(found.specimen, found.recorded)
    specimen = parse_specimen(text.split("\n"), target)
    atomic_write_text(target, text)
    return replace(found, specimen=specimen)


def _choice(choice: Choice | None, taken: Mapping[str, Any]) -> Choice:
    """What to take from the files, from either way to say it."""
    from biaxbayes.machines import FORMATS
    from biaxbayes.machines.conversion import Choice

    if choice is not None:
        if taken:
            raise InputError(f"{next(iter(taken))} is given beside a choice", remedy="give one")
        return choice
    known = Choice.__dataclass_fields__
    for name in taken:
        if name not in known:
            raise InputError(f"unknown option {name[:60]!r}", remedy=f"one of {', '.join(known)}")
    if "machine" not in taken:
        raise InputError("no machine is given", remedy=f"machine={' or '.join(map(repr, FORMATS))}")
    several = {
        name: (taken[name],) if isinstance(taken[name], str) else tuple(taken[name])
        for name in ("columns", "sets", "sheets")
        if name in taken
    }
    chosen: dict[str, Any] = {**taken, **several}
    return Choice(**chosen)


def _check_choice(choice: Choice) -> None:
    """Refuse options that belong to another machine format."""
    from biaxbayes.machines import FORMATS, STRETCH_SOURCES

    stated = {
        "--columns": choice.columns,
        "--set": choice.sets,
        "--stretch-from": choice.stretch_from != STRETCH_SOURCES[0],
    }
    given = {option for option, value in stated.items() if value}
    own = FORMATS[choice.machine].options if choice.machine in FORMATS else ()
    for name, format_ in FORMATS.items():
        foreign = [option for option in format_.options if option not in own]
        if given.intersection(foreign):
            verb, them = ("are", "them") if len(foreign) > 1 else ("is", "it")
            raise InputError(
                f"{' and '.join(foreign)} {verb} for --machine {name}", remedy=f"leave {them} out"
            )


def _check_raw(raw: Sequence[Path], out: Path | None) -> None:
    seen: set[Path] = set()
    for path in raw:
        try:
            real = path.resolve()
            same = out is not None and real == out.resolve()
        except (OSError, RuntimeError, ValueError):
            continue  # the reader says what is wrong with it
        if same:
            raise InputError("would be overwritten", file=path, remedy="choose another --out")
        if real in seen:
            raise InputError("is given twice", file=path, remedy="name each file once")
        seen.add(real)


def _cycle(text: str) -> str:
    if text == "last":
        return text
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) > 0):
        raise InputError(f"--cycle {text[:20]!r} is no cycle", remedy="give a number or 'last'")
    return str(int(text))


# --- fit -----------------------------------------------------------------------------------------


@documented(FitOptions)
def fit(
    specimen: SpecimenLike,
    method: str = "constrained",
    *,
    mounting_force: Sequence[float] | None = None,
    out: str | Path | None = None,
    **options: Any,
) -> FitResult | list[FitResult]:
    """Fit the material by least squares, and the mounting stretch where the method has one.

    Parameters
    ----------
    specimen : Specimen or path-like
    method : {"standard", "zeroed", "fip", "linden", "constrained", "all"}
        As in :func:`biaxbayes.fitting.fit.fit`; ``all`` gives a list, as :func:`fit_all`.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, put back on.
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
    from biaxbayes.fitting.fit import fit as fitted

    if method == ALL_FITS:
        return fit_all(specimen, mounting_force=mounting_force, out=out, **options)
    how = FitOptions.of(options)
    data = opened_specimen(specimen, mounting_force)
    found = fitted(data, method, **vars(how))
    if out is not None:
        write_fits(data, [found], out)
    return found


def write_fits(specimen: Specimen, fits: Sequence[FitResult], folder: str | Path) -> None:
    """Write fits.csv, one row a fit, and the fits over the data as fits.pdf and fits.png.

    Parameters
    ----------
    specimen : Specimen
    fits : sequence of FitResult
    folder : path-like
    """
    import pandas as pd

    from biaxbayes.figures.specimen import fits_figure
    from biaxbayes.figures.style import save_pictures

    target = made_folder(folder)
    rows = []
    for found in fits:
        row = found.record()
        for name in ("mounting_stretch_x", "mounting_stretch_y"):
            value = row.pop(name)
            if isinstance(value, list):
                row |= {
                    f"{name} {p.name}": v for p, v in zip(specimen.protocols, value, strict=True)
                }
            else:
                row[name] = value
        at_bound = row.pop("at_bound")
        assert isinstance(at_bound, list)
        rows.append(
            {**row, "at_bound": " ".join(at_bound), "what_it_does": FIT_WORDS[found.method]}
        )
    write_csv(target / "fits.csv", pd.DataFrame(rows), digits=8)
    save_pictures(fits_figure(specimen, fits), target, "fits")


@documented(FitOptions, without=("initial",))
def fit_all(
    specimen: SpecimenLike,
    *,
    mounting_force: Sequence[float] | None = None,
    out: str | Path | None = None,
    **options: Any,
) -> list[FitResult]:
    """Every method that the specimen allows; arguments as in :func:`fit`."""
    from biaxbayes.fitting.fit import fit_all as fitted

    how = dict(vars(FitOptions.of(options)))
    how.pop("initial")
    data = opened_specimen(specimen, mounting_force)
    found = fitted(data, **how)
    if out is not None:
        write_fits(data, found, out)
    return found
