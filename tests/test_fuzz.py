"""Damaged input of every kind is read, or refused by one line that names the file.

A trial damages a valid input at random and reads it as the verbs do. Anything but a reading or a
:class:`BiaxbayesError` of one printable line fails, and so does a warning.
"""

import csv
import hashlib
import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biaxbayes import Posterior, open_run, read_specimen, write_specimen
from biaxbayes.errors import BiaxbayesError, InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.conversion import convert
from biaxbayes.model.priors import read_priors
from biaxbayes.specimens.check import check_specimen
from good_specimen import GOOD, ROWS, protocols
from virtual_biotester import biotester_export

TRIALS = 50
TOKENS = [
    b"", b",", b"\n", b"\r", b'"', b"'", b"#", b":", b";", b"\t", b" ", b"-", b"0", b"=", b"[",
    b"]", b"{", b"}", b".", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"=A1", b"1_0", b"\xff",
    b"\x00", b"\xef\xbb\xbf", b"\xff\xfe", b"\xe2\x80\xa8", b"\x1c", b"\\u0000", b"\\", b"null",
    b"true", b"9" * 400, b"../", b"<b>&amp;", b"PK\x03\x04", b"\x89HDF", b"1,5", b"stretch_x",
    b"# rest_rows: 3\n", b"1,1,1,1\n", b"# geometry: mounted\n", b"# thickness_mm: 1e-4\n",
    b"# edge_x_mm: 1e4\n", b"1-Stretch", b"9-Recover", b"mN", b"_um", b"F11", b"Test2",
]  # fmt: skip
VALUES: list[Any] = [
    None, True, 0, -1, 10**400, -(2**63), 0.5, -0.0, 1e308, 5e-324, float("nan"), float("inf"), "",
    "x" * 5000, "../../etc/passwd", "/dev/zero", "\x1b[31m", "a\nb", "\x00", "C1", "2 * C1",
    "\udc80", [], {}, [[]], [1, 2], {"x": 1}, {"distribution": "normal", "mean": 0, "sd": 1},
]  # fmt: skip


def damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """A few edits: bytes flipped, tokens put in, parts cut or repeated, numbers exchanged."""
    out = bytearray(data)
    longest = int(rng.choice([1, 8, 400]))  # small damage may leave a file valid
    for _ in range(rng.integers(1, 5)):
        at, length = int(rng.integers(max(len(out), 1))), int(rng.integers(longest + 1))
        kind = rng.choice(["flip", "token", "token", "cut", "repeat", "number"])
        if kind == "flip" and out:
            out[at] = int(rng.integers(256)) if longest > 1 else ord(str(rng.integers(10)))
        elif kind == "token":
            out[at : at + min(length, 8)] = TOKENS[rng.integers(len(TOKENS))]
        elif kind == "cut":
            del out[at : at + length]
        elif kind == "repeat":
            out[at:at] = out[at : at + length]
        else:
            out[at : at + 4] = f"{rng.standard_normal():.3g}e{rng.integers(-330, 311)}".encode()
    return bytes(out)


def damaged_json(rng: np.random.Generator, text: bytes) -> bytes:
    """A value somewhere in nested dicts and lists is another, or gone."""
    table = place = json.loads(text)
    while True:
        key = list(place)[rng.integers(len(place))] if isinstance(place, dict) else 0
        if not isinstance(place[key], dict | list) or not place[key] or rng.random() < 0.3:
            break
        place = place[key]
    if rng.random() < 0.2:
        del place[key]
    else:
        place[key] = VALUES[rng.integers(len(VALUES))]
    return json.dumps(table).encode("utf-8", "surrogatepass")


CAUCHY = (
    "# mounting_stretch_x: 1.03 +- 0.01\n# rest_rows: 2\n"
    + "stretch_x,stretch_y,cauchy_x_kPa,cauchy_y_kPa\n"
    + "\n".join(ROWS)
)
TIMED = "time_s,stretch_x,stretch_y,piola_x_kPa,piola_y_kPa\n" + "".join(
    f"{0.1 * i},{row}\n" for i, row in enumerate(ROWS)
)
SPECIMENS = [GOOD, protocols('"1:1, slow"', '"1:0.5"'), CAUCHY, TIMED]
PRIORS = [
    'kappa = 0.1\nk1 = "2 * C1"\n',
    'alpha = { distribution = "normal", mean = 41, sd = 5 }\n'
    'C1 = { distribution = "lognormal", median = 10, sd_log = 2 }\n',
    'kappa = { distribution = "uniform", low = 0.0, high = 0.3 }\nnoise_sd = 0.01\n',
]


