"""Compiled code: what was compiled just now and what the cache gave back are the same."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from biaxbayes.laws import LAWS
from biaxbayes.laws.response import constants_at, derivatives
from biaxbayes.model.posterior import Posterior
from biaxbayes.specimens.specimen import Protocol, Specimen

DATA = Path(__file__).resolve().parents[1] / "data"
DENSITY = """
import numpy as np
from biaxbayes import read_specimen
from biaxbayes.model.posterior import Posterior

posterior = Posterior(read_specimen(r"{specimen}"), noise="independent", mounting="noisy")
rng = np.random.default_rng(1)
u = rng.normal(0.0, 0.3, (200, posterior.dimension))
print(posterior.log_prob(u).tobytes().hex())
"""


def test_compiled_functions_of_two_laws_have_two_names():
    """Of one name, and compiled by two processes, one would run in the environment of the other.

    A name tells types by their text, and processes count what they compile from the same number.
    """
    up = np.linspace(0.0, 1.0, 6)
    record = Protocol("1", 1.0 + 0.2 * up, 1.0 + 0.1 * up, 10.0 * up, 8.0 * up)
    specimen = Specimen("virtual", (record,), "piola", load_noise=0.5)
    types = [
        numba.typeof(
            Posterior(specimen, law=law, mounting="ignored", noise="independent").assembly.problem
        )
        for law in LAWS
    ]
    assert len({str(kind) for kind in types}) == len(LAWS)
    registered = {*derivatives.registry, *constants_at.registry}
    assert len({kind.__name__ for kind in registered}) == len(registered)


@pytest.mark.long
def test_a_process_that_compiles_finds_what_later_ones_find(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    code = DENSITY.format(specimen=DATA / "donor2-media.csv")
    first, second = (
        subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    )
    assert first == second
    assert len(set(bytes.fromhex(first.strip()))) > 100  # not all of them -inf


SMALL = """
import numba
before = numba.config.CACHE_DIR
from biaxbayes.compilation import CACHE, compiled

@compiled()
def doubled(x):
    return 2.0 * x

print(doubled(21.0), numba.config.CACHE_DIR == before, sum(doubled.stats.cache_hits.values()))
"""


def small_program(folder: Path, cache: Path | str) -> tuple[list[str], str]:
    """Words that a program prints that compiles a function, and its standard error."""
    program = folder / "program.py"
    if not program.exists():  # numba 0.60 goes by its date
        program.write_text(SMALL)
    done = subprocess.run(
        [sys.executable, str(program)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split(), done.stderr


def test_compiled_code_is_kept_and_the_setting_of_numba_stays_the_users(tmp_path):
    assert small_program(tmp_path, tmp_path / "cache") == (["42.0", "True", "0"], "")
    assert small_program(tmp_path, tmp_path / "cache") == (["42.0", "True", "1"], "")


def test_a_cache_that_cannot_be_written_is_left_aside_with_one_line(tmp_path):
    (tmp_path / "file").write_text("no folder")
    words, output = small_program(tmp_path, tmp_path / "file")
    assert words == ["42.0", "True", "0"]
    assert output.count("\n") == 1 and "compiled code cannot be cached in" in output
