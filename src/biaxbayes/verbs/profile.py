"""``biaxbayes profile``: the likelihood along one parameter, everything else re-optimised."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from biaxbayes.errors import InputError
from biaxbayes.options import MOUNTING_MODES, ModelOptions, option, takes_options
from biaxbayes.text_files import atomic_write_text, write_csv
from biaxbayes.verbs import inputs
from biaxbayes.verbs import options as opt
from biaxbayes.verbs.inputs import PathLike, RunLike, SpecimenLike

if TYPE_CHECKING:
    import pandas as pd

    from biaxbayes.profiles.profile import Profile


@dataclass(frozen=True)
class ProfileOptions(ModelOptions):
    """The statistical model of a profile likelihood; its mounting stretches cannot be free."""

    mounting: str = option(
        "noisy",
        "How the mounting force enters.",
        choices=tuple(m for m in MOUNTING_MODES if m != "free"),
    )


@takes_options(ProfileOptions)
def profile(
    source: RunLike | SpecimenLike,
    parameters: Sequence[str] = (),
    *,
    out: PathLike | None = None,
    mounting_force: Sequence[float] | None = None,
    workers: int = 1,
    **options: Any,
) -> list[Profile]:
    """Compute the profile likelihood of each parameter, from the data without priors.

    Parameters
    ----------
    source : Run, Specimen or path-like
        A run, with its own model, or a specimen.
    parameters : sequence of str
        C1, k1, k2, alpha, kappa, mounting_stretch_x or _y; by default the free ones of the first
        five.
    out : path-like, optional
        Folder for profile.csv, profile-intervals.csv and profile.pdf.
    mounting_force : (float, float), optional
        For a tared specimen: the force (or stress) at the mounted state, added back.
    workers : int
        Processes.
    **options
        For a specimen, as in :class:`ProfileOptions`.
    """
    from biaxbayes.figures.profile import profile_figure
    from biaxbayes.figures.style import save_figure
    from biaxbayes.model.preparation import prepare
    from biaxbayes.profiles.profile import profiles

    if inputs.is_run(source):
        if given := [*["mounting_force"] * (mounting_force is not None), *options]:
            problem = f"`{given[0][:60]}` does not go with a run, which has its own"
            raise InputError(problem, remedy="give the specimen's CSV instead")
        posterior = inputs.as_run(source).posterior()  # type: ignore[arg-type]
    else:
        model = ProfileOptions.from_values(options)
        data = inputs.open_specimen(source, mounting_force)  # type: ignore[arg-type]
        posterior = prepare(data, **model.keywords())
    settings = posterior.settings
    free = (n for n in posterior.law.names if n not in settings.priors or n in posterior.free)
    result = profiles(posterior, tuple(dict.fromkeys(parameters or free)), workers=workers)
    if out is not None:
        folder = inputs.make_folder(out)
        about = f"profile likelihood of {posterior.specimen.name}: mounting {settings.mounting}, "
        about += f"noise {settings.noise}"
        about += "".join(f", {name}={value:g}" for name, value in settings.fixed.items())
        write_profiles(result, folder, about)
        save_figure(profile_figure(result), folder / "profile.pdf")
    return result


# --- profile.csv, profile-intervals.csv and --json ------------------------------------------------


def interval_table(profiles: Sequence[Profile]) -> pd.DataFrame:
    """One row per profile: interval, open ends, kind."""
    from pandas import DataFrame

    ends = ["low_90", "high_90", "open_low", "open_high"]
    rows = [
        (p.parameter, p.unit, p.estimate, p.low, p.high, p.open_low, p.open_high, p.kind)
        for p in profiles
    ]
    table = DataFrame(rows, columns=["parameter", "unit", "estimate", *ends, "kind"])
    return table.assign(in_words=[p.in_words() for p in profiles])


def write_profiles(profiles: Sequence[Profile], folder: Path, about: str) -> None:
    """Write both tables and profile-provenance.json into a folder; ``about``: what was profiled."""
    from pandas import concat

    from biaxbayes.profiles.profile import FLAT_DEVIANCE
    from biaxbayes.profiles.profile_curve import THRESHOLD
    from biaxbayes.runs.run_result import TABLE_DIGITS
    from biaxbayes.stored_data import json_text

    record = {
        "about": about,
        "deviance": "-2 ln L above its minimum, everything else at its best; no prior",
        "deviance_of_90_percent": THRESHOLD,
        "deviance_of_flat": FLAT_DEVIANCE,
        "kinds": "structural: flat; practical: open on a side; finite: crossed on both sides (an "
        "angle of 0 or 90 degrees is a mirror and counts as closed)",
    }
    curves = concat({p.parameter: p.table for p in profiles}, names=["profiled"])
    curves = curves.reset_index("profiled")
    write_csv(folder / "profile.csv", curves, digits=8)
    write_csv(folder / "profile-intervals.csv", interval_table(profiles), digits=TABLE_DIGITS)
    atomic_write_text(folder / "profile-provenance.json", json_text(record))


def profiles_as_json(profiles: Sequence[Profile]) -> str:
    """Intervals and curves as JSON."""
    records = []
    for row, profile in zip(interval_table(profiles).to_dict("records"), profiles, strict=True):
        curve = {str(k): v for k, v in profile.table.to_dict("list").items()}
        infinite = {k for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)}
        plain = {str(k): None if k in infinite else v for k, v in row.items()}
        records.append({**plain, "curve": curve})
    return json.dumps(records, indent=2, allow_nan=False, ensure_ascii=False)


# --- the command ---------------------------------------------------------------------------------


@click.command("profile")
@opt.argument("source", metavar="SPECIMEN|RUN")
@opt.parameters_option(
    "C1, k1, k2, alpha, kappa, mounting_stretch_x or _y; repeatable [the first five]."
)
@opt.options(ProfileOptions, "law", "mounting", "noise", "mounting_stretch")
@opt.fix_option("Fix a parameter; repeatable.")
@opt.options(ProfileOptions, "fibre_switch")
@opt.mounting_force_option()
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@opt.file_option("out", "Folder [<stem>-profile].")
@opt.json_option("Intervals and curves as JSON.")
def command(source: Path, out: Path | None, as_json: bool, **given: Any) -> None:
    r"""Profile likelihood of parameters of a specimen: what the data alone say.

    At every value of the parameter all others and the mounting stretches are fitted again. A RUN
    folder has its own model options, of which the priors are left out. Writes profile.csv,
    profile-intervals.csv and profile.pdf.

    \b
    biaxbayes profile media.csv --parameter kappa
    """
    folder = out or Path(f"{source.name if source.is_dir() else source.stem}-profile")
    if source.is_dir():  # a run has a model: no defaults of another
        own = (*opt.MODEL, "fix", "priors")
        given = {k: v for k, v in given.items() if k not in own or opt.was_given(k)}
    else:
        given = opt.with_priors(**given)
    result = profile(source, out=folder, **given)
    if as_json:
        click.echo(profiles_as_json(result))
        return
    click.echo("\n".join(curve.in_words() for curve in result))
    click.echo(f"curves in {folder / 'profile.csv'}, figure {folder / 'profile.pdf'}")
