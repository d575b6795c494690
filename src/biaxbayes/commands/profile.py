"""``biaxbayes profile``: the likelihood along one parameter, everything else re-optimised."""

from __future__ import annotations

from pathlib import Path

import click

from biaxbayes.errors import InputError

__all__ = ["command"]

DEFAULT = ("C1", "k1", "k2", "alpha", "kappa")


@click.command("profile")
@click.argument("specimen", type=click.Path(path_type=Path))
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="C1, k1, k2, alpha, kappa, mounting_stretch_x or _y; repeatable [the first five].",
)
@click.option(
    "--mounting",
    type=click.Choice(["noisy", "exact", "ignored", "zeroed"]),
    default="noisy",
    show_default=True,
    help="How the mounting force enters.",
)
@click.option(
    "--noise",
    type=click.Choice(["effective", "systematic", "independent"]),
    default="effective",
    show_default=True,
    help="Weigh the rows by the independent readings they are worth, or not.",
)
@click.option(
    "--mounting-stretch",
    type=click.Choice(["shared", "per-protocol"]),
    default="shared",
    show_default=True,
    help="One mounted state for all protocols, or one each.",
)
@click.option("--fix", multiple=True, metavar="NAME=VALUE", help="Hold a parameter; repeatable.")
@click.option("--fibre-switch", is_flag=True, help="Fibres carry no compression (Abaqus, FEBio).")
@click.option(
    "--mounting-force",
    nargs=2,
    type=float,
    default=None,
    metavar="X Y",
    help="For a tared file: the force (or stress) at the mounted state, put back on.",
)
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder [<stem>-profile].")
@click.option("--json", "as_json", is_flag=True, help="Intervals and curves as JSON.")
def command(
    specimen: Path,
    parameters: tuple[str, ...],
    mounting: str,
    noise: str,
    mounting_stretch: str,
    fix: tuple[str, ...],
    fibre_switch: bool,
    mounting_force: tuple[float, float] | None,
    workers: int,
    out: Path | None,
    as_json: bool,
) -> None:
    r"""Profile likelihood of parameters of SPECIMEN (a CSV): what the data alone say.

    At every value of the parameter all others and the mounting stretches are fitted again. Writes
    profile.csv, profile-intervals.csv and profile.pdf.

    \b
    biaxbayes profile media.csv --parameter kappa
    """
    from biaxbayes.commands.model_options import specimen_with_mounting_force
    from biaxbayes.findings.profile import profiles
    from biaxbayes.inference.posterior import Posterior
    from biaxbayes.output.figures.profile import profile_figure
    from biaxbayes.output.profile_file import as_json as told
    from biaxbayes.output.profile_file import write_profiles
    from biaxbayes.output.style import save_figure

    fixed = _fixed(fix)
    data = specimen_with_mounting_force(specimen, mounting_force)
    posterior = Posterior(
        data,
        mounting=mounting,
        noise=noise,
        mounting_stretch=mounting_stretch,
        fibre_switch=fibre_switch,
        priors=fixed,
    )
    names = tuple(dict.fromkeys(parameters)) or tuple(n for n in DEFAULT if n not in fixed)
    found = profiles(posterior, names, workers=workers)
    folder = out or Path(f"{specimen.stem}-profile")
    _make(folder)
    about = f"profile likelihood of {data.name}: mounting {mounting}, noise {noise}"
    write_profiles(found, folder, about + "".join(f", {text}" for text in fix))
    save_figure(profile_figure(found), folder / "profile.pdf")
    if as_json:
        click.echo(told(found))
        return
    for profile in found:
        click.echo(profile.in_words())
    click.echo(f"curves in {folder / 'profile.csv'}, figure {folder / 'profile.pdf'}")


def _fixed(texts: tuple[str, ...]) -> dict[str, float]:
    from biaxbayes.inference.priors_file import check_fixed

    out = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        try:
            number = float(value)
        except ValueError:
            raise InputError(f"--fix {text[:60]!r}", remedy="write it as --fix kappa=0.1") from None
        out[name] = check_fixed(name, number)
    if "noise_sd" in out:
        raise InputError("noise_sd is profiled out and cannot be fixed here")
    return out


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder ({error.strerror})", file=folder) from None
