"""Tables of other programs in every format: what is read, what is passed over, what is refused."""

import io
import re
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from biaxbayes.errors import InputError
from biaxbayes.machines.choice import Choice
from biaxbayes.machines.conversion import convert
from biaxbayes.machines.outcome import OpenQuestions
from biaxbayes.specimens.specimen_file import read_specimen
from workbooks import read_tables, xlsx

T = np.linspace(0.0, 1.0, 31)
NAMES = ["F11", "F22", "P11_kPa", "P22_kPa"]
VALUES = np.column_stack([1 + 0.2 * T, 1 + 0.15 * T, 2 + 60 * T**2, 1 + 40 * T**3])
COLUMNS = "stretch_x=F11,stretch_y=F22,piola_x_kPa=P11_kPa,piola_y_kPa=P22_kPa"


def read(path: Path, *, columns: str = COLUMNS, **choice):
    return convert([path], Choice("generic", (columns,), **choice), header={})


def holds(path: Path, *, columns: str = COLUMNS, rows=slice(None), **choice) -> bool:
    (p,) = read(path, columns=columns, **choice).specimen.protocols
    got = np.column_stack([p.stretch_x, p.stretch_y, p.load_x, p.load_y])
    return np.allclose(got, VALUES[rows], rtol=1e-9)


def text_table(separator: str = ",", *, extra: str = "", decimal: str = ".") -> str:
    lines = [separator.join([*NAMES, *(["Comment"] if extra else [])])]
    for i, row in enumerate(VALUES.tolist()):
        cells = [repr(v).replace(".", decimal) for v in row]
        lines.append(separator.join([*cells, *([extra if i == 7 else ""] if extra else [])]))
    return "\n".join(lines) + "\n"


# --- preambles, comments, clocks ------------------------------------------------------------------

LABVIEW = """LabVIEW Measurement\t\t\t
Writer_Version\t2\t\t
***End_of_Header***\t\t\t
Channels\t4\t\t
Samples\t31\t31\t31
Date\t2020/01/02\t2020/01/02\t2020/01/02
Time\t10:31:00\t10:31:00\t10:31:00
X0\t0.0\t0.0\t0.0
Delta_X\t0.1\t0.1\t0.1
***End_of_Header***\t\t\t
"""


PREAMBLES = [
    ("Specimen,A-12,,\nDate,2020-01-02,,\n,,,\nThickness,1.2,mm,\n", ","),
    ("Length;10;12;8\nWidth;3;4;5\n;;;\n", ";"),
    (LABVIEW, "\t"),
    ("made by hand\n\nno separators here\n", ","),
]
COMMENTS = [("\t", "slipped"), (";", "1,5"), ("\t", "peak!"), (";", "2.3"), ("\t", "10:31:00")]
FOREIGN = [(code, "Kraft Prüfling") for code in ("latin-1", "cp1252", "mac-roman")]
FOREIGN += [("cp932", "荷重"), ("gb18030", "载荷")]
TEXT = text_table()
WRITTEN = [
    *((preamble + text_table(separator)).encode() for preamble, separator in PREAMBLES),
    # a column that is filled in few rows, which may be shorter than the others
    *(text_table(separator, extra=words).encode() for separator, words in COMMENTS),
    *(text_table(s, extra=words).replace(f"{s}\n", "\n").encode() for s, words in COMMENTS),
    *(TEXT.replace("P11_kPa", name).encode(encoding) for encoding, name in FOREIGN),
    TEXT.replace("P22_kPa", '"P22_kPa\n"').encode(),
    TEXT.replace("P11_kPa", '"P11\n[kPa]"').encode(),
    *(f"# {text_table(separator)}".encode() for separator in ", \t"),  # of numpy.savetxt
    TEXT.encode("utf-16-le"),
    TEXT.encode("utf-16-be"),
    TEXT.encode() + b"\x1a",
    TEXT.replace("\n", "\r\n").encode() + b"\r\n\x1a",
    TEXT.replace("e-", "e\u2212").encode(),
]


@pytest.mark.parametrize("written", WRITTEN)
def test_a_table_is_found_however_its_text_is_written(written, tmp_path):
    """Names that are odd, or in another encoding, are given by position."""
    path = tmp_path / "raw.txt"
    path.write_bytes(written)
    assert holds(path, columns=COLUMNS.replace("P11_kPa,", "#3:kPa,").replace("=P22_kPa", "=#4"))


