"""Measured pages: what made them, whether the code has changed since, and how they are remade."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

import evidence
import study
from biaxbayes.laws import LAWS
from biaxbayes.options.model import MOUNTING
from studies import same_draws
from studies.page import ROOT, Stamp, put_stamp, stamp_of

STUDY = re.compile(r"scripts/study\.py (\w+)")


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository with a page and two rooms, one of which the page speaks of."""
    monkeypatch.setattr(evidence, "ROOT", tmp_path)
    page = evidence.Page("page.md", ("laws",), ("python one.py {work}", "python two.py {work}"))
    monkeypatch.setattr(evidence, "PAGES", {"page": page})
    for name in ("user.name", "user.email"):
        monkeypatch.setenv(f"GIT_{name.replace('user.', 'AUTHOR_').upper()}", "a@b")
        monkeypatch.setenv(f"GIT_{name.replace('user.', 'COMMITTER_').upper()}", "a@b")
    evidence.git("init", "--quiet")
    for room in ("laws", "figures"):
        (tmp_path / "src" / "biaxbayes" / room).mkdir(parents=True)
        changed(tmp_path, room, "first")
    (tmp_path / "page.md").write_text("# Title\n\nWords.\n")
    (tmp_path / "one.py").write_text(
        "import sys, pathlib\n"
        "file = pathlib.Path(sys.argv[1]) / 'one.txt'\n"
        "file.write_text(file.read_text() + '.' if file.exists() else '.')\n"
    )
    (tmp_path / "two.py").write_text(
        "import sys, pathlib\n"
        "text = (pathlib.Path(sys.argv[1]) / 'one.txt').read_text()\n"
        "if not pathlib.Path('two.ok').exists(): sys.exit(3)\n"
        "pathlib.Path('page.md').write_text(f'# Title\\n\\nFirst ran {len(text)} times.\\n')\n"
    )
    return tmp_path


def changed(root: Path, room: str, text: str) -> None:
    (root / "src" / "biaxbayes" / room / "code.py").write_text(text)
    evidence.git("add", "--all", "src")
    assert evidence.git("commit", "--quiet", "-m", text) is not None


def told() -> str:
    return evidence.age(evidence.PAGES["page"])[1]


def run(monkeypatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["evidence.py", *arguments])
    return evidence.main()


def test_every_measured_page_is_in_the_table():
    pages = [ROOT / "data" / "README.md", *(ROOT / "docs").glob("*.md")]
    stamped = {str(page.relative_to(ROOT)) for page in pages if stamp_of(page)}
    assert stamped == {page.path for page in evidence.PAGES.values()}
    for page in evidence.PAGES.values():
        assert all((ROOT / source).exists() for source in page.sources), page


def test_the_commands_are_those_that_studies_take():
    for page in evidence.PAGES.values():
        for command in page.commands:
            if not (named := STUDY.search(command)):
                continue
            told = study.studies()[named[1]].read_text(encoding="utf-8")
            for option in re.findall(r" (--[\w-]+)", command):
                assert f'"{option}"' in told, command
    assert len(evidence.used_studies()) >= 12 and evidence.used_studies() <= study.studies().keys()
    for page in evidence.PAGES.values():
        text = (ROOT / page.path).read_text(encoding="utf-8")
        for name in STUDY.findall(" ".join(page.commands)):
            assert name in text, f"{page.path} does not name its study {name}"


def stamp_now(root: Path) -> None:
    commit, day = (evidence.git("log", "-1", "--format=%h %cs") or "").split(" ")
    put_stamp(root / "page.md", Stamp(commit, day, day, "python page.py"))


def test_a_page_is_older_where_the_code_it_speaks_of_has_changed(checkout):
    assert told() == "does not say what made it"
    stamp_now(checkout)
    assert told().endswith(": current")
    changed(checkout, "figures", "second = 2")
    assert told().endswith(": current")
    changed(checkout, "laws", "second = 2; third = 3")
    assert told().endswith("OLDER, 2 definitions differ: laws/code.py second, laws/code.py third")
    changed(
        checkout, "laws", "a = b = c = 1\ndef f(): return 2\nfor x in 1, 2: f()\nclass A: k = 1"
    )
    assert "OLDER, 4 definitions differ, among them laws/code.py a, laws/code.py f, " in told()
    changed(checkout, "laws", "first")  # as when the page was made
    assert told().endswith(": current")


