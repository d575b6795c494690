"""Runs left alone, runs that end badly, and the comparison between them."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import pkgutil
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import click
import h5py
import numpy as np

from biaxbayes import figures, jobs, reports
from biaxbayes.cli import group
from biaxbayes.cli import main as biaxbayes_main
from biaxbayes.errors import BiaxbayesError
from biaxbayes.identifiability.identify import Identifiability, identify
from biaxbayes.jobs import products as run_products
from biaxbayes.jobs import sample as sampling
from biaxbayes.model.posterior import Posterior
from biaxbayes.reports import page
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import PROVENANCE
from biaxbayes.runs.run import open_run
from biaxbayes.sampling.sampler import Draws, Plan
from biaxbayes.text_files import atomic_write_bytes
from studies.page import DATA

SPECIMEN = DATA / "donor2-adventitia.csv"
SEED = 1
PLENTY = 600.0  # seconds after which a trial counts as hung


WRITTEN_BY_SAMPLE = ("specimen.csv", "posterior.nc", "fit.json", "summary.csv", PROVENANCE)
"""Files of a run that are not made of its draws by ``write_products``."""


@dataclass
class Tally:
    """Trials of one kind, and what went wrong in them."""

    what: str
    trials: int = 0
    ended_badly: int = 0  # the kill or the full disk met a run that was still going
    identical: int = 0
    problems: list[str] = field(default_factory=list)

    def row(self) -> list[str]:
        """Line of the table."""
        wrong = "; ".join(sorted(set(self.problems))[:3]) or "none"
        return [self.what, *map(str, (self.trials, self.ended_badly, self.identical)), wrong]


def sampled(folder: Path, *options: str) -> int:
    """Exit code of a run in this process."""
    settings = ["--ess", "2000", "--quiet", "--overwrite", "--seed", str(SEED), *options]
    try:
        biaxbayes_main(["sample", str(SPECIMEN), "--out", str(folder), *settings])
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 1
    return 98


def start(folder: Path, *options: str, before: Callable[[], None] = lambda: None) -> int:
    """Process id of a run in a forked process; its standard error goes to a file beside it."""
    child = os.fork()
    if child:
        return child
    try:
        log = os.open(f"{folder}.err", os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o644)
        os.dup2(log, 2)
        before()
        os._exit(sampled(folder, *options))
    finally:
        os._exit(99)


def ended(child: int) -> int:
    """Exit code of a run, negative for a signal."""
    limit = time.monotonic() + PLENTY
    while time.monotonic() < limit:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -99


def values(folder: Path) -> dict[str, bytes]:
    """Every array of posterior.nc and every CSV, as bytes."""
    out = {p.name: p.read_bytes() for p in folder.glob("*.csv")}
    with h5py.File(folder / "posterior.nc") as file:

        def keep(name: str, item: h5py.HLObject) -> None:
            if isinstance(item, h5py.Dataset):
                out[name] = np.asarray(item[()]).tobytes()

        file.visititems(keep)
    return out


def import_all() -> None:
    """What a run imports only when it needs it, so that a fork need not."""
    group.get_command(click.Context(group), "sample")
    for room in (figures, jobs, reports):
        for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
            importlib.import_module(module.name)


class Bench:
    """Runs left alone, against which the others are held, and a place for those."""

    def __init__(self, place: Path) -> None:
        self.place = place
        import_all()
        # Fewer walkers and shorter blocks than usual, so that a short run has several checkpoints.
        sampling.Plan = functools.partial(Plan, walkers=32, first_block=16)  # type: ignore[misc, assignment]
        self.whole = place / "whole"
        self.earlier = place / "earlier"
        # In this process: what it imports and compiles need not be so again in a fork.
        assert sampled(self.earlier, "--seed", str(SEED + 1)) == 0, "the first run failed"
        begun = time.monotonic()
        assert ended(start(self.whole)) == 0, "the second run failed"
        self.seconds = time.monotonic() - begun
        self.values = values(self.whole)
        self.drawn = {p.name: p.read_bytes() for p in self.whole.iterdir()}
        self.bytes = sum(p.stat().st_size for p in self.whole.iterdir())

    def copy_products(self) -> None:
        """From here on, what is made of the draws is that of the whole run, not made again.

        They are written by the program's own writer, call by call as if they had been.
        """
        others = (*WRITTEN_BY_SAMPLE, page.NAME, checkpoint.NAME, checkpoint.PREVIOUS)
        products = {n: b for n, b in self.drawn.items() if n not in others}

        verdicts = identify(open_run(self.whole))

        def write_products(folder: Path, posterior: Posterior, draws: Draws) -> Identifiability:
            del posterior, draws
            for name, content in products.items():
                atomic_write_bytes(folder / name, content)
            return verdicts

        def write_report(folder: Path, *_: object) -> None:
            atomic_write_bytes(folder / page.NAME, self.drawn.get(page.NAME, b"left out"))

        run_products.write_products = write_products
        page.write_report = write_report  # type: ignore[assignment]
        begun = time.monotonic()
        again = self.place / "again"
        assert ended(start(again)) == 0, "the third run failed"
        self.seconds = time.monotonic() - begun
        assert values(again) == self.values, "the third run is another one"

    def fresh(self, folder: Path, *, occupied: bool) -> Path:
        """An empty folder for a trial, or one with a finished run of another seed."""
        shutil.rmtree(folder, ignore_errors=True)
        if occupied:
            shutil.copytree(self.earlier, folder)
        return folder

    def judge(self, tally: Tally, folder: Path, code: int, *, occupied: bool) -> None:
        """Look at what a trial left behind, resume it, and compare."""
        tally.trials += 1
        tally.ended_badly += code != 0
        message = Path(f"{folder}.err").read_text()
        if code > 0 and (code != 2 or message.count("\n") != 1 or "Traceback" in message):
            tally.problems.append(f"exit {code}: {message.strip()[-80:]}")
        if occupied:
            try:
                run = open_run(folder)
                written = run.tree.attrs["sampling_seed"], run.summary, run.specimen
                assert written[0] == run.provenance["seed"]
            except (BiaxbayesError, AssertionError) as error:
                tally.problems.append(f"earlier run not readable: {error}")
        resumed = ended(start(folder, *self._again(folder)))
        if resumed != 0:
            why = Path(f"{folder}.err").read_text().strip()[-80:]
            tally.problems.append(f"resume ended with {resumed}: {why}")
        elif values(folder) == self.values and not list(folder.glob(".*")):
            tally.identical += 1
        else:
            tally.problems.append("resumed to other values")

    @staticmethod
    def _again(folder: Path) -> tuple[str, ...]:
        """Resume, unless the earlier run's checkpoint was not yet replaced: then start again."""
        for name in (checkpoint.NAME, checkpoint.PREVIOUS):
            with contextlib.suppress(OSError, checkpoint.DamagedCheckpoint):
                _, identity = checkpoint.unpack((folder / name).read_bytes())
                return ("--resume",) if identity["seed"] == SEED else ()
        return ("--resume",)