def specimen(path: Path) -> None:
    """The loads are those that another reader finds in the file; written, they are read equal."""
    read = read_specimen(path)
    assert np.isfinite(read.area).all() and (read.area > 0.0).all() and read.peak_load > 0.0
    assert all(np.isfinite(read.mounting_readings(shared=s)).all() for s in (True, False))
    assert all(finding.message.isprintable() for finding in check_specimen(read))
    write_specimen(read, path.with_name("again.csv"))
    assert read_specimen(path.with_name("again.csv")) == read
    lines = path.read_text("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    table = [x for x in lines if x.strip(" ,\t\x0b\x0c") and not x.lstrip('" ').startswith("#")]
    names, *rows = [[c.strip() for c in row] for row in csv.reader(table)]
    for axis in "xy":
        at = next(i for i, n in enumerate(names) if n.startswith(f"{read.loads}_{axis}"))
        loads = np.concatenate([getattr(p, f"load_{axis}") for p in read.protocols])
        written = np.array([float(row[at]) for row in rows])
        if read.loads == "cauchy":  # the nominal stress stays when the reference moves
            np.testing.assert_allclose(np.sort(loads), np.sort(written), rtol=0.2, atol=1e-9)
        else:
            np.testing.assert_array_equal(loads, written)


def priors(path: Path) -> None:
    good = path.with_name("good.csv")
    try:
        posterior = Posterior(read_specimen(good), noise="independent", priors=read_priors(path))
    except InputError as refusal:
        raise InputError(str(refusal), file=path) from None
    rng = np.random.default_rng(1)
    typical = {"k1": 20.0, "k2": 3.0, "alpha": 40.0, "kappa": 0.12, "noise_sd": 0.01}
    values = {n: typical.get(n, 1.0) * np.exp(rng.normal(0, 0.5, 20)) for n in posterior.free}
    density = np.asarray(posterior.log_density(values))
    assert not np.isnan(density).any() and not np.isposinf(density).any()


def export(path: Path) -> None:
    """Each branch of a machine's export is converted to finite loads, or refused."""
    size = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
    for branch in ("loading", "both", "unloading"):
        for p in convert(
            [path], Choice("biotester", branch=branch, cycles="last", sets=("all",)), header=size
        ).specimen.protocols:
            assert np.isfinite(p.load_x).all() and np.isfinite(p.load_y).all()


READERS: dict[str, tuple[list[bytes | str], Callable[[Path], object]]] = {
    "specimen": (list(SPECIMENS), specimen),
    "priors.toml": (list(PRIORS), priors),
    "export": ([biotester_export(cycles=1, rows=8).text()], export),
}


def is_read(read: Callable[[Path], object], path: Path) -> bool:
    """Whether an input is read; a refusal must be one printable line with its path."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(path)
        except BiaxbayesError as refusal:
            assert str(path) in str(refusal) and str(refusal).isprintable(), refusal
            return False
    return True


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("trials", [TRIALS, pytest.param(3000, marks=pytest.mark.slow)])
def test_a_damaged_file_is_read_or_refused(reader, trials, tmp_path):
    contents, read = READERS[reader]
    (tmp_path / "good.csv").write_text(GOOD)
    path = tmp_path / reader
    results = []
    for number in range(trials * (4 if reader == "specimen" else 1)):
        rng = np.random.default_rng([number, *reader.encode()])
        content = contents[number % len(contents)]
        data = content.encode() if isinstance(content, str) else content
        path.write_bytes(data)
        assert number >= len(contents) or is_read(read, path)  # undamaged
        path.write_bytes(damaged(rng, data) if rng.random() > 0.05 else rng.bytes(1000))
        results.append(is_read(read, path))
    assert results.count(False) > 10


def open_all(run: Path) -> None:
    """Everything that is read of a run folder."""
    opened = open_run(run)
    opened.specimen, opened.summary, opened.draws, opened.chains, opened.fit
    opened.posterior()


@pytest.mark.long
def test_a_damaged_run_folder_is_read_or_refused(small_run, tmp_path):
    assert is_read(open_all, small_run.path)
    results = []
    for number in range(30):
        rng = np.random.default_rng([1, number])
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        run = Path(shutil.copytree(small_run.path, tmp_path / "run"))
        names = ("provenance.json", "posterior.nc", "summary.csv", "specimen.csv", "fit.json")
        path = run / names[number % len(names)]
        change = damaged_json if path.suffix == ".json" and rng.random() < 0.7 else damaged
        path.write_bytes(change(rng, path.read_bytes()))
        if path.name != "provenance.json" and rng.random() < 0.8:  # whoever changed it knew how
            record = json.loads((run / "provenance.json").read_text())
            record["files"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
            (run / "provenance.json").write_text(json.dumps(record))
        results.append(is_read(open_all, run))
    assert results.count(False) > 10