@pytest.mark.parametrize("name", ["Time", "Clock", "time_s", "Zeit"])
def test_a_clock_that_nobody_mapped_is_no_obstacle(name, tmp_path):
    path = tmp_path / "raw.csv"
    head, *rows = text_table().splitlines()
    clock = [f"10:31:{i:02d},{row}" for i, row in enumerate(rows)]
    path.write_text("\n".join([f"{name},{head}", *clock]))
    assert holds(path)
    with pytest.raises(InputError, match="'10:31:00' is not a"):
        read(path, columns=f"{COLUMNS},time_s={name}")


@pytest.mark.parametrize(
    ("numbers", "decimal"),
    [("0,123;1,5;2,125", True), ("1,250;2,375;3,500", None), ("0,125;2,375;3,500", True)],
)
def test_thousands_are_not_taken_for_decimals(numbers, decimal, tmp_path):
    path = tmp_path / "raw.csv"
    path.write_text("a;b;c\n" + f"{numbers}\n" * 4)
    if decimal is None:
        with pytest.raises(InputError, match="may be decimals or thousands"):
            read_tables(path)
    else:
        assert read_tables(path)[0][""].decimal_comma is decimal


# --- missing readings -----------------------------------------------------------------------------


@pytest.mark.parametrize("gap", ["NaN", "", "n/a", "--"])
def test_lost_markers_are_named_at_once_and_dropped_if_asked(gap, tmp_path):
    path = tmp_path / "raw.csv"
    lines = text_table().splitlines()
    lost = [3, 4, 5, 9, 20]
    for i in lost:
        lines[i + 1] = ",".join([gap, *lines[i + 1].split(",")[1:]])
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="5 of 31 rows lack a reading") as refusal:
        read(path)
    assert "rows 5-7, 11, 22" in str(refusal.value) and "`drop_missing=True`" in str(refusal.value)
    kept = np.delete(np.arange(31), lost)
    assert holds(path, rows=kept, drop_missing=True)
    told = read(path, drop_missing=True).account
    assert "5  a reading is missing:" in told and "lines 5-7, 11, 22" in told


def test_a_specimen_file_says_which_readings_are_missing(tmp_path):
    path = tmp_path / "specimen.csv"
    lines = text_table().splitlines()
    lines[0] = "stretch_x,stretch_y,piola_x_kPa,piola_y_kPa"
    for i in (10, 11, 14):
        lines[i] = ",".join(["NaN", *lines[i].split(",")[1:]])
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"3 of 31 rows lack.*rows 11-12, 15.*missing_rows: drop"):
        read_specimen(path)  # lines count from 1
    path.write_text("# missing_rows: drop\n" + path.read_text())
    specimen = read_specimen(path)
    assert specimen.protocols[0].rows == 28 and "3 of 31 rows" in specimen.notes[0]


# --- workbooks, MATLAB, LabVIEW -------------------------------------------------------------------


def xls(sheets: dict[str, list[list[object]]]) -> bytes:
    import xlwt

    book = xlwt.Workbook()
    for name, rows in sheets.items():
        sheet = book.add_sheet(name)
        for i, row in enumerate(rows):
            for j, value in enumerate(row):
                sheet.write(i, j, value)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def ods(sheets: dict[str, list[list[object]]]) -> bytes:
    """An OpenDocument workbook by hand, with the empty cells to the margin that programs write."""

    def cell(value: object) -> str:
        kind = f'float" office:value="{value!r}' if isinstance(value, float) else "string"
        text = f"<text:p>{value}</text:p>"
        return f'<table:table-cell office:value-type="{kind}">{text}</table:table-cell>'

    margin = '<table:table-row table:number-rows-repeated="1048000"><table:table-cell '
    margin += 'table:number-columns-repeated="16384"/></table:table-row></table:table>'
    tables = ""
    for name, rows in sheets.items():
        cells = (f"<table:table-row>{''.join(map(cell, row))}</table:table-row>" for row in rows)
        tables += f'<table:table table:name="{name}">{"".join(cells)}{margin}'
    urn = "urn:oasis:names:tc:opendocument:xmlns"
    spaces = " ".join(f'xmlns:{n}="{urn}:{n}:1.0"' for n in ("office", "table", "text"))
    for tag in ("spreadsheet", "body"):
        tables = f"<office:{tag}>{tables}</office:{tag}>"
    content = f"<office:document-content {spaces}>{tables}</office:document-content>"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("content.xml", content)
        archive.writestr("META-INF/manifest.xml", "<manifest/>")
    return out.getvalue()


