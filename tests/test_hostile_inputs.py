"""Odd specimen and priors files: each ends in its one line and exit code 2, or is read right."""

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from biaxbayes import read_specimen, write_specimen
from biaxbayes.errors import InputError
from biaxbayes.model.priors import read_priors
from commands import refused
from good_specimen import BODY, GOOD, HEADER, NAMES, ROWS, TABLE, protocols

COLUMNS = np.array([[float(cell) for cell in row.split(",")] for row in ROWS])


def cell(text: str, column: int = 2, row: int = 4) -> str:
    """The good file with one cell replaced."""
    cells = ROWS[row].split(",")
    cells[column] = text
    return HEADER + NAMES + "\n".join([*ROWS[:row], ",".join(cells), *ROWS[row + 1 :]]) + "\n"


def scaled(*factors: float) -> str:
    """The good file with its columns times some factors; 0 makes a column of ones."""
    table = np.where(np.array(factors) == 0.0, 1.0, COLUMNS * factors)
    return HEADER + NAMES + "".join(",".join(map(repr, row)) + "\n" for row in table.tolist())


CELLS = {  # in row 13, column force_x_N
    "NaN": "missing", "": "empty", "broken": "'broken' is not a number", "1.2 N": "without unit",
    "=A1": "'=A1' is a formula", "=cmd|' /C calc'!A0": "is a formula",
    "1_000": "not a plain number",
    "inf": "'inf' is not a finite number", "1e400": "not a finite number", "1e308": "MPa",
    "0x1F": "'0x1F'", "#DIV/0!": "lack a reading: '#DIV/0!' in line 13",
    '"0,17"': "'0,17' has a decimal comma",
}  # fmt: skip
HEADERS = {  # what stands in the good file, what in its place, and what the message says
    ("layer", "tissue"): "unknown header key 'tissue'",
    ("thickness_mm", "thickness"): "did you mean thickness_mm?",
    ("# layer: media", "# geometry: mounted"): "'geometry' appears twice",
    ("1.35", "-1.35"): "must be a positive number",
    ("1.35", "1,35"): "'1,35'",
    ("1.35", "nan"): "'nan'",
    ("1.35", "1e308"): "out of range",
    ("20", "20 mm"): "without unit",
    ("unloaded", "deformed"): "'deformed'",
    ("# thickness_mm: 1.35\n", ""): "must state thickness_mm",
    ("# geometry: unloaded\n", ""): "'# geometry: unloaded|mounted'",
    ("noise_N", "noise_kPa"): "load_noise_kPa does not fit",
    ("0.0006", "60"): "exceeds every load",
    ("# layer", "# rest_rows: 0\n# layer"): "rest_rows must be at least 1",
    ("# layer", "# rest_rows: 2.5\n# layer"): "whole number",
    ("# layer", "# rest_rows: 99\n# layer"): "no stretched row",
    ("# layer", "# rest_rows: 1, 2\n# layer"): "rest_rows has 2 values for 1 protocol",
    ("# layer", "# mounting_stretch_x: 1.03\n# layer"): "1.03 +- 0.01",
    ("# layer", "# mounting_stretch_x: 1.02 +- 1e-300\n# layer"): "1.03 +- 0.01",
    ("# layer: media", "# layer: \x1b[31m"): "control character 0x1b",
}
NAME_LINES = {  # names of the columns
    "stretch_x,time_s,force_x_N,force_y_N": "column stretch_y: missing column",
    "stretch_x,stretch_y,force_x_N,time_s": "column force_y_N: missing column",
    "stretch_x,stretch_y,force_x_N,piola_y_kPa": "more than one kind of loads",
    "stretch_x,stretch_x,force_x_N,force_y_N": "appears twice",
    "stretch_x,stretch_y,force_x_N,temperature_C": "unknown column",
    "stretch_x,stretch_y,force_x_mN,force_y_N": "column force_x_mN: unknown",
    "force_x_N,force_y_N,stretch_x,stretch_y": "stretches are ratios near 1",
    "stretch_x;stretch_y;force_x_N;force_y_N": "semicolons",
    "stretch_x\tstretch_y\tforce_x_N\tforce_y_N": "tabs",
    "Dear colleague, the file is attached.": "not a specimen CSV",
    ",".join(f"c{i}" for i in range(3000)): "3000 columns",
    ",".join(f"column{i}" for i in range(10_000)): "characters",
}
FILES: dict[str, tuple[str | bytes, str]] = {
    "empty": (b"", "is empty; export the record again"),
    "binary": (GOOD.encode() + b"\x00\x01", "row 21: is binary"),
    "a workbook": (b"PK\x03\x04" + b"x" * 99, "'biaxbayes convert' reads"),
    "gzip": (gzip.compress(GOOD.encode()), "gzip archive, not a text file; unpack"),
    "UTF-16": (GOOD.encode("utf-16"), "UTF-16, not UTF-8 text"),
    "latin-1": (GOOD.replace("media", "Zwölf").encode("latin-1"), "row 2: is not UTF-8"),
    "a line of 2 MB": (GOOD + "1" * 2_000_000, "2,000,000 characters"),
    "header only": (HEADER, "no table"),
    "no rows": (HEADER + NAMES, "row 8: no row of data"),
    "one row": (HEADER + NAMES + ROWS[0] + "\n", "only 1 row"),
    "numbers only": (BODY, "not a specimen CSV"),
    "row names": (HEADER + "," + NAMES + "".join(f"1,{r}\n" for r in ROWS), "without a name"),
    "semicolons below": (HEADER + NAMES + BODY.replace(",", ";"), "1 cell for 4 columns"),
    "decimal comma": (HEADER + NAMES + "1,0,1,0,0,1,0,1\n1,1,1,1,0,2,0,2\n", "decimal commas"),
    "open quote": (cell('"0.1') + BODY * 400, "row 13: not a row of a CSV"),
    "header below": (GOOD + "# thickness_mm: 2\n", "below the column names"),
    "cut off": (GOOD.rpartition(",")[0], "row 20: 3 cells for 4 columns; the file may be cut"),
    "forces in mN": (scaled(1, 1, 1000, 1000), "in mN, divide"),
    "per cent": (scaled(100, 100, 1, 1), "strains or per cent"),
    "stretch below zero": (cell("-0.5", column=0), "row 13, column stretch_x"),
    "strains": (scaled(0.01, 1, 1, 1), "stretches are ratios near 1"),
    "constant stretch": (scaled(0, 1, 1, 1), "column stretch_x: the stretch never changes"),
    "constant force": (scaled(1, 1, 0, 1), "column force_x_N: every value is 1"),
    "a protocol of one row": (protocols("a") + f"b,{ROWS[0]}\n", "protocol 'b' has one row"),
    "a protocol returns": (protocols("a", "b", "a"), "'a' comes back"),
    "no protocol name": (protocols("a", ""), "name is empty"),
    "a protocol per row": (
        HEADER + "protocol," + NAMES + "".join(f"{i},1,1,1,1\n" for i in range(3000)),
        "more than 1000 protocols",
    ),
    "a protocol at rest": (protocols("a") + f"b,{ROWS[0]}\n" * 3, "never changes"),
}  # fmt: skip
REFUSED = [
    *((cell(text), ("row 13, column force_x_N: ", says)) for text, says in CELLS.items()),
    *((GOOD.replace(a, b), (says,)) for (a, b), says in HEADERS.items()),
    *((HEADER + line + "\n" + BODY, (says,)) for line, says in NAME_LINES.items()),
    *((content, (says,)) for content, says in FILES.values()),
]


