"""``biaxbayes app``: a page in the browser for the other verbs."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

import click

from biaxbayes.errors import InputError
from biaxbayes.verbs.options import flag


@click.command("app")
@click.argument("folder", type=click.Path(path_type=Path), default=Path())
@click.option("--port", type=click.IntRange(1, 65535), help="Port on this machine  [a free one]")
@flag("no-browser", "Open no browser; the address is printed.")
@flag("until-closed", "End when the last page is closed and no run goes on.")
def command(folder: Path, port: int | None, no_browser: bool, until_closed: bool) -> None:
    """Open a page for FOLDER (default: the current one), on this machine only.

    Drop an export of a machine on it, answer what the file leaves open, sample, look at the
    result and take it away. It calls the other commands, and all files are ordinary ones in FOLDER.
    """
    if not folder.is_dir():
        raise InputError("is not a folder", file=folder, remedy="make it first")
    try:
        from biaxbayes.app.pages import PAGES
        from biaxbayes.app.server import serve
    except ModuleNotFoundError as error:
        problem = f"`app` needs the package {error.name}"
        raise InputError(problem, remedy="pip install 'biaxbayes[app]'") from None
    with contextlib.suppress(KeyboardInterrupt):
        try:
            how = {"browser": not no_browser, "until_closed": until_closed}
            asyncio.run(serve(folder.resolve(), PAGES, port=port or 0, **how))
        except OSError as error:
            problem = f"port {port} cannot be used ({error.strerror})"
            raise InputError(problem, remedy="give another `port`, or none") from None