ROWS = [list(NAMES), *VALUES.tolist()]
INFO = [["Specimen", "A-12"], ["Operator", "me"], ["Thickness", 1.2]]
BOOKS = {"xlsx": xlsx, "xls": xls, "ods": ods}


@pytest.mark.parametrize("kind", BOOKS)
def test_workbooks_of_all_kinds(kind, tmp_path):
    pytest.importorskip({"xls": "xlwt"}.get(kind, "openpyxl"))
    path = tmp_path / f"raw.{kind}"
    path.write_bytes(BOOKS[kind]({"1 to 1": ROWS}))
    assert holds(path)
    preamble = [["Specimen", "A-12"], ["Thickness", 1.2], []]
    path.write_bytes(BOOKS[kind]({"1 to 1": [*preamble, *ROWS]}))
    assert holds(path)
    path.write_bytes(BOOKS[kind]({"Info": INFO, "a": ROWS}))
    assert holds(path)
    # An info sheet is named and left out; a sheet with a table is a protocol.
    other = [NAMES, *(VALUES[:, [1, 0, 3, 2]] ** [1, 2, 1, 1]).tolist()]
    path.write_bytes(BOOKS[kind]({"Info": INFO, "a": ROWS, "b": other}))
    result = read(path, sheets=("all",))
    assert [p.name for p in result.specimen.protocols] == ["a", "b"]
    assert result.specimen.protocols[1].stretch_y[-1] == pytest.approx(1.2**2)
    assert "sheets left out: Info" in result.account
    chosen = read(path, sheets=("b", "a")).specimen
    assert [p.name for p in chosen.protocols] == ["b", "a"]
    for sheets, says in (
        ((), "more than one sheet"),
        (("a", "a"), "'a'"),
        (("a", "Info"), "'Info' holds no table"),
        (("C",), "no sheet 'C'"),
    ):
        with pytest.raises(InputError, match=says):
            read(path, sheets=sheets)
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(InputError, match="not a readable workbook"):
        read(path)


def test_matlab_files(tmp_path):
    import h5py
    import scipy.io

    path = tmp_path / "raw.mat"
    vectors = dict(zip(NAMES, VALUES.T, strict=True))
    for content in (
        vectors,
        {"test": vectors, "info": "by hand", "n": 3.0},
        {k: v[:, None] for k, v in vectors.items()} | {"calibration": np.arange(4.0)},
    ):
        for packed in (False, True):
            scipy.io.savemat(path, content, do_compression=packed)
            assert holds(path)
    scipy.io.savemat(path, {"M": VALUES})
    names = "stretch_x={M_1},stretch_y={M_2},piola_x_kPa=M_3:kPa,piola_y_kPa=M_4:kPa"
    assert holds(path, columns=names)
    # Version 7.3 is HDF5 behind 512 bytes, its arrays turned round.
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("test")
        for name, values in vectors.items():
            group[name] = values[None, :]
        file["M"] = VALUES.T
        file["M"].attrs["MATLAB_class"] = np.bytes_("double")
        cells = file.create_dataset("cells", (2, 1), dtype=h5py.ref_dtype)
        cells[0, 0], cells[1, 0] = file["M"].ref, group.ref
        group["away"] = h5py.ExternalLink("/etc/passwd", "/x")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(128))
    assert holds(path, sheets=("test",))
    assert holds(path, sheets=("variables",), columns=names)
    assert holds(path, sheets=("cells(2)",))
    assert holds(path, sheets=("cells(1)",), columns=names.replace("M_", "cells_"))
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(InputError, match="not a readable MATLAB file"):
        read(path)


