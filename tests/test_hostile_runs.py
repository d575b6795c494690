"""Run folders that a stranger made, or a disk damaged: one line, and nothing outside is touched."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import h5py
import pytest

import commands


@pytest.fixture
def run(small_run, copied):
    return copied(small_run.path)


def refused(run: Path, capsys, kind: str = "explore") -> str:
    """The one line of a refusal."""
    err = commands.refused(capsys, "report", run, "--format", kind, "--out", "-")
    assert str(run) in err
    return err


def record(run: Path) -> dict:
    return json.loads((run / "provenance.json").read_text())


def sealed(run: Path, name: str = "", **changes: object) -> None:
    """Write the record with changes, and with the right checksum of a file."""
    new = record(run) | changes
    if name:
        new["files"][name] = hashlib.sha256((run / name).read_bytes()).hexdigest()
    (run / "provenance.json").write_text(json.dumps(new))


RECORDS = {
    "empty": (b"", "is empty"),
    "cut off": (b'{"seed": 1', "is damaged (not JSON)"),
    "no JSON": (b"\x00\xff\xfe", "is damaged (not JSON)"),
    "deep": (b"[" * 100_000, "is damaged (not JSON)"),
    "a list": (b"[]", "'the whole'"),
    "another program's": (b'{"seed": 1}', "is not the record of a run"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_that_is_none(run, capsys, name):
    content, says = RECORDS[name]
    (run / "provenance.json").write_bytes(content)
    err = refused(run, capsys)
    assert says in err and "provenance.json" in err


ENTRIES = {
    "state": ({"convergence": {"state": "great"}}, "convergence: state"),
    "weight": ({"noise": {"beta": float("nan")}}, "noise: beta"),
    "seed": ({"seed": "1"}, "seed"),
    "whole number beyond 64 bits": ({"seed": 10**400}, "not JSON"),
    "flag": ({"settings": {"fibre_switch": "no"}}, "settings"),
    "choice": ({"settings": {"mounting": "guessed"}}, "mounting must be one of"),
    "priors": ({"settings": {"priors": ["kappa"]}}, "settings"),
    "code": ({"settings": {"priors": {"kappa": "__import__('os')"}}}, "kappa"),
    "versions": ({"versions": []}, "versions"),
}


@pytest.mark.parametrize("name", ENTRIES)
def test_an_entry_of_another_kind(run, capsys, name):
    changes, says = ENTRIES[name]
    whole = record(run)
    merged = {
        k: whole[k] | v if isinstance(v, dict) and isinstance(whole[k], dict) else v
        for k, v in changes.items()
    }
    sealed(run, **merged)
    assert says in refused(run, capsys)


def altered_result(run: Path, change) -> None:
    """Change the result of a run, with the right checksum."""
    result = json.loads((run / "results.json").read_text())
    change(result)
    (run / "results.json").write_text(json.dumps(result))
    sealed(run, "results.json")


def test_numbers_beyond_all_bounds(run, capsys):
    """An integer that no float holds, and such an option."""
    altered_result(run, lambda r: r["reported"][0].update(low=10**400))
    assert "results.json" in refused(run, capsys, "latex")
    words = ("sample", run / "specimen.csv", "--max-steps", "9" * 400, "--out", "none")
    assert "--max-steps must be a number" in commands.run(capsys, *words)[2]


@pytest.mark.parametrize("name", ["k11.1e51", "", "mounting_stretch_x[other]"])
def test_a_quantity_that_the_run_has_not(run, capsys, name):
    altered_result(run, lambda r: r["summary"][1].update(parameter=name))
    assert "no quantity of this run is called" in refused(run, capsys, "latex")


RESULTS = {
    "verdict": lambda r: r["reported"][0].update(verdict="great"),
    "name": lambda r: r["reported"][0].update(name="<b>"),
    "missing": lambda r: r.pop("evidence"),
    "a list": lambda r: r.update(convergence=[1]),
    "a word": lambda r: r["reported"][0].update(low="one"),
    "another law": lambda r: r.update(law="fung"),
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_that_is_none(run, capsys, name):
    altered_result(run, RESULTS[name])
    err = refused(run, capsys, "latex")
    assert "results.json: is not the result of this run" in err


def test_a_result_changed_since(run, capsys):
    text = (run / "results.json").read_text()
    (run / "results.json").write_text(text.replace('"low": 1', '"low": 2', 1) + " ")
    assert "is not the file that the run wrote" in refused(run, capsys, "latex")


@pytest.mark.parametrize("name", ["posterior.nc", "specimen.csv"])
def test_a_file_changed_since_or_gone(run, capsys, name):
    data = bytearray((run / name).read_bytes())
    data[len(data) // 2] ^= 1
    (run / name).write_bytes(bytes(data))
    assert "is not the file that the run wrote" in refused(run, capsys)
    (run / name).unlink()
    assert "no such file" in refused(run, capsys)


@pytest.mark.parametrize("name", ["provenance.json", "posterior.nc", "specimen.csv"])
def test_links_lead_nowhere_outside(run, capsys, tmp_path, name):
    shutil.move(run / name, tmp_path / "elsewhere")
    (run / name).symlink_to(tmp_path / "elsewhere")
    assert "leads outside the run folder" in refused(run, capsys)
    (run / name).unlink()
    (run / name).symlink_to(run / name)
    assert "link" in refused(run, capsys)


def linked(file: h5py.File) -> None:
    del file["posterior/C1"]
    file["posterior/C1"] = h5py.ExternalLink("/etc/passwd", "/posterior/C1")


def looped(file: h5py.File) -> None:
    file["posterior/again"] = file["posterior"]


def bomb(file: h5py.File) -> None:
    file.create_dataset("bomb", shape=(10**12,), dtype="f8", chunks=(2**20,), compression="gzip")


def not_finite(file: h5py.File) -> None:
    file["posterior/C1"][0, 0] = float("nan")


def lacking(file: h5py.File) -> None:
    del file["posterior/k2"]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (linked, "links to other data"),
        (looped, "its groups loop"),
        (bomb, "claims more data than it can hold"),
        (not_finite, "values that are not finite"),
        (lacking, "no k2"),
        (None, "cannot be read as a posterior"),
    ],
)
def test_a_posterior_that_no_run_wrote(run, capsys, damage, says):
    path = run / "posterior.nc"
    if damage is None:
        path.write_bytes(path.read_bytes()[:5000])
    else:
        with h5py.File(path, "a") as file:
            damage(file)
    sealed(run, "posterior.nc")
    assert says in refused(run, capsys)


def test_draws_without_a_parameter_of_their_errors(run, capsys):
    sealed(run, settings=record(run)["settings"] | {"noise_growth": True})
    assert "no noise_growth" in refused(run, capsys)


def test_not_a_folder_of_a_run(tmp_path, capsys):
    assert "is not a run folder" in refused(tmp_path, capsys)
    (tmp_path / "file").write_text("")
    assert "is not a run folder" in refused(tmp_path / "file", capsys)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert "is not a run folder" in refused(tmp_path / "loop", capsys)
