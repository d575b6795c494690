"""Run folders that a stranger made, or a disk damaged: one line, and nothing outside is touched."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

import commands


@pytest.fixture
def run(small_copy):
    return small_copy.path


def refused(run: Path, capsys, *words: object) -> str:
    """The one line of a refusal."""
    err = commands.refused(capsys, *(words or ("identify", run)))
    assert str(run) in err
    return err


def seal(run: Path, name: str = "", **changes: object) -> None:
    """Write the provenance with changes, and with the right checksum of a file."""
    record = json.loads((run / "provenance.json").read_text())
    for key, value in changes.items():
        both_tables = isinstance(value, dict) and isinstance(record[key], dict)
        record[key] = record[key] | value if both_tables else value
    if name:
        record["files"][name] = hashlib.sha256((run / name).read_bytes()).hexdigest()
    (run / "provenance.json").write_text(json.dumps(record))


Damage = Callable[[Path], object]


def provenance(content: bytes) -> Damage:
    return lambda run: (run / "provenance.json").write_bytes(content)


def entries(**changes: object) -> Damage:
    return lambda run: seal(run, **changes)


def posterior(change: Callable[[h5py.File], object]) -> Damage:
    """Change the archive of a run, with the right checksum."""

    def damage(run: Path) -> None:
        with h5py.File(run / "posterior.nc", "a") as file:
            change(file)
        seal(run, "posterior.nc")

    return damage


def link(file: h5py.File) -> None:
    del file["posterior/C1"]
    file["posterior/C1"] = h5py.ExternalLink("/etc/passwd", "/posterior/C1")


def not_finite(file: h5py.File) -> None:
    file["posterior/C1"][0, 0] = float("nan")


def bomb(file: h5py.File) -> None:
    file.create_dataset("bomb", shape=(10**12,), dtype="f8", chunks=(2**20,), compression="gzip")


def truncate(run: Path) -> None:
    path = run / "posterior.nc"
    path.write_bytes(path.read_bytes()[:5000])
    seal(run, "posterior.nc")


def flip_a_bit(run: Path) -> None:
    data = bytearray((run / "posterior.nc").read_bytes())
    data[len(data) // 2] ^= 1
    (run / "posterior.nc").write_bytes(bytes(data))


DAMAGES: list[tuple[Damage, str]] = [
    (provenance(b""), "provenance.json: is empty"),
    (provenance(b'{"seed": 1'), "is damaged (not JSON)"),
    (provenance(b"[" * 100_000), "is damaged (not JSON)"),
    (provenance(b"[]"), "'the whole'"),
    (provenance(b'{"seed": 1}'), "is not the record of a run"),
    (entries(convergence={"state": "great"}), "convergence: state"),
    (entries(misfit={"toe": "large"}), "misfit: toe"),
    (entries(misfit={"terms": [[10**9]]}), "misfit: terms"),
    (entries(misfit={"terms": ["x"]}), "misfit: terms"),
    (entries(seed=10**400), "not JSON"),
    (entries(settings={"fibre_switch": "no"}), "settings"),
    (entries(settings={"mounting": "guessed"}), "mounting must be one of"),
    (entries(settings={"priors": {"kappa": "__import__('os')"}}), "kappa"),
    (entries(settings={"noise_growth": True}), "settings"),
    (entries(settings={"noise": "effective"}), "noise must be one of"),
    (posterior(link), "links to other data"),
    (posterior(bomb), "claims more data than it can hold"),
    (posterior(not_finite), "values that are not finite"),
    (posterior(lambda f: f.pop("posterior/k2")), "no k2"),
    (truncate, "cannot be read as a posterior"),
    (flip_a_bit, "is not the file that the run wrote"),
    (lambda run: (run / "specimen.csv").unlink(), "no such file"),
]


@pytest.mark.parametrize(("damage", "words"), DAMAGES, ids=[words for _, words in DAMAGES])
def test_a_damaged_run_is_refused_in_one_line(run, capsys, damage, words):
    damage(run)
    assert words in refused(run, capsys)


NOT_THE_RESULT = "results.json: is not the result of this run"
RESULTS = [
    (lambda r: r["reported"][0].update(verdict="great"), NOT_THE_RESULT),
    (lambda r: r["reported"][0].update(name="<b>"), NOT_THE_RESULT),
    (lambda r: r.pop("law_fits"), NOT_THE_RESULT),
    (lambda r: r["reported"][0].update(low="one"), NOT_THE_RESULT),
    (lambda r: r.update(law="fung"), NOT_THE_RESULT),
    (lambda r: r["reported"][0].update(low=10**400), "results.json"),
    (lambda r: r["summary"][1].update(parameter="k11.1e51"), "no quantity of this run is called"),
]


@pytest.mark.parametrize(("change", "words"), RESULTS)
def test_a_result_of_another_kind(run, capsys, change, words):
    result = json.loads((run / "results.json").read_text())
    change(result)
    (run / "results.json").write_text(json.dumps(result))
    latex = ("report", run, "--format", "latex")
    assert "is not the file that the run wrote" in refused(run, capsys, *latex)
    seal(run, "results.json")
    assert words in refused(run, capsys, *latex)
    (run / "results.json").unlink()
    assert "results.json: no such file" in refused(run, capsys, *latex)


@pytest.mark.parametrize("stored", [{}, {"format": 1}, {"format": 2}])
def test_a_run_of_an_earlier_version_is_refused_in_one_line(run, capsys, stored):
    record = json.loads((run / "provenance.json").read_text())
    del record["format"]
    (run / "provenance.json").write_text(json.dumps(record | stored))
    assert "made by an earlier version: sample again" in refused(run, capsys)


@pytest.mark.parametrize("name", ["provenance.json", "posterior.nc", "specimen.csv"])
def test_links_lead_nowhere_outside(run, capsys, tmp_path, name):
    shutil.move(run / name, tmp_path / "elsewhere")
    (run / name).symlink_to(tmp_path / "elsewhere")
    assert "leads outside the run folder" in refused(run, capsys)
    (run / name).unlink()
    (run / name).symlink_to(run / name)
    assert "link" in refused(run, capsys)


def test_nothing_is_written_through_a_link(run, capsys, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    shutil.move(run / "evidence", elsewhere)
    (elsewhere / "identifiability.csv").write_text("mine")
    (run / "evidence").symlink_to(elsewhere)
    (run / "cards-abaqus-kPa-mm").symlink_to(elsewhere)
    before = {p.name: p.read_text() for p in elsewhere.iterdir()}
    assert commands.exit_code("identify", run, "--no-figure") in (0, 3)
    assert "leads outside" in commands.refused(capsys, "export", run, "--to", "abaqus", "--anyway")
    assert {p.name: p.read_text() for p in elsewhere.iterdir()} == before
    assert not (run / "evidence").is_symlink() and list((run / "evidence").iterdir())


def test_a_changed_fit_changes_no_bands(run, capsys):
    fit = json.loads((run / "fit.json").read_text())
    fit[0]["mounting_stretch_x"] *= 1.01
    (run / "fit.json").write_text(json.dumps(fit))
    err = commands.refused(capsys, "predict", run, "--stretch", "1.1", "--anyway")
    assert "fit.json: is not the file that the run wrote" in err


def test_not_a_folder_of_a_run(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for path in (tmp_path, tmp_path / "file", tmp_path / "loop"):
        assert "is not a run folder" in refused(path, capsys)
