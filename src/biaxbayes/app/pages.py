"""The pages: files of the folder, a specimen with its check, a run, and what to do with it."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

from tornado.web import HTTPError

import biaxbayes
from biaxbayes.app.explore import explore
from biaxbayes.app.jobs import STOPPABLE, Job, command_line, is_locked, jobs
from biaxbayes.app.read import read, write
from biaxbayes.app.server import Answer, Page, Place
from biaxbayes.errors import BiaxbayesError, InputError, Interrupted
from biaxbayes.file_lock import NAME as LOCK
from biaxbayes.laws import LAWS
from biaxbayes.options import (
    CARD_PROGRAMS,
    CARD_UNITS,
    ModelOptions,
    Option,
    Options,
    SamplingPlan,
    options_of,
)
from biaxbayes.reports.page import embedded
from biaxbayes.runs.checkpoint import NAMES as CHECKPOINTS
from biaxbayes.runs.folder import PROVENANCE, RUNS, STUDY
from biaxbayes.runs.run import open_run
from biaxbayes.specimens.keys import KEYS
from biaxbayes.text_files import atomic_write_bytes, atomic_write_text, safe_file_name
from biaxbayes.verbs.export import CardOptions
from biaxbayes.verbs.inputs import as_numbers
from biaxbayes.verbs.report import report_text

SHOWN = {".html": "text/html; charset=utf-8", ".png": "image/png"}
"""Files that are shown in a page."""
PASSIVE = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox allow-same-origin; "
    "frame-ancestors 'self'"
)
"""Content security policy of a page that lies in the folder: no scripts."""
TABLES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".xlsx", ".xls", ".ods", ".mat", ".npy", ".npz",
          ".tdms")  # fmt: skip
"""Ends of the names of files that are read; others are not taken."""
RECIPE = "-recipe.toml"
REPORTS = ("report.html", "study.html", "compare.html", "design.png")
"""The page of a result."""


def is_specimen(path: Path) -> bool:
    """Whether a file begins with a header line of a specimen file."""
    with path.open("rb") as file:
        lines = file.read(4_000).decode("utf-8", errors="replace").splitlines()
    return any(line[1:].partition(":")[0].strip() in KEYS for line in lines if line[:1] == "#")


class Result(NamedTuple):
    """A run, study or comparison of the folder, finished or not."""

    name: str  # path in the folder
    job: Job
    kind: str
    state: str  # of a finished run its verdict
    note: str = ""


def result_at(place: Place, name: str) -> Result | None:
    """What a sub-folder, or work that was asked for, has come to."""
    path, job = place.path(name), Job(place.folder, name)
    message = str(job.progress["message"])
    if job.is_running:
        return Result(name, job, "", "running")
    if is_locked(path / LOCK):
        return Result(name, job, "", "being written")
    if (path / PROVENANCE).exists():
        try:
            run = open_run(path)
            return Result(name, job, "run", run.state, str(run.provenance["specimen"]))
        except BiaxbayesError as error:
            return Result(name, job, "run", "damaged", str(error))
    finished = {"study.html": "study", "compare.html": "comparison", "design.png": "design"}
    for file, kind in finished.items():
        if (path / file).exists():
            return Result(name, job, kind, "finished", message * (kind == "design"))
    unfinished = any((path / file).exists() for file in (*CHECKPOINTS, STUDY))
    if unfinished or job.progress.get("code") == Interrupted.exit_code:
        return Result(name, job, "", "stopped", message)
    return Result(name, job, "", "failed", message) if job.asked else None


def results(place: Place) -> list[Result]:
    """All results of the folder and of the studies in it, those of the latest work first."""
    folders = [p for p in sorted(place.folder.iterdir()) if p.is_dir() and p.name[0] != "."]
    folders += [run for p in folders for run in sorted((p / RUNS).glob("*"))]
    works = [place.folder / job.name for job in jobs(place.folder)]
    held = (path.relative_to(place.folder) for path in works + folders if place.holds(path))
    names = dict.fromkeys(path.as_posix() for path in held)
    return [result for name in names if (result := result_at(place, name))]


async def home(page: Page) -> None:
    """Where a file is dropped; files, specimens and results of the folder."""
    place = page.place
    names = [
        p.name
        for p in sorted(place.folder.iterdir())
        if p.suffix.lower() in TABLES and p.name[0] != "." and p.is_file() and place.holds(p)
    ]
    specimens = [name for name in names if is_specimen(place.folder / name)]
    files = [name for name in names if name not in specimens]
    found = await page.off_loop(lambda: results(place))
    page.show("home.html.jinja", files=files, specimens=specimens, results=found)


async def upload(page: Page) -> None:
    """Write files into the folder, beside those of the same name, and show what they are."""
    names, folder = [], page.place.folder
    for file in page.request.files.get("file", []):
        given = Path(file.filename.replace("\\", "/"))
        stem, end = safe_file_name(given.stem, "file"), given.suffix.lower()
        if end not in TABLES and not given.name.endswith(RECIPE):
            remedy = f"files are {', '.join(TABLES)}"
            raise InputError(f"{given.name[:60]!r} is not a table", remedy=remedy)
        name = stem + end
        if not ((folder / name).is_file() and (folder / name).read_bytes() == file.body):
            name = page.place.new_name(stem, end)
            atomic_write_bytes(folder / name, file.body)
        names.append(name)
    tables = [name for name in names if not name.endswith(RECIPE)]
    recipe = [name for name in names if name.endswith(RECIPE)]
    to = "read" if tables else ""
    if tables and all(is_specimen(folder / name) for name in tables):
        to = "specimen"
    page.go_to(to, file=tables, recipe=recipe)


def controls(*tables: type[Options]) -> dict[str, tuple[Option, Any]]:
    """Option and default of each control of a form."""
    found = {n: (o, getattr(table, n)) for table in tables for n, o in options_of(table).items()}
    if "law" in found:  # by its name: no file is read
        option, default = found["law"]
        found["law"] = (Option(option.help.partition(",")[0] + ".", tuple(LAWS)), default)
    return found


def given_options(page: Page, *tables: type[Options]) -> dict[str, Any]:
    """Values of the controls that are not the defaults, as a verb takes them."""
    values: dict[str, Any] = {}
    for name, (option, default) in controls(*tables).items():
        value: Any = page.get_argument(name, "").strip()
        if value and option.kind in (int, float):
            with contextlib.suppress(ValueError):  # refused below
                value = option.kind(value.replace(",", "."))
        elif option.kind is bool:
            value = bool(value)
        if option.choices and value and value not in option.choices:
            raise InputError(f"`{name}` must be one of {', '.join(option.choices)}")
        if value not in ("", default):
            values[name] = value
    for table in tables:
        table.split(values)  # refuses what it does not allow
    return values


async def specimen(page: Page) -> None:
    """A specimen, or several: check and sampling."""
    files = page.files("file")
    page.show(
        "specimen.html.jinja",
        files=[path.name for path in files],
        out=page.place.new_name(files[0].stem + ("-posterior" if len(files) == 1 else "-study")),
        plan=controls(SamplingPlan),
        model=controls(ModelOptions),
    )


async def check(page: Page) -> None:
    """Findings of one specimen beside the picture."""
    (path,) = page.files("file")

    def checked() -> tuple[Any, bytes]:
        with tempfile.TemporaryDirectory() as folder:
            figure = Path(folder) / "check.png"
            return biaxbayes.check(path, figure=figure), figure.read_bytes()

    found, picture = await page.off_loop(checked)
    line = command_line("check", [path.name], {})
    page.show("check.html.jinja", checked=found, picture=embedded(picture), line=line)


async def sample(page: Page) -> None:
    """Start sampling: one specimen, pieces of one tissue, or a study of groups."""
    folder, files = page.place.folder, [path.name for path in page.files("file")]
    name = safe_file_name(page.get_argument("out"), "run")
    if page.place.new_name(name) != name:
        raise InputError(f"{name!r} exists already", remedy="choose another name")
    options = given_options(page, SamplingPlan, ModelOptions)
    if page.get_argument("anyway", ""):
        options["anyway"] = True
    if page.get_argument("as", "") == "study":
        toml = page.place.new_name(name, ".toml")
        atomic_write_text(folder / toml, study_text(page, name, files, options))
        workers = {"workers": options["workers"]} if "workers" in options else {}
        Job(folder, name).start("batch", [toml], {"out": name} | workers)
    else:
        if force := page.get_argument("mounting_force", "").replace(",", ".").split():
            options["mounting_force"] = as_numbers(force, "mounting_force", 2).tolist()
        arguments = [files[0] if len(files) == 1 else files]
        Job(folder, name).start("sample", arguments, {"out": name} | options)
    page.go_to("result", name=name)


def study_text(page: Page, name: str, files: list[str], options: dict[str, Any]) -> str:
    """A study file of some specimens with their groups and donors."""
    if len(files) < 2:
        raise InputError("a study needs two specimens or more", remedy="tick them")
    model = {key: options[key] for key in options_of(ModelOptions) if key in options}
    own = {k: v for k, v in options.items() if k not in model and k != "workers"}
    tables = [("", {"name": name} | own), ("[options]", model)]
    for number, file in enumerate(files):
        labels = {k: page.get_arguments(k)[number : number + 1] for k in ("layer", "donor")}
        given = {key: texts[0] for key, texts in labels.items() if any(texts)}
        tables.append(("[[specimen]]", {"file": file} | given))
    return "\n".join(
        "\n".join([head, *(f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in lines.items())])
        for head, lines in tables
    )


async def result(page: Page) -> None:
    """A run while it is made, and when it is finished; a study; a comparison."""
    (path,) = page.files("name")
    found = result_at(page.place, page.get_argument("name"))
    if found is None:
        raise InputError(f"{path.name[:60]!r} is not a result of biaxbayes")
    files = [p.relative_to(path).as_posix() for p in sorted(path.rglob("*")) if p.is_file()]
    reports = [name for name in REPORTS if name in files and found.state != "running"]
    page.show(
        "result.html.jinja",
        result=found,
        report=reports[0] if reports else "",
        files=[name for name in files if not any(part[0] == "." for part in name.split("/"))],
        programs=CARD_PROGRAMS,
        units=CARD_UNITS,
        stoppable=STOPPABLE,
        line=command_line(**found.job.asked) if found.job.asked else "",
    )


async def change(page: Page) -> None:
    """Stop the work that makes a result, let it go on, or rank further measurements of a run."""
    (path,), name = page.files("name"), page.get_argument("name")
    job, do = Job(page.place.folder, name), page.get_argument("do")
    asked = job.asked
    if do == "design":
        run, name = name, page.place.new_name(f"{path.name}-design")
        Job(page.place.folder, name).start("design", [run], {"out": name})
    elif asked and do == "stop":
        job.stop()
    elif asked:
        # the folder may come from elsewhere: nothing is done but what the page asks for
        paths = [p for one in asked["arguments"] for p in (one if isinstance(one, list) else [one])]
        for path in paths:
            page.place.path(str(path))
        if asked["verb"] not in STOPPABLE or asked["options"].get("out") != name:
            raise InputError(f"{name[:60]!r} cannot be resumed here", remedy="use the command line")
        more = {"resume": True} if asked["verb"] == "sample" else {}
        job.start(asked["verb"], asked["arguments"], asked["options"] | more)
    page.go_to("result", name=name)


async def state(page: Page) -> None:
    """Progress of all work by name, for the page that shows it."""
    works = jobs(page.place.folder)
    page.finish({j.name: {"running": j.is_running, "log": j.log, **j.progress} for j in works})


async def cards(page: Page) -> None:
    """Material cards as an archive; nothing is written into the run."""
    (run,) = page.files("name")
    to, options = page.get_argument("to"), given_options(page, CardOptions)

    def made() -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / f"cards-{safe_file_name(to)}-{options.get('units', CARD_UNITS[0])}"
            biaxbayes.export(run, to, out=out, **options)
            return archive(out)

    name = safe_file_name(f"{run.name}-cards-{to}")
    page.send(await page.off_loop(made), f"{name}.zip")


async def take(page: Page) -> None:
    """A file of the folder, shown or to keep; a folder as an archive; the table as LaTeX."""
    (path,), kind = page.files("name"), page.get_argument("as", "file")
    stem = safe_file_name(path.stem, "file")
    if kind == "latex":
        text = await page.off_loop(lambda: report_text(path, "latex"))
        page.send(text.encode(), f"{stem}-report.tex")
    elif path.is_dir():
        page.send(await page.off_loop(lambda: archive(path)), f"{stem}.zip")
    elif not path.is_file():
        raise HTTPError(404)
    elif kind == "page" and path.suffix in SHOWN:
        page.set_header("Content-Type", SHOWN[path.suffix])
        page.set_header("Content-Security-Policy", PASSIVE)
        page.finish(path.read_bytes())
    else:
        page.send(path.read_bytes(), f"{stem}.{safe_file_name(path.suffix)}")


def archive(folder: Path) -> bytes:
    """A folder as a ZIP archive, without hidden files and links."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(folder.rglob("*")):
            inner = path.relative_to(folder.parent)
            hidden = any(part.startswith(".") for part in inner.parts)
            if path.is_file() and not path.is_symlink() and not hidden:
                file.write(path, inner.as_posix())
    return data.getvalue()


async def compare(page: Page) -> None:
    """Start to compare runs into a new folder."""
    page.files("run")
    name = page.place.new_name("comparison")
    Job(page.place.folder, name).start("compare", [page.get_arguments("run")], {"out": name})
    page.go_to("result", name=name)


PAGES: dict[str, dict[str, Answer]] = {
    "": {"GET": home},
    "upload": {"POST": upload},
    "read": {"GET": read, "POST": write},
    "specimen": {"GET": specimen},
    "check": {"GET": check},
    "sample": {"POST": sample},
    "result": {"GET": result, "POST": change},
    "explore": {"GET": explore},
    "state": {"GET": state},
    "cards": {"GET": cards},
    "take": {"GET": take},
    "compare": {"POST": compare},
}
"""What answers each address behind the token."""