@pytest.mark.parametrize("kind", ["matrices", "rows", "structs", "cells", "nested", "npz"])
def test_arrays_of_matlab_and_numpy_in_other_forms(kind, tmp_path):
    import scipy.io

    path = tmp_path / "raw.mat"
    vectors = dict(zip(NAMES, VALUES.T, strict=True))
    pairs = {"lam": VALUES[:, :2], "P": VALUES[:, 2:]}
    of_pairs = "stretch_x={lam_1},stretch_y={lam_2},piola_x_kPa=P_1:kPa,piola_y_kPa=P_2:kPa"
    if kind == "npz":
        path = path.with_suffix(".npz")
        np.savez(path, **pairs)
        assert holds(path, columns=of_pairs)
        return
    two = np.empty(2, dtype=object)
    two[:] = [vectors, {k: 1.0 + 0.5 * (v - 1.0) for k, v in vectors.items()}]
    content, columns, sheets = {
        "matrices": (pairs, of_pairs, ()),
        "rows": ({k: v.T for k, v in pairs.items()}, of_pairs, ()),
        "structs": ({"runs": two}, COLUMNS, ("runs(1)",)),
        "cells": ({"runs": {"data": two}}, COLUMNS, ("runs.data(1)",)),
        "nested": ({"exp": {"day": {"run": vectors, "n": 3.0}}}, COLUMNS, ()),
    }[kind]
    scipy.io.savemat(path, content)
    assert holds(path, columns=columns, sheets=sheets)
    if kind == "structs":
        with pytest.raises(OpenQuestions) as question:
            read(path)
        assert [*question.value.choices][:3] == ["sheets=runs(1)", "sheets=runs(2)", "sheets=all"]


def test_labview_files(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "raw.tdms"
    named = zip(("F11", "F22", "P11", "P22"), VALUES.T, ("", "", "kPa", "kPa"), strict=True)
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([
            nptdms.ChannelObject("1 to 1", name, values, {"unit_string": unit})
            for name, values, unit in named
        ])  # fmt: skip
    assert holds(path, columns=COLUMNS.replace("1_kPa,", "1,").replace("P22_kPa", "P22"))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=r"TDMS|no sheet|no table"):
        read(path)


# --- bombs ----------------------------------------------------------------------------------------


