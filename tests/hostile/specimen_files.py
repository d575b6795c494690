"""Hostile specimen CSVs: the refused with their message, the valid with their reading."""

from __future__ import annotations

import gzip
import io
import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from biaxbayes.specimens.specimen import Specimen

HEADER = (
    "# specimen: A12\n# layer: media\n# geometry: unloaded\n"
    "# edge_x_mm: 20\n# edge_y_mm: 18\n# thickness_mm: 1.35\n# load_noise_N: 0.0006\n"
)
NAMES = "stretch_x,stretch_y,force_x_N,force_y_N\n"
COUNT = 12


def rows(count: int = COUNT) -> list[str]:
    """Rows of a stiffening specimen, forces in N."""
    return [
        f"{1 + 0.01 * i:.4f},{1 + 0.008 * i:.4f},{0.01 + 0.02 * i**1.5:.6f},{0.008 + 0.03 * i:.6f}"
        for i in range(count)
    ]


def body(count: int = COUNT) -> str:
    return "\n".join(rows(count)) + "\n"


GOOD = HEADER + NAMES + body()
FIRST = len((HEADER + NAMES).splitlines()) + 1
"""Line of the first row of numbers in :data:`GOOD`."""


@dataclass(frozen=True)
class Refused:
    """A file that must be refused with one line that holds all of ``says``."""

    name: str
    make: Callable[[Path], Path]
    says: tuple[str, ...]


@dataclass(frozen=True)
class Accepted:
    """A file that must be read, and what must be true of the specimen."""

    name: str
    make: Callable[[Path], Path]
    holds: Callable[[Specimen], bool]


def content(text: str | bytes, name: str = "specimen.csv") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
        return path

    return make


def with_cell(cell: str, row: int = 4, column: int = 2, quote: bool = False) -> str:
    """The good file with one cell replaced; ``row`` and ``column`` from 0."""
    lines = rows()
    cells = lines[row].split(",")
    cells[column] = f'"{cell}"' if quote else cell
    lines[row] = ",".join(cells)
    return HEADER + NAMES + "\n".join(lines) + "\n"


def with_column(column: int, value: str) -> str:
    """The good file with every value of a column the same."""
    lines = []
    for line in rows():
        cells = line.split(",")
        cells[column] = value
        lines.append(",".join(cells))
    return HEADER + NAMES + "\n".join(lines) + "\n"


def quoted(table: str) -> str:
    """Every cell between quotation marks, as some programs write a CSV."""
    return "".join(
        ",".join(f'"{cell}"' for cell in line.split(",")) + "\n" for line in table.splitlines()
    )


def with_header(old: str, new: str) -> str:
    assert old in HEADER
    return HEADER.replace(old, new) + NAMES + body()


def swapped(old: str, new: str) -> str:
    return HEADER + NAMES.replace(old, new) + body()


def scaled(factor: float, columns: tuple[int, ...] = (2, 3)) -> str:
    lines = []
    for line in rows():
        cells = line.split(",")
        for column in columns:
            cells[column] = f"{float(cells[column]) * factor:.6g}"
        lines.append(",".join(cells))
    return HEADER + NAMES + "\n".join(lines) + "\n"


def protocols(names: list[str], *, quote: bool = False) -> str:
    """One path per name, one below the other."""
    lines = []
    for name in names:
        cell = f'"{name}"' if quote else name
        lines += [f"{cell},{line}" for line in rows()]
    return HEADER + "protocol," + NAMES + "\n".join(lines) + "\n"


def _workbook() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    return out.getvalue()


def _folder(folder: Path) -> Path:
    (folder / "specimen.csv").mkdir()
    return folder / "specimen.csv"


def _loop(folder: Path) -> Path:
    (folder / "a.csv").symlink_to(folder / "b.csv")
    (folder / "b.csv").symlink_to(folder / "a.csv")
    return folder / "a.csv"


def _dangling(folder: Path) -> Path:
    (folder / "a.csv").symlink_to(folder / "nowhere.csv")
    return folder / "a.csv"


def _pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe.csv")
    return folder / "pipe.csv"


def _through_a_file(folder: Path) -> Path:
    content(GOOD)(folder)
    return folder / "specimen.csv" / "inner.csv"


AT = f"row {FIRST + 4}"
DECIMAL_COMMA = HEADER + NAMES + body().replace(",", ";").replace(".", ",").replace(";", ",")

