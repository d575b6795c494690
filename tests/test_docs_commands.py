"""Every command and Python example of the README and of docs/ does what a reader expects: it runs.

Blocks of a ``console`` or ``python`` fence are run page after page in one folder, as a reader goes
on; a block behind ``<!-- slow -->`` only with ``-m slow``. What samples is given fewer draws.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from biaxbayes.cli import VERBS, main
from quick_posteriors import runs_of_few_walkers

ROOT = Path(__file__).parents[1]
PAGES = ("tutorial.md", "how-to.md", "studies.md", "python.md")
FENCE = re.compile(r"(<!-- slow -->\n)?```(\w*)\n(.*?)\n```", re.DOTALL)
FEWER = ("--ess", "100")
SAMPLING = dict.fromkeys(("sample", "ledger", "compare", "batch"), FEWER)
SAMPLING["calibrate"] = ("--ess", "200")
TRIED = {0, 3}
"""With so few draws a run may end as not converged; the command is run, not the science."""
FEW_DRAWS = "ignore:Estimated shape parameter of Pareto:UserWarning"
"""ArviZ's leave-one-out wants more draws than these runs have."""


class Block(NamedTuple):
    """A fenced block of a page."""

    page: str
    language: str
    text: str
    slow: bool


def blocks(path: Path) -> list[Block]:
    text = path.read_text(encoding="utf-8")
    return [Block(path.name, m[2], m[3], bool(m[1])) for m in FENCE.finditer(text)]


def commands(block: Block) -> list[list[str]]:
    lines = [line[2:] for line in block.text.splitlines() if line.startswith("$ ")]
    assert lines, f"{block.page}: a console block without a command"
    return [shlex.split(line) for line in lines]


def run_command(words: list[str]) -> None:
    """Run a command of this program in this process; its error is the test's."""
    assert words[0] == "biaxbayes"
    # The numbers of a study file stand in it.
    fewer = () if any(word.endswith("study.toml") for word in words) else SAMPLING.get(words[1], ())
    arguments = [*words[1:], *fewer]
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main(arguments)
    code = int(ended.value.code or 0)
    output = err.getvalue()[-1500:]
    assert code in (TRIED if words[1] in SAMPLING else {0}), (
        f"{shlex.join(words)}\n{code}: {output}"
    )


def run_python(text: str) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(text, "example", "exec"), {"__name__": "example"})


def prepare(folder: Path) -> None:
    """What a reader of the pages has: a checkout, and the files that a page shows."""
    shutil.copytree(ROOT / "data", folder / "data")
    shutil.copy(ROOT / "data" / "donor2-media.csv", folder / "specimen.csv")
    files = {"how-to.md": ("histology.toml", ""), "studies.md": ("study.toml", "ess = 100\n")}
    for page, (name, before) in files.items():
        for block in blocks(ROOT / "docs" / page):
            if block.language == "toml":
                (folder / name).write_text(before + block.text, encoding="utf-8")


def run_pages(folder: Path, *, slow: bool) -> int:
    prepare(folder)
    count = 0
    for page in PAGES:
        for block in blocks(ROOT / "docs" / page):
            if block.slow and not slow:
                continue
            if block.language == "console":
                for words in commands(block):
                    run_command(words)
                    count += 1
            elif block.language == "python":
                run_python(block.text)
                count += 1
    return count


@pytest.mark.parametrize(
    "slow",
    [pytest.param(False, marks=pytest.mark.long), pytest.param(True, marks=pytest.mark.slow)],
)
@pytest.mark.filterwarnings(FEW_DRAWS)
def test_every_command_of_the_pages_runs(tmp_path, monkeypatch, slow):
    monkeypatch.chdir(tmp_path)
    with contextlib.nullcontext() if slow else runs_of_few_walkers():
        assert run_pages(tmp_path, slow=slow) >= (25 if slow else 20)
    made = ("media-posterior/report.html", "figure2.svg", "table1.tex", "virtual.csv")
    for name in (*made, "media.csv", "protocols.csv", "tensile.csv"):
        assert (tmp_path / name).stat().st_size > 500


def test_every_example_file_is_used_and_no_other():
    shipped = {f"data/examples/{p.name}" for p in (ROOT / "data" / "examples").iterdir()}
    pages = [b for page in ("tutorial.md", "how-to.md") for b in blocks(ROOT / "docs" / page)]
    lines = [words for b in pages if b.language == "console" for words in commands(b)]
    used = {word for words in lines for word in words if word.startswith("data/examples/")}
    assert used == shipped
    assert all(w[2] in used for w in lines if w[1] == "convert")
    table = (ROOT / "data" / "README.md").read_text(encoding="utf-8")
    assert all(f"| `{Path(name).name}` |" in table for name in shipped)


def readme_lines() -> list[list[str]]:
    text = "\n".join(b.text for b in blocks(ROOT / "README.md") if b.language != "python")
    return [shlex.split(line) for line in text.splitlines() if re.match(r"(biaxbayes|bash) ", line)]


def test_readme_commands_exist():
    lines = readme_lines()
    assert len(lines) >= 4
    for words in lines:
        if words[0] == "bash":
            assert (ROOT / words[1]).is_file()
        else:
            assert words[1] in VERBS
    named = set(re.findall(r"`([a-z]+)`", (ROOT / "README.md").read_text(encoding="utf-8")))
    assert set(VERBS) <= named


def test_readme_check_and_convert_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    (tmp_path / "specimen.csv").unlink()  # the first command writes it
    quick = [w for w in readme_lines() if w[0] == "biaxbayes" and w[1] in ("check", "convert")]
    assert {words[1] for words in quick} == {"check", "convert"}
    for words in quick:
        run_command(words)


@pytest.mark.slow
def test_readme_and_demo_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    (tmp_path / "specimen.csv").unlink()  # the first command writes it
    demo = (ROOT / "scripts" / "demo.sh").read_text(encoding="utf-8").splitlines()
    ours = [shlex.split(line) for line in demo if line.startswith("biaxbayes ")]
    assert ours
    for words in [w for w in readme_lines() if w[0] == "biaxbayes"] + ours:
        run_command(words)
    for block in blocks(ROOT / "README.md"):
        if block.language == "python":
            run_python(block.text)


def test_console_blocks_are_ours_and_links_lead_somewhere():
    for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for block in blocks(path):
            if block.language == "console":
                assert path.name in PAGES, f"{path.name} is not among the pages that are run"
                assert all(words[0] == "biaxbayes" for words in commands(block))
        text = path.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#:]+)\)", text):
            assert (path.parent / target).exists(), f"{path.name}: {target}"
