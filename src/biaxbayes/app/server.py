"""The server: on 127.0.0.1, for who has the token in its address, and within one folder."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
import threading
import webbrowser
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from mimetypes import guess_type
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlencode

from bokeh.util.paths import bokehjs_path
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketHandler

from biaxbayes.app.jobs import HIDDEN, jobs
from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.reports.page import page_template
from biaxbayes.tables.sheets import MAX_WORKBOOK_BYTES
from biaxbayes.verbs.convert import BESIDE

HOST = "127.0.0.1"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:;"
    " connect-src 'self'; form-action 'self'; frame-src 'self'; frame-ancestors 'self';"
    " base-uri 'self'"
)
"""Content security policy: no script but those of this server, nothing from elsewhere."""
LOOK_SECONDS, CLOSED_SECONDS = 0.5, 10.0
"""How often the server looks for open pages, and how long there was none when it ends."""


@dataclass
class Place:
    """The folder that is served."""

    folder: Path
    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    pages: int | None = None  # open in a browser; None before the first one
    # one at a time, as figures change matplotlib's settings
    thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))

    @property
    def root(self) -> str:
        """The address of the start page, behind the host."""
        return f"/{self.token}/"

    def holds(self, path: Path) -> bool:
        """Whether a path and what lies in it are in the folder, also behind symbolic links."""
        links = [p for p in path.rglob("*") if p.is_symlink()] if path.is_dir() else []
        return all(p.resolve().is_relative_to(self.folder.resolve()) for p in (path, *links))

    def path(self, name: str) -> Path:
        """A path in the folder by its relative name; InputError for what may lie elsewhere."""
        parts = PurePosixPath(name).parts
        path = self.folder.joinpath(*parts)
        hidden = any(part.startswith(".") or set(part) & set("\\:\0") for part in parts)
        if hidden or not parts or not self.holds(path):
            raise InputError(f"{name[:60]!r} is not a file of the folder {self.folder}")
        return path

    def new_name(self, stem: str, end: str = "") -> str:
        """A name in the folder that is not taken, also not by what is written beside it."""
        number, name = 1, stem
        while any(os.path.lexists(self.folder / (name + e)) for e in (end, *BESIDE)):
            number += 1
            name = f"{stem}-{number}"
        return name + end

    async def until_closed(self) -> None:
        """Wait until no page has been open for some time and no work goes on."""
        closed = 0.0
        while closed < CLOSED_SECONDS:
            await asyncio.sleep(LOOK_SECONDS)
            idle = self.pages == 0 and not any(job.is_running for job in jobs(self.folder))
            closed = (closed + LOOK_SECONDS) * idle


class Guarded(RequestHandler):
    """A request that is refused for another host, or by a page of another origin."""

    place: Place
    by_method: Mapping[str, Answer]

    def initialize(self, place: Place, by_method: Mapping[str, Answer]) -> None:
        """Set the folder, and what answers GET and POST."""
        self.place, self.by_method = place, by_method

    def prepare(self) -> Awaitable[None] | None:
        """Refuse it; also where nothing answers the method."""
        host, origin = self.request.host, self.request.headers.get("Origin")
        own = host in (f"{HOST}:{self.place.port}", f"localhost:{self.place.port}")
        if not own or origin not in (None, f"http://{host}"):
            raise HTTPError(403)
        if self.request.method not in self.by_method:
            raise HTTPError(405 if self.by_method else 403)
        return None

    def write_error(self, status_code: int, **more: Any) -> None:
        """A line of text, which tells nothing to who has not the token."""
        self.set_header("Content-Type", "text/plain")
        self.finish(f"{status_code}: this is not answered; open the address in the terminal\n")


class Open(Guarded, WebSocketHandler):
    """A connection that lasts as long as a page is open."""

    def open(self) -> None:  # type: ignore[override]
        """Count the page."""
        self.place.pages = (self.place.pages or 0) + 1

    def on_close(self) -> None:
        """Count it no more."""
        self.place.pages = (self.place.pages or 1) - 1


class Page(Guarded):
    """A request for a page of the folder."""

    def set_default_headers(self) -> None:
        """No script from elsewhere, no frame of others, no address given away."""
        self.set_header("Content-Security-Policy", POLICY)
        self.set_header("Referrer-Policy", "same-origin")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-store")

    async def prepare(self) -> None:  # type: ignore[override]
        """Answer, whatever the method."""
        super().prepare()
        await self.by_method[self.request.method](self)
        if not self._finished:
            self.finish()

    def show(self, template: str, **values: Any) -> None:
        """Answer with a template."""
        common = {"root": self.place.root, "folder": self.place.folder, "limit": MAX_WORKBOOK_BYTES}
        self.finish(page_template(template, "biaxbayes.app").render(**common, **values))

    def send(self, data: bytes, name: str) -> None:
        """Answer with a file to keep."""
        self.set_header("Content-Type", "application/octet-stream")
        self.set_header("Content-Disposition", f'attachment; filename="{name}"')
        self.finish(data)

    def go_to(self, page: str, **values: Any) -> None:
        """Answer with the address of another page."""
        self.redirect(f"{self.place.root}{page}?{urlencode(values, doseq=True)}")

    def files(self, name: str) -> list[Path]:
        """The paths in the folder that an argument gives, one or more."""
        paths = [self.place.path(text) for text in self.get_arguments(name)]
        if not paths:
            raise InputError("nothing is ticked", remedy="go back, and tick one or more")
        return paths

    async def off_loop(self, work: Callable[[], Any]) -> Any:
        """What work returns that takes seconds, while other pages are answered."""
        return await asyncio.get_running_loop().run_in_executor(self.place.thread, work)

    def write_error(self, status_code: int, **more: Any) -> None:
        """An error as a page: a line for what a user can mend."""
        error = more.get("exc_info", (None, None))[1]
        if isinstance(error, BiaxbayesError):
            self.set_status(400)
            self.show("error.html.jinja", problem=str(error))
        elif status_code == 500:
            problem = f"internal error ({type(error).__name__}); the terminal shows where"
            self.show("error.html.jinja", problem=problem)
        else:
            super().write_error(status_code)

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        """Only defects of this program are logged."""
        if not isinstance(error, BiaxbayesError | HTTPError):
            super().log_exception(kind, error, trace)


Answer = Callable[[Page], Awaitable[None]]
Pages = Mapping[str, Mapping[str, Answer]]
"""What answers an address, by method."""


def application(place: Place, pages: Pages) -> Application:
    """The pages with the files that they load, each address behind the token."""
    package = Path(__file__).parents[1]
    files = {
        "app.js": package / "app", "app.css": package / "app", "style.css": package / "reports",
        "bokeh.min.js": Path(bokehjs_path()) / "js",
    }  # fmt: skip
    answers: dict[str, Any] = dict(pages) | {
        f"static/{name}": {"GET": partial(static, folder / name)} for name, folder in files.items()
    }
    rules: list[Any] = [
        (place.root + name, Page, {"place": place, "by_method": by_method})
        for name, by_method in answers.items()
    ]
    rules.append((place.root + "open", Open, {"place": place, "by_method": {"GET": None}}))
    return Application(
        rules,
        default_handler_class=Guarded,
        default_handler_args={"place": place, "by_method": {}},
        log_function=lambda handler: None,
    )


async def static(path: Path, page: Page) -> None:
    """Answer with a script or a style of the program."""
    page.set_header("Content-Type", guess_type(path.name)[0] or "")
    page.finish(path.read_bytes())


async def serve(
    folder: Path, pages: Pages, *, port: int, browser: bool, until_closed: bool
) -> None:
    """Serve pages on a folder until the last one is closed, or for ever."""
    (socket,) = bind_sockets(port, HOST)
    place = Place(folder, socket.getsockname()[1])
    if not place.holds(folder / HIDDEN):
        raise InputError("links to another folder", file=folder / HIDDEN, remedy="remove it")
    server = HTTPServer(application(place, pages), max_body_size=MAX_WORKBOOK_BYTES + 1_000_000)
    server.add_sockets([socket])
    address = f"http://{HOST}:{place.port}{place.root}"
    print(f"{folder}: open {address}\nCtrl-C ends it", flush=True)
    if browser:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    try:
        await (place.until_closed() if until_closed else asyncio.Event().wait())
    finally:
        server.stop()
        for job in (job for job in jobs(folder) if job.is_running):
            print(f"stopping {job.name}", file=sys.stderr, flush=True)
            job.stop()
        place.thread.shutdown(wait=False, cancel_futures=True)
