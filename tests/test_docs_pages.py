"""The pages agree with the code and with one another: scripts, rooms, verbs, navigation."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

import docs_verbs
import study
from biaxbayes.cli import VERBS, group
from biaxbayes.specimens.keys import KEYS
from biaxbayes.specimens.plausibility import STRESS_LIMIT_KPA
from biaxbayes.specimens.specimen import STRESS_PAIRS
from biaxbayes.specimens.table import STRETCHES

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "biaxbayes"
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "data" / "README.md", *DOCS.glob("*.md")]


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_scripts_and_studies_that_pages_name_are_there():
    text = "\n".join(text_of(page) for page in PAGES)
    scripts = set(re.findall(r"\bscripts/[\w./]*\w", text))
    assert {"scripts/demo.sh", "scripts/test.sh", "scripts/study.py"} <= scripts
    for name in scripts:
        assert (ROOT / name).exists(), name
    named = set(re.findall(r"scripts/study\.py (\w+)", text))
    assert len(named) >= 6
    assert named <= study.studies().keys()


def test_tables_and_figures_of_the_pages_are_there_and_used():
    text = "\n".join(text_of(page) for page in PAGES)
    for folder, kind in (("tables", "csv"), ("figures", "png")):
        linked = set(re.findall(rf"{folder}/([\w-]+\.{kind})", text))
        assert linked == {path.name for path in (DOCS / folder).iterdir()}


def test_a_measured_page_names_release_date_and_command():
    measured = [page for page in PAGES if "\nMeasured with release " in text_of(page)]
    assert len(measured) >= 7
    for page in measured:
        (line,) = re.findall(r"\nMeasured with release [\d.]+ on [\d-]{10} by (.*)", text_of(page))
        assert re.findall(r"scripts/(study\.py \w+|reproduce_paper\.py)", line), page


def test_a_study_says_what_it_is_and_its_help_names_it():
    listed = subprocess.run(
        [sys.executable, ROOT / "scripts" / "study.py"], capture_output=True, text=True, check=True
    )
    names = [line.split()[0] for line in listed.stdout.splitlines()]
    assert names == list(study.studies()) and "toes" in names and "page" not in names
    unknown = [sys.executable, ROOT / "scripts" / "study.py", "nothing"]
    assert subprocess.run(unknown, capture_output=True).returncode == 2
    for name, path in study.studies().items():
        assert f"scripts/study.py {name}" in text_of(path), name


def test_the_reference_of_the_command_line_is_current():
    for path, text in docs_verbs.pages().items():
        assert text_of(path) == text, "run python scripts/docs_verbs.py"


def test_the_page_of_the_specimen_file_is_complete():
    columns, keys = text_of(docs_verbs.SPECIMEN_FILE).split("## Header keys")
    pairs = [name for pair in STRESS_PAIRS.values() for name in pair]
    for name in (*STRETCHES, "protocol", "time_s", *pairs):
        assert f"| `{name}` |" in columns
    assert set(re.findall(r"^\| `(\w+)` \|", keys, re.MULTILINE)) == set(KEYS)
    assert f"{STRESS_LIMIT_KPA:g}" in keys and "unloaded with stresses" in keys
    for page in ("README.md", "docs/tutorial.md", "docs/how-to.md", "docs/index.md"):
        assert "specimen-file.md" in text_of(ROOT / page), page


@pytest.mark.parametrize("verb", VERBS)
def test_the_reference_shows_every_option(verb):
    section = text_of(docs_verbs.PAGE).split(f"\n## {verb}\n")[1].split("\n## ")[0]
    assert f"biaxbayes {verb} [OPTIONS]" in section
    command = group.get_command(click.Context(group), verb)
    shown = [p for p in command.params if isinstance(p, click.Option) and not p.hidden]
    assert shown
    for option in shown:
        assert f"`{option.opts[0]}" in section, option.opts
    assert "--break" not in section


def test_the_map_of_rooms_is_complete():
    table = text_of(DOCS / "layout.md").split("| to add |")[0]
    named = {
        name
        for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    }
    rooms = {p.name for p in SOURCE.iterdir() if (p / "__init__.py").is_file()}
    rooms |= {p.stem for p in SOURCE.glob("*.py") if p.stem != "__init__"}
    assert named == rooms


def test_rooms_import_from_rooms_above_them_alone():
    """While they are loaded; what is imported in a function is free to."""
    table = text_of(DOCS / "layout.md").split("| to add |")[0]
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    order = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    found = set()
    for path in SOURCE.rglob("*.py"):
        room = path.relative_to(SOURCE).with_suffix("").parts[0]
        for node in ast.parse(text_of(path)).body:
            module = getattr(node, "module", None) or ""
            if not isinstance(node, ast.ImportFrom) or not module.startswith("biaxbayes."):
                continue
            other = module.split(".")[1]
            if room in order and order.index(other) > order.index(room):
                found.add((room, other))
    assert not found


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
