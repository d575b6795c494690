"""The page in the browser: what a server answers, and a real browser from a raw file to a card."""

import html
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import numpy as np
import pandas as pd
import pytest

import biaxbayes
from biaxbayes.app.explore import Explored
from biaxbayes.app.jobs import Job, command_line
from biaxbayes.app.server import CLOSED_SECONDS, Place
from biaxbayes.errors import InputError
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.tables.sheets import MAX_WORKBOOK_BYTES

pytestmark = pytest.mark.long
DATA = Path(__file__).resolve().parents[1] / "data"


@dataclass
class App:
    """A server in a process of its own."""

    folder: Path
    address: str
    process: subprocess.Popen

    def ask(self, page: str, headers: dict[str, str] | None = None, **values: object) -> str:
        """The body of a page; HTTPError for a refusal."""
        address = self.address + page + ("?" + urlencode(values, doseq=True) if values else "")
        with urlopen(Request(address, headers=headers or {})) as answer:
            return answer.read().decode()

    def send(self, page: str, content: bytes = b"", kind: str = "", **values: object) -> str:
        """The address that a form leads to."""
        content = content or urlencode(values, doseq=True).encode()
        kind = kind or "application/x-www-form-urlencoded"
        with urlopen(Request(self.address + page, content, {"Content-Type": kind})) as answer:
            return answer.url.removeprefix(self.address)

    def end(self) -> None:
        """End the server as Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(30) == 0
        assert self.process.stdout is not None
        self.process.stdout.close()

    def drop(self, name: str, content: bytes) -> str:
        """The address that a file leads to."""
        head = f'--b\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n\r\n'
        body = head.encode() + content + b"\r\n--b--\r\n"
        return self.send("upload", body, "multipart/form-data; boundary=b")


def started(folder: Path, *options: str) -> App:
    command = [sys.executable, "-m", "biaxbayes", "app", str(folder), "--no-browser", *options]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True,
        # a background job ignores it, and what it starts
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found
    return App(folder, found[0], process)


@pytest.fixture(scope="module")
def app(tmp_path_factory) -> Iterator[App]:
    app = started(tmp_path_factory.mktemp("folder"))
    yield app
    app.end()


def code_of(app: App, page: str = "", **headers: str) -> int:
    try:
        app.ask(page, headers)
    except HTTPError as error:
        with error:
            return error.code
    return 200


def refusal(work: Callable[[], object]) -> str:
    """What the page of a refusal says."""
    with pytest.raises(HTTPError) as refused:
        work()
    with refused.value as error:
        assert error.code == 400
        return html.unescape(error.read().decode())


def test_only_who_has_the_token_at_this_address_is_answered(app):
    host = app.address.split("/")[2]
    assert code_of(app) == 200
    assert code_of(app, Host="evil.example") == 403
    assert code_of(app, Host=f"evil.example:{host[10:]}") == 403
    assert code_of(app, Origin="http://evil.example") == code_of(app, Origin="null") == 403
    assert code_of(app, Origin=f"http://{host}") == 200
    without = App(app.folder, f"http://{host}/", app.process)
    for page in ("", "state", "open", "static/app.js", "x" * 32 + "/"):
        assert code_of(without, page) == 403
    for page in ("open", "static/app.js", "state"):
        assert code_of(app, page, Host="evil.example") == 403
        assert code_of(app, page, Origin="http://evil.example") == 403
    with urlopen(app.address) as page:
        policy = page.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "http" not in policy


@pytest.mark.parametrize(
    "name", ["../secret.csv", "/etc/hostname", ".biaxbayes-app", "a/../../secret.csv", "link.csv",
             "..\\secret.csv", "", "nul\0.csv"],
)  # fmt: skip
def test_nothing_outside_of_the_folder_is_read(name, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret.csv").write_text("secret")
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(InputError, match="is not a file of the folder"):
        Place(folder, 1).path(name)
    assert Place(folder, 1).path("study/runs/one") == folder / "study" / "runs" / "one"


def test_files_are_taken_by_name_and_kind_and_never_replaced(app):
    table = b"a,b\n1,2\n"
    for name in ("law.py", "page.html", "x.csv.exe", "noend"):
        assert "is not a table" in refusal(lambda name=name: app.drop(name, table))
    app.drop("../../../up <b>x.csv", table)
    app.drop("same.csv", table)
    app.drop("same.csv", table)
    app.drop("same.csv", table + b"3,4\n")
    names = {p.name for p in app.folder.iterdir() if p.suffix == ".csv"}
    assert names == {"up-b-x.csv", "same.csv", "same-2.csv"}
    assert not any(p.suffix == ".csv" for p in app.folder.parent.iterdir())
    assert (app.folder / "same.csv").read_bytes() == table


def test_a_law_in_a_file_is_not_run(app):
    shutil.copy(DATA / "donor1.csv", app.folder / "d.csv")
    law = app.folder.parent / "law.py"
    law.write_text("raise SystemExit('ran')")
    said = refusal(lambda: app.send("sample", file="d.csv", out="r", law=str(law)))
    assert "must be one of" in said and not (app.folder / "r").exists()


def test_hostile_names_stay_text(app, hostile_run):
    shutil.copytree(hostile_run.path, app.folder / "<img src=x onerror=alert(1)>")
    name = "<img src=x onerror=alert(1)>"
    pages = app.ask(""), app.ask("result", name=name), app.ask("explore", name=name)
    for page in pages:
        assert "<img src=x" not in page and "<script>document" not in page


def test_a_file_of_30_mb(app):
    row = b"0.01,1.001,1.002,0.5,0.4\n"
    content = b"time (s),lx,ly,Fx (N),Fy (N)\n" + row * (30_000_000 // len(row))
    assert "has more than" in refusal(lambda: app.drop("large.csv", content))
    assert (app.folder / "large.csv").read_bytes() == content


def test_more_than_the_largest_file_is_not_taken(app):
    with pytest.raises(OSError):
        app.drop("larger.csv", bytes(MAX_WORKBOOK_BYTES + 2_000_000))
    assert not (app.folder / "larger.csv").exists() and "Drop files here" in app.ask("")


def test_what_links_lead_to_is_not_shown(app, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.txt").write_text("# specimen: secret")
    (app.folder / "link.txt").symlink_to(outside / "secret.txt")
    (app.folder / "linked-folder").symlink_to(outside)
    (app.folder / "dangling.csv").symlink_to(outside / "made.csv")
    run = app.folder / "run-with-link"
    run.mkdir()
    (run / "report.html").symlink_to(outside / "secret.txt")
    shown = app.ask("")
    assert not any(name in shown for name in ("link.txt", "linked-folder", "run-with-link"))
    names = ("run-with-link", "run-with-link/report.html", "linked-folder/secret.txt", "link.txt")
    for name in names:
        said = refusal(lambda name=name: app.ask("take", name=name))
        assert "is not a file of the folder" in said
    # neither does what is dropped go there
    assert app.drop("dangling.csv", b"a,b\n1,2\n") == "read?file=dangling-2.csv"
    assert not (outside / "made.csv").exists()


def test_a_folder_whose_record_lies_elsewhere_is_refused(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / ".biaxbayes-app").symlink_to(tmp_path)
    command = [sys.executable, "-m", "biaxbayes", "app", str(tmp_path / "folder"), "--no-browser"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and "links to another folder" in ended.stderr


def test_resuming_does_what_the_page_asks_for_alone(app, tmp_path):
    """A folder may come from somebody else, with what is to be resumed."""
    (app.folder / "donor.csv").write_bytes((DATA / "donor1.csv").read_bytes())
    hostile = {
        "verb": ("report", ["donor.csv"], {"out": "hostile"}),
        "out": ("sample", ["donor.csv"], {"out": str(tmp_path / "elsewhere")}),
        "file": ("sample", [["donor.csv", "../secret.csv"]], {"out": "hostile"}),
    }
    for verb, arguments, options in hostile.values():
        asked = {"verb": verb, "arguments": arguments, "options": options}
        (app.folder / ".biaxbayes-app").mkdir(exist_ok=True)
        (app.folder / ".biaxbayes-app" / "hostile.json").write_text(json.dumps(asked))
        said = refusal(lambda: app.send("result", name="hostile", do="resume"))
        assert "cannot be resumed" in said or "is not a file of the folder" in said
    assert not Job(app.folder, "hostile").is_running and not (tmp_path / "elsewhere").exists()
    (app.folder / ".biaxbayes-app" / "hostile.json").unlink()


def test_answers_name_options_of_reading_alone(app):
    app.drop("table.csv", b"a,b\n1,2\n")
    page = app.ask("read", file="table.csv", overwrite="true", protocol_names="x", raw="y", out="o")
    assert "--overwrite" not in page and "internal error" not in page


def test_answers_are_shown_at_their_columns_and_in_the_command(app):
    rows = "".join(f"{0.2 * i:g},{0.1 * i:g},{i * i:g},{2 * i * i:g},a\n" for i in range(9))
    app.drop("answers.csv", f"ux,uy,Fx,Fy,label\n{rows}".encode())
    columns = {
        "columns:stretch_x": "1 + {ux} / 20", "columns:stretch_y": "1 + {uy} / 20",
        "columns:force_x_N": "Fx:mN", "columns:force_y_N": "Fy:mN",
    }  # fmt: skip
    page = app.ask("read", file="answers.csv", drop_missing="true", machine="generic", **columns)
    chosen = {}
    for name, options in re.findall(r'<select data-column="(\w+)".*?>(.*?)</select>', page, re.S):
        chosen[name] = re.findall(r"<option selected>(\w+)", options)
    assert chosen == {
        "ux": ["stretch_x"], "uy": ["stretch_y"], "Fx": ["force_x_N"], "Fy": ["force_y_N"],
        "label": [],
    }  # fmt: skip
    line = shlex.split(html.unescape(re.findall(r'<pre class="paste">(.*?)</pre>', page, re.S)[0]))
    after = line[line.index("--drop-missing") + 1]
    assert after.startswith("--") and "stretch_x=1 + {ux} / 20" in line
    assert re.search(r'<svg class="drawing"[^>]*><title>edge_x_mm', page)


def test_commands_can_be_pasted():
    options = {"out": "a b", "sheets": ["S 1", "S2"], "mounting_force": [0.1, 0.2], "anyway": True}
    line = command_line("sample", [["x.csv", "y.csv"]], options)
    assert shlex.split(line) == [
        "biaxbayes", "sample", "x.csv", "y.csv", "--out", "a b", "--sheet", "S 1", "--sheet", "S2",
        "--mounting-force", "0.1", "0.2", "--anyway",
    ]  # fmt: skip


def cells(page: str) -> dict[str, list[str]]:
    """Rows of the table of a page by their first cell."""
    rows = re.findall(r'<th class="name">([^<( ]+).*?</th>(.*?)</tr>', page, re.S)
    return {name: re.findall(r'<td class="n">([^<]*)</td>', row) for name, row in rows}


def test_draws_in_a_range_and_other_priors(app, media_run):
    shutil.copytree(media_run.path, app.folder / "media", dirs_exist_ok=True)
    draws = media_run.draws
    everything = cells(app.ask("explore", name="media"))
    middle = float(np.median(draws["C1"]))
    chosen = cells(app.ask("explore", name="media", **{"low C1": middle}))
    assert chosen["k1"][0] == everything["k1"][0]  # all draws
    q50 = float(np.median(draws["k1"][draws["C1"] >= middle]))
    assert float(chosen["k1"][1].split()[0]) == pytest.approx(q50, rel=0.15)
    assert float(chosen["C1"][1].split()[0]) > middle
    # weights of another prior of alpha, against weights computed here
    prior = {"prior kappa high": 0.2}
    now = cells(app.ask("explore", name="media", **prior))["kappa"][1]
    assert float(now.split()[0]) == pytest.approx(
        float(np.median(draws["kappa"][draws["kappa"] <= 0.2])), abs=0.02
    )
    narrow = app.ask("explore", name="media", **{"prior mounting_stretch_x scale": 1e-5})
    assert "These priors are refused" in narrow
    assert "must be positive" in refusal(
        lambda: app.ask("explore", name="media", **{"prior C1 sd_log": -1})
    )


def test_weights_of_another_heavy_tailed_prior(media_run):
    explored = Explored(media_run, {"prior mounting_stretch_x scale": "0.02"})
    x = explored.draws["mounting_stretch_x"].to_numpy() - 1.0
    # Student t of three degrees of freedom: p ~ (1 + z^2 / 3)^-2
    ratio = ((1.0 + (x / 0.1) ** 2 / 3.0) / (1.0 + (x / 0.02) ** 2 / 3.0)) ** 2
    np.testing.assert_allclose(explored.prior_weights, ratio / ratio.max(), rtol=1e-12)


def test_cards_are_those_of_the_command(app, media_run, tmp_path):
    shutil.copytree(media_run.path, app.folder / "media", dirs_exist_ok=True)
    values = urlencode({"name": "media", "to": "abaqus", "units": "MPa-mm", "draws": 2})
    with urlopen(f"{app.address}cards?{values}") as answer:
        archive = zipfile.ZipFile(io.BytesIO(answer.read()))
    biaxbayes.export(media_run, "abaqus", units="MPa-mm", draws=2, out=tmp_path / "cards")
    inside = {Path(name).name: archive.read(name) for name in archive.namelist()}
    assert inside == {p.name: p.read_bytes() for p in (tmp_path / "cards").iterdir()}
    assert not list((app.folder / "media").glob("cards*"))


def test_further_measurements_are_ranked_while_other_pages_are_answered(app, media_run):
    shutil.copytree(media_run.path, app.folder / "media", dirs_exist_ok=True)
    assert app.send("result", name="media", do="design") == "result?name=media-design"
    job, made = Job(app.folder, "media-design"), app.folder / "media-design" / "design.csv"
    assert job.is_running and "Stop" in app.ask("result", name=job.name)
    until(lambda: "ranking" in job.progress["phase"])
    begin = time.monotonic()
    app.ask("result", name="media")
    assert job.is_running or time.monotonic() - begin < 2.0
    app.send("result", name=job.name, do="stop")
    until(lambda: not job.is_running)
    page = app.ask("result", name=job.name)
    assert re.search(r"Stopped: <bdi>interrupted after \d+ of \d+ candidates", page)
    assert not made.exists()
    app.send("result", name=job.name, do="resume")
    until(lambda: not job.is_running)
    ranked = biaxbayes.design(media_run)
    assert pd.read_csv(made)["candidate"].unique().tolist() == [e.name for e in ranked.expected]
    assert ranked.conclusion[1:] in html.unescape(app.ask("result", name=job.name))
    assert not (app.folder / "media" / "design.csv").exists()


def test_the_server_ends_and_its_work_is_stopped(tmp_path):
    app = started(tmp_path)
    shutil.copy(DATA / "donor1.csv", tmp_path)
    app.send("sample", file="donor1.csv", out="r")
    job = Job(tmp_path, "r")
    assert job.is_running and json.loads(app.ask("state"))["r"]["running"]
    until(lambda: job.progress["phase"] != "starting")
    app.end()
    until(lambda: not job.is_running)
    assert job.progress["code"] == 130


def test_the_server_ends_some_time_after_the_last_page(chromium, tmp_path):
    app = started(tmp_path, "--until-closed")
    tabs = [new_tab(chromium) for _ in range(2)]
    for tab in tabs:
        tab.goto(app.address)
    tabs[0].close()
    time.sleep(CLOSED_SECONDS + 3.0)
    tabs[1].reload()  # a page is open: the server still answers, however long nothing is asked
    assert app.process.poll() is None
    begin = time.monotonic()
    tabs[1].close()
    assert app.process.wait(60) == 0
    assert CLOSED_SECONDS - 1.0 < time.monotonic() - begin < CLOSED_SECONDS + 20.0
    assert app.process.stdout is not None
    app.process.stdout.close()


def states(app: App) -> dict[str, str]:
    """States of the results on the start page, by name."""
    rows = re.findall(r"<bdi>([^<]*)</bdi></a></th>\s*<td>.*?</td><td[^>]*>([^<]*)<", app.ask(""))
    return {html.unescape(name): state for name, state in rows}


def until(done, seconds: float = 300.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.2)


# --- in a browser --------------------------------------------------------------------------------


def export(path: Path) -> None:
    """Two ratios of three cycles each, in the form of a German machine with crossed units."""
    rows = []
    for ratio in ((1.0, 1.0), (1.0, 0.5)):
        test = virtual_test(
            biaxbayes.GOH(12.0, 60.0, 8.0, 40.0, 0.15), mounting_stretch=(1.02, 1.015),
            measured_stretch=1.18, ratio=ratio, increments=39, edge_x_mm=10.0, edge_y_mm=10.0,
            thickness_mm=1.2,
        )  # fmt: skip
        up = np.hstack([(test.measured - 1.0) * [10.2, 10.15], 1000.0 * test.force_N])
        rows += [np.repeat(up[:1], 5, axis=0), up, up[-2:0:-1] * [1, 1, 0.8, 0.8]] * 3
    table = np.concatenate(rows)
    table[:, 2:] += np.random.default_rng(1).normal(0.0, 0.5, (len(table), 2))
    lines = ["Zeit (s);Weg X (mm);Weg Y (mm);Kraft A (mN);Kraft B (mN)"]
    for i, row in enumerate(table):
        lines.append(";".join(f"{v:.6f}" for v in (0.1 * i, *row)).replace(".", ","))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def new_tab(chromium, **how):
    """A tab that waits for pages also where other work goes on."""
    page = chromium.new_page(**how)
    page.set_default_timeout(120_000)
    return page


def answer(page, name: str, value: str) -> None:
    """Type into a control, as somebody who then goes on to the next one."""
    with page.expect_response(lambda response: "/read?" in response.url):
        control = page.locator(f'input[name="{name}"]')
        control.fill(value)
        control.blur()
    page.wait_for_selector("body:not(.busy)")


END = """([panel, branch]) => {
  const column = [...Bokeh.index.roots].filter(view => view.child_views).at(-1);
  const models = [...column.model.document._all_models.values()];
  const boxes = models.filter(model => model.name === "kept"), figure = column.child_views[panel];
  const { left, top } = figure.el.getBoundingClientRect(), { frame } = figure;
  const x = frame.x_scale.compute(boxes[2 * panel + branch].right);
  return [left + x, top + frame.bbox.top + 0.5 * frame.bbox.height];
}"""


def drop(page, path: Path) -> None:
    """Drop a file where the page takes it, as from a file manager."""
    box = page.locator("input[type=file]").bounding_box()
    at = {"x": box["x"] + 0.7 * box["width"], "y": box["y"] + 0.5 * box["height"]}
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
    tools = page.context.new_cdp_session(page)
    for kind in ("dragEnter", "dragOver", "drop"):
        tools.send("Input.dispatchDragEvent", {"type": kind, "data": data, **at})


def dragged(page, panel: int, branch: int) -> list[int]:
    """First and last lines of two branches, once the end of one is dragged in a panel."""
    page.wait_for_selector(".plot .bk-Column")
    page.locator(".plot").scroll_into_view_if_needed()
    x, y = page.evaluate(END, [panel, branch])
    with page.expect_response(lambda response: "rows=" in response.url):
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - 30, y, steps=5)
        page.mouse.up()
    page.wait_for_selector("body:not(.busy)")
    rows = re.fullmatch(
        r"(\d+):(\d+),(\d+):(\d+)", page.locator('input[name="rows"]').input_value()
    )
    assert rows
    return [int(line) for line in rows.groups()]


def test_from_a_raw_file_to_a_card(chromium, app, tmp_path):
    raw = tmp_path / "Probe 7.csv"
    export(raw)
    page = new_tab(chromium, viewport={"width": 1280, "height": 900})
    problems: list[str] = []
    outside: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    page.on("request", lambda r: None if r.url.startswith((app.address, "data:", "blob:"))
            else outside.append(r.url))  # fmt: skip
    page.goto(app.address)
    drop(page, raw)
    page.wait_for_url("**/read?**")
    # two wrong proposals: the length between the marks, and the cells
    answer(page, "columns:stretch_x", "1 + {Weg X (mm)} / 10.2")
    answer(page, "columns:stretch_y", "1 + {Weg Y (mm)} / 10.15")
    for column, target in (("Kraft A (mN)", "force_x_N"), ("Kraft B (mN)", "force_y_N")):
        with page.expect_response(lambda response: "/read?" in response.url):
            page.locator(f'select[data-column="{column}"]').select_option(target)
        page.wait_for_selector("body:not(.busy)")
    sizes = {"edge_x_mm": "10", "edge_y_mm": "10", "thickness_mm": "1.2", "geometry": "unloaded"}
    for name, value in sizes.items():
        answer(page, name, value)
    # the end of the second branch is dragged in the upper panel, of the first in the lower
    before = dragged(page, panel=0, branch=1)
    rows = dragged(page, panel=1, branch=0)
    assert rows[1] < before[1] and rows[:1] + rows[2:] == before[:1] + before[2:]
    command = shlex.split(page.locator("pre.paste").inner_text())
    page.click("text=Write it, and check")
    page.wait_for_url("**/specimen?**")
    page.wait_for_selector(".findings img, .findings li, figure img")
    written = app.folder / command[command.index("--out") + 1]
    counts = [p.rows for p in biaxbayes.read_specimen(written).protocols]
    assert counts == [rows[1] - rows[0] + 1, rows[3] - rows[2] + 1]
    command[command.index("--out") + 1] = str(tmp_path / "by-command.csv")
    subprocess.run([sys.executable, "-m", *command], cwd=app.folder, check=True, env=os.environ)
    assert (tmp_path / "by-command.csv").read_bytes() == written.read_bytes()
    # sampled with few draws, in two tabs; stopped, and resumed
    page.fill('input[name="ess"]', "50")
    page.click("button.main")
    page.wait_for_selector(".job")
    job = Job(app.folder, f"{written.stem}-posterior")
    other = new_tab(chromium)
    other.goto(page.url)
    page.close()
    until(lambda: "warming" in job.progress["phase"] or "sampling" in job.progress["phase"])
    other.wait_for_selector(".phase:has-text('warming'), .phase:has-text('sampling')")
    other.click("text=Stop; it can be resumed")
    other.wait_for_selector("button[value=resume]", timeout=120_000)
    assert not job.is_running and job.progress["code"] == 130
    other.click("button[value=resume]")
    other.wait_for_selector("iframe.whole", timeout=300_000)
    report = other.frame_locator("iframe.whole")
    report.locator("figure img[alt^='Corner plot']").wait_for()
    assert report.locator("table").first.inner_text().count("\n") > 5
    other.click("summary:has-text('Cards')")
    with other.expect_download() as download:
        other.click("text=Cards, as ZIP")
    archive = zipfile.ZipFile(download.value.path())
    biaxbayes.export(app.folder / job.name, "abaqus", out=tmp_path / "cards", anyway=True)
    card = next(p for p in sorted((tmp_path / "cards").iterdir()) if p.suffix == ".inp")
    name = next(name for name in archive.namelist() if name.endswith(card.name))
    assert archive.read(name) == card.read_bytes()
    other.close()
    assert problems == [] and outside == []


def test_a_box_in_a_pair_gives_the_ranges(chromium, app, media_run):
    shutil.copytree(media_run.path, app.folder / "media", dirs_exist_ok=True)
    page = new_tab(chromium, viewport={"width": 1280, "height": 1400})
    page.goto(f"{app.address}explore?name=media")
    page.wait_for_selector("#corner .bk-Figure")
    page.wait_for_timeout(500)
    figure = page.locator("#corner .bk-Figure").nth(1).bounding_box()
    assert figure is not None
    right, top = figure["x"] + figure["width"], figure["y"]
    with page.expect_response(lambda response: "low+C1=" in response.url):
        page.mouse.move(right - 80, top + 10)
        page.mouse.down()
        page.mouse.move(right - 30, top + 70, steps=3)
        page.mouse.up()
    page.wait_for_selector("body:not(.busy)")
    low, high = (page.locator(f'input[name="{end} C1"]').input_value() for end in ("low", "high"))
    few = np.count_nonzero(
        (media_run.draws["C1"] >= float(low)) & (media_run.draws["C1"] <= float(high))
    )
    assert 0 < few < len(media_run.draws)
    said = page.locator("text=draws are in the ranges").inner_text()
    assert 0 < int(said.split()[0]) < int(said.split()[2])
    page.close()


def test_two_runs_are_compared_from_the_list(chromium, app, media_run):
    for name in ("first", "second"):
        shutil.copytree(media_run.path, app.folder / name, dirs_exist_ok=True)
    page = new_tab(chromium)
    page.goto(app.address)
    for name in ("first", "second"):
        page.check(f'input[name="run"][value="{name}"]')
    page.click("text=Compare the ticked runs")
    page.wait_for_selector("iframe.whole", timeout=300_000)
    text = page.frame_locator("iframe.whole").locator("main").inner_text()
    assert "first" in text and "second" in text
    assert (app.folder / "comparison" / "compare.html").is_file()
    page.close()


@pytest.mark.timeout(1200)
def test_a_study_of_groups_from_the_list(chromium, app):
    groups = {"s-media.csv": "media", "s-intima.csv": "intima"}
    for name, group in groups.items():
        shutil.copy(DATA / f"donor2-{group}.csv", app.folder / name)
    page = new_tab(chromium)
    page.goto(app.address)
    for name in groups:
        page.check(f'input[name="file"][value="{name}"]')
    page.click("text=Check and sample the ticked ones")
    for name, group in groups.items():
        page.get_by_label(f"group of {name}").fill(f'"{group}" ä')
    page.fill('input[name="out"]', "by-layer")
    page.fill('input[name="ess"]', "50")
    page.fill('input[name="workers"]', "1")
    page.click("text=Sample each, as a study")
    page.wait_for_selector(".job")
    # stopped here, and finished on the command line
    job = Job(app.folder, "by-layer")
    until(lambda: "being written" in states(app).values())
    page.click("text=Stop; it can be resumed")
    page.wait_for_selector("button[value=resume]")
    assert not job.is_running and states(app)["by-layer"] == "stopped"
    command = shlex.split("-m biaxbayes batch by-layer.toml --out by-layer --workers 1")
    subprocess.run([sys.executable, *command], cwd=app.folder)
    assert states(app)["by-layer"] == "finished"
    page.reload()
    page.wait_for_selector("iframe.whole")
    text = page.frame_locator("iframe.whole").locator("main").inner_text()
    assert all(f'"{group}" ä' in text for group in groups.values())
    study = json.loads((app.folder / "by-layer" / "study.json").read_text(encoding="utf-8"))
    assert study["name"] == "by-layer" and len(study["done"]) == 2
    page.goto(app.address)
    assert page.locator('a[href*="by-layer%2Fruns"], a[href*="by-layer/runs"]').count() == 2
    page.close()