@pytest.mark.parametrize(("content", "says"), REFUSED, ids=[s[-1][:40] for _, s in REFUSED])
def test_refused_with_its_message(content, says, tmp_path, capsys):
    path = tmp_path / "specimen.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as refusal:
        read_specimen(path)
    assert str(path) in str(refusal.value) and refusal.value.remedy
    assert all(words in str(refusal.value) for words in says)
    assert refused(capsys, "check", "--no-fit", "--", path) == f"biaxbayes: {refusal.value}\n"


def test_a_path_that_is_no_file(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "away").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "locked").write_text(GOOD)
    (tmp_path / "locked").chmod(0)
    for name, says in {
        "none.csv": "no such file", ".": "is a folder", "loop": "cannot be read",
        "away": "no such file", "pipe": "not a regular file", "locked/x": "cannot be read",
        "x" * 300: "cannot be read", "a\nb\x1b[31m.csv": "no such file",
    }.items():  # fmt: skip
        with pytest.raises(InputError) as refusal:
            read_specimen(tmp_path / name)
        assert says in str(refusal.value) and str(refusal.value).isprintable()
    if os.geteuid() != 0:  # root reads everything
        with pytest.raises(InputError, match="cannot be read; check its permissions"):
            read_specimen(tmp_path / "locked")
    (tmp_path / "good.csv").write_text(GOOD)
    with pytest.raises(InputError, match="nowhere does not exist; make it"):
        write_specimen(read_specimen(tmp_path / "good.csv"), tmp_path / "nowhere" / "out.csv")


SAME = {  # the same numbers, written in other ways
    "BOM": "\ufeff" + GOOD,
    "CRLF": GOOD.replace("\n", "\r\n"),
    "CR": GOOD.replace("\n", "\r"),
    "mixed line ends": GOOD.replace("\n", "\r\n", 5),
    "no last line end": GOOD.rstrip("\n"),
    "blank lines": GOOD.replace("\n", "\n   \n"),
    "spaces round commas": HEADER + TABLE.replace(",", " , ").replace("\n", "  \n"),
    "separators behind": HEADER.replace("\n", ",,,\n") + TABLE.replace("\n", ",\n") + ",,,\n",
    "all quoted": HEADER + '"' + TABLE[:-1].replace(",", '","').replace("\n", '"\n"') + '"\n',
    "comments": "# measured by us\n#\n## two marks\n" + GOOD,
}  # fmt: skip