CODE = '''import math

SCALE = 2.0


def f(x):
    """Twice."""
    return SCALE * x


def g(x):
    from math import sqrt

    return sqrt(x)
'''


def test_words_about_the_code_make_no_page_older(checkout):
    changed(checkout, "laws", CODE)
    stamp_now(checkout)
    changed(
        checkout,
        "laws",
        '"""A room."""\n\n' + CODE.replace("Twice.", "2 x.").replace("* x", "*  x # x"),
    )
    assert told().endswith("current")
    changed(
        checkout, "laws", CODE.replace("import math\n", "from math import sqrt, pi\n__all__ = []\n")
    )
    assert told().endswith("current")


def test_code_that_only_moved_makes_no_page_older(checkout):
    changed(checkout, "laws", CODE)
    stamp_now(checkout)
    head, tail = CODE.split("\n\n\ndef g")
    new = checkout / "src" / "biaxbayes" / "laws" / "roots.py"
    new.write_text(f"from biaxbayes.laws.code import SCALE\n\ndef g{tail}")
    changed(checkout, "laws", head)
    assert told().endswith(": current")
    changed(checkout, "figures", head)
    changed(checkout, "laws", "from biaxbayes.figures.code import f")  # and out of its rooms
    assert told().endswith(": current")
    new.write_text(new.read_text().replace("sqrt(x)", "sqrt(2 * x)"))
    changed(checkout, "laws", head)
    assert told().endswith("OLDER, 1 definition differs: laws/roots.py g")
    new.unlink()  # removed, and nothing in its place
    changed(checkout, "laws", head + "\n")
    assert told().endswith(": current")
    changed(checkout, "laws", head.replace("2.0", "3.0"))
    assert told().endswith("OLDER, 1 definition differs: laws/code.py SCALE")


def test_a_change_that_leaves_every_draw_makes_only_pages_of_times_older(checkout, monkeypatch):
    def head():
        return evidence.git("rev-parse", "--short", "HEAD")

    changed(checkout, "laws", CODE)
    stamp_now(checkout)
    before = head()
    changed(checkout, "laws", CODE.replace("SCALE * x", "x * SCALE"))
    assert told().endswith("OLDER, 1 definition differs: laws/code.py f")
    (checkout / "scripts").mkdir()
    record = checkout / "scripts" / "same_draws.csv"
    row = f"{same_draws.HEADER}\n{before},{head()},2026-11-24,47"
    of_times = replace(evidence.PAGES["page"], of_times=True)
    for ratio, times in (("", "OLDER"), ("0.95", "OLDER"), ("1.02", "current")):
        record.write_text(f"{row},{ratio}\n")
        assert told().endswith(": current")
        assert times in evidence.age(of_times)[1]
    changed(checkout, "laws", CODE.replace("SCALE * x", "x * SCALE").replace("2.0", "3.0"))
    assert told().endswith("OLDER, 1 definition differs: laws/code.py SCALE")
    # what the change replaced was no longer there when the page was made
    changed(checkout, "laws", CODE.replace("SCALE * x", "SCALE + x"))
    stamp_now(checkout)
    changed(checkout, "laws", CODE.replace("SCALE * x", "x * SCALE"))
    assert told().endswith("OLDER, 1 definition differs: laws/code.py f")


def test_the_same_code_draws_the_same_and_another_seed_does_not(monkeypatch):
    case = ("donor2-media", {"noise": "independent"}, 1)
    (once, seconds), (again, _) = same_draws.digest(case), same_draws.digest(case)
    assert once == again and seconds > 0.0
    assert once != same_draws.digest((*case[:2], 2))[0]
    named = same_draws.cases()
    assert len({str(case) for case in named}) == len(named)
    assert {options.get("law", "goh") for _, options, _ in named} == set(LAWS)
    assert {options["mounting"] for _, options, _ in named if "mounting" in options} == {*MOUNTING}


