"""Make the virtual specimens in ``data/``: known material, known mounting stretch, honest errors.

    python scripts/make_specimens.py [--out data]

Specimens are the rows of Table 6 of Math. Comput. Appl. 2024, 29(4), 55 that infer the
prestretch, with the dimensions and stretch ranges of its Table 2.

The seeds are 551, 552, ...: article 55, specimen 1, 2, ... They were written down before any
fit was run and have not been changed since; another choice would serve as well, and how the
intervals do over other seeds stands beside the shipped ones in ``data/README.md``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from biaxbayes.mechanics.materials import MATERIALS
from biaxbayes.specimens.specimen import Specimen
from biaxbayes.specimens.specimen_file import write_specimen
from biaxbayes.specimens.virtual_specimen import (
    Dimensions,
    Machine,
    Truth,
    virtual_specimen,
    write_truth,
)

EDGE_MM = 20.0
INCREMENTS = 100
NOISE_N = 0.0006  # resolution of the load cell, Section 2.4
MISFIT = 0.02
FIRST_SEED = 551
LAYERS = {
    "donor1": "wall",
    "donor2": "wall",
    "donor2-intima": "intima",
    "donor2-media": "media",
    "donor2-adventitia": "adventitia",
}
AXES = {"axis_x": "circumferential", "axis_y": "axial"}


def table6_specimen(name: str, seed: int) -> tuple[Specimen, Truth]:
    """The shipped specimen of this name, with any seed."""
    published = MATERIALS[name]
    assert published.thickness_mm is not None
    return virtual_specimen(
        published.material,
        name=name,
        mounting_stretch=published.mounting_stretch,
        measured_stretch=published.measured_stretch,
        increments=INCREMENTS,
        dimensions=Dimensions(EDGE_MM, EDGE_MM, published.thickness_mm),
        machine=Machine(noise_N=NOISE_N, misfit=MISFIT),
        seed=seed,
        labels={"layer": LAYERS[name], **AXES},
        source=published.source,
    )


def make(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    truths = []
    for index, name in enumerate(LAYERS):
        specimen, truth = table6_specimen(name, FIRST_SEED + index)
        write_specimen(specimen, folder / f"{name}.csv")
        truths.append(truth)
    write_truth(truths, folder / "truth.json")
    print(f"{len(truths)} specimens and truth.json in {folder}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "data")
    make(parser.parse_args().out)


if __name__ == "__main__":
    main()