REFUSED = [
    # --- the file itself
    Refused("missing file", lambda folder: folder / "none.csv", ("no such file", "check the path")),
    Refused("a directory", _folder, ("is a folder",)),
    Refused("symlink loop", _loop, ("cannot be read", "symbolic links")),
    Refused("dangling symlink", _dangling, ("no such file",)),
    Refused("a pipe", _pipe, ("not a regular file",)),
    Refused("through a file", _through_a_file, ("cannot be read",)),
    Refused("name too long", lambda folder: folder / ("x" * 300), ("cannot be read", "too long")),
    Refused("empty", content(b""), ("is empty", "export the record again")),
    Refused("white space only", content(b" \n\n\t\n"), ("is empty",)),
    Refused("a lone BOM", content(b"\xef\xbb\xbf"), ("is empty",)),
    Refused("binary", content(GOOD.encode() + b"\x00\x01"), ("binary", f"row {FIRST + COUNT}")),
    Refused("random bytes", content(np.random.default_rng(1).bytes(4000)), ("row 1",)),
    Refused("a workbook", content(_workbook()), ("Excel workbook", "biaxbayes convert")),
    Refused("an old workbook", content(b"\xd0\xcf\x11\xe0" + b"x" * 99), ("old Excel workbook",)),
    Refused("gzip", content(gzip.compress(GOOD.encode())), ("gzip", "unpack")),
    Refused("a PDF", content(b"%PDF-1.7\n" + b"1 0 obj\n"), ("PDF",)),
    Refused("UTF-16", content(GOOD.encode("utf-16")), ("UTF-16", "CSV UTF-8")),
    Refused("UTF-16 without BOM", content(GOOD.encode("utf-16-le")), ("binary", "row 1")),
    Refused(
        "latin-1",
        content(GOOD.replace("media", "Zwölf µm").encode("latin-1")),
        ("not UTF-8", "row 2"),
    ),
    Refused("control character", content(GOOD.replace("media", "\x1b[31m")), ("0x1b", "row 2")),
    # --- not a specimen CSV
    Refused("prose", content("Dear colleague,\nthe file is attached.\n"), ("not a specimen CSV",)),
    Refused("HTML", content("<!doctype html>\n<p>Not found</p>\n"), ("not a specimen CSV",)),
    Refused("JSON", content('{"stretch_x": [1, 1.1]}\n'), ("not a specimen CSV",)),
    Refused("numbers only", content(body()), ("not a specimen CSV", "row 1")),
    Refused("10,000 columns", content(",".join(f"c{i}" for i in range(3000))), ("3000 columns",)),
    Refused(
        "10,000 columns, a long line",
        content(",".join(f"column{i}" for i in range(10_000))),
        ("characters", "row 1"),
    ),
    Refused(
        "10,000 cells in a row",
        content(GOOD + "1," * 9_999 + "1\n"),
        ("10000 cells for 4 columns", f"row {FIRST + COUNT}"),
    ),
    Refused("a line of 2 MB", content(GOOD + "1" * 2_000_000), ("2,000,000 characters",)),
    Refused("header only", content(HEADER), ("no table",)),
    Refused("names only", content(HEADER + NAMES), ("no row of data", f"row {FIRST - 1}")),
    Refused("one row", content(HEADER + NAMES + body(1)), ("only 1 row", f"row {FIRST}")),
    # --- separators
    Refused(
        "semicolons",
        content(HEADER + (NAMES + body()).replace(",", ";")),
        ("semicolons", "biaxbayes convert"),
    ),
    Refused("tabs", content(HEADER + (NAMES + body()).replace(",", "\t")), ("tabs",)),
    Refused(
        "semicolons below", content(HEADER + NAMES + body().replace(",", ";")), ("1 cell for",)
    ),
    Refused("decimal comma", content(DECIMAL_COMMA), ("8 cells", "decimal comma", f"row {FIRST}")),
    Refused(
        "quoted decimal comma",
        content(with_cell("0,17", quote=True)),
        ("'0,17'", "decimal comma", AT, "column force_x_N"),
    ),
    # --- columns
    Refused("missing stretch", content(swapped("stretch_y,", "time_s,")), ("column stretch_y",)),
    Refused("missing force", content(swapped(",force_y_N", ",time_s")), ("column force_y_N",)),
    Refused(
        "no stress pair",
        content("stretch_x,stretch_y\n1,1\n1.1,1.1\n"),
        ("no stress pair", "piola_x_kPa"),
    ),
    Refused("two pairs", content(swapped("force_y_N", "piola_y_kPa")), ("more than one",)),
    Refused("duplicate column", content(swapped("stretch_y", "stretch_x")), ("appears twice",)),
    Refused("unknown column", content(swapped("force_y_N", "temperature_C")), ("unknown column",)),
    Refused(
        "misspelt column",
        content(swapped("force_y_N", "force_y_n")),
        ("did you mean force_y_N?", f"row {FIRST - 1}"),
    ),
    Refused(
        "row names",
        content(HEADER + "," + NAMES + "\n".join(f"{i},{r}" for i, r in enumerate(rows()))),
        ("without a name", "row names"),
    ),
    Refused("name in mN", content(swapped("force_x_N", "force_x_mN")), ("force_x_mN", "unknown")),
    # --- cells
    Refused("NaN", content(with_cell("NaN")), (AT, "column force_x_N", "missing", "remove")),
    Refused("text", content(with_cell("broken")), (AT, "column force_x_N", "'broken'")),
    Refused("empty cell", content(with_cell("")), (AT, "column force_x_N", "empty")),
    Refused("formula", content(with_cell("=A1")), (AT, "'=A1' is a formula", "column force_x_N")),
    Refused("command formula", content(with_cell("=cmd|' /C calc'!A0")), (AT, "is a formula")),
    Refused("inf", content(with_cell("inf")), (AT, "'inf' is not a finite number")),
    Refused("-Infinity", content(with_cell("-Infinity")), (AT, "not a finite number")),
    Refused("1e400", content(with_cell("1e400")), (AT, "not a finite number")),
    Refused("1e308", content(with_cell("1e308")), (AT, "column force_x_N", "MPa")),
    Refused("1e308 as stretch", content(with_cell("1e308", column=0)), (AT, "column stretch_x")),
    Refused("unit in the cell", content(with_cell("1.2 N")), (AT, "without unit")),
    Refused("thousands", content(with_cell("1_000")), (AT, "not a plain number")),
    Refused("hexadecimal", content(with_cell("0x1F")), (AT, "'0x1F'")),
    Refused("#DIV/0!", content(with_cell("#DIV/0!")), (AT, "'#DIV/0!' is not a number")),
    Refused("complex", content(with_cell("1+2j")), (AT, "'1+2j' is not a number")),
    Refused("line break in a cell", content(with_cell("0.1\n0.2", quote=True)), (AT, "quotation")),
    Refused("open quote", content(with_cell('"0.1')), (AT, "quotation mark")),
    Refused(
        "open quote of 200 kB",
        content(with_cell('"0.1') + body() * 400),
        (AT, "not a row of a CSV"),
    ),
    Refused("header below", content(GOOD + "# thickness_mm: 2\n"), ("below the column names",)),
    Refused(
        "truncated row",
        content(GOOD[: GOOD.rindex(",", 0, len(GOOD) - 12)]),
        ("cut off", f"row {FIRST + COUNT - 1}"),
    ),
    Refused("a cell more", content(with_cell("0.1,0.2")), (AT, "5 cells for 4 columns")),
    # --- header
    Refused(
        "unknown key", content(with_header("layer", "tissue")), ("unknown header key", "row 2")
    ),
    Refused(
        "misspelt key",
        content(with_header("thickness_mm", "thickness")),
        ("did you mean thickness_mm?", "row 6"),
    ),
    Refused("key twice", content("# layer: a\n" + GOOD), ("appears twice", "row 3")),
    Refused("negative thickness", content(with_header("1.35", "-1.35")), ("positive", "row 6")),
    Refused("zero thickness", content(with_header("1.35", "0")), ("positive number", "row 6")),
    Refused("thickness as text", content(with_header("1.35", "thin")), ("'thin'", "row 6")),
    Refused("thickness with comma", content(with_header("1.35", "1,35")), ("'1,35'", "row 6")),
    Refused("thickness NaN", content(with_header("1.35", "nan")), ("'nan'", "row 6")),
    Refused("thickness 1e308", content(with_header("1.35", "1e308")), ("cannot be", "row 6")),
    Refused("thickness 1e-308", content(with_header("1.35", "1e-308")), ("cannot be", "row 6")),
    Refused("edge with unit", content(with_header("20", "20 mm")), ("without unit", "row 4")),
    Refused("geometry", content(with_header("unloaded", "deformed")), ("'deformed'", "row 3")),
    Refused("no thickness", content(with_header("# thickness_mm: 1.35\n", "")), ("thickness_mm",)),
    Refused(
        "no geometry",
        content(with_header("# geometry: unloaded\n", "")),
        ("'# geometry: unloaded|mounted'",),
    ),
    Refused("noise in kPa", content(with_header("noise_N", "noise_kPa")), ("load_noise_kPa",)),
    Refused("noise in mN", content(with_header("0.0006", "60")), ("exceeds every load", "row 7")),
    Refused("rest_rows 0", content("# rest_rows: 0\n" + GOOD), ("rest_rows", "row 1")),
    Refused("rest_rows 2.5", content("# rest_rows: 2.5\n" + GOOD), ("whole number", "row 1")),
    Refused("rest_rows 99", content("# rest_rows: 99\n" + GOOD), ("no stretched row", "row 1")),
    Refused(
        "rest_rows 1,2",
        content("# rest_rows: 1, 2\n" + GOOD),
        ("2 numbers where the protocols are 1",),
    ),
    Refused(
        "stretch from an image",
        content("# mounting_stretch_x: 1.03\n" + GOOD),
        ("1.03 +- 0.01", "row 1"),
    ),
    # --- what the numbers mean
    Refused("forces in mN", content(scaled(1000.0)), ("MPa", "in mN, divide", "column force_x_N")),
    Refused("y in mN", content(scaled(1e5, (3,))), ("in mN, divide", "column force_y_N")),
    Refused("stretch below 0", content(with_cell("-0.5", column=0)), (AT, "column stretch_x")),
    Refused("stretch 0", content(with_cell("0", column=1)), (AT, "column stretch_y")),
    Refused("strains", content(with_column(0, "0.01")), ("stretches are ratios near 1",)),
    Refused("per cent", content(scaled(100.0, (0, 1))), ("per cent", "column stretch_x")),
    Refused(
        "swapped columns",
        content(HEADER + "force_x_N,force_y_N,stretch_x,stretch_y\n" + body()),
        ("stretches are ratios near 1", f"row {FIRST}", "column stretch_x"),
    ),
    Refused("constant stretch", content(with_column(0, "1.0")), ("never changes", "stretch_x")),
    Refused("constant force", content(with_column(2, "0.5")), ("every value is 0.5", "force_x_N")),
    Refused("no force", content(with_column(3, "0")), ("every value is zero", "column force_y_N")),
    Refused("forces in GN", content(scaled(1e-9)), ("check the unit", "column force_x_N")),
    # --- protocols
    Refused("protocol of one row", content(protocols(["a"]) + f"b,{rows()[0]}\n"), ("one row",)),
    Refused("protocol returns", content(protocols(["a", "b", "a"])), ("'a' comes back",)),
    Refused("empty protocol name", content(protocols(["a", ""])), ("name is empty",)),
    Refused(
        "a protocol a row",
        content(HEADER + "protocol," + NAMES + "".join(f"{i},1,1,1,1\n" for i in range(3000))),
        ("more than 1000 protocols",),
    ),
    Refused(
        "a protocol at rest", content(protocols(["a"]) + f"b,{rows()[0]}\n" * 3), ("never changes",)
    ),
]


