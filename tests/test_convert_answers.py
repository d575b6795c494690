"""What an export leaves open is asked; with the answers it is read to the values it was made of."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
import commands
from biaxbayes import GOH
from biaxbayes.errors import InputError
from biaxbayes.machines.account import account
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.tables.question import Question

SIZE = {"edge_x_mm": 10.0, "edge_y_mm": 10.0, "thickness_mm": 1.2, "geometry": "unloaded"}
RATIOS = {"1:1": (1.0, 1.0), "1:0.5": (1.0, 0.5), "0.5:1": (0.5, 1.0)}
SOFT, STIFF = GOH(12.0, 60.0, 8.0, 40.0, 0.15), GOH(30.0, 20.0, 8.0, 40.0, 0.15)
NOISE_N = 0.0005
NAMES = ("lambda_x", "lambda_y", "Fx [N]", "Fy [N]")
TARGETS = ("stretch_x", "stretch_y", "force_x_N", "force_y_N")


def made(
    ratio: tuple[float, float] = (1.0, 1.0), rows: int = 60, material: GOH = SOFT, seed: int = 1
) -> np.ndarray:
    """Stretches and noisy forces of a loading branch, (rows, 4)."""
    test = virtual_test(
        material,
        mounting_stretch=(1.02, 1.015),
        measured_stretch=1.18,
        ratio=ratio,
        increments=rows - 1,
        edge_x_mm=10.0,
        edge_y_mm=10.0,
        thickness_mm=1.2,
    )
    table = np.column_stack([test.measured_x, test.measured_y, test.force_x_N, test.force_y_N])
    table[:, 2:] += NOISE_N * np.random.default_rng(seed).standard_normal((rows, 2))
    return table


def written(folder: Path, columns: dict[str, object], name: str = "raw.csv") -> Path:
    path = folder / name
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*(list(values) for values in columns.values()), strict=True))
    return path


def table_of(rows: np.ndarray, **more: object) -> dict[str, object]:
    return {
        **{k.replace("_", " "): v for k, v in more.items()},
        **dict(zip(NAMES, rows.T, strict=True)),
    }


def mapped(names=NAMES, *more: str) -> str:
    return ",".join([f"{t}={n}" for t, n in zip(TARGETS, names, strict=True)] + list(more))


def read(path: Path | list[Path], columns: str | None = None, **options):
    header = SIZE | options.pop("header", {})
    return biaxbayes.convert(
        path, machine="generic", columns=columns or mapped(), header=header, **options
    )


def asked(path: Path | list[Path], columns: str | None = None, **options) -> Question:
    with pytest.raises(Question) as question:
        read(path, columns, **options)
    assert str(question.value).isprintable()
    assert question.value.choices
    return question.value


def is_made_of(result, *tables: np.ndarray) -> bool:
    """Whether the protocols have exactly these rows."""
    protocols = result.specimen.protocols
    return len(protocols) == len(tables) and all(
        np.allclose(np.hstack([p.stretch, p.recorded_load]), table, rtol=1e-9)
        for p, table in zip(protocols, tables, strict=True)
    )


# --- account, picture and recipe ------------------------------------------------------------------


def cycled(folder: Path, name: str = "raw.csv") -> tuple[Path, np.ndarray]:
    """Two cycles up and down in one table, and the rows of the last rise."""
    up = made()
    back = up[::-1] * [1, 1, 0.9, 0.9]
    return written(
        folder, table_of(np.concatenate([up * [1, 1, 1.2, 1.2], back, up, back])), name
    ), up


def test_every_row_is_in_the_account(tmp_path):
    path, up = cycled(tmp_path)
    result = read(path, cycles="last", branch="loading")
    told = "\n".join(account(result))
    assert "240 rows read" in told and "kept" in told and "cycle 2 of 2" in told
    counts = [int(line.split()[2]) for line in told.splitlines() if line.startswith("  left")]
    (record,) = result.records
    kept = np.concatenate([r.rows for r in result.recordings])
    assert (record.reasons[kept] == "").all() and (np.delete(record.reasons, kept) != "").all()
    assert sum(counts) + kept.size == 240
    assert result.specimen.protocols[0].rows in (60, 61)
    assert np.allclose(result.specimen.protocols[0].stretch[-60:], up[:, :2])


def test_a_picture_and_a_recipe_are_beside_the_file(tmp_path, capsys):
    path, _ = cycled(tmp_path)
    words = ["convert", path, "--machine", "generic", "--columns", mapped()]
    for key, value in SIZE.items():
        words += [f"--{key.replace('_', '-')}", value]
    out = tmp_path / "specimen.csv"
    code, _, err = commands.run(capsys, *words, "--out", out)
    assert code == 2 and "--cycles last" in err and "holds several cycles (2)" in err
    assert list(tmp_path.iterdir()) == [path]  # without an answer nothing is written
    code, text, _ = commands.run(
        capsys, *words, "--cycles", "last", "--branch", "loading", "--out", out
    )
    assert code == 0 and "picture: " in text and "recipe: " in text
    assert (tmp_path / "specimen-record.png").read_bytes().startswith(b"\x89PNG")
    recipe = tmp_path / "specimen-recipe.toml"
    # another specimen of the lab: the same answers, its own dimensions
    next_one, _ = cycled(tmp_path, "next.csv")
    words = ["convert", next_one, "--recipe", recipe, "--edge-x-mm", 9, "--edge-y-mm", 9]
    words += ["--thickness-mm", 1.1]
    code, text, err = commands.run(capsys, *words, "--out", tmp_path / "next-specimen.csv")
    assert code == 0, err
    again = biaxbayes.read_specimen(tmp_path / "next-specimen.csv")
    assert again.edge_x_mm == 9.0 and again.geometry == "unloaded"
    assert np.all(again.protocols[0].stretch == biaxbayes.read_specimen(out).protocols[0].stretch)


def test_a_file_that_does_not_fit_a_recipe_is_refused(tmp_path):
    path, _ = cycled(tmp_path)
    out = tmp_path / "specimen.csv"
    read(path, cycles="last", branch="loading", out=out)
    recipe = tmp_path / "specimen-recipe.toml"
    both = np.concatenate([made(), made()[::-1], made((1.0, 0.5)), made((1.0, 0.5))[::-1]])
    other = written(tmp_path, table_of(both), "other.csv")
    with pytest.raises(Question, match="stretch ratios"):
        biaxbayes.convert(other, recipe=recipe, header=SIZE)
    with pytest.raises(InputError, match=r"does not fit the recipe .* its protocols are 2"):
        biaxbayes.convert(other, recipe=recipe, protocols_by="ratio", header=SIZE)
    renamed = written(tmp_path, dict(zip("abcd", made().T, strict=True)), "renamed.csv")
    with pytest.raises(InputError, match="no column 'lambda_x'"):
        biaxbayes.convert(renamed, recipe=recipe, header=SIZE)
    recipe.write_text(recipe.read_text() + "colour = 3\n")
    recipe.write_text("colour = 3\n" + recipe.read_text())
    with pytest.raises(InputError, match="no option 'colour'"):
        biaxbayes.convert(path, recipe=recipe, header=SIZE)
