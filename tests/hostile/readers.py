"""Every reader under damaged input: what goes in, what is called, and what must come of it.

A trial calls the command line in this process, as a user would, with what follows the reading
left out where it would take seconds. It must end within ten seconds with exit code 0 (or 3), or
with 2 and one printable line that names the file; anything else is a problem.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import math
import os
import shutil
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import biaxbayes
import virtual_biotester
from biaxbayes import read_specimen, write_specimen
from biaxbayes.cli import main
from biaxbayes.errors import BiaxbayesError
from biaxbayes.model.posterior import Posterior
from biaxbayes.runs import checkpoint
from biaxbayes.runs.run import open_run
from biaxbayes.sampling.sampler import Plan
from biaxbayes.specimens.specimen_file import parse_specimen, specimen_text
from biaxbayes.verbs.options import open_usable_run
from biaxbayes.verbs.sample import Sampling
from hostile import priors_files, specimen_files
from hostile.mutations import TOKENS, as_toml, mutated_bytes, mutated_table, odd_numbers
from quick_posteriors import without_figures

__all__ = ["READERS", "Bases", "Tally", "finished_run", "hammer"]

SECONDS = 10.0
REPLACED = 0.05
"""Share of inputs that are no damaged file but noise, or a checkpoint with a wrong checksum."""


@dataclass
class Tally:
    """What came of many inputs to one reader."""

    reader: str
    read: int = 0
    refused: int = 0
    with_place: int = 0
    slowest: float = 0.0
    problems: list[str] = field(default_factory=list)

    @property
    def inputs(self) -> int:
        return self.read + self.refused + len(self.problems)

    def add(self, other: Tally) -> None:
        self.read += other.read
        self.refused += other.refused
        self.with_place += other.with_place
        self.slowest = max(self.slowest, other.slowest)
        self.problems += other.problems


@dataclass
class Bases:
    """Valid input to start from: a finished run, made once."""

    run: Path

    def copied(self, folder: Path) -> Path:
        shutil.rmtree(folder / "run", ignore_errors=True)
        return Path(shutil.copytree(self.run, folder / "run"))


def finished_run(folder: Path) -> Bases:
    """A small run to damage, without figures."""
    specimen = Path(__file__).parents[2] / "data" / "donor2-adventitia.csv"
    with (
        without_figures(),
        mock.patch("biaxbayes.verbs.sample.Plan", partial(Plan, walkers=32, first_block=16)),
    ):
        biaxbayes.sample(specimen, out=folder / "run", ess=500)
    return Bases(folder / "run")


def command(*arguments: object) -> tuple[int, str]:
    """Exit code and standard error of a command line, in this process."""
    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        try:
            main([str(a) for a in arguments])
        except SystemExit as end:
            return int(end.code or 0), err.getvalue()
    return -1, err.getvalue()


def judge(code: int, err: str, path: Path, tally: Tally) -> None:
    """Count an ending, or say what is wrong with it."""
    if code in (0, 3):
        tally.read += 1
        return
    line = err.splitlines()[-1] if err.strip() else ""
    wrong = (
        code != 2
        or not line.startswith(("biaxbayes: ", "Error: "))
        or not line.isprintable()
        or "Traceback" in err
        or "internal error" in err
    )
    if wrong or str(path) not in line:
        tally.problems.append(f"exit {code}: {err.strip()[-300:]!r}")
        return
    tally.refused += 1
    # More than the file's name: a row, a column or a key, or what the whole file is.
    tally.with_place += any(w in line for w in ("row ", "column ", "'", "key", "specimen "))


# --- specimen files -----------------------------------------------------------------------------

PROTOCOLS = specimen_files.protocols(["1:1, slow", "1:0.5"], quote=True)
SPECIMENS = [
    specimen_files.GOOD.encode(),
    PROTOCOLS.encode(),
    (
        "# mounting_stretch_x: 1.03 +- 0.01\n# rest_rows: 2\n"
        "stretch_x,stretch_y,cauchy_x_kPa,cauchy_y_kPa\n" + specimen_files.body()
    ).encode(),
]
SPECIMEN_TOKENS = [
    *TOKENS, b"stretch_x", b"protocol", b"force_x_N", b"# rest_rows: 3\n", b"1,1,1,1\n",
    b"# geometry: mounted\n", b"# thickness_mm: 1e-4\n", b"# edge_x_mm: 1e4\n", b"# specimen: \n",
]  # fmt: skip


def specimen_file(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    path = folder / "specimen.csv"
    base = SPECIMENS[rng.integers(len(SPECIMENS))]
    data = rng.bytes(int(rng.integers(2000))) if rng.random() < REPLACED else base
    path.write_bytes(mutated_bytes(rng, data, SPECIMEN_TOKENS))
    code, err = command("check", "--no-fit", path)
    if not err:
        code = 0  # read, also where the record cannot be a loading curve
    judge(code, err, path, tally)
    if code == 0 and not read_as_written(path):
        tally.problems.append(f"read wrong: {path.read_bytes()!r}")


def read_as_written(path: Path) -> bool:
    """The loads of a specimen are those that another reader finds in the file."""
    lines = path.read_text("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    table = [x for x in lines if x.strip(" ,\t\x0b\x0c") and not x.lstrip('" ').startswith("#")]
    cells = [[c.strip() for c in row] for row in csv.reader(table)]
    specimen = read_specimen(path)
    suffix = {"force": "N"}.get(specimen.stress_pair, "kPa")
    for axis in "xy":
        at = cells[0].index(f"{specimen.stress_pair}_{axis}_{suffix}")
        there = [float(row[at]) for row in cells[1:]]
        got = np.concatenate([getattr(p, f"load_{axis}") for p in specimen.protocols])
        if specimen.stress_pair == "cauchy":  # kept nominal when the reference moves
            got = np.sort(got)
            if not np.allclose(got, np.sort(there), rtol=0.2, atol=1e-9):
                return False
        elif not np.array_equal(got, there):
            return False
    return True


# --- priors and study files ---------------------------------------------------------------------

PRIORS: list[dict[str, Any]] = [
    {"kappa": 0.1, "k1": "2 * C1"},
    {
        "alpha": {"distribution": "normal", "mean": 41, "sd": 5},
        "C1": {"distribution": "lognormal", "median": 10, "sd_log": 2},
        "k2": {"distribution": "loguniform", "low": 0.01, "high": 500},
        "mounting_stretch": {"distribution": "normal", "mean": 1, "sd": 0.1},
    },
    {"kappa": {"distribution": "uniform", "low": 0.0, "high": 0.3}, "noise_sd": 0.01},
]
STUDY = {
    "name": "three",
    "seed": 1,
    "ess": 500,
    "max_steps": 2000,
    "options": {"noise": "effective", "mounting": "noisy", "thin": "auto", "fibre_switch": False},
    "priors": {"kappa": 0.2},
    "specimen": [
        {"file": "specimen.csv", "label": "a", "donor": "D1", "layer": "media"},
        {
            "file": "other.csv",
            "mounting_force": [0.01, 0.02],
            "options": {"mounting": "zeroed"},
            "priors": PRIORS[1],
        },
    ],
}


def damaged_toml(rng: np.random.Generator, table: dict) -> bytes:
    """Another value somewhere, or another byte."""
    if rng.random() < 0.5:
        table = mutated_table(rng, table)
    text = as_toml(table if isinstance(table, dict) else {"kappa": table})
    data = text.encode("utf-8", "surrogatepass")
    return mutated_bytes(rng, data, most=2) if rng.random() < 0.5 else data


def evaluate_instead(self: Sampling, **_: object) -> None:
    """In place of sampling: the posterior is built, and its density is a number."""
    posterior = Posterior(self.specimen, **{**self.options, "noise": "independent"})
    rng = np.random.default_rng(1)
    values = {
        "C1": 8.0, "k1": 20.0, "k2": 3.0, "alpha": 40.0, "kappa": 0.12, "noise_sd": 0.01,
        "mounting_force_x": 0.01, "mounting_force_y": 0.008, "noise_growth": 0.01,
    }  # fmt: skip
    parameters = {n: values.get(n, 1.0) * np.exp(rng.normal(0, 0.5, 20)) for n in posterior.free}
    out = np.asarray(posterior.log_density(parameters))
    if np.isnan(out).any() or np.isposinf(out).any():
        raise AssertionError("the density is not a number")
    raise SystemExit(0)


def priors_file(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    specimen, path = folder / "good.csv", folder / "priors.toml"
    specimen.write_text(specimen_files.GOOD)
    texts = [*priors_files.ACCEPTED.values()]
    pick = int(rng.integers(len(PRIORS) + len(texts)))
    if pick < len(PRIORS):
        path.write_bytes(damaged_toml(rng, PRIORS[pick]))
    else:
        path.write_bytes(mutated_bytes(rng, texts[pick - len(PRIORS)]))
    with mock.patch.object(Sampling, "execute", evaluate_instead):
        code, err = command("sample", specimen, "--out", folder / "out", "--priors", path)
    judge(code, err, path, tally)


def study_file(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    from biaxbayes.studies.study_file import read_study

    for name in ("specimen.csv", "other.csv"):
        (folder / name).write_text(specimen_files.GOOD)
    path = folder / "STUDY.toml"
    path.write_bytes(damaged_toml(rng, STUDY))
    try:
        study = read_study(path)
        for specimen in study.specimens:
            if specimen.file.parent.resolve() != folder.resolve() and not specimen.file.is_file():
                raise AssertionError(f"leads to {specimen.file}")
            if not specimen.label.isprintable():
                raise AssertionError(f"label {specimen.label!r}")
        code, err = 0, ""
    except BiaxbayesError as refusal:
        code, err = refusal.exit_code, f"biaxbayes: {refusal}\n"
    judge(code, err, path, tally)


# --- machine exports ----------------------------------------------------------------------------

GENERIC = (
    "t;F11;F22;Px;Py\ns;-;-;kPa;kPa\n"
    + "".join(f"{i};{1 + 0.01 * i};{1 + 0.02 * i};{0.5 + i};{0.6 + 2 * i}\n" for i in range(12))
).encode()
EXPORTS = [
    virtual_biotester.biotester_export(cycles=1, rows=8).text().encode(),
    virtual_biotester.biotester_export(cycles=1, rows=8, tracked=False)
    .text(";", ",")
    .encode("cp1252"),
]
EXPORT_TOKENS = [*TOKENS, b"1-Stretch", b"9-Recover", b"mN", b"_um", b"F11", b"Px", b"Test2"]
SIZES = ("--edge-x-mm", 10, "--edge-y-mm", 10, "--thickness-mm", 1.2, "--geometry", "unloaded")
COLUMNS = "stretch_x=F11,stretch_y=F22,piola_x_kPa=Px,piola_y_kPa=Py"


def machine_export(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    path, out = folder / "export.csv", folder / "out.csv"
    out.unlink(missing_ok=True)
    generic = rng.random() < 0.4
    base = GENERIC if generic else EXPORTS[rng.integers(2)]
    path.write_bytes(mutated_bytes(rng, base, EXPORT_TOKENS))
    # The generic record has no unloading.
    branch = str(rng.choice(["loading", "both", "loading" if generic else "unloading"]))
    how = ("generic", "--columns", COLUMNS) if generic else ("biotester", "--set", "all")
    code, err = command(
        "convert", path, "--machine", *how, "--branch", branch, "--out", out, *SIZES
    )
    if "from its option" in err:  # what an option asks for is not in the file
        err = err.replace("biaxbayes: ", f"biaxbayes: {path} ")
    judge(code, err, path if str(path) in err else out, tally)


# --- run folders and checkpoints ----------------------------------------------------------------

RUN_FILES = ("provenance.json", "posterior.nc", "summary.csv", "specimen.csv", "fit.json")
VERBS = (
    ("report", "--format", "latex", "--out", "-"),
    ("report", "--format", "html", "--out", "-"),
    ("report", "--format", "latex", "--out", "-"),
    ("export", "--to", "abaqus", "--at", "map", "--overwrite"),
)


def run_folder(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    run = bases.copied(folder)
    name = RUN_FILES[rng.integers(len(RUN_FILES))]
    path = run / name
    if name.endswith(".json") and rng.random() < 0.7:
        table = mutated_table(rng, json.loads(path.read_text()))
        path.write_text(json.dumps(table), "utf-8", "surrogatepass")
    else:
        path.write_bytes(mutated_bytes(rng, path.read_bytes()))
    if name != "provenance.json" and rng.random() < 0.8:  # whoever changed it knew how
        record = json.loads((run / "provenance.json").read_text())
        record["files"][name] = hashlib.sha256(path.read_bytes()).hexdigest()
        (run / "provenance.json").write_text(json.dumps(record))
    if rng.random() < 0.3:
        verb, *options = VERBS[rng.integers(len(VERBS))]
        code, err = command(verb, run, *options)
    else:
        code, err = opened(run)
    judge(code, err, run, tally)


def opened(run: Path) -> tuple[int, str]:
    """Everything that can be read of a run folder, as the verbs do."""
    try:
        it = open_run(run)
        it.specimen, it.summary, it.draws, it.chains, it.fit
        assert open_usable_run(run, anyway=True).law.names
        it.posterior()
    except BiaxbayesError as refusal:
        return 2, f"biaxbayes: {refusal}\n"
    return 0, ""


def saved_checkpoint(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    body = (bases.run / checkpoint.NAME).read_bytes()[32:]
    if rng.random() < 0.5:
        with np.load(io.BytesIO(body)) as archive:
            parts = {k: archive[k] for k in archive.files}
        key = list(parts)[rng.integers(len(parts))]
        if key == "text":
            text = json.loads(parts["text"].tobytes().decode())
            changed = json.dumps(mutated_table(rng, text)).encode("utf-8", "surrogatepass")
            parts["text"] = np.frombuffer(changed, dtype=np.uint8)
        else:
            parts = damage(rng, parts, key)
        out = io.BytesIO()
        np.savez(out, **parts)
        body = out.getvalue()
    else:
        body = mutated_bytes(rng, body)
    digest = rng.bytes(32) if rng.random() < REPLACED else hashlib.sha256(body).digest()
    try:
        state, _ = checkpoint.unpack(digest + body)
        if not np.isfinite(state.chain).all():
            raise AssertionError("a chain that is not finite")
        tally.read += 1
    except (checkpoint.DamagedCheckpoint, BiaxbayesError):
        tally.refused += 1


def damage(rng: np.random.Generator, parts: dict, key: str) -> dict:
    """The arrays of a checkpoint, one of them turned into something else."""
    with np.errstate(all="ignore"):
        return parts | {key: parts[key] * rng.choice([-1.0, 0.0, 1e308, np.nan, np.inf])}


# --- paths of stretches, and options ------------------------------------------------------------

STRETCHES = b"# a path\nstretch_x,stretch_y\n1,1\n1.05,1.02\n1.1,1.05\n"


def stretch_path(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    from biaxbayes.specimens.table import read_stretches

    path = folder / "path.csv"
    path.write_bytes(mutated_bytes(rng, STRETCHES))
    try:
        found = read_stretches(path)
        code, err = 0, ""
        if found.shape[1] != 2 or not np.isfinite(found).all():
            raise AssertionError("stretches that are no numbers")
    except BiaxbayesError as refusal:
        code, err = refusal.exit_code, f"biaxbayes: {refusal}\n"
    judge(code, err, path, tally)


WORDS = (
    "nan", "inf", "-1", "0", "1e308", "1e-320", "9" * 400, "", " ", "\x1b[31m", "a b", "kappa",
    "kappa=nan", "C1=1e400", "alpha=91", "k1=", "=", "ü", "--", "none", "auto", "../..",
    "/dev/null", "x" * 5000, "true", "1,5", "0x10", "1_0", "kappa=0.1=2",
)  # fmt: skip
OPTIONS = (
    "--seed", "--ess", "--max-steps", "--workers", "--mounting", "--noise", "--mounting-stretch",
    "--thin", "--fix", "--priors", "--out",
)  # fmt: skip


def options(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    specimen = folder / "good.csv"
    specimen.write_text(specimen_files.GOOD)
    tared = rng.random() < 0.4
    if tared:
        write_specimen(read_specimen(specimen).zeroed(), specimen)
    chosen: list[str] = []
    for _ in range(rng.integers(1, 4)):
        chosen += [OPTIONS[rng.integers(len(OPTIONS))], WORDS[rng.integers(len(WORDS))]]
    if rng.random() < (0.8 if tared else 0.2):
        some = ["nan", "inf", "-1", "1e308", "0", "x", *3 * ["0.01", "0.02", "8", "1000"]]
        numbers = rng.choice(some, 2)
        chosen += ["--mounting-force", *map(str, numbers)]
    with mock.patch.object(Sampling, "execute", evaluate_instead):
        code, err = command("sample", specimen, *chosen)
    # The place of an option's fault is the option.
    named = err.replace("biaxbayes: ", f"biaxbayes: {specimen} ").replace(
        "Error: ", f"Error: {specimen} "
    )
    judge(code, named, specimen, tally)


TARED = [
    specimen_text(parse_specimen(x.decode().split("\n"), Path("x")).zeroed()) for x in SPECIMENS
]
MOUNTED = (0.02, 0.02, 1.0)
"""Of the unit of each: N, N, kPa."""
MAD = (np.nan, np.inf, -1.0, 0.0, 1e-12, 1e3, 1e6, 1e308)
MOUNTING_WORDS = ("--mounting-stretch", "per-protocol"), ("--mounting", "exact"), ("--thin", "auto")


def tared_specimen(rng: np.random.Generator, folder: Path, bases: Bases, tally: Tally) -> None:
    """A tared file with the force it had when it was mounted: read, put back on, evaluated."""
    path, which = folder / "tared.csv", int(rng.integers(len(TARED)))
    text = TARED[which]
    if rng.random() < 12 * REPLACED:  # a sound table of odd numbers gets further than odd bytes
        path.write_text(odd_numbers(rng, text))
    else:
        path.write_bytes(mutated_bytes(rng, text.encode(), SPECIMEN_TOKENS))
    scale = 1.0 if rng.random() >= 4 * REPLACED else float(rng.choice(MAD))
    force = [repr(scale * float(v)) for v in rng.uniform(0.5, 2.0, 2) * MOUNTED[which]]
    words = [w for pair in MOUNTING_WORDS if rng.random() < 0.3 for w in pair]
    with mock.patch.object(Sampling, "execute", evaluate_instead):
        out = folder / "out"
        code, err = command("sample", path, "--out", out, "--mounting-force", *force, *words)
    if str(path) not in err:  # a specimen goes by its file's name, the fault of an option by it
        err = err.replace("tared.csv", str(path)).replace("s: --", f"s: {path} --")
    judge(code, err, path, tally)


READERS: dict[str, Callable[[np.random.Generator, Path, Bases, Tally], None]] = {
    "specimen CSV": specimen_file,
    "priors TOML": priors_file,
    "study TOML": study_file,
    "machine export": machine_export,
    "run folder": run_folder,
    "checkpoint": saved_checkpoint,
    "path of stretches": stretch_path,
    "options of sample": options,
    "tared specimen": tared_specimen,
}


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def hammer(reader: str, seed: int, count: int, folder: Path, bases: Bases) -> Tally:
    """So many damaged inputs to a reader, from a seed."""
    tally = Tally(reader)
    for number in range(count):
        rng = np.random.default_rng([seed, number, *reader.encode()])
        begun = time.perf_counter()
        try:
            with inside(folder), warnings.catch_warnings():
                warnings.simplefilter("error")
                READERS[reader](rng, folder, bases, tally)
        except Exception:
            last = traceback.format_exc().strip().splitlines()
            tally.problems.append(f"{seed}, {number}: {' | '.join(last[-3:])}")
        took = time.perf_counter() - begun
        tally.slowest = max(tally.slowest, took)
        if took > SECONDS or math.isnan(took):
            tally.problems.append(f"{seed}, {number}: took {took:.1f} s")
    return tally