def same(specimen: Specimen) -> bool:
    """Whether a specimen holds the numbers of :data:`GOOD`."""
    wanted = np.array([[float(cell) for cell in line.split(",")] for line in rows()])
    (p,) = specimen.protocols
    got = np.column_stack([p.stretch_x, p.stretch_y, p.load_x, p.load_y])
    return bool(np.array_equal(got, wanted)) and specimen.thickness_mm == 1.35


def _many_rows(folder: Path) -> Path:
    count = 200_000
    t = np.linspace(0.0, 1.0, count)
    lines = "\n".join(
        f"{1 + 0.2 * s:.9f},{1 + 0.1 * s:.9f},{0.1 + s:.9f},{0.1 + s * s:.9f}" for s in t
    )
    return content(HEADER + NAMES + lines + "\n")(folder)


def _linked(folder: Path) -> Path:
    path = content(GOOD, "there/real.csv")(folder)
    (folder / "link.csv").symlink_to(path)
    return folder / "link.csv"


ACCEPTED = [
    Accepted("good", content(GOOD), same),
    Accepted("BOM", content("\ufeff" + GOOD), same),
    Accepted("CRLF", content(GOOD.replace("\n", "\r\n")), same),
    Accepted("CR", content(GOOD.replace("\n", "\r")), same),
    Accepted("mixed line ends", content(GOOD.replace("\n", "\r\n", 5)), same),
    Accepted("no last line end", content(GOOD.rstrip("\n")), same),
    Accepted("blank lines", content(GOOD.replace("\n", "\n\n")), same),
    Accepted("blank lines with spaces", content(GOOD.replace("\n", "\n   \n")), same),
    Accepted("trailing spaces", content(GOOD.replace("\n", "  \n")), same),
    Accepted("spaces round commas", content(HEADER + (NAMES + body()).replace(",", " , ")), same),
    Accepted("trailing comma", content(HEADER + (NAMES + body()).replace("\n", ",\n")), same),
    Accepted("empty rows of a spreadsheet", content(GOOD + ",,,\n,,,\n"), same),
    Accepted(
        "header padded by a spreadsheet",
        content(HEADER.replace("\n", ",,,\n") + NAMES + body()),
        same,
    ),
    Accepted("all quoted", content(HEADER + quoted(NAMES + body())), same),
    Accepted("plain comments", content("# measured by us\n#\n## two marks\n" + GOOD), same),
    Accepted(
        "exponents", content(with_cell("+1.7E-1")), lambda s: s.protocols[0].load_x[4] == 0.17
    ),
    Accepted(
        "umlauts",
        content(GOOD.replace("media", "Außenwand µ 主动脉")),
        lambda s: s.layer == "Außenwand µ 主动脉",
    ),
    Accepted(
        "colon in a value", content(GOOD.replace("media", "a: b")), lambda s: s.layer == "a: b"
    ),
    Accepted("blank value", content(GOOD.replace("media", "")), lambda s: s.layer is None),
    Accepted(
        "markup in a value", content(GOOD.replace("media", "<b>&")), lambda s: s.layer == "<b>&"
    ),
    Accepted("path with spaces", content(GOOD, "Über uns/Probe 1 (x).csv"), same),
    Accepted(
        "invisible characters in a name",
        content(GOOD.replace("A12", "\ufeff A\u200b12\u2028")),
        lambda s: s.name == "A 12",
    ),
    Accepted("symlink", _linked, same),
    Accepted(
        "columns in another order",
        content(
            HEADER + "force_x_N,stretch_y,stretch_x,force_y_N\n" + "0.1,1,1,0.1\n0.2,1.2,1.1,0.3\n"
        ),
        lambda s: s.protocols[0].stretch_x[1] == 1.1,
    ),
    Accepted("two rows", content(HEADER + NAMES + body(2)), lambda s: s.protocols[0].rows == 2),
    Accepted("200,000 rows", _many_rows, lambda s: s.protocols[0].rows == 200_000),
    Accepted(
        "quoted names",
        content(protocols(["1:1, slow", "1:0.5"], quote=True)),
        lambda s: [p.name for p in s.protocols] == ["1:1, slow", "1:0.5"],
    ),
    Accepted(
        "names with quotes",
        content(protocols(['the ""first""'], quote=True)),
        lambda s: s.protocols[0].name == 'the "first"',
    ),
    Accepted(
        "names with underscores",
        content(protocols(["1_000", "p4_cycle"])),
        lambda s: s.protocols[0].name == "1_000",
    ),
    Accepted(
        "numbers as names",
        content(protocols(["01", "1"])),
        lambda s: [p.name for p in s.protocols] == ["01", "1"],
    ),
    Accepted(
        "stretch off one",
        content(GOOD.replace("1.0000,1.0000", "1.0010,0.9990")),
        lambda s: s.protocols[0].stretch_x[0] == 1.0 and len(s.notes) == 1,
    ),
    Accepted(
        "rest rows stated",
        content("# rest_rows: 3\n" + GOOD),
        lambda s: s.protocols[0].rest_rows == 3,
    ),
    Accepted(
        "a confirmed stress",
        content("# stress_limit_kPa: 1e9\n" + scaled(1000.0)),
        lambda s: s.peak_load > 100.0,
    ),
    Accepted(
        "negative forces at rest",
        content(with_cell("-0.001", row=0)),
        lambda s: s.protocols[0].load_x[0] == -0.001,
    ),
    Accepted(
        "a stretch from an image",
        content("# mounting_stretch_x: 1.03 ± 0.01\n" + GOOD),
        lambda s: s.metadata["mounting_stretch_x"] == "1.03 ± 0.01",
    ),
]