def test_a_file_that_is_no_code_counts_by_its_content(checkout):
    table = checkout / "src" / "biaxbayes" / "laws" / "table.csv"
    table.write_text("1,2\n")
    changed(checkout, "laws", CODE)
    stamp_now(checkout)
    table.write_text("1,3\n")
    changed(checkout, "laws", CODE)
    assert told().endswith("OLDER, 1 definition differs: laws/table.csv")


def test_a_commit_of_another_clone_counts_by_its_day(checkout):
    page = checkout / "page.md"
    put_stamp(page, Stamp("0123456", "2024-05-06", "2024-05-07", "python x"))
    assert "OLDER, 1 commit has" in told()
    put_stamp(page, Stamp("0123456", "2090-05-06", "2090-05-07", "python x"))
    assert told().endswith(": current")


def test_check_ends_well_without_git(checkout, monkeypatch, capsys):
    put_stamp(checkout / "page.md", Stamp("0123456", "2024-05-06", "2024-05-07", "python x"))
    monkeypatch.setenv("PATH", "")
    assert run(monkeypatch, "--check") == 0
    printed = capsys.readouterr().out
    assert "not known outside a git checkout" in printed
    assert re.search("studies that remake no page: .*mutation", printed)


def test_a_page_is_remade_once_and_goes_on_where_it_stopped(checkout, monkeypatch, capfd):
    page, kept = checkout / "page.md", ("--folder", str(checkout / "kept"))
    package = evidence.git("rev-parse", "--short", "HEAD")
    evidence.git("commit", "--quiet", "--allow-empty", "-m", "not of the package")
    assert run(monkeypatch, *kept) == 1
    assert "ended with 3" in capfd.readouterr().out and stamp_of(page) is None
    (checkout / "two.ok").touch()
    assert run(monkeypatch, "page", *kept) == 0
    assert "done before: python one.py" in capfd.readouterr().out
    text = page.read_text()
    assert "First ran 1 times." in text
    stamp = stamp_of(page)
    assert stamp is not None and stamp.commit == package
    assert "`python scripts/evidence.py page`" in text.splitlines()[2]
    assert run(monkeypatch, *kept) == 0
    assert page.read_text() == text and "current" in capfd.readouterr().out
    assert run(monkeypatch, "--again", *kept) == 0
    assert page.read_text() == text  # anew: nothing is kept of the time before
    assert "python one.py" in capfd.readouterr().out


def test_a_page_is_not_made_of_code_that_is_not_committed(checkout, monkeypatch, capsys):
    (checkout / "src" / "biaxbayes" / "laws" / "code.py").write_text("not committed")
    assert run(monkeypatch, "--folder", str(checkout / "kept")) == 1
    assert "commit first" in capsys.readouterr().out
    assert stamp_of(checkout / "page.md") is None


def test_continuous_integration_prints_the_ages_and_never_fails_for_them():
    lines = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    (line,) = [line for line in lines if "evidence.py" in line]
    assert "--check" in line and line.rstrip().endswith("|| true")
    made = subprocess.run(["bash", "-n", ROOT / ".ci" / "run"], capture_output=True)
    assert made.returncode == 0


LONGEST_TABLE = 16  # rows
GUIDES = {"docs/studies.md"}
"""Pages on use that have a measured figure further down."""


def test_pages_open_with_their_result_and_long_tables_stand_beside_them():
    linked = set()
    for page in evidence.PAGES.values():
        text = (ROOT / page.path).read_text(encoding="utf-8")
        lengths = [len(t.splitlines()) - 2 for t in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)]
        assert max(lengths, default=0) <= LONGEST_TABLE, page.path
        assert page.path in GUIDES or "\n**" in text.split("\n## ")[0], f"{page.path}: no result"
        linked |= set(re.findall(r"tables/([\w-]+\.csv)", text))
    assert linked == {path.name for path in (ROOT / "docs" / "tables").iterdir()}
