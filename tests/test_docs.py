"""The pages agree with the code, and their commands, examples and notebooks run."""

import ast
import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

import docs_verbs
import study
from biaxbayes.cli import VERBS, main
from biaxbayes.experiments import BIAXIAL
from biaxbayes.specimens.keys import KEYS
from biaxbayes.specimens.plausibility import STRESS_LIMIT_KPA
from biaxbayes.specimens.table import STRETCHES
from quick_posteriors import runs_of_few_walkers

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "biaxbayes"
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "data" / "README.md", *DOCS.glob("*.md")]


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def first_cells(text: str) -> list[str]:
    """Names in the first column of the tables of a text."""
    rows = re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


def test_scripts_and_studies_that_pages_name_are_there():
    text = "\n".join(text_of(page) for page in PAGES)
    scripts = set(re.findall(r"\bscripts/[\w./]*\w", text))
    assert {"scripts/demo.sh", "scripts/test.sh", "scripts/study.py"} <= scripts
    for name in scripts:
        assert (ROOT / name).exists(), name
    named = set(re.findall(r"scripts/study\.py (\w+)", text))
    assert len(named) >= 6
    assert named <= study.studies().keys()


def test_the_reference_of_the_command_line_is_current():
    for path, text in docs_verbs.pages().items():
        assert text_of(path) == text, "run python scripts/docs_verbs.py"


def test_the_page_of_the_specimen_file_is_complete():
    columns, keys = text_of(docs_verbs.SPECIMEN_FILE).split("## Header keys")
    pairs = [name for loads in BIAXIAL.loads.values() for name in loads.columns]
    assert {*STRETCHES, "protocol", "time_s", *pairs} <= set(first_cells(columns))
    assert set(first_cells(keys)) == set(KEYS)
    assert f"{STRESS_LIMIT_KPA:g}" in keys and "unloaded with stresses" in keys
    for page in ("README.md", "docs/tutorial.md", "docs/how-to.md", "docs/index.md"):
        assert "specimen-file.md" in text_of(ROOT / page), page


def test_the_map_of_rooms_is_complete_and_rooms_import_from_those_above_them_alone():
    """While they are loaded; what is imported in a function is free to."""
    order = first_cells(text_of(DOCS / "layout.md").split("| to add |")[0])
    rooms = {p.name for p in SOURCE.iterdir() if (p / "__init__.py").is_file()}
    rooms |= {p.stem for p in SOURCE.glob("*.py") if p.stem != "__init__"}
    assert set(order) == rooms
    imported = set()
    for path in SOURCE.rglob("*.py"):
        room = path.relative_to(SOURCE).with_suffix("").parts[0]
        for node in ast.parse(text_of(path)).body:
            module = getattr(node, "module", None) or ""
            if not isinstance(node, ast.ImportFrom) or not module.startswith("biaxbayes."):
                continue
            imported.add((room, module.split(".")[1]))
    below = {(a, b) for a, b in imported if a in rooms and order.index(b) > order.index(a)}
    assert not below
    general = {"sampling", "errors", "progress_bar", "tasks"}
    assert {b for a, b in imported if a == "sampling"} <= general  # nothing of tissue


def test_no_test_module_imports_another():
    for path in (ROOT / "tests").glob("*.py"):
        assert not re.search(r"^ *(from|import) test_", text_of(path), re.MULTILINE), path


def test_no_imports_go_round_in_a_circle():
    wanted: dict[str, set[str]] = {}
    for path in SOURCE.rglob("*.py"):
        name = ".".join(("biaxbayes", *path.relative_to(SOURCE).with_suffix("").parts))
        nodes = [n for n in ast.parse(text_of(path)).body if isinstance(n, ast.ImportFrom)]
        names = {f"{n.module}.{a.name}" for n in nodes for a in n.names}
        wanted[name.removesuffix(".__init__")] = names | {str(n.module) for n in nodes}
    graph = {name: (names & wanted.keys()) - {name} for name, names in wanted.items()}
    while leaves := {name for name, names in graph.items() if not names & graph.keys()}:
        graph = {name: names for name, names in graph.items() if name not in leaves}
    assert not graph


# --- commands and examples ---

PAGES_TO_RUN = ("tutorial.md", "how-to.md", "studies.md", "python.md")
FENCE = re.compile(r"(<!-- slow -->\n)?```(\w*)\n(.*?)\n```", re.DOTALL)
FEWER = ("--ess", "100")
SAMPLING = dict.fromkeys(("sample", "compare", "batch"), FEWER)
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
    for page in PAGES_TO_RUN:
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
                assert path.name in PAGES_TO_RUN, f"{path.name} is not among the pages that are run"
                assert all(words[0] == "biaxbayes" for words in commands(block))
        text = path.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#:]+)\)", text):
            assert (path.parent / target).exists(), f"{path.name}: {target}"


# --- notebooks ---


NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SECONDS_A_CELL = 240


def outputs(notebook) -> list:
    return [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]


def test_notebooks_are_stored_without_output_and_named_on_their_page():
    nbformat = pytest.importorskip("nbformat")
    page = text_of(DOCS / "python.md")
    assert len(NOTEBOOKS) == 2
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        assert not outputs(notebook) and f"(notebooks/{path.name})" in page


@pytest.mark.long
@pytest.mark.filterwarnings("default")  # of the client, not of the notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs(path, tmp_path):
    """In a kernel of its own, from a folder as deep as the checkout's."""
    nbformat, nbclient = (pytest.importorskip(name) for name in ("nbformat", "nbclient"))
    folder = tmp_path / "docs" / "notebooks"
    folder.mkdir(parents=True)
    (tmp_path / "data").symlink_to(ROOT / "data")
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, timeout=SECONDS_A_CELL, resources=place).execute()
    shown = outputs(notebook)
    assert not [o for o in shown if o.output_type == "error" or o.get("name") == "stderr"]
    data = [o.data for o in shown if "data" in o]
    assert not any("ipywidgets" in text for d in data for text in d.values() if text)
    assert any("image/png" in d for d in data)
    assert any("<table" in d.get("text/html", "") for d in data)
    assert (folder / "media-posterior" / "report.html").is_file()
    # The live line of a long call leaves nothing behind.
    assert not any(d.get("text/plain") == "writing" for d in data)


def test_the_readme_names_every_command_and_no_other():
    assert {words[1] for words in readme_lines() if words[0] == "biaxbayes"} <= set(VERBS)
    assert set(VERBS) <= set(re.findall(r"`([a-z]+)`", text_of(ROOT / "README.md")))