@pytest.mark.parametrize("way", SAME)
def test_read_right_however_it_is_written(way, tmp_path):
    path = tmp_path / "Über uns (x).csv"
    path.write_text(SAME[way], "utf-8", newline="")
    specimen = read_specimen(path)
    (p,) = specimen.protocols
    np.testing.assert_array_equal(
        np.column_stack([p.stretch_x, p.stretch_y, p.load_x, p.load_y]), COLUMNS
    )
    assert (specimen.name, specimen.thickness_mm, specimen.layer) == ("A12", 1.35, "media")


def test_odd_but_valid_values(tmp_path):
    def read(text: str):
        (tmp_path / "a.csv").write_text(text)
        return read_specimen(tmp_path / "a.csv")

    for layer in ("Außenwand µ 主动脉", "a: b", "<b>&"):
        assert read(GOOD.replace("media", layer)).layer == layer
    assert read(GOOD.replace("media", "")).layer is None
    assert read(GOOD.replace("A12", "\ufeff A\u200b12\u2028")).name == "A 12"
    assert read(cell("+1.7E-1")).protocols[0].load_x[4] == 0.17
    assert read("# stress_limit_kPa: 1e9\n" + scaled(1, 1, 1000, 1000)).peak_load > 100.0
    assert read("# rest_rows: 3\n" + GOOD).protocols[0].rest_rows == 3
    names = [
        p.name for p in read(protocols('"1:1, slow"', '"the ""first"""', "1_000", "01")).protocols
    ]
    assert names == ["1:1, slow", 'the "first"', "1_000", "01"]


PRIORS: dict[str | bytes, str] = {
    "": "is empty; write its settings",
    b"\x00\x01\x02kappa = 0\n": "is binary",
    "kappa: 0\n": "not valid TOML",
    "kappa = 0\nkappa = 0.1\n": "not valid TOML",
    "kappa = " + "[" * 3000 + "]" * 3000 + "\n": "nested too deeply",
    "kappa = nan\n": "kappa cannot be fixed at nan",
    "C1 = -1\n": "C1 cannot be fixed at -1",
    "alpha = 100\n": "alpha cannot be fixed at 100",
    "kappa = true\n": "kappa must be a number, a tie or a distribution",
    "mounting_stretch = 1.0\n": "cannot be fixed",
    'k1 = "2 * k1"\n': "k1 cannot be tied to",
    'k1 = "2 * C1"\nC1 = "2 * k1"\n': "tied in a circle",
    "k1 = \"__import__('os').getpid() * C1\"\n": "k1 cannot be tied to",
    'k1 = "nan * C1"\n': "k1 cannot be tied to",
    'k1 = { distribution = "cauchy", mean = 3 }\n': "k1: unknown distribution 'cauchy'",
    'alpha = { distribution = "normal", mean = 3 }\n': "lacks sd",
    'alpha = { distribution = "normal", mean = 3, sd = 1, mode = 2 }\n': "has no 'mode'",
    'alpha = { distribution = "normal", mean = 3, sd = 0 }\n': "deviation must be positive",
    'alpha = { distribution = "normal", mean = 3, sd = inf }\n': "sd must be a finite number",
    'kappa = { distribution = "uniform", low = 0.3, high = 0.1 }\n': "low must be below high",
    'alpha = { distribution = "normal", mean = 5000, sd = 1 }\n': "the prior has no mass",
    'C1 = { distribution = "lognormal", median = -1, sd_log = 1 }\n': "median must be positive",
    'k2 = { distribution = "loguniform", low = 0, high = 1 }\n': "k2: low must be positive",
}


@pytest.mark.parametrize("content", PRIORS)
def test_priors_refused_with_their_message(content, tmp_path, capsys):
    path, specimen = tmp_path / "priors.toml", tmp_path / "specimen.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    specimen.write_text(GOOD)
    words = ("sample", specimen, "--priors", path, "--out", tmp_path / "run")
    err = refused(capsys, *words)
    assert err.startswith(f"biaxbayes: {path}") and PRIORS[content] in err
    assert not Path(tmp_path / "run").exists()


def test_priors_read_right(tmp_path):
    path = tmp_path / "ä priors.toml"
    path.write_bytes(
        b"\xef\xbb\xbf# so: \xc3\xa4\r\nkappa = 0.1 # dry\r\nk1 = '2 * C1'\r\nC1 = 1e1\r\n"
    )
    read = read_priors(path)
    assert (read["kappa"], read["C1"]) == (0.1, 10.0)
    assert (read["k1"].factor, read["k1"].other) == (2.0, "C1")
    path.write_text('alpha.distribution = "uniform"\nalpha.low = 10\nalpha.high = 200\n')
    alpha = read_priors(path)["alpha"].as_table()
    assert (alpha["low"], alpha["high"]) == (10.0, 90.0)  # cut where alpha ends