def book_of(sheet: str) -> bytes:
    """A small .xlsx with one sheet as given."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        with zipfile.ZipFile(io.BytesIO(xlsx({"a": [["x"]]}))) as old:
            for name in old.namelist():
                if "sheet1" not in name:
                    archive.writestr(name, old.read(name))
        space = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
        archive.writestr(
            "xl/worksheets/sheet1.xml",
            f"<worksheet {space}><sheetData>{sheet}</sheetData></worksheet>",
        )

    return out.getvalue()


def mat_of_many_cells() -> bytes:
    """A cell array of 3e8 cells in some hundred bytes."""
    import scipy.io

    out = io.BytesIO()
    scipy.io.savemat(out, {"c": np.array([[1.0], [2.0], [3.0]], dtype=object)})
    small, large = (np.array([n, 1], dtype="<i4").tobytes() for n in (3, 300_000_000))
    return out.getvalue().replace(small, large, 1)


def npz_of_many_numbers() -> bytes:
    """An array that claims 3e8 numbers."""
    array, out = io.BytesIO(), io.BytesIO()
    described = {"descr": "<f8", "fortran_order": False, "shape": (300_000_000,)}
    np.lib.format.write_array_header_1_0(array, described)
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("a.npy", array.getvalue())
    return out.getvalue()


def repeating_ods() -> bytes:
    """A cell with a value that repeats over a whole sheet."""
    out = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(ods({"a": ROWS}))) as old,
        zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            content = old.read(name)
            for what, often in ((b"table-row", b'rows-repeated="900000"'),
                                (b"table-cell", b'columns-repeated="9000"')):  # fmt: skip
                repeated = b"<table:" + what + b" table:number-" + often
                content = content.replace(b"<table:" + what, repeated, 1)
            new.writestr(name, content)
    return out.getvalue()


CORNERS = (
    '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'
)
BOMBS = {
    "a row of nine million cells": lambda: book_of("<row>" + "<c/>" * 9_000_000 + "</row>"),
    "two cells at the corners": lambda: book_of(CORNERS),
    "the same in single quotes": lambda: book_of(CORNERS.replace('"', "'")),
    "an ods that repeats a row": repeating_ods,
    "a .mat of cells": mat_of_many_cells,
    "an .npz of many numbers": npz_of_many_numbers,
}


def child_of(process: subprocess.Popen) -> str:
    """The number of the process that another one has started."""
    started = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not (child := started.read_text().strip()):
        assert process.poll() is None
        time.sleep(0.01)
    return child


def has_ended(number: str) -> bool:
    """Whether a process ends soon; one that nobody waits for is a zombie (Z) afterwards."""
    state = Path(f"/proc/{number}/stat")
    until = time.monotonic() + 30.0
    while time.monotonic() < until:
        try:
            if state.read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for the process in /proc")
def test_the_process_that_reads_a_file_ends_with_the_command(tmp_path):
    path = tmp_path / "large.xlsx"
    path.write_bytes(BOMBS["a row of nine million cells"]())
    words = ("convert", str(path), "--machine", "generic", "--out", "x.csv")
    command = [sys.executable, "-m", "biaxbayes", *words]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as convert:
        reader = child_of(convert)
        convert.terminate()
        assert convert.wait(60) == 128 + signal.SIGTERM
        assert "biaxbayes: stopped at once" in convert.stderr.read()
    assert has_ended(reader)


@pytest.mark.skipif(
    sys.platform == "win32", reason="Windows keeps the number of a parent that ended"
)
def test_the_process_that_reads_a_file_ends_with_a_command_that_is_killed(tmp_path):
    path = tmp_path / "large.xlsx"
    path.write_bytes(BOMBS["a row of nine million cells"]())
    words = "from pathlib import Path; from biaxbayes.tables.sheets import read_sheets; "
    command = [sys.executable, "-c", f"{words}read_sheets(Path({str(path)!r}))"]
    with subprocess.Popen(command, cwd=tmp_path) as parent:
        reader = child_of(parent)
        parent.kill()
    assert has_ended(reader)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * ("nine" in n)) for n in BOMBS]
)
def test_a_small_file_does_not_take_the_memory(name, tmp_path):
    path = tmp_path / "bomb.xlsx"
    path.write_bytes(BOMBS[name]())
    assert path.stat().st_size < 2_000_000
    with pytest.raises(InputError) as refusal:
        read_tables(path)
    said = str(refusal.value)
    # cells without a value may be passed over without being kept
    empty = "nine million" in name and "holds no table: 0 rows" in said
    assert empty or ("as CSV" in said and re.search("takes more than 1 GB|not a readable", said))


# --- texts of other programs ----------------------------------------------------------------------


def test_an_archive_that_is_no_workbook_is_named(tmp_path):
    path = tmp_path / "raw.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("tests/one.csv", text_table())
    with pytest.raises(InputError, match=r"is a ZIP archive.*unpack it.*tests/one\.csv"):
        read(path)


def test_group_headers_and_repeated_names_are_given_by_position(tmp_path):
    path = tmp_path / "raw.csv"
    rows = "\n".join(",".join(map(repr, row)) for row in VALUES[:, [0, 2, 1, 3]].tolist())
    path.write_text("Axis X,,Axis Y,\nStretch,Load,Stretch,Load\n-,kPa,-,kPa\n" + rows + "\n")
    columns = COLUMNS.replace("F11", "Stretch").replace("F22", "#3")
    with pytest.raises(InputError, match=r"give it by position, as #1"):
        read(path, columns=columns)
    assert holds(path, columns="stretch_x=#1,stretch_y=#3,piola_x_kPa=#2,piola_y_kPa=#4")


def test_hidden_rows_and_sheets_are_asked_about(tmp_path):
    import openpyxl

    path = tmp_path / "raw.xlsx"
    wrong = VALUES * [1, 1, 0.9, 0.9]
    path.write_bytes(xlsx({"seen": [NAMES, *VALUES.tolist()], "old": [NAMES, *wrong.tolist()]}))
    book = openpyxl.load_workbook(path)
    book["old"].sheet_state = "hidden"
    book.save(path)
    with pytest.raises(OpenQuestions, match="'old' is hidden"):
        read(path)
    assert holds(path, hidden="drop")
    assert holds(path, sheets=("seen",))
    book["old"].sheet_state = "visible"
    for row in (5, 9, 20):
        book["seen"].row_dimensions[row].hidden = True
    book.save(path)
    with pytest.raises(OpenQuestions, match="3 rows of 'seen' are hidden or filtered"):
        read(path, sheets=("seen",))
    result = read(path, sheets=("seen",), hidden="drop")
    assert result.specimen.protocols[0].rows == 28
    assert "3  hidden:" in result.account
    assert holds(path, sheets=("seen",), hidden="keep")


def test_a_file_that_only_unpacks_to_much_is_no_table(tmp_path):
    path = tmp_path / "spaces.xlsx"
    path.write_bytes(book_of(" " * 210_000_000))
    with pytest.raises(InputError, match="holds no table"):
        read_tables(path)
