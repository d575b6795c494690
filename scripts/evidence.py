"""Remake the measured pages of the documentation, and say which are older than their code.

    python scripts/evidence.py --check         which pages are older than the code they speak of
    python scripts/evidence.py --list          the commands behind each page
    python scripts/evidence.py paper data      remake these; without a name, all that are older

What a page was made of stands under its heading: commit, day and command. A page is remade only
where the code it speaks of has changed since (--again: in any case); a change after which every
draw and verdict is the same, byte for byte, makes older only a page of times, and that only where
it changes them. The same command goes on where it was interrupted: commands that are done are not
run again, and studies keep what they have below --folder.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import date
from importlib.util import find_spec
from pathlib import Path

from code_changes import Change, differing
from studies.page import ROOT, Stamp, put_stamp, stamp_of
from study import studies

SOURCE = "src/biaxbayes"
REAL = "BIAXBAYES_REAL"
NAMED = 3
"""Of the definitions that differ, how many `--check` names."""
AS_LONG = 0.03
"""Part by which the time of a run may differ where it counts as the same: noise of a machine."""
POSTERIOR = ("laws", "mechanics", "model", "sampling")


@dataclass(frozen=True)
class Page:
    """A page of measured figures.

    Attributes
    ----------
    path : str
        Relative to the root of the repository.
    rooms : tuple of str
        Folders and modules of the package that its figures speak of.
    commands : tuple of str
        What remakes it, in this order. ``{work}`` is a folder that the page's studies keep,
        ``{real}`` that of measured tissue.
    needs : tuple of str
        Packages beyond those of biaxbayes itself.
    of_times : bool
        Whether its figures are times, which a change that leaves every draw may change.
    """

    path: str
    rooms: tuple[str, ...]
    commands: tuple[str, ...]
    needs: tuple[str, ...] = ()
    of_times: bool = False

    @property
    def sources(self) -> list[str]:
        """The folders that the page speaks of, relative to the root."""
        return [f"{SOURCE}/{room}" for room in self.rooms]

    @property
    def of_measured_tissue(self) -> bool:
        """Whether it cannot be remade without measured specimens, which are not shipped."""
        return any("{real}" in command for command in self.commands)


STUDY = "python scripts/study.py"
CONVERT_AORTA = (
    "biaxbayes convert {real}/aorta-tbad/p*.csv --machine generic --geometry unloaded "
    "--columns stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa "
    "--protocol-names 0.5to1,1to1,1to0.75,1to0.5,0.75to1 --overwrite"
)
PAGES = {
    "paper": Page(
        "docs/paper.md",
        ("laws", "mechanics", "fitting"),
        ("python scripts/reproduce_paper.py",),
    ),
    "finite-elements": Page(
        "docs/finite-elements.md", ("laws", "fem"), (f"{STUDY} hooks",), ("skfem",)
    ),
    "robustness": Page(
        "docs/robustness.md",
        ("runs", "jobs", "specimens", "machines", "studies", "text_files.py"),
        (
            f"{STUDY} fuzz --write docs/robustness.md",
            f"{STUDY} crashes --calls 24 --write docs/robustness.md",
        ),
    ),
    "studies": Page(
        "docs/studies.md",
        ("jobs", "executors", "sampling", "figures", "reports"),
        (f"{STUDY} batch --specimens 10 100 --folder {{work}}/batch --write docs/studies.md",),
        of_times=True,
    ),
    "identifiability": Page(
        "docs/identifiability.md",
        (*POSTERIOR, "identifiability", "optimal_design"),
        (
            f"{STUDY} identifiability_figures",
            f"{STUDY} verdicts --write docs/identifiability.md",
            f"{STUDY} edges --write docs/identifiability.md",
            f"{STUDY} design data/donor2-media.csv --outcomes 30 --write docs/identifiability.md",
            f"{STUDY} design data/donor2.csv --outcomes 30 --write docs/identifiability.md",
        ),
    ),
    "data": Page(
        "data/README.md",
        POSTERIOR,
        (f"{STUDY} intervals --seeds 50 --workers 2 --record {{work}}/intervals.jsonl",),
    ),
    "benchmark": Page(
        "docs/benchmark.md",
        POSTERIOR,
        (
            f"{STUDY} benchmark --samplers --others --jobs 2 --json {{work}}/others.json --resume",
            f"{STUDY} benchmark --samplers --plain --jobs 2 --json {{work}}/plain.json --resume",
            f"{STUDY} benchmark --costs --json {{work}}/costs.json",
            f"{STUDY} benchmark --from-json {{work}}/others.json {{work}}/plain.json "
            "{work}/costs.json --write docs/benchmark.md",
        ),
        ("numpyro", "nautilus", "dynesty", "pymecht", "flowjax", "optax"),
        of_times=True,
    ),
    "model-error": Page(
        "docs/model-error.md",
        (*POSTERIOR, "identifiability", "prediction"),
        (
            f"{CONVERT_AORTA} --out {{work}}/aorta.csv",
            f"{STUDY} leave_out {{work}}/aorta.csv --out {{work}}/leave-out.csv "
            "--page docs/model-error.md",
            f"{STUDY} averaged_rows {{work}}/aorta.csv --folder {{work}}/averaged "
            "--page docs/model-error.md",
            f"{STUDY} model_error run --specimens 105 --folder {{work}}/model-error "
            "--candidates effective",
            f"{STUDY} model_error table --specimens 105 --folder {{work}}/model-error "
            "--candidates effective --page docs/model-error.md",
            f"{STUDY} model_error run --specimens 29 --folder {{work}}/model-error",
            f"{STUDY} model_error table --specimens 29 --folder {{work}}/model-error "
            "--page docs/model-error.md",
        ),
    ),
    "mounting-stretch": Page(
        "docs/mounting-stretch.md",
        (
            "laws",
            "mechanics",
            "fitting",
            "identifiability/mounting_stretch/stated.py",
            "identifiability/mounting_stretch/law_range.py",
        ),
        (
            f"{STUDY} toes --first 300 --count 15 --sharp 60 --fits {{work}}/fits "
            "--page docs/mounting-stretch.md",
        ),
    ),
    "laws": Page(
        "docs/laws-evidence.md",
        (
            *POSTERIOR,
            "comparison/law_comparison.py",
            "comparison/law_weights.py",
            "comparison/mixture.py",
            "comparison/pooling.py",
        ),
        (
            f"{CONVERT_AORTA} --out {{work}}/aorta.csv",
            "biaxbayes laws {work}/aorta.csv --out {work}/aorta --workers 2 --resume",
            f"{STUDY} laws_measured {{work}}/aorta --place laws-aorta --page docs/laws-evidence.md",
            "biaxbayes convert {real}/valve-pymecht/biax-data.csv --machine generic --columns "
            "stretch_x=lambda_1,stretch_y=lambda_2,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa "
            "--overwrite --out {work}/valve.csv",
            "biaxbayes laws {work}/valve.csv --mounting ignored --out {work}/valve --workers 2 "
            "--resume",
            f"{STUDY} laws_measured {{work}}/valve --place laws-valve --page docs/laws-evidence.md",
            f"{STUDY} law_sampling {{work}}/aorta.csv {{work}}/valve.csv:ignored virtual "
            "--folder {work}/sampling --workers 2",
            f"{STUDY} law_sampling --folder {{work}}/sampling --page docs/laws-evidence.md",
            f"{STUDY} law_truths --folder {{work}}/truths --count 20 --workers 2",
            f"{STUDY} law_truths --folder {{work}}/truths --page docs/laws-evidence.md",
        ),
    ),
    "population": Page(
        "docs/population-evidence.md",
        (*POSTERIOR, "populations"),
        (
            f"{STUDY} population calibration --studies 200 --workers 2 --folder {{work}}",
            f"{STUDY} population ridge --studies 20 --workers 2 --folder {{work}}",
            f"{STUDY} population alike --studies 20 --workers 2 --folder {{work}}",
            f"{STUDY} population common-misfit --studies 20 --workers 2 --folder {{work}}",
            f"{STUDY} population own-misfit --studies 20 --workers 2 --folder {{work}}",
            f"{STUDY} population no-misfit --studies 20 --workers 2 --folder {{work}}",
            f"{STUDY} population agreement --folder {{work}}",
            f"{STUDY} population time --specimens 10 20 40 100 --folder {{work}}",
            f"{STUDY} population table --folder {{work}} --page docs/population-evidence.md",
        ),
        ("numpyro",),
    ),
    "calibration": Page(
        "docs/calibration.md",
        (*POSTERIOR, "calibration"),
        (
            f"{STUDY} calibration --folder {{work}}/calibration --workers 2",
            f"{STUDY} calibration --folder {{work}}/calibration --document docs",
        ),
    ),
}
"""The pages by name, the quickest first."""


# --- how old a page is ---------------------------------------------------------------------------


def git(*arguments: str) -> str | None:
    """What git says about this checkout, or None where it has nothing to say."""
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def commits_since(stamp: Stamp, sources: list[str]) -> int | None:
    """How many commits have touched the code since the day of a page; None without git."""
    since = f"--since={stamp.day} 23:59:59"
    found = git("rev-list", "--count", since, "HEAD", "--", *sources)
    return None if found is None else int(found)


def changes_with_the_same_draws(*, of_times: bool) -> list[Change]:
    """Changes that were shown to leave every draw and verdict (``study.py same_draws --write``).

    For pages of times those alone that were shown to leave the time of a run, too.
    """
    path = ROOT / "scripts" / "same_draws.csv"
    rows = path.read_text(encoding="utf-8").splitlines()[1:] if path.exists() else []
    rooms = tuple(f"{SOURCE}/{room}" for room in (*POSTERIOR, "fitting", "identifiability"))
    found = []
    for before, after, _, _, ratio in (row.split(",") for row in rows):
        as_long = bool(ratio) and abs(float(ratio) - 1.0) <= AS_LONG
        if as_long or not of_times:
            found.append(Change(before, after, rooms))
    return found


def age(page: Page) -> tuple[bool, str]:
    """(whether the page should be remade, how old it is in words)."""
    stamp = stamp_of(ROOT / page.path)
    if stamp is None:
        return True, "does not say what made it"
    of = f"commit {stamp.commit} of {stamp.day}"
    same = changes_with_the_same_draws(of_times=page.of_times)
    changes = differing(ROOT, stamp.commit, page.sources, SOURCE, same)
    if changes is None:  # not a commit of this clone: by its day
        count = commits_since(stamp, page.sources)
        if count is None:
            return True, f"{of}; whether the code is newer is not known outside a git checkout"
        told = "1 commit has" if count == 1 else f"{count} commits have"
        told += f" changed {', '.join(page.rooms)} since"
    else:
        count = len(changes)
        told = "1 definition differs" if count == 1 else f"{count} definitions differ"
        told += ", among them " if count > NAMED else ": "
        told += ", ".join(changes[:NAMED])
    return (True, f"{of}: OLDER, {told}") if count else (False, f"{of}: current")


def check(names: list[str]) -> None:
    """Print how old every page is."""
    ages = {name: age(PAGES[name]) for name in names}
    for name, (_, words) in ages.items():
        print(f"{PAGES[name].path:28}{words}")
    older = [name for name, (old, _) in ages.items() if old]
    print(f"{len(older)} of {len(names)} pages of measured figures are older than their code")
    print(f"studies that remake no page: {', '.join(sorted(set(studies()) - used_studies()))}")


def used_studies() -> set[str]:
    """The studies that the pages are remade by."""
    every = [shlex.split(command) for page in PAGES.values() for command in page.commands]
    return {words[2] for words in every if words[:2] == shlex.split(STUDY)}


# --- remaking it ---------------------------------------------------------------------------------


def why_not(page: Page) -> str:
    """Why a page cannot be remade here; empty where it can."""
    missing = [name for name in page.needs if find_spec(name) is None]
    if missing:
        return f"{', '.join(missing)} not installed (extras bench and fe)"
    if page.of_measured_tissue and not os.environ.get(REAL):
        return f"{REAL} does not name measured tissue"
    if git("rev-parse", "HEAD") is None:
        return "not a git checkout: the page could not say which commit it is of"
    if changed := git("status", "--porcelain", "--", *page.sources):
        return f"commit first, so that the page can say what it is of: {changed.split()[1]} changed"
    return ""


def argv(command: str, work: Path) -> list[str]:
    """A command as it is run: by this Python, its folders and patterns filled in."""
    out: list[str] = []
    for word in shlex.split(command):
        filled = word.replace("{work}", str(work)).replace("{real}", os.environ.get(REAL, ""))
        path = Path(filled)
        out += sorted(map(str, path.parent.glob(path.name))) if "*" in path.name else [filled]
    program = {"python": [sys.executable], "biaxbayes": [sys.executable, "-m", "biaxbayes.cli"]}
    return [*program[out[0]], *out[1:]]


def remake(name: str, kept: Path) -> bool:
    """Run what a page needs and has not had of this code, and stamp it; whether that went well."""
    page = PAGES[name]
    # the last commit of the package: what else is in the repository does not make the figures
    commit, day = (git("log", "-1", "--format=%h %cs", "--", SOURCE) or " ").split(" ")
    state = git("log", "-1", "--format=%h", "--", *page.sources) or commit
    work = kept / f"{name}-{state}"  # what was kept of other code is not gone on with
    record = work / "done.txt"
    if not record.exists():  # nothing was begun, or all of it ended: measured anew
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        record.touch()
    done = record.read_text(encoding="utf-8").splitlines()
    paths = [str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(p for p in paths if p),
        "OMP_NUM_THREADS": "1",
        "MPLBACKEND": "Agg",
    }
    for command in page.commands:
        if command in done:
            print(f"{name}: done before: {command}", flush=True)
            continue
        print(f"{name}: {command}", flush=True)
        clock = time.monotonic()
        ended = subprocess.run(argv(command, work), cwd=ROOT, env=environment)
        print(f"{name}: {(time.monotonic() - clock) / 60:.1f} min", flush=True)
        if ended.returncode:
            print(f"{name}: ended with {ended.returncode}; the page keeps its old date")
            return False
        with record.open("a", encoding="utf-8") as file:
            file.write(f"{command}\n")
    made = Stamp(commit, day, date.today().isoformat(), f"python scripts/evidence.py {name}")
    put_stamp(ROOT / page.path, made)
    record.unlink()
    return True


def main() -> int:
    """Check, list or remake pages; exit code 1 where one could not be made."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", metavar="PAGE", help=f"of {', '.join(PAGES)}")
    parser.add_argument("--check", action="store_true", help="say which are older, and end with 0")
    parser.add_argument("--list", action="store_true", help="print the commands, and run none")
    parser.add_argument("--again", action="store_true", help="also pages that are current")
    parser.add_argument("--folder", type=Path, default=ROOT / "evidence", help="of kept studies")
    options = parser.parse_args()
    unknown = [name for name in options.pages if name not in PAGES]
    if unknown:
        parser.error(f"no page {unknown[0]}; pages are {', '.join(PAGES)}")
    names = options.pages or list(PAGES)
    if options.check:
        check(names)
        return 0
    if options.list:
        for name in names:
            print(f"{name}: {PAGES[name].path}", *PAGES[name].commands, sep="\n    ")
        return 0
    failed = []
    for name in names:
        old, words = age(PAGES[name])
        if not (old or options.again):
            print(f"{name}: {words}")
        elif reason := why_not(PAGES[name]):
            print(f"{name}: skipped, {reason}")
            failed.append(name)
        elif not remake(name, options.folder.resolve()):
            failed.append(name)
    if failed:
        print(f"not remade: {', '.join(failed)}")
    return int(bool(failed))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("stopped; the same command goes on")
        sys.exit(130)
