"""Tables open anywhere, and nothing is overwritten unasked."""

import csv
import os

import pandas as pd
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes.errors import InputError, RunError
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import PROVENANCE, manifest
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.text_files import read_csv, write_csv
from commands import refused, run

OWN_LAW = '''"""Neo-Hookean."""
import numpy as np
parameters = {"c_kPa": ("lognormal", 20, 2)}

def energy(X, Y, Z, c):
    return c / 2 * (X + Y + Z - 3)
'''
TEXTS = ["=1+1", "+1+1", "-2+3", "@SUM(A1)", "\t=1+1", "'=1+1", "'tis", "plain", "-1.5", "+2e3"]


def test_a_spreadsheet_computes_nothing_and_texts_read_back_as_they_were(tmp_path):
    table = pd.DataFrame({"=label": TEXTS, "value": [-1.5] * len(TEXTS)})
    write_csv(tmp_path / "table.csv", table)
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    for cell in (*head, *(row[0] for row in rows)):
        assert not cell.startswith(("=", "+", "-", "@", "\t")) or float(cell)
    assert [row[0] for row in rows[-2:]] == TEXTS[-2:]  # numbers stay numbers
    assert {row[1] for row in rows} == {"-1.5"}
    back = read_csv(tmp_path / "table.csv", dtype={"'=label": str})
    pd.testing.assert_frame_equal(back, table, check_dtype=False)


def test_a_finished_run_is_refused_in_one_line_and_stays(capsys, tmp_path, small_run, copied):
    folder, path = copied(small_run.path), tmp_path / "other.csv"
    write_specimen(quick_posteriors.small_specimen(), path)
    before = manifest(folder)
    for option in ((), ("--quiet",)):
        code, out, err = run(capsys, "sample", path, "--out", folder, *option)
        assert code == 2 and not out and len(err.splitlines()) == 1
        assert "holds a finished run" in err and "--overwrite" in err
    assert manifest(folder) == before
    # There is nothing to resume without a checkpoint: that would replace it, too.
    for name in (checkpoint.NAME, checkpoint.PREVIOUS):
        (folder / name).unlink(missing_ok=True)
    with pytest.raises(RunError, match="finished run"):
        biaxbayes.sample(path, out=folder, resume=True, **quick_posteriors.QUICK)


@pytest.mark.long
def test_a_run_is_replaced_whole(tmp_path, small_run, copied):
    folder = copied(small_run.path)
    biaxbayes.export(folder, "abaqus", anyway=True)
    biaxbayes.predict(folder, stretch=1.1, out=folder, anyway=True)
    with quick_posteriors.runs_without_figures():
        biaxbayes.plot(folder, "corner", out=folder / "corner-180mm.svg")
    biaxbayes.report(folder, "latex")
    (folder / "prediction.pdf").write_text("mended by hand\n")
    for name in ("notes.txt", "design.csv", "corner-of-the-paper.pdf"):
        (folder / name).write_text("mine\n")
    (folder / "cards-abaqus-kPa-mm" / "job.inp").write_text("mine\n")
    steps = []
    with quick_posteriors.runs_without_figures():
        again = biaxbayes.sample(
            quick_posteriors.small_specimen(), out=folder, overwrite=True, seed=4,
            progress=steps.append, **quick_posteriors.QUICK,
        )  # fmt: skip
    kept = {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    own = {name.partition("/")[0] for name in again.provenance["files"]} | {PROVENANCE}
    assert kept - own - {checkpoint.NAME, checkpoint.PREVIOUS} == {
        *("notes.txt", "design.csv", "corner-of-the-paper.pdf", "prediction.pdf"),
        "cards-abaqus-kPa-mm",
    }
    assert [p.name for p in (folder / "cards-abaqus-kPa-mm").iterdir()] == ["job.inp"]
    assert again.provenance["seed"] == 4
    (output,) = [p.note for p in steps if p.note.startswith("removed with the previous run")]
    # How long writing takes is not known: it is no share that stands at 0 %.
    assert {p.share for p in steps if p.phase == "writing"} == {None}
    assert set(output.partition(": ")[2].split(", ")) == {
        *("cards-abaqus-kPa-mm", "prediction.csv", "corner-180mm.svg", "report.tex"),
    }


def test_a_file_of_another_program_is_not_replaced(small_copy, tmp_path, capsys):
    """A picture or page of this program is, so that a command can be repeated."""
    specimen, run_folder = tmp_path / "specimen.csv", small_copy.path
    write_specimen(quick_posteriors.small_specimen(), specimen)
    picture = tmp_path / "specimen-check.png"
    for path in (specimen, picture):
        if path == picture:
            path.write_bytes(b"\x89PNG of my own")
        before = path.read_bytes()
        for words in (
            ("report", run_folder, "--format", "latex", "--out", path),
            ("plot", run_folder, "--figure", "trace", "--out", path.with_suffix(".png")),
            ("check", specimen, "--no-fit", "--figure", path),
        ):
            if path != specimen or words[0] == "report":
                assert "biaxbayes did not make it" in refused(capsys, *words)
        assert path.read_bytes() == before
    _, out, _ = run(capsys, "check", specimen, "--no-fit")
    assert "picture: none" in out and picture.read_bytes().endswith(b"my own")
    picture.unlink()
    for _ in range(2):
        _, out, _ = run(capsys, "check", specimen, "--no-fit", "--figure", tmp_path / "f.pdf")
        assert f"picture: {picture}" in out
        biaxbayes.report(run_folder, "latex", out=tmp_path / "table.tex")
        biaxbayes.report(run_folder, out=tmp_path / "page.html")


@pytest.mark.long
def test_a_name_that_is_not_utf_8_does_not_end_a_run(tmp_path):
    specimen, law = (tmp_path / os.fsdecode(name) for name in (b"sp\xff.csv", b"own\xff.py"))
    write_specimen(quick_posteriors.small_specimen(), specimen)
    law.write_text(OWN_LAW)
    with quick_posteriors.runs_without_figures():
        sampled = biaxbayes.sample(
            specimen, out=tmp_path / "run", law=str(law), noise="independent", mounting="exact",
            ess=60,
        )  # fmt: skip
    assert sampled.law.name.isprintable() and sampled.law.name.startswith("own")
    assert str(biaxbayes.open_run(sampled.path).provenance["source"]).startswith("sp")


def test_plot_leaves_the_figures_of_the_run(capsys, media_run, copied):
    folder = copied(media_run.path)
    own = manifest(folder)
    code, out, _ = run(capsys, "plot", folder, "--parameter", "kappa", "--parameter", "alpha")
    assert code == 0 and out.strip().endswith("corner-kappa-alpha-180mm.pdf")
    code, out, _ = run(capsys, "plot", folder, "--figure", "bands", "--width-mm", 85)
    assert code == 0 and out.strip().endswith("stress-bands-85mm.pdf")
    err = refused(capsys, "plot", folder, "--out", folder / "corner.pdf")
    assert "figure of the run itself" in err
    with pytest.raises(InputError, match="of the run itself"):
        biaxbayes.plot(folder, "bands", out=folder / "stress-bands", suffix="png")
    after = manifest(folder)
    assert {name: after[name] for name in own} == own
