"""Make the files in ``data/examples/`` that the tutorial and the how-to page begin with.

    python scripts/make_examples.py [--out data/examples]

They are what machines write of virtual specimens: an export of a BioTester, a workbook with a sheet
a protocol, a table of another machine (semicolons, decimal comma, Windows letters), and a record
that was tared after mounting. What is in them and which command reads it: ``data/README.md``.
"""

from __future__ import annotations

import argparse
import io
import re
import zipfile
from dataclasses import replace
from pathlib import Path

from biaxbayes.laws.published import MATERIALS
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from biaxbayes.specimens.virtual_specimen import Dimensions, Machine, virtual_specimen
from make_specimens import EDGE_MM, FIRST_SEED, HOOKED, LAYERS, NOISE_N, table6_specimen
from virtual_biotester import biotester_export

__all__ = ["make"]

DATA = Path(__file__).parents[1] / "data"
MEDIA = "donor2-media"
NEXT_SEED = FIRST_SEED + len(LAYERS) + len(HOOKED)
RATIOS = {"1 to 1": (1.0, 1.0), "1 to 0.5": (1.0, 0.5), "0.5 to 1": (0.5, 1.0)}
ROWS = 41
DIGITS = (5, 5, 3, 3)
"""Behind the point, of stretches and stresses in the workbook."""
FORCE_DIGITS = 7
WRITTEN = (2024, 9, 1, 0, 0, 0)
"""Day in the workbook, so that the same content gives the same bytes."""


def biotester() -> bytes:
    """A preconditioning set and the measured one, of three cycles."""
    first = biotester_export(name="Precondition", cycles=1, rows=ROWS, seed=NEXT_SEED)
    main = biotester_export(name="Equibiaxial", cycles=3, rows=ROWS, seed=NEXT_SEED + 1)
    return (first.text() + main.text().split("\n", 1)[1]).encode()


def workbook() -> bytes:
    """Piola stresses of the media, three stretch ratios, and a sheet of notes."""
    import openpyxl

    published = MATERIALS[MEDIA]
    assert published.thickness_mm is not None and published.measured_stretch is not None
    specimen, _ = virtual_specimen(
        published.material,
        name=MEDIA,
        mounting_stretch=published.mounting_stretch,
        measured_stretch=published.measured_stretch,
        ratios=tuple(RATIOS.values()),
        increments=ROWS - 1,
        dimensions=Dimensions(EDGE_MM, EDGE_MM, published.thickness_mm),
        machine=Machine(noise_N=NOISE_N, loads="piola"),
        seed=NEXT_SEED + 4,
    )
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, p in zip(RATIOS, specimen.protocols, strict=True):
        sheet = book.create_sheet(name)
        sheet.append(["F11", "F22", "P11_kPa", "P22_kPa"])
        columns = (p.stretch_x, p.stretch_y, p.load_x, p.load_y)
        for row in zip(*(column.tolist() for column in columns), strict=True):
            sheet.append([round(value, digits) for value, digits in zip(row, DIGITS, strict=True)])
    book.create_sheet("Notes").append(["virtual media of donor 2"])
    out = io.BytesIO()
    book.save(out)
    return _dated(out.getvalue())


def _dated(book: bytes) -> bytes:
    """The same workbook with a fixed day in its members and its properties."""
    out = io.BytesIO()
    day = "{}-{:02}-{:02}T{:02}:{:02}:{:02}Z".format(*WRITTEN).encode()
    with zipfile.ZipFile(io.BytesIO(book)) as old, zipfile.ZipFile(out, "w") as new:
        for name in sorted(old.namelist()):
            data = old.read(name)
            if name == "docProps/core.xml":
                data = re.sub(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", day, data)
            entry = zipfile.ZipInfo(name, WRITTEN)
            entry.external_attr = 0o644 << 16
            new.writestr(entry, data)  # stored: how well zlib packs depends on its version
    return out.getvalue()


def tensile_machine() -> bytes:
    """Displacements of the grips and forces of the media, as a German machine writes them."""
    specimen, _ = table6_specimen(MEDIA, NEXT_SEED + 3)
    p = specimen.protocols[0]
    lines = ["Prüfzeit [s];Weg X [mm];Weg Y [mm];Kraft X [N];Kraft Y [N]"]
    for i in range(0, p.rows, 2):
        moved = [(stretch[i] - 1.0) * EDGE_MM for stretch in (p.stretch_x, p.stretch_y)]
        cells = [f"{0.5 * i:.1f}", *(f"{v:.3f}" for v in moved)]
        cells += [f"{load[i]:.5f}" for load in (p.load_x, p.load_y)]
        lines.append(";".join(cells).replace(".", ","))
    return ("\r\n".join(lines) + "\r\n").encode("cp1252")


def make(folder: Path) -> None:
    """Write all examples into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in (
        ("biotester.csv", biotester()),
        ("workbook.xlsx", workbook()),
        ("tensile-machine.csv", tensile_machine()),
    ):
        (folder / name).write_bytes(content)
    tared = read_specimen(DATA / f"{MEDIA}.csv").zeroed()
    rounded = [
        replace(p, load_x=p.load_x.round(FORCE_DIGITS), load_y=p.load_y.round(FORCE_DIGITS))
        for p in tared.protocols
    ]
    write_specimen(replace(tared, protocols=tuple(rounded)), folder / "tared.csv")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DATA / "examples")
    make(parser.parse_args().out)


if __name__ == "__main__":
    main()
